"""SET_POSITION_TARGET_LOCAL_NED as PX4 reads it: masks, frames, what it refuses."""

from __future__ import annotations

from math import isfinite

from sitl.body import Senses
from sitl.setpoints import BODY_NED, LOCAL_NED, NOTHING, Setpoint, heading, turned
from sitl.wire import Fields


def read_px4(fields: Fields, t_ns: int, senses: Senses) -> Setpoint | None:
    """Reads a setpoint as PX4 does: axis by axis, NaN and masked axes are not commanded.

    Returns:
        None when it commands neither a position nor a velocity.

    Raises:
        ValueError: the frame is not one that PX4 takes.
    """
    frame, mask = fields["coordinate_frame"], fields["type_mask"]
    if frame not in (LOCAL_NED, BODY_NED):
        raise ValueError(f"coordinate frame {frame} unsupported")
    vx, vy, vz, px, py, pz = fields["vx"], fields["vy"], fields["vz"], fields["x"], fields["y"], fields["z"]
    north = None if mask & 8 or not isfinite(vx) else vx
    east = None if mask & 16 or not isfinite(vy) else vy
    down = None if mask & 32 or not isfinite(vz) else vz
    x = None if mask & 1 or not isfinite(px) else px
    y = None if mask & 2 or not isfinite(py) else py
    z = None if mask & 4 or not isfinite(pz) else pz
    if frame == BODY_NED:
        x = y = z = None  # positions in the body frame are not supported
        if north is not None and east is not None:
            north, east = turned(north, east, senses.yaw_enu_rad)
    if north is east is down is x is y is z is None:
        return None
    pos = NOTHING
    if not (x is y is z is None):
        origin_enu_m = senses.origin_enu_m
        pos = (
            None if y is None else origin_enu_m[0] + y,
            None if x is None else origin_enu_m[1] + x,
            None if z is None else origin_enu_m[2] - z,
        )
    return Setpoint(t_ns, pos, (east, north, None if down is None else -down), *heading(fields))
