"""A flight as an MCAP file that Foxglove opens as it is: messages with Foxglove's own schemas, as JSON.

Every report has its own time; nothing is interpolated. The team's frame is called ``team``, ENU; bodies are x forward,
y left, z up.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
from mcap.writer import CompressionType, Writer

from groundstation.app.body_axes import enu_from_flu
from groundstation.core.frames import quat_ned_from_frd_of_euler
from groundstation.core.types import FloatArray
from groundstation.records.replay import Flight
from groundstation.records.tracks import VehicleTrack
from groundstation.records.wide import Cells

_LEVEL = np.array([1.0, 0.0, 0.0, 0.0])

_TIME = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
_VECTOR = {"type": "object", "properties": {axis: {"type": "number"} for axis in "xyz"}}
_QUATERNION = {"type": "object", "properties": {axis: {"type": "number"} for axis in "xyzw"}}
_POSE = {"type": "object", "properties": {"position": _VECTOR, "orientation": _QUATERNION}}
_NUMBER, _TEXT = {"type": "number"}, {"type": "string"}
SCHEMAS: dict[str, dict[str, object]] = {
    "foxglove.PoseInFrame": {"timestamp": _TIME, "frame_id": _TEXT, "pose": _POSE},
    "foxglove.FrameTransform": {"timestamp": _TIME, "parent_frame_id": _TEXT, "child_frame_id": _TEXT,
                                "translation": _VECTOR, "rotation": _QUATERNION},
    "foxglove.Log": {"timestamp": _TIME, "level": {"type": "integer"}, "message": _TEXT, "name": _TEXT,
                     "file": _TEXT, "line": {"type": "integer"}},
    "gs.Velocity": {"x_enu_m_s": _NUMBER, "y_enu_m_s": _NUMBER, "z_enu_m_s": _NUMBER},
    "gs.Team": {"phase": _TEXT, "min_distance_m": _NUMBER, "min_distance_pair": _TEXT, "formation_error_m": _NUMBER},
    "gs.Distances": {},
    "gs.Flight": {"name": _TEXT, "outcome": _TEXT, "reason": _TEXT, "safety_radius_m": _NUMBER},
}  # fmt: skip
"""Name of a schema: the properties of its messages. Foxglove's are those of its documentation of well-known schemas."""
_INFO, _WARNING = 2, 3


def write(flight: Flight, table: dict[str, Cells], made_by: str) -> tuple[bytes, dict[str, object]]:
    """The file, and what is told of it; ``table`` is ``records.wide.wide`` of the flight."""
    epoch_ns = 0 if flight.manifest is None else 1_000 * flight.manifest.epoch_unix_us
    items = messages(flight, table)
    return to_mcap(items, epoch_ns, made_by), {"messages": len(items), "topics": len({item.topic for item in items})}


class Message(NamedTuple):
    """One message: time in ns since the flight began, topic, name of its schema, content."""

    t_ns: int
    topic: str
    schema: str
    content: dict[str, object]


def messages(flight: Flight, table: dict[str, Cells]) -> list[Message]:
    """Everything that is told of a flight, in order of time.

    Args:
        flight: as read.
        table: ``records.wide.wide`` of it, for what concerns the whole team.
    """
    whole: list[Message] = [Message(0, "/flight", "gs.Flight", _about(flight))]
    for track in flight.vehicles:
        whole += _of_vehicle(flight, track)
    whole += _of_team(table)
    for event in flight.events:
        level = _WARNING if event.text.startswith("alarm") else _INFO
        since_ns = event.t_ns - flight.start_ns
        content = {"timestamp": _time(since_ns), "level": level, "message": event.text, "name": "gs", "file": "",
                   "line": 0}  # fmt: skip
        whole.append(Message(since_ns, "/events", "foxglove.Log", content))
    return sorted(whole, key=lambda message: message.t_ns)


