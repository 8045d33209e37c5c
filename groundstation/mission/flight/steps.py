"""The steps of a mission in flight: one class each, with what it keeps while it lasts and how it ends.

A new kind of step is a class in ``plan.schema`` and one here; it is flown in one of the phases that there are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from groundstation.core import frames
from groundstation.core.motion import Motion, MovePlan
from groundstation.core.types import BoolArray, FloatArray
from groundstation.mission.flight.free_size import Sizes, missed, sizes_of, stands_at
from groundstation.mission.flight.poses import Poses
from groundstation.mission.flight.under_way import UnderWay
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.schema import (
    FormStep,
    GoToStep,
    HoldStep,
    HoverStep,
    MoveStep,
    Step,
    WaypointsStep,
)
from groundstation.mission.timing import SECOND_NS, Held, SinceBefore

_HOLD_TOLERANCE = 2.0  # noise may exceed the tolerance for a moment; twice of it for a second is no noise
_PACE_UP_S = 1.0  # in which a move that was held up gets going again
_PACE_DOWN_S = 0.3
_MOVE_PATIENCE = 3.0  # times its duration, and _MOVE_SPARE_S, after which a move that is held up is given up
_MOVE_SPARE_S = 10.0
_FENCE_SPARE_M = 0.05
_PLACE_M, _OF_MARGIN = 0.15, 0.35


@dataclass(frozen=True)
class Now:
    """What a step looks at in one tick.

    Attributes:
        now_ns: its time.
        poses: of the team.
        error_m: largest distance error, NaN where a position is not known.
        upright: the formation does not stand on its head.
        absent: vehicles that do not follow at the moment, shape (n,).
        sway_m: how far distances may sway in gusts and by poor velocities, beside every tolerance.
    """

    now_ns: int
    poses: Poses
    error_m: float
    upright: bool
    absent: BoolArray
    sway_m: float = 0.0

    def allowed(self, tolerance_m: float) -> str:
        """A tolerance in words, with what gusts and poor velocities add to it."""
        return f"{tolerance_m:g} m" + (f", and {self.sway_m:.2f} m for what sways" if self.sway_m else "")

    @property
    def off(self) -> str:
        """How far off the worst distance is, for people."""
        return f"a distance is {self.error_m:.3f} m off" if np.isfinite(self.error_m) else "a position is not known"


@dataclass(frozen=True)
class StepTick:
    """What one tick of a step came to.

    Attributes:
        done: the next step follows.
        give_up: why the mission cannot go on; empty while it can.
        motion: what the formation does as one; None at rest.
        present: the part of it that shows in velocities already.
        places_ned_m: everybody flies there, shape (n, 3), and forms nothing; None in formation.
    """

    done: bool = False
    give_up: str = ""
    motion: Motion | None = None
    present: Motion | None = None
    places_ned_m: FloatArray | None = None


class StepFlight:
    """A step under way.

    Args:
        flown: what it belongs to.
        now_ns: when it begins.
    """

    phase: ClassVar[str]
    """Name of the phase in which it is flown."""
    swaps: ClassVar[bool] = False
    """Whoever is locked in may swap roles or go round others."""
    formed: ClassVar[bool] = True
    """Flies the formation, whose distances count."""

    def __init__(self, flown: UnderWay, now_ns: int) -> None:
        self._flown = flown
        self._since_ns = now_ns
        self._held = Held()

    def tick(self, now: Now) -> StepTick:
        """One tick."""
        raise NotImplementedError

    def stood_still(self, held_ns: int) -> None:
        """The operator held the team for a while: the step's clock did not run."""
        self._since_ns += held_ns
        self._held.forget()

    def left_room(self, room: float) -> None:
        """Takes the share of a commanded motion that the fence left to all in this tick, 0 to 1."""

    def _tolerance_m(self) -> float:
        """What the last ``form`` step asked for."""
        steps = self._flown.plan.spec.steps[: self._flown.number]
        return next(item.form.tolerance_m for item in reversed(steps) if item.form is not None)

    def _lost(self, doing: str, now: Now, steady_ns: int = SECOND_NS) -> str:
        """Why the formation counts as lost, empty while it does not."""
        tolerance_m = self._tolerance_m()
        limit_m = _HOLD_TOLERANCE * tolerance_m + now.sway_m
        if not self._held(not now.error_m <= limit_m, now.now_ns, steady_ns):
            return ""
        self._flown.figures.lost()
        return (
            f"formation lost while {doing}: {now.off}, limit is"
            f" {_HOLD_TOLERANCE:g} times the tolerance of {now.allowed(tolerance_m)}"
        )

    def _sizes(self, poses: Poses) -> Sizes:
        return sizes_of(poses.pos_team_ned_m[self._flown.members], self._flown.stage)

    def _tell_size(self, poses: Poses) -> None:
        """Tells the log how large a formation came out whose size is left to chance."""
        if self._flown.stage.scale.kind == "free":
            self._flown.tell(stands_at(self._sizes(poses), self._flown.stage))


