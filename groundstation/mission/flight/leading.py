"""The formation goes where the operator says: orders that move, turn and scale it, one after the other.

Each order is flown as a ``move`` step of the mission is, as fast as half of the limits allow whoever it carries
farthest. It is judged when it is given, from where the team will be by then, and once more when it begins. What it asks
of the fence, of sizes and of the time left is refused in words, and the team stays as it is.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from groundstation.core import frames
from groundstation.core.motion import MovePlan
from groundstation.core.phases import Phase
from groundstation.core.types import FloatArray
from groundstation.mission.flight.moving import Moving, leads_astray
from groundstation.mission.flight.step import Now, StepFlight, StepTick
from groundstation.mission.flight.under_way import UnderWay
from groundstation.mission.plan.schema import LeadStep
from groundstation.mission.plan.timed import in_good_time
from groundstation.mission.timing import SECOND_NS

_WAITING_MAX = 4
_WAY = tuple(np.linspace(0.0, 1.0, 49).tolist())
"""Shares of a move at which it has to lie inside the fence: every 7.5 degrees of a whole turn."""
_SIZE_SPARE = 1e-6


@dataclass(frozen=True)
class Asked:
    """An order that moves the formation.

    Attributes:
        text: as it was given.
        move: what it comes to, in the time that it takes.
    """

    text: str
    move: MovePlan


class Leading(StepFlight):
    """Keeps the formation, and moves it as the operator says, until its time is over or the operator ends it.

    Args:
        flown: what it belongs to.
        now_ns: when it begins.
        step: for how long, and between which sizes.
    """

    phase = Phase.LEAD

    def __init__(self, flown: UnderWay, now_ns: int, step: LeadStep) -> None:
        super().__init__(flown, now_ns)
        self._step = step
        self._waiting: deque[Asked] = deque()
        self._moving: Moving | None = None
        self._flying: Asked | None = None
        self._ends = ""
        self._done = 0

    # What the operator says

    def steer(self, text: str, wanted: MovePlan, pos_team_ned_m: FloatArray, now_ns: int) -> tuple[bool, str]:
        """Takes an order.

        Args:
            text: as it was given.
            wanted: what it comes to; its duration does not matter.
            pos_team_ned_m: where everybody is, shape (n, 3); NaN where that is not known.
            now_ns: time of the tick.

        Returns:
            Whether it is taken, and how long it takes, or why not.
        """
        flown, step, plan = self._flown, self._step, self._flown.plan
        if self._ends:
            return False, f"the lead step ends ({self._ends})"
        if len(self._waiting) >= _WAITING_MAX:
            return False, f"{_WAITING_MAX} orders wait already; `stay` drops them"
        lost = np.flatnonzero(~np.isfinite(pos_team_ned_m).all(axis=1))
        if lost.size:
            return False, f"where vehicle {plan.spec.vehicles[int(lost[0])].id} is, is not known at the moment"
        before = [] if self._moving is None else [self._moving.left]
        before += [item.move for item in self._waiting]
        size = flown.size * float(np.prod([move.scale for move in before]))
        why = self._wrong_size(size, wanted.scale)
        if why:
            return False, why
        points_m = size * (flown.stage.formation.points_enu_m - flown.stage.formation.points_enu_m.mean(axis=0))
        move = in_good_time(wanted, points_m, plan.spec.speed_limit_m_s, plan.acceleration_limit_m_s2)
        pos_enu_m = frames.enu_from_ned(pos_team_ned_m)
        for earlier in before:
            pos_enu_m = earlier.carried(pos_enu_m)
        outside = leads_astray(plan, pos_enu_m, move, _WAY)
        if outside:
            return False, f"it {outside}"
        left_s = step.seconds - (now_ns - self._since_ns) / SECOND_NS
        needed_s = sum(item.seconds for item in before) + move.seconds
        if needed_s > left_s:
            after = " after what waits" if before else ""
            return False, f"it takes {needed_s:.1f} s{after}, and the lead step ends in {left_s:.1f} s"
        self._waiting.append(Asked(text, move))
        waits = f", after {len(before)} before it" if before else ""
        return True, f"{text}: takes {move.seconds:.1f} s{waits}"

    def _wrong_size(self, size: float, scale: float) -> str:
        """Why the formation, of a size, is not to be scaled by that; empty where it may be."""
        if scale == 1.0:
            return ""
        if self._flown.stage.scale.kind == "free":
            return "the formation's size is left free (scale.kind), so nothing holds it"
        step = self._step
        low, high = step.smallest * (1.0 - _SIZE_SPARE), step.largest * (1.0 + _SIZE_SPARE)
        if low <= size * scale <= high:
            return ""
        return (
            f"it would make the formation {size * scale:.3g} times its size; the mission allows {step.smallest:g} to"
            f" {step.largest:g} (lead.smallest, lead.largest), and it is at {size:.3g}"
        )

    def stay(self) -> None:
        """The move under way comes to rest, and those that wait are dropped."""
        if self._waiting:
            self._flown.tell(f"dropped: {', '.join(item.text for item in self._waiting)}")
        self._waiting.clear()
        if self._moving is not None:
            self._moving.end_early()

    def end(self, why: str) -> None:
        """The step ends as soon as the team has come to rest."""
        if not self._ends:
            self._ends = why
            self.stay()

    # The tick

    def stood_still(self, held_ns: int) -> None:
        """The operator held the team for a while."""
        super().stood_still(held_ns)
        if self._moving is not None:
            self._moving.stood_still(held_ns)

    def left_room(self, room: float) -> None:
        """A wall slows the move down."""
        if self._moving is not None:
            self._moving.left_room(room)

    def tick(self, now: Now) -> StepTick:
        """Goes on with what was asked for, or keeps the formation."""
        flown = self._flown
        if now.now_ns - self._since_ns >= self._step.seconds * SECOND_NS:
            self.end(f"its {self._step.seconds:g} s are over")
        if self._moving is None and self._waiting:
            self._flying = self._waiting.popleft()
            self._moving = Moving(flown, now.now_ns, self._flying.move, _WAY)
        if self._moving is not None:
            tick = self._moving.tick(now)
            if tick.give_up and not tick.stands:
                return tick
            if not (tick.give_up or tick.done):
                return tick
            self._over(tick.give_up)
            return StepTick()
        flown.figures.held_within(now.error_m)
        lost = self._lost("being led", now)
        if lost:
            return StepTick(give_up=lost)
        if self._ends:
            orders = "1 order was" if self._done == 1 else f"{self._done} orders were"
            flown.tell(f"lead is over, {self._ends}: {orders} flown")
        return StepTick(done=bool(self._ends))

    def _over(self, why_not: str) -> None:
        """A move has ended, or could not be flown: whatever was asked for after it counted on it."""
        text = self._flying.text if self._flying is not None else ""
        cut = self._moving is not None and self._moving.cut_short
        self._moving = self._flying = None
        if why_not:
            self._flown.note("alarm", f"{text}: {why_not}", ())
            self.stay()
            return
        self._done += 1
        self._flown.tell(f"{text}: ended early" if cut else f"{text}: done")