def to_mcap(items: Iterable[Message], epoch_ns: int, made_by: str) -> bytes:
    """The file.

    Args:
        items: messages in order of time.
        epoch_ns: Unix time at which the flight began; 0 where it is not known.
        made_by: named in its head.
    """
    buffer = io.BytesIO()
    writer = Writer(buffer, compression=CompressionType.NONE)
    writer.start(library=made_by)
    channels: dict[str, int] = {}
    schemas: dict[str, int] = {}
    for number, item in enumerate(items):
        if item.schema not in schemas:
            schema = {"title": item.schema, "type": "object", "properties": SCHEMAS[item.schema]}
            schemas[item.schema] = writer.register_schema(item.schema, "jsonschema", json.dumps(schema).encode())
        if item.topic not in channels:
            channels[item.topic] = writer.register_channel(item.topic, "json", schemas[item.schema])
        content = {**item.content}
        if "timestamp" in content:
            content["timestamp"] = _time(epoch_ns + item.t_ns)
        writer.add_message(
            channels[item.topic], log_time=epoch_ns + item.t_ns, publish_time=epoch_ns + item.t_ns, sequence=number,
            data=json.dumps(content, allow_nan=False).encode(),
        )  # fmt: skip
    writer.finish()  # type: ignore[no-untyped-call]
    return buffer.getvalue()


def _about(flight: Flight) -> dict[str, object]:
    result = (None if flight.manifest is None else flight.manifest.result) or {}
    about: dict[str, object] = {"name": flight.name}
    about |= {key: str(result[key]) for key in ("outcome", "reason") if key in result}
    return about if flight.safety_radius_m is None else about | {"safety_radius_m": flight.safety_radius_m}


def _of_vehicle(flight: Flight, track: VehicleTrack) -> Iterator[Message]:
    name = f"/vehicles/{track.sysid}"
    frame = "team" if track.in_team_frame else f"origin_{track.sysid}"
    turned = [enu_from_flu(quat) for quat in quat_ned_from_frd_of_euler(*track.rpy_ned_rad.T)]
    last = np.searchsorted(track.attitude_t_ns, track.t_ns, side="right") - 1
    for row, (t_ns, pos) in enumerate(zip(track.t_ns.tolist(), track.pos_team_enu_m, strict=True)):
        if not np.isfinite(pos).all():
            continue
        quat = _LEVEL if last[row] < 0 else turned[last[row]]
        since_ns, place, rotation = t_ns - flight.start_ns, _vector(pos), _quaternion(quat)
        yield Message(since_ns, f"{name}/pose", "foxglove.PoseInFrame",
                      {"timestamp": _time(since_ns), "frame_id": frame,
                       "pose": {"position": place, "orientation": rotation}})  # fmt: skip
        yield Message(since_ns, "/tf", "foxglove.FrameTransform",
                      {"timestamp": _time(since_ns), "parent_frame_id": frame, "child_frame_id": f"v{track.sysid}",
                       "translation": place, "rotation": rotation})  # fmt: skip
    for what, times_ns, values in (
        ("velocity", track.t_ns, track.vel_enu_m_s),
        ("setpoint", track.setpoint_t_ns, track.setpoint_vel_enu_m_s),
    ):
        for t_ns, velocity in zip(times_ns.tolist(), values, strict=True):
            if np.isfinite(velocity).all():
                content: dict[str, object] = {
                    f"{axis}_enu_m_s": float(value) for axis, value in zip("xyz", velocity, strict=True)
                }
                yield Message(t_ns - flight.start_ns, f"{name}/{what}", "gs.Velocity", content)


def _of_team(table: dict[str, Cells]) -> Iterator[Message]:
    pairs = [name for name in table if name.startswith("distance_")]
    for row, t_s in enumerate(table["t_s"]):
        since_ns = round(float(t_s) * 1e9)
        team = {name: _known(table[name][row]) for name in SCHEMAS["gs.Team"]}
        yield Message(since_ns, "/team", "gs.Team", {name: value for name, value in team.items() if value is not None})
        distances = {name: _known(table[name][row]) for name in pairs}
        known = {name: value for name, value in distances.items() if value is not None}
        if known:
            yield Message(since_ns, "/team/distances", "gs.Distances", known)


def _known(value: object) -> object | None:
    if isinstance(value, str):
        return value or None
    number = float(value)  # type: ignore[arg-type]  # a number of an array
    return number if np.isfinite(number) else None


def _vector(values: FloatArray) -> dict[str, float]:
    return {axis: float(value) for axis, value in zip("xyz", values, strict=True)}


def _quaternion(wxyz: FloatArray) -> dict[str, float]:
    return {axis: float(value) for axis, value in zip("wxyz", wxyz, strict=True)}


def _time(t_ns: int) -> dict[str, int]:
    return {"sec": t_ns // 1_000_000_000, "nsec": t_ns % 1_000_000_000}
