"""ArduCopter, from 4.0 on."""

from __future__ import annotations

from groundstation.mavlink.autopilots.arducopter.autopilot import ArduCopter

__all__ = ["AUTOPILOT"]

AUTOPILOT = ArduCopter()
