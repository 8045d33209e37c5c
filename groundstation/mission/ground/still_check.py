"""Vehicles that stand before takeoff do not move: a position that does is nothing to fly by."""

from __future__ import annotations

import numpy as np

from groundstation.core.quick import norms
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.mavlink.vehicle import LANDED_ON_GROUND, NEVER, Fleet
from groundstation.mission.flight.resting import Rest, still_limit_m
from groundstation.mission.ground.speed_check import SpeedCheck
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.timing import SECOND_NS

_ORIGIN_MOVES_M = 0.5  # between two ticks: a new origin, no motion
_CARRIED_M_S, _CARRIED_NS = 0.3, 2 * SECOND_NS
_HEIGHT_SHARE = 1.0 / 3.0  # of heights by GPS, which are that much worse


class StillCheck:
    """How far the positions of n vehicles have moved while they stood and could be armed.

    What is carried about says so by its velocity, and may. A new start or a new origin begins anew.

    Args:
        plan: limits, who flies by GPS.
        fleet: what the vehicles report.
    """

    def __init__(self, plan: MissionPlan, fleet: Fleet) -> None:
        n = plan.size
        self._fleet, self._limit_m = fleet, still_limit_m(plan)
        self._pose_age_ns = round(plan.spec.limits.pose_age_s * SECOND_NS)
        self._height_share: FloatArray = np.array([_HEIGHT_SHARE if plan.uses_gps(i) else 1.0 for i in range(n)])
        self._global: BoolArray = np.array([vehicle.position == "global" for vehicle in plan.spec.vehicles])
        self._rest = Rest(n)
        self._last_ned_m: FloatArray = np.full((n, 3), np.nan)
        self._restarts, self._origins_ns = fleet.restarts.copy(), fleet.origin_moved_ns.copy()
        self._carried_ns: IntArray = np.full(n, NEVER, dtype=np.int64)
        self._carried: BoolArray = np.zeros(n, dtype=np.bool_)

    def look(self, now_ns: int, pos_team_ned_m: FloatArray, pose_ns: IntArray) -> None:
        """Takes what is told at this tick.

        Args:
            now_ns: time of the tick.
            pos_team_ned_m: where they report to stand, shape (n, 3).
            pose_ns: when that was measured, shape (n,).
        """
        fleet = self._fleet
        anew = (fleet.restarts != self._restarts) | (fleet.origin_moved_ns != self._origins_ns)
        self._restarts, self._origins_ns = fleet.restarts.copy(), fleet.origin_moved_ns.copy()
        anew |= norms(pos_team_ned_m - self._last_ned_m) > _ORIGIN_MOVES_M
        self._last_ned_m = pos_team_ned_m.copy()
        fresh = now_ns - pose_ns <= self._pose_age_ns
        vel_ned_m_s = np.where(self._global[:, None], fleet.place_vel_ned_m_s, fleet.vel_ned_m_s)
        fast = norms(vel_ned_m_s) > _CARRIED_M_S
        self._carried_ns = np.where(fast, now_ns, self._carried_ns)
        self._rest.forget(np.asarray(anew | self._carried, dtype=np.bool_))
        settled = fresh & fleet.prearm_ok & (fleet.landed_state == LANDED_ON_GROUND)
        self._rest.take(pos_team_ned_m, np.asarray(settled, dtype=np.bool_))
        self._carried = (self._moved_m() > self._limit_m) & (now_ns - self._carried_ns <= _CARRIED_NS)

    def _moved_m(self) -> FloatArray:
        return np.asarray(np.hypot(self._rest.moved_m, self._height_share * self._rest.moved_ned_m[:, 2]))

    def words(self, vehicle: int) -> str | None:
        """What is wrong with a position, None where nothing is."""
        if self._carried[vehicle]:
            return "is being moved; put it on its pad and let it stand still"
        moved_m = float(self._moved_m()[vehicle])
        if moved_m <= self._limit_m:
            return None
        return (
            f"its position has moved by {moved_m:.2f} m while it stood, limit {self._limit_m:.2g} m; put it on its pad,"
            " see to its GPS or motion capture, and restart it there"
        )


class MotionCheck:
    """Whether n vehicles that stand say so: by their velocities, and by their positions.

    Args:
        plan: limits, who flies by GPS.
        fleet: what the vehicles report.
    """

    def __init__(self, plan: MissionPlan, fleet: Fleet) -> None:
        self._speeds, self._still = SpeedCheck(plan, fleet), StillCheck(plan, fleet)

    def look(self, now_ns: int, pos_team_ned_m: FloatArray, pose_ns: IntArray) -> None:
        """Takes what is told at this tick; as ``StillCheck.look``."""
        self._speeds.look(now_ns, pos_team_ned_m, pose_ns)
        self._still.look(now_ns, pos_team_ned_m, pose_ns)

    def words(self, vehicle: int) -> str | None:
        """What is wrong with a vehicle's motion, None where nothing is."""
        return self._speeds.words(vehicle) or self._still.words(vehicle)
