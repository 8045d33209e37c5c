"""Setpoints, and what readers of SET_POSITION_TARGET_LOCAL_NED share; each personality has a reader of its own.

Pure: fields and the vehicle's own place and heading in, a setpoint in the world's ENU frame out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from sitl.wire import Fields

Triple = tuple[float | None, float | None, float | None]
NOTHING: Triple = (None, None, None)
LOCAL_NED, LOCAL_OFFSET_NED, BODY_NED, BODY_OFFSET_NED = 1, 7, 8, 9


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


def turned(forward: float, right: float, yaw_enu_rad: float) -> tuple[float, float]:
    """North and east of a horizontal body vector, turned by the heading alone.

    The heading from north is pi/2 - yaw: its cosine is the sine of the heading from east, and the other way round.
    """
    c, s = math.sin(yaw_enu_rad), math.cos(yaw_enu_rad)
    return c * forward - s * right, s * forward + c * right


def heading(fields: Fields) -> tuple[float | None, float | None]:
    """Yaw and yaw rate in ENU; where a yaw is given the rate does not count."""
    mask = fields["type_mask"]
    if not mask & 0x400 and math.isfinite(fields["yaw"]):
        return math.pi / 2.0 - fields["yaw"], None
    if not mask & 0x800 and math.isfinite(fields["yaw_rate"]):
        return None, -fields["yaw_rate"]
    return None, None
