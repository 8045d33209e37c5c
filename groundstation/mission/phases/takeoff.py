"""From the pads to the places in the air above them."""

from __future__ import annotations

import numpy as np

from groundstation.core.phases import Phase
from groundstation.mission.flight.climb import Climb
from groundstation.mission.flight.poses import Poses
from groundstation.mission.phases.state import Entry, PhaseState, Step
from groundstation.mission.phases.table import NEXT, Event
from groundstation.mission.team import Team
from groundstation.mission.timing import SECOND_NS, There

_TOLERANCE_M = 0.1


class TakeoffPhase(PhaseState):
    """Until everybody is above its pad."""

    phase = Phase.TAKEOFF
    steers = streams = True

    def __init__(self, team: Team, entry: Entry) -> None:
        super().__init__(team, entry)
        self._climb = Climb(team.plan, team.roster, team.helm.guide.beside_m, team.standing)
        self._there = There(team.plan.size)

    def leave(self, to: Phase) -> None:
        """A takeoff that is asked again now would be obeyed; whoever does not go on to climb gets setpoints."""
        self._team.forget_commands()
        if to in (Phase.RETURN, Phase.STOP):
            self._team.roster.end_climb(self._team.roster.climbing)

    def stood_still(self, held_ns: int) -> None:
        """The operator held it for a while."""
        super().stood_still(held_ns)
        self._there.forget()

    def step(self, now_ns: int, poses: Poses) -> Step:
        """Climbs, by command and by velocity."""
        team, gather_ned_m = self._team, self._team.formation.gather_ned_m
        offset_m = np.linalg.norm(poses.pos_team_ned_m - gather_ned_m, axis=1)
        height_m, target_m = team.height_m(poses.pos_team_ned_m), team.height_m(gather_ned_m)
        self._climb.step(now_ns, team.fleet, team.station.commands, height_m, target_m)
        to_go_m = np.where(team.roster.climbing, np.inf, offset_m)
        there = self._there(to_go_m, team.tolerance_m(_TOLERANCE_M), now_ns)
        event = None
        if there.all():
            event = NEXT[team.formation.next_step(now_ns, poses)]
        elif now_ns - self.since_ns >= team.plan.spec.takeoff.timeout_s * SECOND_NS:
            said = team.words.by_vehicle()
            late = ", ".join(
                f"{team.name(i)} is {offset_m[i]:.2f} m from its place" + (f": {said[i]}" if i in said else "")
                for i in np.argsort(-offset_m)[:3].tolist()
            )
            team.verdict.abort(f"takeoff not finished after {team.plan.spec.takeoff.timeout_s:g} s: {late}")
            event = Event.GIVE_UP
        return Step(team.helm.to_targets(poses, gather_ned_m).vel_ned_m_s, event)