class Forming(StepFlight):
    """Until every distance has been within its tolerance for a second."""

    phase = "form"
    swaps = True

    def __init__(self, flown: UnderWay, now_ns: int, step: FormStep) -> None:
        super().__init__(flown, now_ns)
        self._step = step

    def tick(self, now: Now) -> StepTick:
        """Looks at the distances."""
        flown, step = self._flown, self._step
        near = now.error_m <= step.tolerance_m + now.sway_m
        within = near and now.upright
        if self._held(within, now.now_ns):
            took_s = (self._held.since_ns - self._since_ns) / SECOND_NS
            if now.sway_m:
                flown.tell(f"formed in gusts: the tolerance was {now.allowed(step.tolerance_m)}")
            if len(flown.plan.stages) > 1:
                flown.tell(f"formed {flown.stage.formation.name} after {took_s:.2f} s")
            self._tell_size(now.poses)
            later = flown.plan.spec.steps[flown.number + 1 :]
            flown.figures.formed(took_s, last=all(item.form is None for item in later))
            return StepTick(done=True)
        if not within and now.now_ns - self._since_ns >= step.timeout_s * SECOND_NS:
            whys = [] if now.upright else ["the team stands upside down (set upright_1_s or takeoff.stagger_m)"]
            whys += [] if near else [f"{now.off}, tolerance is {now.allowed(step.tolerance_m)}"]
            return StepTick(give_up=f"not formed after {step.timeout_s:g} s: {', and '.join(whys)}")
        return StepTick()


class Holding(StepFlight):
    """Keeps the formation for its time."""

    phase = "hold"

    def __init__(self, flown: UnderWay, now_ns: int, step: HoldStep) -> None:
        super().__init__(flown, now_ns)
        self._step = step

    def tick(self, now: Now) -> StepTick:
        """Looks whether it holds."""
        self._flown.figures.held_within(now.error_m)
        lost = self._lost("holding", now)
        if lost:
            return StepTick(give_up=lost)
        return StepTick(done=now.now_ns - self._since_ns >= self._step.seconds * SECOND_NS)


