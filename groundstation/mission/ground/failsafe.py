"""How the team comes down when the ground station is gone: worked out before takeoff, written into the parameters.

Nobody avoids anybody then, so the plan keeps the vehicles apart by heights and times alone, wherever the formation
stands and however it is turned:

1. Setpoints stop: everybody stops and holds. Distances stay those of the formation; there is time to take over.
2. After ``hold_s`` the highest one climbs to a height of its own above all others and flies home there; then the next
   one, a level lower, and so on. Whoever climbs has nobody above it that has not left already, and no two cross at one
   height.
3. Everybody waits above its pad until the last one has arrived, then all sink onto their pads, which are r apart.

That needs a level for each vehicle below the ceiling, and pads of which none is above another one. Where there is no
room for it, a team in which nobody flies above another one lands where it is; any other can only hold until it is taken
over, and says so. Refuses to promise anything for vehicles whose parameters are not known.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from groundstation.core.types import FloatArray, IntArray
from groundstation.mavlink.failsafes import Wish
from groundstation.mission.plan.pads import pads_above

if TYPE_CHECKING:
    from groundstation.mission.plan.plan import MissionPlan

_STEP_M = 0.1
_SAME_M = 1e-6
_ABOVE = 0.25  # of a level: what the formation may stand higher than planned
_SETTLE_S = 5.0  # to speed up and to stop, twice
_SPARE_S = 2.0
_TURN_S = 1.0  # that heartbeats and clocks may be apart
_LAST_TURN_S, _WAIT_MAX_S = 110.0, 60.0  # limits of FS_GCS_TIMEOUT and RTL_LOIT_TIME
_SINK_M_S = 0.4  # near the ground, at least

_LEFT_ALONE = {
    "return": "brings it back",
    "land": "lands it where it is",
    "hold": "lets it hover until its battery is low",
    "own": "does what its own parameters say",
}


@dataclass(frozen=True)
class FailsafePlan:
    """What every vehicle does by itself.

    Attributes:
        action: return, land, hold or own.
        roles: role per vehicle that it is worked out for, shape (n,).
        wishes: what is asked of each vehicle.
        stacked: some vehicle flies above another one, nearer than r and the error of the positions.
        down_s: from the last heartbeat until everybody is down; infinite where nobody comes down by itself.
        words: what happens, for people.
        problem: why what the mission asks for cannot be had, None where it can.
    """

    action: str
    roles: IntArray
    wishes: tuple[Wish, ...]
    stacked: bool
    down_s: float
    words: str
    problem: str | None

    @property
    def left_alone(self) -> str:
        """What an autopilot's own failsafe does with a vehicle in the air when setpoints stop, for people."""
        return _LEFT_ALONE[self.action]


def first_roles(plan: MissionPlan) -> IntArray:
    """Role per vehicle, from the pads: known before anybody has reported a position."""
    return plan.pad_roles


@dataclass(frozen=True)
class _Return:
    """Heights above the ground, turns and waits, shape (n,) each."""

    height_m: FloatArray
    after_s: FloatArray
    wait_s: FloatArray
    down_s: float

    @property
    def top_m(self) -> float:
        return float(self.height_m.max())

    @property
    def in_time(self) -> bool:
        return float(self.after_s.max()) <= _LAST_TURN_S and float(self.wait_s.max()) <= _WAIT_MAX_S


