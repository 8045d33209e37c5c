"""The phases in which everybody stands still: for a moment before the way back, or at the operator's word."""

from __future__ import annotations

import numpy as np

from groundstation.core.phases import Phase
from groundstation.mission.flight.poses import Poses
from groundstation.mission.phases.state import Entry, PhaseState, Step
from groundstation.mission.phases.table import Event
from groundstation.mission.team import Team
from groundstation.mission.timing import SECOND_NS

_STOP_NS = SECOND_NS


class StopPhase(PhaseState):
    """A second of standing still between the operator's ``return`` and the way back."""

    phase = Phase.STOP
    steers = streams = True

    def step(self, now_ns: int, poses: Poses) -> Step:
        """Stands still."""
        self._team.helm.rest()
        return Step(event=Event.STOOD if now_ns - self.since_ns >= _STOP_NS else None)


class PausePhase(PhaseState):
    """Stands still at the operator's word, as long as that is safe; avoidance stays on.

    Attributes:
        held: the phase that goes on afterwards, as it was.
        instead: what follows in place of it, because of what was found meanwhile; None when it goes on.
    """

    phase = Phase.PAUSE
    steers = streams = True

    def __init__(self, team: Team, entry: Entry) -> None:
        super().__init__(team, entry)
        if entry.before is None or entry.poses is None:
            raise ValueError("a hold follows an order, out of a phase in the air")
        self.held: PhaseState = entry.before
        self.instead: Phase | None = None
        self._rest_ned_m = team.rest_ned_m(entry.poses)
        # Who has left the ground stays where it is; a climb by command would go on to its end.
        team.roster.end_climb(team.standing.airborne(entry.now_ns))

    @property
    def goes_on_with(self) -> Phase:
        """What follows when the hold is over."""
        return self.instead or self.held.phase

    def go_on_with(self, phase: Phase) -> None:
        """This follows in place of what was held."""
        self.instead = phase

    def step(self, now_ns: int, poses: Poses) -> Step:
        """Stands still, until a battery or the time is over."""
        team, limits, event = self._team, self._team.plan.spec.limits, None
        why = team.too_low_to_hold(now_ns)
        if why is None and now_ns - self.since_ns >= limits.hold_s * SECOND_NS:
            why = f"held for {limits.hold_s:g} s, which is the limit"
        if why is not None:
            team.verdict.abort(f"{why}; the hold is over, everybody comes back")
            event = Event.GIVE_UP_NOW
        elif not (team.roster.waited_for & team.fleet.armed).any():
            event = Event.NOBODY_LEFT
        # Who was on its way to a place of its own stands still like all others.
        places_ned_m = np.where(team.roster.lands_here[:, None], team.roster.place_ned_m, self._rest_ned_m)
        return Step(team.helm.to_targets(poses, places_ned_m).vel_ned_m_s, event)
