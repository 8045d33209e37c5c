"""The phase in which vehicles that are in the air already are taken over."""

from __future__ import annotations

import numpy as np

from groundstation.core.phases import Phase
from groundstation.mission.flight.poses import Poses
from groundstation.mission.ground.take_over import TakeOver
from groundstation.mission.phases.state import Entry, PhaseState, Step
from groundstation.mission.phases.table import Event
from groundstation.mission.team import Team


class TakeOverPhase(PhaseState):
    """Holds whoever is in the air, then brings everybody home whose place is known.

    Attributes:
        take_over: how it is coming on.
    """

    phase = Phase.TAKEOVER
    streams = True

    def __init__(self, team: Team, entry: Entry) -> None:
        super().__init__(team, entry)
        self.take_over = TakeOver(
            team.plan, team.station, team.frame, team.preflight, roster=team.roster, start_ns=entry.now_ns
        )

    def locate(self, now_ns: int) -> None:
        """Where the vehicles' frames lie is found out from where they took off."""
        self._team.frame.placement.look_in_flight(self._team.fleet, now_ns)

    def step(self, now_ns: int, poses: Poses) -> Step:
        """Goes on taking over."""
        team, verdict = self._team, self._team.verdict
        state = self.take_over.step(now_ns, poses.pos_team_ned_m)
        for note in state.notes:
            verdict.note("info", note)
        verdict.trouble(state.problems + state.waiting)
        team.stance.face(self.take_over.yaw_ned_rad)
        if not state.done:
            return Step()
        home = state.home
        if not home.any():
            verdict.refuse(state.problems or ["nobody is in the air; there is nothing to take over"])
            return Step(event=Event.REFUSED)
        team.frame.settle_in_flight(team.fleet)
        team.fleet.hold_addresses(team.plan.signed_links)
        team.board.begin(team.fleet)
        team.roster.release(np.flatnonzero(~home).tolist())
        team.formation.gather_at(self.take_over.gather_ned_m())
        team.stance.take_off(now_ns)
        for line in team.frame.words():
            verdict.note("info", line)
        for problem in state.problems:
            verdict.abort(problem)
        names = ", ".join(str(own_id) for own_id in team.fleet.ids[home])
        verdict.note("info", f"taken over and brought home: vehicle {names}")
        return Step(event=Event.TAKEN)