def make_failsafe(plan: MissionPlan) -> FailsafePlan:
    """Works out how the team comes down by itself."""
    spec = plan.spec.failsafe
    roles = first_roles(plan)
    clearance_m = plan.spec.avoidance.radius_m + plan.margin_m
    stacked = any(_stacked(plan.stages[k].formation.points_enu_m, clearance_m) for k in set(plan.stage_of_step))
    back = _returning(plan, roles, clearance_m)
    obstacle = _against_returning(plan, back)
    action, problem = spec.action, None
    if action == "auto":
        action = "return" if obstacle is None else "hold" if stacked else "land"
    elif action == "return" and obstacle is not None:
        problem = f"failsafe.action: return: {obstacle[0]}; {obstacle[1]}"
    elif action == "land" and stacked:
        problem = "failsafe.action: land: the upper vehicles would land on the lower ones; let them return or hold"
    because = f": {obstacle[0]}" if obstacle is not None and spec.action == "auto" else ""
    down_s, words = {
        "return": (
            back.down_s,
            f"they are asked to hold for {spec.hold_s:g} s, return one by one at"
            f" {_span(back.height_m.min(), back.top_m)} m, and land on their pads; all down after {back.down_s:.0f} s",
        ),
        "land": (
            spec.hold_s + _top_m(plan) / _SINK_M_S + _SETTLE_S,
            f"they are asked to hold for {spec.hold_s:g} s and land where they are{because}",
        ),
        "hold": (
            math.inf,
            f"they are asked to hold until they are taken over or their batteries are low{because}",
        ),
        "own": (math.inf, "they do what their own parameters say"),
    }[action]
    home_m = plan.pads_enu_m[:, 2]
    wishes = tuple(
        Wish(
            action=action,
            after_s=float(back.after_s[i]) if action == "return" else spec.hold_s,
            height_m=float(back.height_m[i] - home_m[i]) if action == "return" else math.nan,
            wait_s=float(back.wait_s[i]) if action == "return" else 0.0,
            stacked=stacked,
            setpoint_s=1.0 / plan.rates_of(i).setpoint_hz,
            speed_m_s=plan.spec.speed_limit_m_s,
            battery_min=plan.spec.limits.battery_min,
        )
        for i in range(plan.size)
    )
    words = f"when the ground station is gone: {words}"
    return FailsafePlan(action, roles, wishes, stacked, down_s, words, problem)


def out_of_turn(failsafe: FailsafePlan, heights_m: FloatArray) -> list[tuple[int, int]]:
    """Pairs of vehicles of which the first is to leave before the second, though the second flies higher.

    Roles that were exchanged in flight bring that about: the first one might climb into the second.

    Args:
        failsafe: with everybody's turn.
        heights_m: how high each vehicle's role is now, shape (n,).
    """
    if failsafe.action != "return":
        return []
    after_s = np.array([wish.after_s for wish in failsafe.wishes])
    sooner = after_s[:, None] < after_s[None, :]
    lower = heights_m[:, None] < heights_m[None, :] - _SAME_M
    return [(int(i), int(j)) for i, j in np.argwhere(sooner & lower)]


class OutOfTurn:
    """Tells once that vehicles have exchanged roles for which the autopilots' turns to return are wrong.

    Args:
        failsafe: with the roles that it is worked out for.
        sysids: for words.
    """

    def __init__(self, failsafe: FailsafePlan, sysids: list[int]) -> None:
        self._failsafe, self._sysids = failsafe, sysids
        self._told = False

    def words(self, roles: IntArray, points_enu_m: FloatArray) -> str | None:
        """An alarm, None when there is nothing to tell.

        Args:
            roles: role per vehicle, shape (n,).
            points_enu_m: of the formation under way, shape (n, 3).
        """
        if self._told or np.array_equal(roles, self._failsafe.roles):
            return None
        wrong = out_of_turn(self._failsafe, points_enu_m[roles, 2])
        if not wrong:
            return None
        self._told = True
        names = ", ".join(f"{self._sysids[i]} below {self._sysids[j]}" for i, j in wrong[:4])
        return (
            f"roles were exchanged, vehicle {names}: should the ground station be lost now, who is below"
            " would return first; take over at once in that case"
        )


def _against_returning(plan: MissionPlan, back: _Return) -> tuple[str, str] | None:
    """Why the team cannot return one above the other, and what helps; None where it can."""
    spec = plan.spec.failsafe
    ceiling_m = spec.ceiling_m if spec.ceiling_m is not None else plan.spec.fence.max_m[2]
    if plan.size > 1 and (len(set(plan.stage_of_step)) > 1 or plan.moved or plan.places_enu_m):
        return "a mission of several formations, or with moves, leaves open who flies above whom", "let them hold"
    if len(plan.obstacles):
        return "autopilots that return by themselves know nothing of the mission's obstacles", "let them hold"
    radius_m = plan.spec.avoidance.radius_m
    stairs = np.argwhere(pads_above(plan.pads_enu_m, radius_m)).tolist()
    if stairs:
        low, high = stairs[0]
        beside_m = float(np.hypot(*(plan.pads_enu_m[high] - plan.pads_enu_m[low])[:2]))
        ids = [vehicle.id for vehicle in plan.spec.vehicles]
        return (
            f"the pad of vehicle {ids[high]} lies above that of vehicle {ids[low]}, {beside_m:.2f} m beside it, minimum"
            f" is r = {radius_m:g} m: all vehicles sink at once",
            "move the pads apart, or let them hold",
        )
    higher = "raise failsafe.ceiling_m, or let them hold"
    if back.top_m > ceiling_m:
        needed = f"{plan.size} vehicles that return one above the other need {back.top_m:.1f} m of height"
        needed = needed if plan.size > 1 else f"a vehicle that returns needs {back.top_m:.1f} m of height"
        return f"{needed}, there are {ceiling_m:g} m (failsafe.ceiling_m)", higher
    if not back.in_time:
        return f"{plan.size} vehicles that return one after the other take too long for their autopilots", higher
    return None


