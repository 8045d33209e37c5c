"""Vehicles that stand, armed and not, and whose positions move all the same: before takeoff and after touchdown.

One that has not taken off yet does not take off any more; of one that has landed it is told. Both count as standing
where they came to rest.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from groundstation.core.quick import finite_rows, norms, some
from groundstation.core.types import BoolArray, FloatArray
from groundstation.mavlink.vehicle import LANDED_ON_GROUND
from groundstation.mission.flight.poses import Poses, changed
from groundstation.mission.flight.resting import Rest, still_limit_m
from groundstation.mission.monitors.findings import SEE_TO_POSITION, Finding, Lasting, Reaction, Sight
from groundstation.mission.plan.plan import MissionPlan

_LASTS_S = 0.3
_LEAST_M = 0.3  # while motors run or have just run: lifting off and touching down they slide, before they tell
_COMES_BACK_S = 4.0
"""Touching down, PX4's simulator as it comes was 0.65 m off, its velocity 0.25 m/s: half as much again."""


class Resting:
    """Watches those that stand, from arming on.

    A velocity that is known to be poor has led its position astray when the vehicle comes down; standing still, the
    estimator takes that back within seconds, and the limit is wider by it.

    Attributes:
        moves: stand and say to be elsewhere, shape (n,): whatever setpoint follows from that is not sent.
    """

    def __init__(self, plan: MissionPlan) -> None:
        n = plan.size
        self._still_m = still_limit_m(plan)
        self._limit_m: FloatArray = np.full(n, max(_LEAST_M, self._still_m))
        self._allowed_m = self._limit_m
        self._rest, self._flown = Rest(n), np.zeros(n, dtype=np.bool_)
        self._arming, self._lasting = Lasting(n, _LASTS_S), Lasting(n, _LASTS_S)
        self._told: BoolArray = np.zeros(n, dtype=np.bool_)
        self.moves: BoolArray = np.zeros(n, dtype=np.bool_)

    def while_arming(self, pos_team_ned_m: FloatArray, now_ns: int) -> dict[int, str]:
        """Takes positions of a tick before takeoff, shape (n, 3): everybody stands; returns what is wrong, by row."""
        self._take(pos_team_ned_m, np.ones(len(self._told), dtype=np.bool_))
        moved_m = norms(self._rest.moved_ned_m)
        return {
            row: f"its position has moved by {moved_m[row]:.2f} m while the team was arming, limit"
            f" {self._still_m:.2g} m; see to its GPS or motion capture, and restart it on its pad"
            for row in self._arming(moved_m > self._still_m, now_ns)
        }

    def trusted(self, poses: Poses) -> Poses:
        """Poses with those that are known to stand where they stand."""
        if not some(self._told):
            return poses
        stands = self._told & finite_rows(self._rest.place_ned_m)
        pos_ned_m = np.where(stands[:, None], self._rest.place_ned_m, poses.pos_team_ned_m)
        return changed(poses, pos_team_ned_m=pos_ned_m)

    def take(self, pos_team_ned_m: FloatArray, airborne: BoolArray, vel_rms_m_s: FloatArray | float = 0.0) -> None:
        """Takes positions of a tick in flight.

        Args:
            pos_team_ned_m: as reported, shape (n, 3).
            airborne: who flies, shape (n,).
            vel_rms_m_s: root mean square of the error of velocities that are known to be poor, shape (n,) or for all;
                zero for all others.
        """
        self._allowed_m = np.hypot(self._limit_m, _COMES_BACK_S * np.asarray(vel_rms_m_s))
        self._take(pos_team_ned_m, ~airborne)
        self._flown |= airborne

    def _take(self, pos_team_ned_m: FloatArray, stands: BoolArray) -> None:
        self._rest.take(pos_team_ned_m, stands)
        self.moves = np.asarray(self._rest.moved_m > self._allowed_m)

    def look(self, sight: Sight, ours: BoolArray) -> Iterator[Finding]:
        """Keeps those on the ground that have not left it, and tells of those that have landed."""
        stands = (sight.fleet.landed_state == LANDED_ON_GROUND) & ~sight.airborne & ours
        for vehicle in self._lasting(stands & self.moves, sight.now_ns):
            self._told[vehicle] = True
            moved = f"its position has moved by {self._rest.moved_m[vehicle]:.2f} m while it stood"
            what = f"{moved}, limit {self._allowed_m[vehicle]:.2g} m"
            if self._flown[vehicle] and sight.blind[vehicle]:
                continue  # nobody believed it any more, and that was told
            if self._flown[vehicle]:
                yield Finding(
                    Reaction.FAILED, f"{what}, after it landed", (vehicle,), lost=True, remedy=SEE_TO_POSITION
                )
            else:
                what += (
                    ", before it took off; it stays there, see to its GPS or motion capture and restart it on its pad"
                )
                yield Finding(Reaction.LAND, what, (vehicle,), lost=True)
