"""Velocities held against positions while the vehicles stand, as in the air."""

from __future__ import annotations

import numpy as np

from groundstation.core.speeds import Speeds
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.mavlink.vehicle import Fleet
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.timing import SECOND_NS, SinceBefore

_ORIGIN_MOVES_M = 0.5  # between two ticks: a new origin, no motion


class SpeedCheck:
    """How far the velocities of n vehicles are off what their positions do, before takeoff.

    Args:
        plan: limits, who flies by global positions.
        fleet: what the vehicles report.
    """

    def __init__(self, plan: MissionPlan, fleet: Fleet) -> None:
        self._fleet, self._limits = fleet, plan.spec.limits
        self._global: BoolArray = np.array([vehicle.position == "global" for vehicle in plan.spec.vehicles])
        self._speeds, self._since_before = Speeds(plan.size), SinceBefore()
        self._stood_ned_m: FloatArray = np.full((plan.size, 3), np.nan)

    def look(self, now_ns: int, pos_team_ned_m: FloatArray, pose_ns: IntArray) -> None:
        """Takes what is told at this tick.

        Args:
            now_ns: time of the tick.
            pos_team_ned_m: where they report to stand, shape (n, 3).
            pose_ns: when that was measured, shape (n,).
        """
        passed_s = self._since_before(now_ns)
        if passed_s > 0.0:
            fleet = self._fleet
            vel_ned_m_s = np.where(self._global[:, None], fleet.place_vel_ned_m_s, fleet.vel_ned_m_s)
            fresh = np.asarray(now_ns - pose_ns <= self._limits.pose_age_s * SECOND_NS)
            moved_m = np.linalg.norm(pos_team_ned_m - self._stood_ned_m, axis=1)
            self._stood_ned_m = pos_team_ned_m.copy()
            self._speeds.forget(np.asarray(moved_m > _ORIGIN_MOVES_M))
            self._speeds.take(pos_team_ned_m, vel_ned_m_s, passed_s, fresh)

    def words(self, vehicle: int) -> str | None:
        """What is wrong with a velocity, None where nothing is."""
        off_m_s, limit_m_s = float(self._speeds.rms_m_s[vehicle]), self._limits.velocity_error_m_s
        if off_m_s <= limit_m_s:
            return None
        return (
            f"its velocity is wrong: {off_m_s:.2f} m/s off what its positions do, limit {limit_m_s:g} m/s; let it stand"
            " still, or restart its estimator"
        )
