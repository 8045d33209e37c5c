"""The phases that are flown in formation: form, hold, move, lead."""

from __future__ import annotations

import numpy as np

from groundstation.mission.flight.poses import Poses
from groundstation.mission.phases.phase import Phase
from groundstation.mission.phases.state import PhaseState, Step
from groundstation.mission.phases.table import Event
from groundstation.mission.team import PAD_TOLERANCE_M

_EVENTS = {
    "form": Event.NEXT_FORM,
    "hold": Event.NEXT_HOLD,
    "move": Event.NEXT_MOVE,
    "lead": Event.NEXT_LEAD,
    "return": Event.STEPS_DONE,
}


def event_of(follows: str) -> Event:
    """What it is called that a phase of this name is the next of the mission."""
    return _EVENTS[follows]


class FormationPhase(PhaseState):
    """One step of the mission."""

    steers = streams = True

    def stood_still(self, held_ns: int) -> None:
        """The operator held it for a while."""
        super().stood_still(held_ns)
        self._team.formation.stood_still(held_ns)

    def step(self, now_ns: int, poses: Poses) -> Step:
        """Flies the formation; those that have dropped out fly apart."""
        team, formation = self._team, self._team.formation
        tick = formation.step(now_ns, poses, team.absent(), team.board.sway_m)
        words = team.preflight.checks.turns.words(formation.role_of_agent, formation.formation.points_enu_m)
        if words is not None:
            team.verdict.note("alarm", words)
        event = None
        if tick.give_up:
            team.verdict.abort(tick.give_up)
            event = Event.GIVE_UP
        elif tick.follows is not None:
            event = event_of(tick.follows)
        out = ~team.roster.in_formation
        if not out.any():
            return Step(tick.vel_ned_m_s, event)
        apart = team.apart.step(now_ns, poses, formation.gather_ned_m, team.tolerance_m(PAD_TOLERANCE_M))
        return Step(np.where(out[:, None], apart, tick.vel_ned_m_s), event)


class FormPhase(FormationPhase):
    """Until every distance is within its tolerance."""

    phase = Phase.FORM


class HoldPhase(FormationPhase):
    """Keeps the formation."""

    phase = Phase.HOLD


class MovePhase(FormationPhase):
    """Moves, turns and scales it."""

    phase = Phase.MOVE


class LeadPhase(FormationPhase):
    """Keeps it, and moves it as the operator says."""

    phase = Phase.LEAD
