"""Columns of the streamed types of ArduPilot's own dialect."""

from __future__ import annotations

import numpy as np

from groundstation.mavlink.codec import StructuredArray
from sitl.messages import IntArray, Message, message, pilots_of, rows_of
from sitl.state import State
from sitl.telemetry import View

ARDUPILOT_MESSAGES: dict[str, Message] = {}


@message(ARDUPILOT_MESSAGES)
def _ekf_status_report(state: State, _view: View, vehicles: IntArray) -> StructuredArray:
    out = rows_of("EKF_STATUS_REPORT", vehicles)
    good = state.known.has_position[vehicles] & ~state.broken.invalid[vehicles]
    # without a position: attitude, velocities and height, and "constant position"; nothing before it has begun
    begun = np.array([pilot.age_ns >= pilot.boot.deaf_ns for pilot in pilots_of(state, vehicles)], dtype=bool)
    out["flags"] = np.where(good, 0x33F, np.where(begun, 0xA7, 0x400))
    for name in ("velocity_variance", "pos_horiz_variance", "pos_vert_variance", "compass_variance"):
        out[name] = np.where(good, 0.02, 1.2)
    return out


@message(ARDUPILOT_MESSAGES)
def _meminfo(_state: State, _view: View, vehicles: IntArray) -> StructuredArray:
    out = rows_of("MEMINFO", vehicles)
    out["freemem"], out["freemem32"] = 65535, 131072
    return out