class Moving(StepFlight):
    """A move with a clock of its own, which waits for whoever does not follow, for a wall, and for closing up."""

    phase = "move"

    def __init__(self, flown: UnderWay, now_ns: int) -> None:
        super().__init__(flown, now_ns)
        self._move: MovePlan = flown.plan.moves[flown.number]
        self._begun = False
        self._move_s, self._pace, self._room = 0.0, 0.0, 1.0
        self._since_before = SinceBefore()
        self._from_enu_m: FloatArray = np.zeros(3)
        self._size_before = flown.size
        self._stood_at: Sizes = (1.0, 1.0)

    def stood_still(self, held_ns: int) -> None:
        """The operator held the team for a while."""
        super().stood_still(held_ns)
        self._since_before.forget()
        self._pace = 0.0

    def left_room(self, room: float) -> None:
        """A wall slows the move down."""
        self._room = room

    def tick(self, now: Now) -> StepTick:
        """Goes on moving."""
        flown, move = self._flown, self._move
        pos_enu_m = frames.enu_from_ned(now.poses.pos_team_ned_m)
        if not self._begun:
            outside = self._begin(now, pos_enu_m)
            if outside:
                self._since_before(now.now_ns)
                return StepTick(give_up=outside)
        flown.figures.moved_within(now.error_m)
        self._run_clock(now)
        lost = self._lost("moving", now, 3 * SECOND_NS)
        if lost:
            return StepTick(give_up=lost)
        present = move.at(self._move_s, self._pace)
        flown.resize(self._size_before * present.scale)
        if self._move_s >= move.seconds + 2.0 * flown.settle_s:
            return self._end(now, pos_enu_m)
        if now.now_ns - self._since_ns >= (_MOVE_PATIENCE * move.seconds + _MOVE_SPARE_S) * SECOND_NS:
            why = "a vehicle does not follow" if now.absent.any() else now.off
            why = "the fence is in the way" if self._room < 1.0 else why
            done = 100.0 * move.share(self._move_s)
            return StepTick(give_up=f"move not finished: {done:.0f} % of the way done, {why}")
        return StepTick(motion=move.at(self._move_s, self._pace, flown.settle_s), present=present)

    def _begin(self, now: Now, pos_enu_m: FloatArray) -> str:
        """Notes where the team stands; returns why the move would end outside the fence, empty if it would not."""
        self._begun = True
        self._from_enu_m = pos_enu_m.mean(axis=0)
        self._stood_at = self._sizes(now.poses)
        outside = self._outside(pos_enu_m)
        if not outside and self._move.scale != 1.0:
            self._flown.tell_formation("changing")
        return outside

    def _run_clock(self, now: Now) -> None:
        """The move's own time passes as fast as the team can follow."""
        elapsed_s = min(self._since_before(now.now_ns), 2.0 / self._flown.plan.spec.rate_hz)
        tolerance_m = self._tolerance_m()
        wanted = (_HOLD_TOLERANCE * tolerance_m + now.sway_m - now.error_m) / ((_HOLD_TOLERANCE - 1.0) * tolerance_m)
        wanted = 0.0 if now.absent.any() else min(max(wanted, 0.0), 1.0, self._room)
        step_up, step_down = elapsed_s / _PACE_UP_S, elapsed_s / _PACE_DOWN_S
        self._pace = min(max(wanted, self._pace - step_down), self._pace + step_up)
        done = self._move.share(self._move_s)
        self._move_s += self._pace * elapsed_s
        done = self._move.share(self._move_s) - done
        self._flown.keeper.shift(done * self._move.by_enu_m, done * self._move.turn_rad)

    def _end(self, now: Now, pos_enu_m: FloatArray) -> StepTick:
        """The move is over; tells how far it went, and whether the size is what was asked for."""
        flown, move = self._flown, self._move
        flown.resize(self._size_before * move.scale)
        if move.scale != 1.0:
            flown.tell_formation(f"{flown.size:.6g}")
        by = " ".join(f"{value:.2f}" for value in pos_enu_m.mean(axis=0) - self._from_enu_m)
        told = " ".join(f"{value:.2f}" for value in move.by_enu_m)
        flown.tell(f"the middle of the team has moved by {by} m (ENU), told were {told} m")
        self._tell_size(now.poses)
        if flown.stage.scale.kind == "free" and move.scale != 1.0:
            why = missed(self._sizes(now.poses), self._stood_at, move.scale, flown.stage, flown.keep_out_m)
            if why:
                flown.figures.lost()
                return StepTick(give_up=why)
        return StepTick(done=True)

    def _outside(self, pos_enu_m: FloatArray) -> str:
        """Why the move would end outside the fence, from where the team is; empty if it would not."""
        move, plan = self._move, self._flown.plan
        centre = pos_enu_m.mean(axis=0)
        offset = move.scale * (pos_enu_m - centre)
        cos, sin = np.cos(move.turn_rad), np.sin(move.turn_rad)
        turned = np.stack(
            [cos * offset[:, 0] - sin * offset[:, 1], sin * offset[:, 0] + cos * offset[:, 1], offset[:, 2]], axis=1
        )
        end = centre + move.by_enu_m + turned
        low, high = np.array(plan.spec.fence.min_m), np.array(plan.spec.fence.max_m)
        low[2] = max(low[2], plan.min_altitude_m)
        beyond = np.maximum(low - end, end - high)
        vehicle, axis = (int(k) for k in np.unravel_index(int(np.argmax(beyond)), beyond.shape))
        if beyond[vehicle, axis] <= _FENCE_SPARE_M:
            return ""
        return (
            f"move not begun: it would take vehicle {plan.spec.vehicles[vehicle].id} to {'xyz'[axis]} ="
            f" {end[vehicle, axis]:.2f} m, {beyond[vehicle, axis]:.2f} m beyond the fence or below min_altitude_m"
        )


