"""What every step of a mission in flight is: what it looks at in a tick, and what comes of it.

The kinds of steps are in ``steps``, and those that move the formation in ``moving`` and ``leading``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from groundstation.core.motion import Motion
from groundstation.core.phases import Phase
from groundstation.core.types import BoolArray, FloatArray
from groundstation.mission.flight.free_size import Sizes, sizes_of, stands_at
from groundstation.mission.flight.poses import Poses
from groundstation.mission.flight.under_way import UnderWay
from groundstation.mission.timing import SECOND_NS, Held

HOLD_TOLERANCE = 2.0
"""Noise may exceed the tolerance for a moment; twice of it for a second is no noise."""


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
        stands: all the same the formation stands: whoever was free to ask for something else could.
        motion: what the formation does as one; None at rest.
        present: the part of it that shows in velocities already.
        places_ned_m: everybody flies there, shape (n, 3), and forms nothing; None in formation.
    """

    done: bool = False
    give_up: str = ""
    stands: bool = False
    motion: Motion | None = None
    present: Motion | None = None
    places_ned_m: FloatArray | None = None


class StepFlight:
    """A step under way.

    Args:
        flown: what it belongs to.
        now_ns: when it begins.
    """

    phase: ClassVar[Phase]
    """In which it is flown."""
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
        limit_m = HOLD_TOLERANCE * tolerance_m + now.sway_m
        if not self._held(not now.error_m <= limit_m, now.now_ns, steady_ns):
            return ""
        self._flown.figures.lost()
        return (
            f"formation lost while {doing}: {now.off}, limit is"
            f" {HOLD_TOLERANCE:g} times the tolerance of {now.allowed(tolerance_m)}"
        )

    def _sizes(self, poses: Poses) -> Sizes:
        return sizes_of(poses.pos_team_ned_m[self._flown.members], self._flown.stage)

    def _tell_size(self, poses: Poses) -> None:
        """Tells the log how large a formation came out whose size is left to chance."""
        if self._flown.stage.scale.kind == "free":
            self._flown.tell(stands_at(self._sizes(poses), self._flown.stage))
