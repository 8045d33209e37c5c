"""The phases before takeoff: preflight, and arming all together or not at all."""

from __future__ import annotations

import numpy as np

from groundstation.core import frames
from groundstation.core.phases import Phase
from groundstation.mavlink.commands import Outcome
from groundstation.mission.flight.poses import Poses
from groundstation.mission.ground.arming import Arming
from groundstation.mission.ground.preflight import REASONS_NS
from groundstation.mission.operator import Order
from groundstation.mission.phases.state import Entry, PhaseState, Step
from groundstation.mission.phases.table import Event
from groundstation.mission.team import Team
from groundstation.mission.timing import SECOND_NS, Held

_STREAM_FIRST_NS = SECOND_NS  # PX4 wants about a second of setpoints before it takes OFFBOARD


class ConnectPhase(PhaseState):
    """Until everybody is ready to be armed."""

    phase = Phase.CONNECT

    def __init__(self, team: Team, entry: Entry, *, check_only: bool = False) -> None:
        super().__init__(team, entry)
        self._check_only = check_only
        self._ready = Held()
        self._started = check_only or not team.plan.spec.takeoff.wait
        self._waits = False

    def locate(self, now_ns: int) -> None:
        """Where the vehicles' frames lie is followed until it is settled."""
        self._team.frame.placement.look(self._team.fleet, now_ns)

    def refusal(self, order: Order) -> str | None:
        """A team starts when it is ready, and has waited for the order; parameters are set where they may be."""
        if order is Order.FIX:
            return self._team.preflight.checks.why_not_fix()
        if order is not Order.START or self._waits:
            return None
        if self._started:
            return "the team takes off by itself when preflight is through; `gs fly --wait` makes it wait"
        problems = self._team.verdict.problems or ["the team has not been well for long enough"]
        return f"preflight is not through: {problems[0]}"

    def start(self) -> None:
        """The operator lets the team take off."""
        self._started = True

    def step(self, now_ns: int, poses: Poses) -> Step:
        """Goes on with preflight."""
        team, verdict = self._team, self._team.verdict
        state = team.preflight.step(now_ns, team.words.by_vehicle(now_ns - REASONS_NS), poses.pos_team_ned_m)
        for note in state.notes:
            verdict.note("info", note)
        verdict.trouble(state.fatal + state.waiting)
        late = now_ns - self.since_ns >= team.plan.spec.limits.preflight_s * SECOND_NS
        ready = self._ready(not (state.fatal or state.waiting), now_ns)
        if not self._started:  # whatever is wrong can be put right, however long that takes
            if ready and not self._waits:
                verdict.note("info", "everybody is ready; the team waits for the order `start`")
            self._waits = ready
            return Step()
        if state.fatal or (state.waiting and late):
            verdict.refuse(state.fatal or state.waiting)
            return Step(event=Event.REFUSED)
        if not ready:
            return Step()
        if self._check_only:
            verdict.complete()
            return Step(event=Event.CHECKED)
        team.frame.settle(team.fleet, now_ns)
        team.fleet.hold_addresses(team.plan.signed_links)
        team.board.begin(team.fleet)
        team.stance.face(frames.yaw_ned_from_quat(team.fleet.quat_ned_from_frd))
        for line in team.frame.words():
            verdict.note("info", line)
        team.words.forget()
        return Step(event=Event.READY)


class ArmPhase(PhaseState):
    """Until everybody is armed and in the mode that follows us.

    Attributes:
        arming: how it is coming on.
    """

    phase = Phase.ARM
    streams = True

    def __init__(self, team: Team, entry: Entry) -> None:
        super().__init__(team, entry)
        self.arming = Arming(team.plan, team.fleet, team.station.commands, team.standing, team.roster)
        self._moved: dict[int, str] = {}

    def heard(self, outcome: Outcome) -> None:
        """Takes how a command ended."""
        self.arming.heard(outcome)

    def leave(self, to: Phase) -> None:
        """An arming, or disarming, that is asked again now would be obeyed."""
        self._team.forget_commands()

    def step(self, now_ns: int, poses: Poses) -> Step:
        """Streams first, then asks for what is missing; roles are given when all are armed."""
        team = self._team
        self._moved |= team.board.resting.while_arming(poses.pos_team_ned_m, now_ns)
        if now_ns - self.since_ns < _STREAM_FIRST_NS:
            return Step()
        limits = team.plan.spec.limits
        problem = (
            self.arming.started_anew()
            or self.arming.two_senders(now_ns)
            or self._blind(now_ns, limits.pose_lost_s)
            or self._astray()
        )
        if problem is None and not self.arming.step(now_ns):
            if now_ns - self.since_ns < limits.arming_s * SECOND_NS:
                return Step()
            problem = self.arming.why_not(limits.arming_s, team.words.by_vehicle())
        if problem is not None:
            team.verdict.abort(problem)
            return Step(event=Event.GIVE_UP)
        team.formation.assign(team.preflight.checks.failsafe.roles)
        team.stance.take_off(now_ns)
        return Step(event=Event.ARMED)

    def _astray(self) -> str | None:
        """Words for those whose position moves while they stand, None where nobody's does."""
        return "; ".join(f"{self._team.name(row)}: {words}" for row, words in self._moved.items()) or None

    def _blind(self, now_ns: int, limit_s: float) -> str | None:
        """Words for those whose position is lost while the team is arming, None where nobody's is."""
        team = self._team
        blind = np.flatnonzero(now_ns - team.frame.pose_ns(team.fleet) > limit_s * SECOND_NS)
        silent = team.fleet.silent(now_ns, limit_s)
        lines = (
            f"{team.name(i)}: {'nothing was heard of it' if silent[i] else 'no position'} for"
            f" {limit_s:g} s while the team was arming: its link or its estimator failed, or it has"
            " started anew"
            for i in blind.tolist()
        )
        return "; ".join(lines) or None