def _stacked(points_enu_m: FloatArray, clearance_m: float) -> bool:
    """Whether one point lies above another one, nearer than vehicles may be."""
    apart = np.linalg.norm(points_enu_m[:, None, :2] - points_enu_m[None, :, :2], axis=2)
    return bool((apart[np.triu_indices(len(points_enu_m), 1)] < clearance_m).any())


def _top_m(plan: MissionPlan) -> float:
    """How high the formation reaches above the ground."""
    heights = plan.formation.points_enu_m[:, 2]
    middle_m = plan.spec.takeoff.height_m + float(plan.pads_enu_m[:, 2].mean())
    top = max(middle_m + float(heights.max() - heights.mean()), plan.min_altitude_m + float(np.ptp(heights)))
    top = max([top, *(float(places[:, 2].max()) for places in plan.places_enu_m.values() if len(places))])
    return max(top, plan.spec.takeoff.height_m + plan.spec.takeoff.stagger_m / 2.0 + float(plan.pads_enu_m[:, 2].max()))


def _span(low: float, high: float) -> str:
    """Two numbers for people, or the one that they are."""
    shown = [f"{low:.1f}", f"{high:.1f}"]
    return shown[0] if shown[0] == shown[1] else " to ".join(shown)


def _returning(plan: MissionPlan, roles: IntArray, clearance_m: float) -> _Return:
    profile, n = plan.profile, plan.size
    level_m = _up(clearance_m, _STEP_M)
    heights = plan.formation.points_enu_m[roles, 2]
    turn = np.empty(n, dtype=np.int64)
    turn[np.lexsort((np.arange(n), -heights))] = np.arange(n)  # the highest first
    base_m = _up(_top_m(plan) + (1.0 + _ABOVE) * level_m, _STEP_M)
    height_m: FloatArray = np.round(base_m + level_m * (n - 1 - turn), 1)
    turn_s = math.ceil(level_m / profile.climb_m_s + _TURN_S)
    after_s: FloatArray = plan.spec.failsafe.hold_s + turn_s * turn.astype(np.float64)
    # Where a vehicle starts is known to be between the floor and the top of the formation, and how far from its pad
    # is not: the fence says how far at most.
    low, high = np.array(plan.spec.fence.min_m[:2]), np.array(plan.spec.fence.max_m[:2])
    way_m = min(float(np.linalg.norm(high - low)), 2.0 * _reach_m(plan))
    arrives_s = after_s + (height_m - plan.min_altitude_m) / profile.climb_m_s + way_m / profile.cruise_m_s + _SETTLE_S
    soonest_s = after_s + (height_m - _top_m(plan)) / (3.0 * profile.climb_m_s)
    wait_s: FloatArray = np.ceil(np.maximum(arrives_s.max() - soonest_s, 0.0) + _SPARE_S)
    sinks_s = float(height_m.max()) / profile.climb_m_s + 10.0 / _SINK_M_S * min(float(height_m.max()) / 10.0, 1.0)
    return _Return(height_m, after_s, wait_s, float((arrives_s + wait_s).max()) + sinks_s + _SETTLE_S)


def _reach_m(plan: MissionPlan) -> float:
    """How far from its middle the team stands or flies, horizontally, at most."""
    return float(
        max(
            np.linalg.norm(points[:, :2] - points[:, :2].mean(axis=0), axis=1).max()
            for points in (plan.pads_enu_m, plan.formation.points_enu_m)
        )
    )


def _up(value: float, step: float) -> float:
    return round(math.ceil(value / step - 1e-9) * step, 3)
