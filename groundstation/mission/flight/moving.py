"""A formation that moves, turns and grows as told: with a clock of its own, which waits for whoever cannot follow.

A ``move`` step of the mission and an order of the operator in a ``lead`` step are flown by the same class.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from groundstation.core import frames
from groundstation.core.motion import MovePlan
from groundstation.core.phases import Phase
from groundstation.core.types import FloatArray
from groundstation.mission.flight.free_size import Sizes, missed
from groundstation.mission.flight.step import HOLD_TOLERANCE, Now, StepFlight, StepTick
from groundstation.mission.flight.under_way import UnderWay
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.timing import SECOND_NS, SinceBefore

_PACE_UP_S = 1.0  # in which a move that was held up gets going again
_PACE_DOWN_S = 0.3
_MOVE_PATIENCE = 3.0  # times its duration, and _MOVE_SPARE_S, after which a move that is held up is given up
_MOVE_SPARE_S = 10.0
_FENCE_SPARE_M = 0.05
_TICK_S = 0.02
_MOST_LOOKS = 400


@dataclass(frozen=True)
class _Start:
    """How the team stood when a move began: where its middle was, and the formation's size, as told and as it stood."""

    middle_enu_m: FloatArray
    size: float
    stood_at: Sizes


class Moving(StepFlight):
    """A move with a clock of its own, which waits for whoever does not follow, for a wall, and for closing up.

    Args:
        flown: what it belongs to.
        now_ns: when it begins.
        move: what is to be done.
        way: shares of it at which it has to lie inside the fence.
    """

    phase = Phase.MOVE

    def __init__(self, flown: UnderWay, now_ns: int, move: MovePlan, way: Sequence[float] = (1.0,)) -> None:
        super().__init__(flown, now_ns)
        self._move, self._way = move, way
        self._ends_early = False
        self._move_s, self._pace, self._room = 0.0, 0.0, 1.0
        self._since_before = SinceBefore()
        self._start = _Start(np.zeros(3), flown.size, (1.0, 1.0))
        self._begun = False

    def stood_still(self, held_ns: int) -> None:
        """The operator held the team for a while."""
        super().stood_still(held_ns)
        self._since_before.forget()
        self._pace = 0.0

    def left_room(self, room: float) -> None:
        """A wall slows the move down."""
        self._room = room

    def end_early(self) -> None:
        """Comes to rest as soon as it can and is over then, as far as it has come."""
        self._ends_early = True

    @property
    def cut_short(self) -> bool:
        """It ended before all of it was done."""
        return self._move_s < self._move.seconds

    @property
    def left(self) -> MovePlan:
        """What is still to be done of it."""
        share = 1.0 if self._ends_early else self._move.share(self._move_s)
        return replace(self._move.left(share), seconds=max(self._move.seconds - self._move_s, _TICK_S))

    def tick(self, now: Now) -> StepTick:
        """Goes on moving."""
        flown, move = self._flown, self._move
        pos_enu_m = frames.enu_from_ned(now.poses.pos_team_ned_m)
        if not self._begun:
            outside = self._begin(now, pos_enu_m)
            if outside:
                self._since_before(now.now_ns)
                return StepTick(give_up=f"move not begun: it {outside}", stands=True)
        flown.figures.moved_within(now.error_m)
        self._run_clock(now)
        lost = self._lost("moving", now, 3 * SECOND_NS)
        if lost:
            return StepTick(give_up=lost)
        present = move.at(self._move_s, self._pace)
        flown.resize(self._start.size * present.scale)
        if self._move_s >= move.seconds + 2.0 * flown.settle_s or (self._ends_early and self._pace == 0.0):
            return self._end(now, pos_enu_m)
        if now.now_ns - self._since_ns >= (_MOVE_PATIENCE * move.seconds + _MOVE_SPARE_S) * SECOND_NS:
            why = "a vehicle does not follow" if now.absent.any() else now.off
            wall = "the fence or an obstacle" if len(flown.plan.obstacles) else "the fence"
            why = f"{wall} is in the way" if self._room < 1.0 else why
            done = 100.0 * move.share(self._move_s)
            if not self._ends_early:
                if move.scale != 1.0:
                    flown.tell_formation(f"{flown.size:.6g}")
                return StepTick(give_up=f"move not finished: {done:.0f} % of the way done, {why}", stands=True)
        return StepTick(motion=move.at(self._move_s, self._pace, flown.settle_s), present=present)

    def _begin(self, now: Now, pos_enu_m: FloatArray) -> str:
        """Notes where the team stands; returns why the move would end outside the fence, empty if it would not."""
        self._begun = True
        self._start = _Start(pos_enu_m.mean(axis=0), self._flown.size, self._sizes(now.poses))
        outside = leads_astray(self._flown.plan, pos_enu_m, self._move, self._way)
        if not outside and self._move.scale != 1.0:
            self._flown.tell_formation("changing")
        return outside

    def _run_clock(self, now: Now) -> None:
        """The move's own time passes as fast as the team can follow."""
        elapsed_s = min(self._since_before(now.now_ns), 2.0 / self._flown.plan.spec.rate_hz)
        tolerance_m = self._tolerance_m()
        wanted = (HOLD_TOLERANCE * tolerance_m + now.sway_m - now.error_m) / ((HOLD_TOLERANCE - 1.0) * tolerance_m)
        wanted = 0.0 if now.absent.any() or self._ends_early else min(max(wanted, 0.0), 1.0, self._room)
        step_up, step_down = elapsed_s / _PACE_UP_S, elapsed_s / _PACE_DOWN_S
        self._pace = min(max(wanted, self._pace - step_down), self._pace + step_up)
        done = self._move.share(self._move_s)
        self._move_s += self._pace * elapsed_s
        done = self._move.share(self._move_s) - done
        self._flown.keeper.shift(done * self._move.by_enu_m, done * self._move.turn_rad)

    def _end(self, now: Now, pos_enu_m: FloatArray) -> StepTick:
        """The move is over; tells how far it went, and whether the size is what was asked for."""
        flown, move = self._flown, self._move
        if self.cut_short:
            move = move.done(move.share(self._move_s))
        flown.resize(self._start.size * move.scale)
        if move.scale != 1.0:
            flown.tell_formation(f"{flown.size:.6g}")
        by = " ".join(f"{value:.2f}" for value in pos_enu_m.mean(axis=0) - self._start.middle_enu_m)
        told = " ".join(f"{value:.2f}" for value in move.by_enu_m)
        flown.tell(f"the middle of the team has moved by {by} m (ENU), told were {told} m")
        self._tell_size(now.poses)
        if flown.stage.scale.kind == "free" and move.scale != 1.0:
            why = missed(self._sizes(now.poses), self._start.stood_at, move.scale, flown.stage, flown.keep_out_m)
            if why:
                flown.figures.lost()
                return StepTick(give_up=why)
        return StepTick(done=True)


