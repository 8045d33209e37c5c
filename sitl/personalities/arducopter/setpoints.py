"""SET_POSITION_TARGET_LOCAL_NED as ArduCopter reads it: masks, frames, what it refuses."""

from __future__ import annotations

import math

from sitl.body import Senses
from sitl.setpoints import (
    BODY_NED,
    BODY_OFFSET_NED,
    LOCAL_NED,
    LOCAL_OFFSET_NED,
    NOTHING,
    Setpoint,
    Triple,
    heading,
    turned,
)
from sitl.wire import Fields

_SPEED_SANE_M_S = 1000.0


def read_ardupilot(fields: Fields, t_ns: int, senses: Senses) -> Setpoint | None:
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
                triple[:2] = turned(triple[0], triple[1], senses.yaw_enu_rad)
    target: Triple = NOTHING
    if pos is not None:
        base = senses.origin_enu_m if frame == LOCAL_NED else senses.pos_enu_m
        target = base[0] + pos[1], base[1] + pos[0], base[2] - pos[2]
    speed: Triple = NOTHING if vel is None else (vel[1], vel[0], -vel[2])
    return Setpoint(t_ns, target, speed, *heading(fields))
