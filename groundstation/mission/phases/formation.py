"""The phases in which the steps of the mission are flown: one class for all of them."""

from __future__ import annotations

import numpy as np

from groundstation.core.phases import Phase
from groundstation.mission.flight.poses import Poses
from groundstation.mission.phases.state import Entry, PhaseState, Step
from groundstation.mission.phases.table import NEXT, Event
from groundstation.mission.team import PAD_TOLERANCE_M, Team


class FormationPhase(PhaseState):
    """One step of the mission.

    Args:
        phase: in which it is flown.
        team: what it works with.
        entry: how it was entered.
    """

    steers = streams = True

    def __init__(self, phase: Phase, team: Team, entry: Entry) -> None:
        super().__init__(team, entry)
        self.phase = phase

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
            event = NEXT[tick.follows]
        out = ~team.roster.in_formation
        if not out.any():
            return Step(tick.vel_ned_m_s, event)
        apart = team.apart.step(now_ns, poses, formation.gather_ned_m, team.tolerance_m(PAD_TOLERANCE_M))
        return Step(np.where(out[:, None], apart, tick.vel_ned_m_s), event)