def leads_astray(plan: MissionPlan, pos_enu_m: FloatArray, move: MovePlan, way: Sequence[float]) -> str:
    """Why a move would leave the fence or come too near to an obstacle, in words that follow its name; empty if not.

    Args:
        plan: with the fence and the lowest height.
        pos_enu_m: where everybody is, shape (n, 3), team frame.
        move: the move.
        way: shares of it that are looked at. Whoever is outside already may stay so, and come no farther.
    """
    low, high = np.array(plan.spec.fence.min_m), np.array(plan.spec.fence.max_m)
    low[2] = max(low[2], plan.min_altitude_m)
    if len(plan.obstacles):
        into = _into_obstacle(plan, pos_enu_m, move)
        if into:
            return into
    allowed_m = np.full(pos_enu_m.shape, _FENCE_SPARE_M)
    if len(way) > 1:
        allowed_m = np.maximum(allowed_m, np.maximum(low - pos_enu_m, pos_enu_m - high) + 1e-3)
    for share in way:
        end = move.carried(pos_enu_m, share)
        beyond = np.maximum(low - end, end - high)
        vehicle, axis = (int(k) for k in np.unravel_index(int(np.argmax(beyond - allowed_m)), beyond.shape))
        if not beyond[vehicle, axis] <= allowed_m[vehicle, axis]:
            return (
                f"would take vehicle {plan.spec.vehicles[vehicle].id} to {'xyz'[axis]} = {end[vehicle, axis]:.2f} m,"
                f" {beyond[vehicle, axis]:.2f} m beyond the fence or below min_altitude_m"
            )
    return ""


def _into_obstacle(plan: MissionPlan, pos_enu_m: FloatArray, move: MovePlan) -> str:
    """The same of obstacles, all along the way; empty if nobody comes too near to one."""
    obstacles = plan.obstacles
    radius_m = float(np.linalg.norm(pos_enu_m - pos_enu_m.mean(axis=0), axis=1).max()) * max(move.scale, 1.0)
    way_m = float(np.linalg.norm(move.by_enu_m)) + (abs(move.turn_rad) + abs(float(np.log(move.scale)))) * radius_m
    now_m, _ = obstacles.distances(pos_enu_m)
    least_m = np.minimum(obstacles.keep_m - _FENCE_SPARE_M, now_m - 1e-3)  # who is nearer already comes no nearer
    for share in np.linspace(0.0, 1.0, min(2 + int(4.0 * way_m / obstacles.keep_m), _MOST_LOOKS)):
        distance_m, _ = obstacles.distances(move.carried(pos_enu_m, float(share)))
        vehicle, body = (int(k) for k in np.unravel_index(int(np.argmin(distance_m - least_m)), distance_m.shape))
        if not distance_m[vehicle, body] >= least_m[vehicle, body]:
            return (
                f"would take vehicle {plan.spec.vehicles[vehicle].id} to {distance_m[vehicle, body]:.2f} m from"
                f" obstacle {obstacles.bodies[body].name}, minimum is {obstacles.keep_m:.2f} m"
            )
    return ""
