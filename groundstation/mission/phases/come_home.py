"""The way back: to the places above the pads."""

from __future__ import annotations

import numpy as np

from groundstation.core.phases import Phase
from groundstation.mission.flight.poses import Poses
from groundstation.mission.phases.state import Entry, PhaseState, Step
from groundstation.mission.phases.table import Event
from groundstation.mission.team import PAD_TOLERANCE_M, Team
from groundstation.mission.timing import SECOND_NS, There


class ReturnPhase(PhaseState):
    """Until everybody who is waited for is above its pad."""

    phase = Phase.RETURN
    steers = streams = True

    def __init__(self, team: Team, entry: Entry) -> None:
        super().__init__(team, entry)
        self._back = There(team.plan.size)

    def stood_still(self, held_ns: int) -> None:
        """The operator held it for a while."""
        super().stood_still(held_ns)
        self._back.forget()

    def step(self, now_ns: int, poses: Poses) -> Step:
        """Flies home."""
        team = self._team
        places_ned_m = team.places_ned_m(team.formation.gather_ned_m)
        offset_m = np.linalg.norm(poses.pos_team_ned_m - places_ned_m, axis=1)
        waited_for = team.roster.waited_for & team.fleet.armed & ~(team.board.blind | team.landing.lost(now_ns))
        away = ~self._back(np.where(waited_for, offset_m, 0.0), team.tolerance_m(PAD_TOLERANCE_M), now_ns)
        event = None
        if not away.any():
            event = Event.BACK
        elif now_ns - self.since_ns >= team.plan.spec.land.timeout_s * SECOND_NS:
            names = ", ".join(
                f"vehicle {team.fleet.ids[row]} is {offset_m[row]:.2f} m from its place"
                for row in np.flatnonzero(away).tolist()
            )
            waited_s = team.plan.spec.land.timeout_s
            text = f"not everybody is back after {waited_s:g} s, landing: {names}"
            if team.verdict.reason:
                team.verdict.note("alarm", text)
            else:  # who lands elsewhere has not completed its mission
                team.verdict.abort(text)
            event = Event.BACK
        return Step(team.formation.fly_home(poses, team.absent(), places_ned_m), event)
