"""SET_POSITION_TARGET_LOCAL_NED as each autopilot reads it: masks, frames, what it refuses.

Pure: fields and the vehicle's own place and heading in, a setpoint in the world's ENU frame out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from sitl.wire import Fields

Triple = tuple[float | None, float | None, float | None]
NOTHING: Triple = (None, None, None)
LOCAL_NED, LOCAL_OFFSET_NED, BODY_NED, BODY_OFFSET_NED = 1, 7, 8, 9
_SPEED_SANE_M_S = 1000.0


@dataclass(frozen=True)
class Setpoint:
    """What a ground station asked for last, in the world's ENU frame as the vehicle believes it.

    Attributes:
        t_ns: arrival.
        pos_enu_m: None on each axis that is not held.
        vel_enu_m_s: None on each axis without.
        yaw_enu_rad, yaw_rate_rad_s: None where not given.
    """

    t_ns: int
    pos_enu_m: Triple
    vel_enu_m_s: Triple
    yaw_enu_rad: float | None
    yaw_rate_rad_s: float | None


def _turned(forward: float, right: float, yaw_enu_rad: float) -> tuple[float, float]:
    """North and east of a horizontal body vector, turned by the heading alone.

    The heading from north is pi/2 - yaw: its cosine is the sine of the heading from east, and the other way round.
    """
    c, s = math.sin(yaw_enu_rad), math.cos(yaw_enu_rad)
    return c * forward - s * right, s * forward + c * right


def _heading(fields: Fields) -> tuple[float | None, float | None]:
    """Yaw and yaw rate in ENU; where a yaw is given the rate does not count."""
    mask = fields["type_mask"]
    if not mask & 0x400 and math.isfinite(fields["yaw"]):
        return math.pi / 2.0 - fields["yaw"], None
    if not mask & 0x800 and math.isfinite(fields["yaw_rate"]):
        return None, -fields["yaw_rate"]
    return None, None


def read_px4(fields: Fields, t_ns: int, origin_enu_m: Sequence[float], yaw_enu_rad: float) -> Setpoint | None:
    """Reads a setpoint as PX4 does: axis by axis, NaN and masked axes are not commanded.

    Returns:
        None when it commands neither a position nor a velocity.

    Raises:
        ValueError: the frame is not one that PX4 takes.
    """
    frame, mask = fields["coordinate_frame"], fields["type_mask"]
    if frame not in (LOCAL_NED, BODY_NED):
        raise ValueError(f"coordinate frame {frame} unsupported")
    north, east, down = (
        None if mask & (8 << axis) or not math.isfinite(fields[name]) else fields[name]
        for axis, name in enumerate(("vx", "vy", "vz"))
    )
    x, y, z = (
        None if mask & (1 << axis) or not math.isfinite(fields[name]) else fields[name]
        for axis, name in enumerate(("x", "y", "z"))
    )
    if frame == BODY_NED:
        x = y = z = None  # positions in the body frame are not supported
        if north is not None and east is not None:
            north, east = _turned(north, east, yaw_enu_rad)
    if all(value is None for value in (north, east, down, x, y, z)):
        return None
    pos = (
        None if y is None else origin_enu_m[0] + y,
        None if x is None else origin_enu_m[1] + x,
        None if z is None else origin_enu_m[2] - z,
    )
    return Setpoint(t_ns, pos, (east, north, None if down is None else -down), *_heading(fields))


def read_ardupilot(
    fields: Fields, t_ns: int, origin_enu_m: Sequence[float], pos_enu_m: Sequence[float], yaw_enu_rad: float
) -> Setpoint | None:
    """Reads a setpoint as ArduCopter does: any ignored axis ignores its whole triple.

    Returns:
        None for what stops the vehicle: another frame, nothing to follow, no numbers, or more than 1000 m/s.
    """
    frame, mask = fields["coordinate_frame"], fields["type_mask"]
    pos = None if mask & 0x7 else [fields[name] for name in ("x", "y", "z")]
    vel = None if mask & 0x38 else [fields[name] for name in ("vx", "vy", "vz")]
    if frame not in (LOCAL_NED, LOCAL_OFFSET_NED, BODY_NED, BODY_OFFSET_NED) or (pos is None and vel is None):
        return None
    if not all(map(math.isfinite, (pos or []) + (vel or []))) or any(abs(v) > _SPEED_SANE_M_S for v in vel or ()):
        return None
    if frame in (BODY_NED, BODY_OFFSET_NED):
        for triple in (pos, vel):
            if triple is not None:
                triple[:2] = _turned(triple[0], triple[1], yaw_enu_rad)
    base = origin_enu_m if frame == LOCAL_NED else pos_enu_m
    target = NOTHING if pos is None else (base[0] + pos[1], base[1] + pos[0], base[2] - pos[2])
    speed = NOTHING if vel is None else (vel[1], vel[0], -vel[2])
    return Setpoint(t_ns, target, speed, *_heading(fields))
