"""A flight as an MCAP file that Foxglove opens as it is: messages with Foxglove's own schemas, as JSON.

Every report has its own time; nothing is interpolated. The team's frame is called ``team``, ENU; bodies are x forward,
y left, z up.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterable, Iterator

import numpy as np
from mcap.writer import CompressionType, Writer

from groundstation.app.body_axes import enu_from_flu
from groundstation.app.foxglove_messages import (
    SCHEMAS,
    TEAM,
    Message,
    log_message,
    pose_messages,
    schema_of,
    stamped,
    velocity_message,
)
from groundstation.core.frames import quat_ned_from_frd_of_euler
from groundstation.records.replay import Flight
from groundstation.records.tracks import VehicleTrack
from groundstation.records.wide import Cells

_LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


def write(flight: Flight, table: dict[str, Cells], made_by: str) -> tuple[bytes, dict[str, object]]:
    """The file, and what is told of it; ``table`` is ``records.wide.wide`` of the flight."""
    epoch_ns = 0 if flight.manifest is None else 1_000 * flight.manifest.epoch_unix_us
    items = messages(flight, table)
    return to_mcap(items, epoch_ns, made_by), {"messages": len(items), "topics": len({item.topic for item in items})}


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
    whole += [log_message(event.t_ns - flight.start_ns, event.text) for event in flight.events]
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
            schema = json.dumps(schema_of(item.schema)).encode()
            schemas[item.schema] = writer.register_schema(item.schema, "jsonschema", schema)
        if item.topic not in channels:
            channels[item.topic] = writer.register_channel(item.topic, "json", schemas[item.schema])
        writer.add_message(
            channels[item.topic], log_time=epoch_ns + item.t_ns, publish_time=epoch_ns + item.t_ns, sequence=number,
            data=json.dumps(stamped(item, epoch_ns), allow_nan=False).encode(),
        )  # fmt: skip
    writer.finish()  # type: ignore[no-untyped-call]
    return buffer.getvalue()


def _about(flight: Flight) -> dict[str, object]:
    result = (None if flight.manifest is None else flight.manifest.result) or {}
    about: dict[str, object] = {"name": flight.name}
    about |= {key: str(result[key]) for key in ("outcome", "reason") if key in result}
    return about if flight.safety_radius_m is None else about | {"safety_radius_m": flight.safety_radius_m}


def _of_vehicle(flight: Flight, track: VehicleTrack) -> Iterator[Message]:
    frame = TEAM if track.in_team_frame else f"origin_{track.id}"
    turned = [enu_from_flu(quat) for quat in quat_ned_from_frd_of_euler(*track.rpy_ned_rad.T)]
    last = np.searchsorted(track.attitude_t_ns, track.t_ns, side="right") - 1
    for row, (t_ns, pos) in enumerate(zip(track.t_ns.tolist(), track.pos_team_enu_m, strict=True)):
        if np.isfinite(pos).all():
            quat = _LEVEL if last[row] < 0 else turned[last[row]]
            yield from pose_messages(t_ns - flight.start_ns, track.id, frame, pos, quat)
    for what, times_ns, values in (
        ("velocity", track.t_ns, track.vel_enu_m_s),
        ("setpoint", track.setpoint_t_ns, track.setpoint_vel_enu_m_s),
    ):
        for t_ns, velocity in zip(times_ns.tolist(), values, strict=True):
            if np.isfinite(velocity).all():
                yield velocity_message(t_ns - flight.start_ns, track.id, what, velocity)


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
