"""PX4, from 1.12 on."""

from __future__ import annotations

from groundstation.mavlink.autopilots.px4.autopilot import Px4

__all__ = ["AUTOPILOT"]

AUTOPILOT = Px4()
