"""Messages by Foxglove's own schemas, as JSON: for files (``mcap_file``) and live streams (``console.live``).

The team's frame is called ``team``, ENU; bodies are x forward, y left, z up.
"""

from __future__ import annotations

from typing import NamedTuple

from groundstation.core.types import FloatArray

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
INFO, WARNING = 2, 3
"""Levels of ``foxglove.Log``."""
TEAM = "team"
"""The team's frame."""


class Message(NamedTuple):
    """One message: time in ns since the flight began, topic, name of its schema, content."""

    t_ns: int
    topic: str
    schema: str
    content: dict[str, object]


def pose_messages(t_ns: int, sysid: int, frame: str, pos_m: FloatArray, wxyz: FloatArray) -> tuple[Message, Message]:
    """Where a vehicle is, as a pose and as a frame of its own.

    Args:
        t_ns: since the flight began.
        sysid: of the vehicle.
        frame: in which the position is told.
        pos_m: ENU, shape (3,).
        wxyz: its attitude, see ``body_axes.enu_from_flu``, shape (4,).
    """
    place, rotation = _vector(pos_m), _quaternion(wxyz)
    pose: dict[str, object] = {
        "timestamp": time_of(t_ns),
        "frame_id": frame,
        "pose": {"position": place, "orientation": rotation},
    }
    turned: dict[str, object] = {"timestamp": time_of(t_ns), "parent_frame_id": frame, "child_frame_id": f"v{sysid}",
              "translation": place, "rotation": rotation}  # fmt: skip
    return (
        Message(t_ns, f"/vehicles/{sysid}/pose", "foxglove.PoseInFrame", pose),
        Message(t_ns, "/tf", "foxglove.FrameTransform", turned),
    )


def velocity_message(t_ns: int, sysid: int, what: str, vel_enu_m_s: FloatArray) -> Message:
    """A velocity or a setpoint of a vehicle."""
    content: dict[str, object] = {
        f"{axis}_enu_m_s": float(value) for axis, value in zip("xyz", vel_enu_m_s, strict=True)
    }
    return Message(t_ns, f"/vehicles/{sysid}/{what}", "gs.Velocity", content)


def log_message(t_ns: int, text: str) -> Message:
    """What happened; alarms, which begin with that word, are warnings."""
    level = WARNING if text.startswith("alarm") else INFO
    content: dict[str, object] = {
        "timestamp": time_of(t_ns),
        "level": level,
        "message": text,
        "name": "gs",
        "file": "",
        "line": 0,
    }
    return Message(t_ns, "/events", "foxglove.Log", content)


def stamped(message: Message, epoch_ns: int) -> dict[str, object]:
    """Its content with Unix time in place of that since the flight began."""
    there = {"timestamp": time_of(epoch_ns + message.t_ns)} if "timestamp" in message.content else {}
    return {**message.content, **there}


def schema_of(name: str) -> dict[str, object]:
    """A whole JSON schema."""
    return {"title": name, "type": "object", "properties": SCHEMAS[name]}


def time_of(t_ns: int) -> dict[str, int]:
    """Seconds and nanoseconds."""
    return {"sec": t_ns // 1_000_000_000, "nsec": t_ns % 1_000_000_000}


def _vector(values: FloatArray) -> dict[str, float]:
    return {axis: float(value) for axis, value in zip("xyz", values, strict=True)}


def _quaternion(wxyz: FloatArray) -> dict[str, float]:
    return {axis: float(value) for axis, value in zip("wxyz", wxyz, strict=True)}
