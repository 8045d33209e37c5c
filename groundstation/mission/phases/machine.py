"""Goes from phase to phase as the table says, and makes the objects of the phases."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from groundstation.core.phases import FORMATION_PHASES, Phase
from groundstation.mission.flight.poses import Poses
from groundstation.mission.operator import Order
from groundstation.mission.phases.come_down import DonePhase, LandPhase, SilentPhase
from groundstation.mission.phases.come_home import ReturnPhase
from groundstation.mission.phases.formation import FormationPhase
from groundstation.mission.phases.on_the_ground import ArmPhase, ConnectPhase
from groundstation.mission.phases.stand import PausePhase, StopPhase
from groundstation.mission.phases.state import Entry, PhaseState
from groundstation.mission.phases.table import TABLE, Afterwards, Answer, Event, refusal
from groundstation.mission.phases.takeoff import TakeoffPhase
from groundstation.mission.phases.taking_over import TakeOverPhase
from groundstation.mission.purpose import Purpose
from groundstation.mission.team import Team

_MAKERS: dict[Phase, Callable[[Team, Entry], PhaseState]] = {
    kind.phase: kind
    for kind in (
        ConnectPhase, TakeOverPhase, ArmPhase, TakeoffPhase, StopPhase, PausePhase, ReturnPhase,
        LandPhase, SilentPhase, DonePhase,
    )
} | {phase: partial(FormationPhase, phase) for phase in FORMATION_PHASES}  # fmt: skip


class Machine:
    """Which phase the team is in.

    Args:
        team: what the phases work with.
        start_ns: time at which the first one begins.
        purpose: what for.

    Attributes:
        state: the phase under way.
    """

    def __init__(self, team: Team, start_ns: int, purpose: Purpose = Purpose.FLY) -> None:
        self._team = team
        entry = Entry(start_ns)
        self.state: PhaseState = (
            TakeOverPhase(team, entry)
            if purpose.in_the_air
            else ConnectPhase(team, entry, check_only=purpose.only_checks)
        )
        team.verdict.note("phase", self.state.phase.value)

    @property
    def phase(self) -> Phase:
        """The phase under way."""
        return self.state.phase

    def refusal(self, order: Order) -> str | None:
        """Why an order is refused at this moment, None when it is obeyed."""
        return refusal(self.phase, order) or self.state.refusal(order)

    def happen(self, event: Event, now_ns: int, poses: Poses | None = None) -> None:
        """Something has come about.

        Args:
            event: what.
            now_ns: when.
            poses: of the team, where an order of the operator needs them.

        Raises:
            RuntimeError: it cannot come about in this phase.
        """
        follows, state = TABLE[self.phase][event], self.state
        if follows is Answer.NEVER:
            raise RuntimeError(f"{event.value}: that cannot come about in phase {self.phase.value}")
        if follows is Answer.STAY:
            return
        if isinstance(state, PausePhase):
            if isinstance(follows, Afterwards):
                state.go_on_with(follows.phase)
                return
            if follows is Answer.RESUME:
                self._resume(state, now_ns)
                return
        if not isinstance(follows, Phase):
            raise RuntimeError(f"{event.value}: nothing is held in phase {self.phase.value}")
        self._enter(_MAKERS[follows](self._team, Entry(now_ns, event, state, poses)))

    def _resume(self, pause: PausePhase, now_ns: int) -> None:
        """What was held goes on, or what has to follow instead begins."""
        if pause.instead is not None:
            self._enter(_MAKERS[pause.instead](self._team, Entry(now_ns, Event.ORDER_RESUME, pause)))
            self._team.formation.begin_anew(now_ns)
            return
        self._enter(pause.held)
        pause.held.stood_still(now_ns - pause.since_ns)

    def _enter(self, state: PhaseState) -> None:
        self.state.leave(state.phase)
        self.state = state
        self._team.verdict.note("phase", state.phase.value)

    # What several parts of the program share

    def give_up(self, reason: str, now_ns: int, event: Event = Event.GIVE_UP) -> None:
        """Ends the mission early: on the ground at once, in the air by way of the pads."""
        self._team.verdict.abort(reason)
        self.happen(event, now_ns)

    @property
    def going_on(self) -> bool:
        """Whether the mission goes on without a vehicle that is lost now."""
        phase = self.state.goes_on_with if isinstance(self.state, PausePhase) else self.phase
        return self._team.plan.spec.on_lost != "return_all" and phase in FORMATION_PHASES

    def drop_out(self, reason: str, now_ns: int) -> None:
        """Some vehicles have left the formation: the others come back, or go on without them, as the mission says."""
        if not self.going_on:
            self.give_up(reason, now_ns)
            return
        why_not = self._team.formation.close_up(now_ns)
        if why_not:
            self.give_up(f"{reason}; {why_not}", now_ns)
            return
        self._team.verdict.abort(reason)
        self.happen(Event.GO_ON_WITHOUT, now_ns)