class _ToPlaces(StepFlight):
    """Everybody has a place: where it is, or as far from where the team's middle goes as it is from that now."""

    formed = False

    def __init__(self, flown: UnderWay, now_ns: int) -> None:
        super().__init__(flown, now_ns)
        self._from_middle_ned_m: FloatArray | None = None
        self._middle_ned_m: FloatArray = np.zeros(3)

    def _begin(self, now: Now) -> FloatArray:
        """Takes where everybody comes to rest at the beginning; returns offsets from the middle, shape (n, 3)."""
        if self._from_middle_ned_m is None:
            rest_ned_m = now.poses.pos_team_ned_m + self._flown.settle_s * now.poses.vel_ned_m_s
            counts = self._flown.members & np.isfinite(rest_ned_m).all(axis=1)
            self._middle_ned_m = rest_ned_m[counts].mean(axis=0) if counts.any() else np.zeros(3)
            # Whoever is not seen now counts as in the middle: monitors hold it, and avoidance keeps the others off it.
            self._from_middle_ned_m = np.nan_to_num(rest_ned_m - self._middle_ned_m)
        return self._from_middle_ned_m


class Hovering(_ToPlaces):
    """Stays where it is for its time."""

    phase = "hold"

    def __init__(self, flown: UnderWay, now_ns: int, step: HoverStep) -> None:
        super().__init__(flown, now_ns)
        self._step = step

    def tick(self, now: Now) -> StepTick:
        """Stays."""
        places_ned_m = self._begin(now) + self._middle_ned_m
        done = now.now_ns - self._since_ns >= self._step.seconds * SECOND_NS
        return StepTick(done=done, places_ned_m=places_ned_m)


class Going(_ToPlaces):
    """Flies through places, the last of which is reached when everybody has been there for a second."""

    phase = "move"

    def __init__(self, flown: UnderWay, now_ns: int, step: GoToStep | WaypointsStep) -> None:
        super().__init__(flown, now_ns)
        self._step = step
        self._places_ned_m: FloatArray = frames.ned_from_enu(flown.plan.places_enu_m[flown.number])
        self._leg = 0

    def tick(self, now: Now) -> StepTick:
        """Flies on, to the next place when this one is reached."""
        flown, step = self._flown, self._step
        from_middle_ned_m = self._begin(now)
        to_ned_m = from_middle_ned_m + self._places_ned_m[self._leg]
        off_m = np.where(flown.members, np.linalg.norm(now.poses.pos_team_ned_m - to_ned_m, axis=1), 0.0)
        near_m = (step.tolerance_m or place_tolerance_m(flown.plan)) + 0.5 * now.sway_m
        there = bool((off_m <= near_m).all())
        last = self._leg == len(self._places_ned_m) - 1
        if there and not last:
            self._leg += 1
            self._since_ns = now.now_ns
        elif not there and now.now_ns - self._since_ns >= step.timeout_s * SECOND_NS:
            worst = int(np.argmax(np.where(np.isfinite(off_m), off_m, np.inf)))
            where = " ".join(f"{value:.2f}" for value in frames.enu_from_ned(to_ned_m[worst]))
            how = f"{off_m[worst]:.2f} m from" if np.isfinite(off_m[worst]) else "not known to be at"
            vehicle = flown.plan.spec.vehicles[worst].id
            why = f"vehicle {vehicle} is {how} its place {where} m (ENU), limit is {near_m:.2f} m"
            return StepTick(give_up=f"not there after {step.timeout_s:g} s: {why}", places_ned_m=to_ned_m)
        done = self._held(there, now.now_ns) and last
        return StepTick(done=done, places_ned_m=from_middle_ned_m + self._places_ned_m[self._leg])


def place_tolerance_m(plan: MissionPlan) -> float:
    """How near to a place counts as there: 0.15 m, or what positions may be off where that is more."""
    return max(_PLACE_M, _OF_MARGIN * plan.margin_m)


def step_flight(flown: UnderWay, now_ns: int, step: Step) -> StepFlight:
    """The class that flies a step, at its beginning."""
    match step:
        case FormStep():
            return Forming(flown, now_ns, step)
        case HoldStep():
            return Holding(flown, now_ns, step)
        case MoveStep():
            return Moving(flown, now_ns)
        case HoverStep():
            return Hovering(flown, now_ns, step)
        case GoToStep() | WaypointsStep():
            return Going(flown, now_ns, step)
