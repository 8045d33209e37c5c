"""Flies one mission: bytes and times in, bytes out.

Flight, dry run, replay and tests all run this object. It reads no clock, sleeps never and draws nothing at random;
``step`` is called on a fixed tick with the time, and all that it does follows from what it was given before.

It takes bytes in, lets the monitors look, steps the phase, holds whoever should stand still, and transmits. What the
team does is in ``phases``, who does what in ``roster``. Whatever goes wrong in the air ends in RETURN and LAND; before
arming it ends at once, with nothing armed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from groundstation.core.law import OwnCodeError
from groundstation.core.phases import AIRBORNE_PHASES, FORMATION_PHASES, UNWATCHED_PHASES, Phase
from groundstation.core.quick import some
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.mavlink.blocks import Block
from groundstation.mavlink.codec import Piece
from groundstation.mavlink.station import Outgoing
from groundstation.mavlink.vehicle import NEVER
from groundstation.mission.flight.poses import Poses, out_of_sight
from groundstation.mission.lookout import Lookout
from groundstation.mission.orders import Orders
from groundstation.mission.phases.machine import Machine
from groundstation.mission.phases.table import Event
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.purpose import Purpose
from groundstation.mission.team import Team
from groundstation.mission.timing import SECOND_NS, Held
from groundstation.mission.told import Told
from groundstation.mission.verdict import Figures, Note

__all__ = ["AIRBORNE_PHASES", "FORMATION_PHASES", "Figures", "Note", "Phase", "Runner"]

_FAULTS_NOTED = 5
_SIGHTLESS_NS = 2 * SECOND_NS  # so long everybody stands still where poses cannot be worked out


class Runner(Told):
    """One mission under way.

    Args:
        plan: what to fly.
        start_ns: time at which it begins, on the clock of all other times.
        purpose: what for.

    Attributes:
        plan: what is flown.
    """

    def __init__(self, plan: MissionPlan, start_ns: int, purpose: Purpose = Purpose.FLY) -> None:
        self.plan = plan
        team = Team(plan, start_ns, purpose)
        super().__init__(team, Machine(team, start_ns, purpose))
        self._orders = Orders(self._team, self._machine)
        self._lookout = Lookout(self._team, self._machine)
        self._period_ns = round(SECOND_NS / plan.spec.rate_hz)
        self._sightless = Held()
        self._faults = 0
        self._lines: list[str] = []
        self._sent_ned_m_s: FloatArray = np.zeros((plan.size, 3))
        self._shape = plan.compensator()
        # Setpoints of vehicles on a narrow link go out every few ticks, one vehicle after the other.
        self._setpoint_every: IntArray = np.array(
            [max(1, int(np.ceil(plan.spec.rate_hz / plan.rates_of(i).setpoint_hz - 1e-9))) for i in range(plan.size)]
        )
        self._takes_turns = bool((self._setpoint_every > 1).any())
        for link, rates in enumerate(plan.rates):
            if rates.limited:
                self._team.verdict.note("info", rates.words(plan.links[link], plan.link_of_vehicle.count(link)))

    @property
    def sent_ned_m_s(self) -> FloatArray:
        """Velocities of the last tick, shape (n, 3): zero for whoever stands still or gets none.

        With ``compensate_s`` what vehicles are to fly, and not the commands that make them.
        """
        return self._sent_ned_m_s.copy()

    # What comes in

    def receive(self, link: int, peer: str, data: bytes, t_rx_ns: int) -> None:
        """Takes a datagram; see ``Station.receive``."""
        self._team.station.receive(link, peer, data, t_rx_ns)

    def take(self, link: int, peer: str, pieces: Sequence[Piece], t_rx_ns: int) -> None:
        """Takes what was split before; see ``Station.take``."""
        self._team.station.take(link, peer, pieces, t_rx_ns)

    def take_block(self, block: Block) -> None:
        """Takes many datagrams; see ``Station.take_block``."""
        self._team.station.take_block(block)

    def operator(self, command: str) -> None:
        """Takes a line of the operator, see ``operator.parse_command``; it is acted upon in the next step.

        A line that is not understood, or that the phase refuses, changes nothing and is answered by a note.
        """
        self._lines.append(command)

    # The tick

    def step(self, now_ns: int) -> list[Outgoing]:
        """Acts on all that was received: one tick.

        Args:
            now_ns: time of this tick, later than that of the tick before.

        Returns:
            Datagrams to be sent.
        """
        team, figures = self._team, self._team.figures
        figures.ticked(late=self._last_step_ns != NEVER and now_ns - self._last_step_ns >= 2 * self._period_ns)
        self._last_step_ns = now_ns
        self._guarded(now_ns, team.station.ingest)
        self._guarded(now_ns, partial(self._listen, now_ns))
        self._guarded(now_ns, partial(self._machine.state.locate, now_ns))
        poses = self._poses(now_ns)
        sightless = self._sightless.since_ns != NEVER
        lines, self._lines = self._lines, []
        for line in lines:
            self._guarded(now_ns, partial(self._orders.obey, line, poses, now_ns, sightless=sightless))
        if team.stance.flies:
            figures.flown((now_ns - team.stance.takeoff_ns) / SECOND_NS)
        flying = self.phase in AIRBORNE_PHASES and team.stance.flies
        if flying and sightless:
            self._wait_for_sight(now_ns)
        elif flying:
            poses = self._watched(out_of_sight(poses), now_ns)
        elif self.phase in UNWATCHED_PHASES and not sightless:
            self._guarded(now_ns, partial(self._lookout.watch_the_ground, poses, now_ns))
        # Whatever the monitors do, who has been asked to land is asked until it does.
        if self.phase is Phase.SILENT or (flying and not sightless):
            self._guarded(now_ns, partial(self._bring_down, now_ns, poses))
        velocity_ned_m_s = self._stepped(now_ns, poses, sightless=sightless)
        self._guarded(now_ns, partial(team.killing.step, now_ns))
        return self._transmitted(now_ns, velocity_ned_m_s)

    def _listen(self, now_ns: int) -> None:
        """Takes the vehicles' words and answers."""
        team = self._team
        for outcome in team.station.commands.take_outcomes():
            self._machine.state.heard(outcome)
            team.landing.heard(outcome)
            if team.words.refused(outcome):
                team.verdict.note("info", f"{team.name(outcome.vehicle)}: {outcome.words()}")
        for text in team.fleet.take_texts(now_ns):
            team.verdict.note("info", f"{team.name(text.vehicle)} says: {text.text}")
            team.words.said(text)
        if (room := team.fleet.room) is not None:
            room.look(now_ns)
            for line in room.take_news():
                team.verdict.note("alarm" if team.stance.flies else "info", line)

    def _poses(self, now_ns: int) -> Poses:
        """Where everybody is; unknown, all of it, when that cannot be worked out."""
        try:
            poses = self._team.frame.poses(self.fleet, now_ns)
        except Exception as error:
            self._fault(error, now_ns)
            self._sightless(True, now_ns)
            n = self.plan.size
            level = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
            return Poses(np.full((n, 3), np.nan), np.zeros((n, 3)), level, np.zeros(n, dtype=np.bool_))
        self._sightless.forget()
        return poses

    def _wait_for_sight(self, now_ns: int) -> None:
        """Poses cannot be worked out: everybody stands still for a moment, then is left to its failsafe.

        What the autopilots do without a ground station was set before takeoff so that they keep clear of each other.
        """
        if self._sightless(True, now_ns, _SIGHTLESS_NS):
            words = "setpoints end, the autopilots' own failsafe takes over"
            self._machine.give_up(words, now_ns, Event.SILENCE)

    def _watched(self, poses: Poses, now_ns: int) -> Poses:
        """Lets the monitors look; returns the poses to steer by."""
        try:
            poses = self._lookout.watch(poses, self._sent_ned_m_s, now_ns)
            self._lookout.measure(poses, now_ns)
        except Exception as error:
            self._fault(error, now_ns)
        return poses

    def _bring_down(self, now_ns: int, poses: Poses) -> None:
        """Asks those to land who may, and tells where they come down."""
        team, phase = self._team, self.phase
        coming, silent = phase in (Phase.RETURN, Phase.LAND), phase is Phase.SILENT
        team.landing.step(now_ns, team.around(poses, coming=coming, silent=silent))
        for news in team.landing.spots.take_news():
            if news.elsewhere and not team.roster.lands_here[news.vehicle]:
                team.verdict.abort(news.text)
            else:
                team.verdict.note("alarm", news.text)

    def _stepped(self, now_ns: int, poses: Poses, *, sightless: bool) -> FloatArray:
        """Steps the phase; whatever goes wrong there, the vehicles get a setpoint: to stand still."""
        still: FloatArray = np.zeros((self.plan.size, 3))
        state = self._machine.state
        if sightless and state.steers:
            return still
        try:
            step = state.step(now_ns, poses)
            if step.event is not None:
                self._machine.happen(step.event, now_ns)
        except Exception as error:
            self._fault(error, now_ns)
            self._team.helm.rest()
            return still
        return still if step.vel_ned_m_s is None else step.vel_ned_m_s

    def _transmitted(self, now_ns: int, velocity_ned_m_s: FloatArray) -> list[Outgoing]:
        """What goes out: setpoints to whom they are due, and whatever else waits."""
        team, state = self._team, self._machine.state
        if not state.speaks:
            return team.station.transmit_poses()  # without which they could not even come down by themselves
        # Who waits to hear us follows the first setpoint that comes through, up to a second before we know.
        still = team.board.hold | team.board.waits | ~team.steerable
        told = team.board.told(velocity_ned_m_s)
        sent = np.where(still[:, None], 0.0, told) if some(still) else told.copy()
        self._sent_ned_m_s = team.landing.dark.velocities(sent, team.landing.in_the_dark, now_ns)
        steered = due = np.asarray(team.roster.steered & state.streams)
        if self._takes_turns:
            due = steered & ((team.figures.ticks + np.arange(self.plan.size)) % self._setpoint_every == 0)
        try:
            return team.station.transmit(now_ns, self._shaped(steered), team.stance.yaw_ned_rad, due)
        except Exception as error:
            self._fault(error, now_ns)
            return []  # the next tick tries again; autopilots fly on by their last setpoint for half a second

    def _shaped(self, steered: BoolArray) -> FloatArray:
        """Commands that make vehicles fly what was sent, shape (n, 3), NED; as it is without compensation."""
        team, shape = self._team, self._shape
        if shape is None:
            return self._sent_ned_m_s
        odd = shape.compensated & team.board.strays
        if some(odd):
            shape.stop(odd)
            for vehicle in odd.nonzero()[0].tolist():
                words = "does not answer as its profile says: its setpoints are not shaped any more (compensate_s)"
                team.verdict.note("alarm", f"{team.name(vehicle)} {words}")
        shape.rest(~steered)
        return shape(self._sent_ned_m_s)

    def _guarded(self, now_ns: int, act: Callable[[], None]) -> None:
        """Does one part of a tick. Whatever goes wrong in it is told and ends the mission, and stops no other part."""
        try:
            act()
        except Exception as error:
            self._fault(error, now_ns)

    def _fault(self, error: Exception, now_ns: int) -> None:
        """A fault of our own, in any part of a tick: the team comes back.

        Where that fails too it stands still until the time for it is over, and then lands.
        """
        self._faults += 1
        text = f"fault in the ground station, {type(error).__name__}: {error}"
        if isinstance(error, OwnCodeError):  # a law of the mission's own is no part of the ground station
            text = str(error)
        if self._faults <= _FAULTS_NOTED:
            self._team.verdict.note("alarm", text)
        left = "; everybody is left to its own failsafe" if self.phase is Phase.TAKEOVER else ""
        self._machine.give_up(text + left, now_ns, Event.FAULT)
