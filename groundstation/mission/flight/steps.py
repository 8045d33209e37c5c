"""The steps of a mission in flight: one class each, with what it keeps while it lasts and how it ends.

A new kind of step is a class in ``plan.schema`` and one here; it is flown in one of the phases that there are.
"""

from __future__ import annotations

import numpy as np

from groundstation.core import frames
from groundstation.core.phases import Phase
from groundstation.core.types import FloatArray
from groundstation.mission.flight.leading import Leading
from groundstation.mission.flight.moving import Moving
from groundstation.mission.flight.step import Now, StepFlight, StepTick
from groundstation.mission.flight.under_way import UnderWay
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.schema import (
    FormStep,
    GoToStep,
    HoldStep,
    HoverStep,
    LeadStep,
    MoveStep,
    Step,
    WaypointsStep,
)
from groundstation.mission.timing import SECOND_NS

_PLACE_M, _OF_MARGIN = 0.15, 0.35


class Forming(StepFlight):
    """Until every distance has been within its tolerance for a second."""

    phase = Phase.FORM
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
                allowed = now.allowed(step.tolerance_m)
                flown.tell(f"formed while vehicles swayed (gusts, poor velocities): the tolerance was {allowed}")
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

    phase = Phase.HOLD

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

    phase = Phase.HOLD

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

    phase = Phase.MOVE

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
            return Moving(flown, now_ns, flown.plan.moves[flown.number])
        case LeadStep():
            return Leading(flown, now_ns, step)
        case HoverStep():
            return Hovering(flown, now_ns, step)
        case GoToStep() | WaypointsStep():
            return Going(flown, now_ns, step)
