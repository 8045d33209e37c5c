"""Crazyflies behind ``gs gateway``, or behind the gateway inside a dry run."""

from __future__ import annotations

from groundstation.mavlink.autopilots.crazyflie.autopilot import Crazyflie

__all__ = ["AUTOPILOT"]

AUTOPILOT = Crazyflie()
