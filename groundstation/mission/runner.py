"""Flies one mission: bytes and times in, bytes out.

Flight, dry run, replay and tests all run this object. It reads no clock, sleeps never and draws nothing at random;
``step`` is called on a fixed tick with the time, and all that it does follows from what it was given before.

The team goes through the phases of ``Phase`` together. Whatever goes wrong in the air ends in RETURN and LAND; before
arming it ends at once, with nothing armed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from groundstation.core import frames
from groundstation.core.limits import Fence
from groundstation.core.metrics import min_clearance, min_distance_m
from groundstation.core.regions import SafetySphere
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.mavlink.codec import Piece
from groundstation.mavlink.station import Outgoing, Station
from groundstation.mavlink.vehicle import NEVER, Fleet
from groundstation.mission.blame import HELP_IN_THE_AIR, Blame, still_flying
from groundstation.mission.flight.climb import Climb
from groundstation.mission.flight.formation_flight import FormationFlight
from groundstation.mission.flight.guidance import Guide, Poses
from groundstation.mission.flight.killing import Killing
from groundstation.mission.flight.landing import Landing, clear_spots
from groundstation.mission.flight.standing import landed_age_s
from groundstation.mission.flight.team_frame import TeamFrame
from groundstation.mission.ground.check_table import CheckRow
from groundstation.mission.ground.failsafe import FailsafePlan, out_of_turn
from groundstation.mission.ground.preflight import REASONS_NS, Preflight
from groundstation.mission.monitors.board import Monitor, Sight
from groundstation.mission.operator import OperatorCommand, Order, parse_command, refusal
from groundstation.mission.phases.arming import Arming
from groundstation.mission.phases.phase import AIRBORNE_PHASES, FORMATION_PHASES, Figures, Note, Phase
from groundstation.mission.phases.take_over import TakeOver, out_of_sight
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.roster import enlist
from groundstation.mission.words import Words

__all__ = ["AIRBORNE_PHASES", "FORMATION_PHASES", "Figures", "Note", "Phase", "Runner"]

_SECOND_NS = 1_000_000_000
_STREAM_FIRST_NS = _SECOND_NS  # PX4 wants about a second of setpoints before it takes OFFBOARD
_STEADY_NS = _SECOND_NS  # how long a condition has to hold before the team believes it
_DISARMED_NS = 5 * _SECOND_NS // 2  # two heartbeats that say so
_STOP_NS = _SECOND_NS  # standing still between an abort and the way back
_DOWN_MAX_NS = 120 * _SECOND_NS  # nobody is waited for longer than this while the team comes down
_FAULTS_NOTED = 5
_SIGHTLESS_NS = 2 * _SECOND_NS  # so long everybody stands still where poses cannot be worked out
_TAKEOFF_TOLERANCE_M = 0.1
_PAD_TOLERANCE_M = 0.15
_STREAMING_PHASES = AIRBORNE_PHASES | {Phase.TAKEOVER, Phase.ARM}
_SLOWNESS_MAX = 2.0  # links with a delay make everybody approach more gently, so that errors of velocity show more
_OF_MARGIN = 0.35  # share of the positions' own error that those tolerances are widened to


class Runner:
    """One mission under way.

    Args:
        plan: what to fly.
        start_ns: time at which it begins, on the clock of all other times.
        check_only: stop after the preflight checks, arm nothing.
        look_only: set no parameters either, whatever the mission says; tell what a flight would set.
        take_over: the vehicles are in the air already; take them over and bring them home, see ``takeover``.

    Attributes:
        phase: what the team is doing.
        outcome: None until done; then completed, aborted or refused.
        reason: why it was aborted or refused, "" otherwise.
        figures: see ``Figures``.
        fleet: state of the vehicles.
    """

    def __init__(
        self,
        plan: MissionPlan,
        start_ns: int,
        *,
        check_only: bool = False,
        look_only: bool = False,
        take_over: bool = False,
    ) -> None:
        n = plan.size
        self.plan = plan
        self.phase = Phase.TAKEOVER if take_over else Phase.CONNECT
        self._region = plan.region
        self.outcome: str | None = None
        self.reason = ""
        self.figures = Figures()
        self.fleet = Fleet([vehicle.id for vehicle in plan.spec.vehicles], plan.link_of_vehicle)
        self.problems: list[str] = []
        self._station = Station(
            self.fleet,
            start_ns,
            greeted=[(link, address.peer) for link, address in enumerate(plan.addresses) if address.peer],
        )
        self._frame = TeamFrame(plan)
        self._preflight = Preflight(plan, self._station, self._frame, look_only=look_only)
        self._arming = Arming(plan, self.fleet, self._station.commands)
        self._guide = Guide(plan)
        self._roster = enlist(plan, untaken=take_over)
        self._climb = Climb(plan, self._roster, self._guide.beside_m)
        self._guide_apart = Guide(plan)  # of those that fly apart from the formation: its setpoints are theirs alone
        self._monitor = Monitor(plan)
        self._check_only = check_only
        self._landed_age_s = landed_age_s(plan)
        self._period_ns = round(_SECOND_NS / plan.spec.rate_hz)
        self._start_ns = start_ns
        self._phase_ns = start_ns
        self._takeoff_ns = NEVER
        self._last_step_ns = NEVER
        self._steady_since_ns = NEVER
        self._notes: list[Note] = [Note("phase", self.phase.value)]
        self._take_over = TakeOver(
            plan, self._station, self._frame, self._preflight, roster=self._roster, start_ns=start_ns
        )
        self._flight = FormationFlight(plan, self._roster, self._guide, self.figures, self._note)
        self._landing = Landing(plan, self.fleet, self._station.commands, self._roster, self._guide.beside_m)
        self._killing = Killing(plan, self.fleet, self._station.commands, self._roster)
        self._faults = 0
        self._sightless_since_ns = NEVER
        self._yaw_ned_rad: FloatArray = np.zeros(n)
        self._words = Words()
        self._blame = Blame()
        self._lines: list[str] = []
        self._resume_to = Phase.CONNECT
        self._resume_phase_ns = start_ns
        self._lands_here = False
        self._out_of_turn: list[tuple[int, int]] = []
        self._spoken_to = False  # after silence: the operator wants something of the vehicles again
        self._home_since_ns = np.full(n, NEVER, dtype=np.int64)
        self._sent_ned_m_s: FloatArray = np.zeros((n, 3))
        self._pads_ned_m: FloatArray = frames.ned_from_enu(plan.pads_enu_m)
        self._rest_ned_m: FloatArray = self._pads_ned_m.copy()
        self._spread_m = _OF_MARGIN * plan.margin_m * min(plan.slowness, _SLOWNESS_MAX)
        # Setpoints of vehicles on a narrow link go out every few ticks, one vehicle after the other.
        self._setpoint_every: IntArray = np.array(
            [max(1, int(np.ceil(plan.spec.rate_hz / plan.rates_of(i).setpoint_hz - 1e-9))) for i in range(n)]
        )
        for link, rates in enumerate(plan.rates):
            if rates.limited:
                self._note("info", rates.words(plan.links[link], plan.link_of_vehicle.count(link)))

    # What comes in

    def receive(self, link: int, peer: str, data: bytes, t_rx_ns: int) -> None:
        """Takes a datagram; see ``Station.receive``."""
        self._station.receive(link, peer, data, t_rx_ns)

    def take(self, link: int, peer: str, pieces: Sequence[Piece], t_rx_ns: int) -> None:
        """Takes what was split before; see ``Station.take``."""
        self._station.take(link, peer, pieces, t_rx_ns)

    def operator(self, command: str) -> None:
        """Takes a line of the operator, see ``operator.parse_command``; it is acted upon in the next step.

        A line that is not understood, or that the phase refuses, changes nothing and is answered by a note.
        """
        self._lines.append(command)

    @property
    def done(self) -> bool:
        """Whether there is nothing left to do."""
        return self.phase is Phase.DONE

    @property
    def role_of_agent(self) -> IntArray:
        """Role per vehicle, shape (n,)."""
        return self._flight.role_of_agent

    def formation_error_m(self, pos_m: FloatArray) -> float:
        """Largest |d_ij - d*_ij| of the formation under way, of positions in any one frame, shape (n, 3)."""
        return self._flight.error_m(pos_m)

    @property
    def setpoints_sent(self) -> int:
        """Number of velocity setpoints sent so far."""
        return self._station.setpoints_sent

    @property
    def local_origins_enu_m(self) -> FloatArray:
        """Where the vehicles' own local frames begin in the team frame, see ``TeamFrame.local_origins_enu_m``."""
        return self._frame.local_origins_enu_m()

    @property
    def airborne(self) -> BoolArray:
        """Vehicles that are armed and have not told lately that they stand on the ground, shape (n,)."""
        airborne: BoolArray = self.fleet.armed & ~self.fleet.stands(self._last_step_ns, self._landed_age_s)
        return airborne

    def check_rows(self) -> list[CheckRow]:
        """What preflight found, a row for each vehicle."""
        return self._preflight.rows(self.problems, self._last_step_ns)

    @property
    def failsafe(self) -> FailsafePlan:
        """What the team does when the ground station is gone."""
        return self._preflight.checks.failsafe

    def take_notes(self) -> list[Note]:
        """Hands out what happened since the last call."""
        notes, self._notes = self._notes, []
        return notes

    # The tick

    def step(self, now_ns: int) -> list[Outgoing]:
        """Acts on all that was received: one tick.

        Args:
            now_ns: time of this tick, later than that of the tick before.

        Returns:
            Datagrams to be sent.
        """
        if self._last_step_ns != NEVER and now_ns - self._last_step_ns >= 2 * self._period_ns:
            self.figures.deadline_misses += 1
        self._last_step_ns = now_ns
        self.figures.ticks += 1
        self._guarded(now_ns, self._station.ingest)
        self._guarded(now_ns, self._listen)
        n = self.plan.size
        velocity: FloatArray = np.zeros((n, 3))
        poses = self._poses(now_ns)
        lines, self._lines = self._lines, []
        for line in lines:
            self._guarded(now_ns, self._obey, line, poses, now_ns)
        if self._takeoff_ns != NEVER:
            self.figures.flight_time_s = (now_ns - self._takeoff_ns) / _SECOND_NS
        flying = self.phase in AIRBORNE_PHASES and self._takeoff_ns != NEVER
        sightless = self._sightless_since_ns != NEVER
        if flying and sightless:
            self._wait_for_sight(now_ns)
        elif flying:
            poses = out_of_sight(poses)
            try:
                poses = self._watch(poses, now_ns)
                self._measure(poses)
            except Exception as error:
                self._fault(error, now_ns)
            # Whatever the monitors do, who has been asked to land is asked until it does.
            self._guarded(now_ns, self._landing.step, now_ns, poses)
        if self.phase is Phase.CONNECT:
            self._guarded(now_ns, self._connect, now_ns)
        elif self.phase is Phase.TAKEOVER:
            self._guarded(now_ns, self._take, now_ns)
        elif self.phase is Phase.ARM:
            self._guarded(now_ns, self._arm, now_ns, poses)
        elif self.phase is Phase.SILENT:
            self._guarded(now_ns, self._landing.step, now_ns, poses)
            self._guarded(now_ns, self._come_down, now_ns)
        elif self.phase in AIRBORNE_PHASES and not sightless:
            velocity = self._steer(now_ns, poses)
        self._guarded(now_ns, self._killing.step, now_ns)
        streaming = self._roster.steered & (self.phase in _STREAMING_PHASES)
        streaming &= (self.figures.ticks + np.arange(n)) % self._setpoint_every == 0
        if self.phase is Phase.SILENT and not (self._spoken_to or self._roster.killed.any()):
            return []  # heartbeats too: some autopilots act only when those are gone
        still = self._monitor.hold | ~self._roster.follows
        velocity = self._sent_ned_m_s = np.where(still[:, None], 0.0, velocity)
        try:
            return self._station.transmit(now_ns, velocity, self._yaw_ned_rad, streaming)
        except Exception as error:
            self._fault(error, now_ns)
            return []  # the next tick tries again; autopilots fly on by their last setpoint for half a second

    def _guarded(self, now_ns: int, act: Callable[..., None], *given: object) -> None:
        """Does one part of a tick. Whatever goes wrong in it is told and ends the mission, and stops no other part."""
        try:
            act(*given)
        except Exception as error:
            self._fault(error, now_ns)

    def _poses(self, now_ns: int) -> Poses:
        """Where everybody is; unknown, all of it, when that cannot be worked out."""
        try:
            poses = self._frame.poses(self.fleet, now_ns)
        except Exception as error:
            self._fault(error, now_ns)
            if self._sightless_since_ns == NEVER:
                self._sightless_since_ns = now_ns
            n = self.plan.size
            level = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
            return Poses(np.full((n, 3), np.nan), np.zeros((n, 3)), level, np.zeros(n, dtype=np.bool_))
        self._sightless_since_ns = NEVER
        return poses

    def _wait_for_sight(self, now_ns: int) -> None:
        """Poses cannot be worked out: everybody stands still for a moment, then is left to its failsafe.

        What the autopilots do without a ground station was set before takeoff so that they keep clear of each other.
        """
        if now_ns - self._sightless_since_ns >= _SIGHTLESS_NS:
            self._abort("setpoints end, the autopilots' own failsafe takes over")
            self._enter(Phase.SILENT, now_ns)

    def _steer(self, now_ns: int, poses: Poses) -> FloatArray:
        """One tick of a phase in the air; whatever goes wrong here, the vehicles get a setpoint: to stand still."""
        try:
            if self.phase is Phase.TAKEOFF:
                return self._takeoff(now_ns, poses)
            if self.phase in FORMATION_PHASES:
                return self._formation(now_ns, poses)
            if self.phase is Phase.PAUSE:
                return self._pause(now_ns, poses)
            if self.phase is Phase.RETURN:
                return self._return(now_ns, poses)
            if self.phase is Phase.LAND:
                return self._land(now_ns, poses)
            self._guide.rest()
            if now_ns - self._phase_ns >= _STOP_NS:
                self._enter(Phase.RETURN, now_ns)
        except Exception as error:
            self._fault(error, now_ns)
            self._guide.rest()
        return np.zeros((self.plan.size, 3))

    def _fault(self, error: Exception, now_ns: int) -> None:
        """A fault in our own mathematics, in flight: the team comes back.

        Where that fails too it stands still until the time for it is over, and then lands.
        """
        self._faults += 1
        text = f"fault in the ground station, {type(error).__name__}: {error}"
        if self._faults <= _FAULTS_NOTED:
            self._note("alarm", text)
        if self.phase is Phase.TAKEOVER:
            self._abort(f"{text}; everybody is left to its own failsafe")
            self._enter(Phase.SILENT, now_ns)
        self._give_up(text, now_ns)

    # Phases

    def _connect(self, now_ns: int) -> None:
        plan = self.plan
        state = self._preflight.step(now_ns, self._words.by_vehicle(now_ns - REASONS_NS))
        for note in state.notes:
            self._note("info", note)
        self.problems = state.fatal + state.waiting
        if state.fatal:
            self._refuse(state.fatal, now_ns)
        elif state.waiting:
            self._steady_since_ns = NEVER
            if now_ns - self._start_ns >= plan.spec.limits.preflight_s * _SECOND_NS:
                self._refuse(state.waiting, now_ns)
        elif self._steady(now_ns):
            if self._check_only:
                self.outcome = "completed"
                self._enter(Phase.DONE, now_ns)
            else:
                self._frame.settle(self.fleet, now_ns)
                self.fleet.hold_addresses(plan.signed_links)
                self._monitor.begin(self.fleet)
                self._yaw_ned_rad = frames.yaw_ned_from_quat(self.fleet.quat_ned_from_frd)
                for line in self._frame.words():
                    self._note("info", line)
                self._words = Words()
                self._arming = Arming(plan, self.fleet, self._station.commands)
                self._enter(Phase.ARM, now_ns)

    def _take(self, now_ns: int) -> None:
        """Holds whoever is in the air, then brings everybody home whose place is known."""
        state = self._take_over.step(now_ns)
        for note in state.notes:
            self._note("info", note)
        self.problems = state.problems + state.waiting
        self._yaw_ned_rad = self._take_over.yaw_ned_rad
        if not state.done:
            return
        home = state.home
        if not home.any():
            self._refuse(state.problems or ["nobody is in the air; there is nothing to take over"], now_ns)
            return
        self._frame.settle_in_flight(self.fleet)
        self.fleet.hold_addresses(self.plan.signed_links)
        self._monitor.begin(self.fleet)
        self._roster.release(np.flatnonzero(~home).tolist())
        self._flight.gather_ned_m = self._take_over.gather_ned_m()
        self._takeoff_ns = now_ns
        for line in self._frame.words():
            self._note("info", line)
        for problem in state.problems:
            self._abort(problem)
        names = ", ".join(str(sysid) for sysid in self.fleet.sysid[home])
        self._note("info", f"taken over and brought home: vehicle {names}")
        self._enter(Phase.RETURN, now_ns)

    def _arm(self, now_ns: int, poses: Poses) -> None:
        if now_ns - self._phase_ns < _STREAM_FIRST_NS:
            return
        limits = self.plan.spec.limits
        blind = np.flatnonzero(now_ns - self._frame.pose_ns(self.fleet) > limits.pose_lost_s * _SECOND_NS)
        problem = self._arming.started_anew()
        if problem is None and len(blind):
            silent = self.fleet.silent(now_ns, limits.pose_lost_s)
            problem = "; ".join(
                f"vehicle {self.fleet.sysid[i]}: {'nothing was heard of it' if silent[i] else 'no position'} for"
                f" {limits.pose_lost_s:g} s while the team was arming: its link or its estimator failed, or it has"
                " started anew"
                for i in blind.tolist()
            )
        if problem is not None:
            self._give_up(problem, now_ns)
        elif self._arming.step(now_ns):
            self._flight.assign(self.failsafe.roles)
            self._takeoff_ns = now_ns
            self._enter(Phase.TAKEOFF, now_ns)
        elif now_ns - self._phase_ns >= limits.arming_s * _SECOND_NS:
            self._give_up(self._arming.why_not(limits.arming_s, self._words.by_vehicle()), now_ns)

    def _takeoff(self, now_ns: int, poses: Poses) -> FloatArray:
        offset = np.linalg.norm(poses.pos_team_ned_m - self._flight.gather_ned_m, axis=1)
        height_m = (self._pads_ned_m - poses.pos_team_ned_m)[:, 2]
        target_m = (self._pads_ned_m - self._flight.gather_ned_m)[:, 2]
        self._climb.step(now_ns, self.fleet, self._station.commands, height_m, target_m)
        near = offset < max(_TAKEOFF_TOLERANCE_M, self._spread_m)
        if bool((near & ~self._roster.climbing).all()):
            if self._steady(now_ns):
                self._enter(self._flight.next_step(now_ns, poses), now_ns)
        else:
            self._steady_since_ns = NEVER
            if now_ns - self._phase_ns >= self.plan.spec.takeoff.timeout_s * _SECOND_NS:
                said = self._words.by_vehicle()
                late = ", ".join(
                    f"vehicle {self.fleet.sysid[i]} is {offset[i]:.2f} m from its place"
                    + (f": {said[i]}" if i in said else "")
                    for i in np.argsort(-offset)[:3].tolist()
                )
                self._give_up(f"takeoff not finished after {self.plan.spec.takeoff.timeout_s:g} s: {late}", now_ns)
        return self._guide.to_targets(poses, self._flight.gather_ned_m).vel_ned_m_s

    def _formation(self, now_ns: int, poses: Poses) -> FloatArray:
        tick = self._flight.step(now_ns, poses, self._absent())
        self._tell_out_of_turn()
        if tick.give_up:
            self._give_up(tick.give_up, now_ns)
        elif tick.enter is not None:
            self._enter(tick.enter, now_ns)
        apart = ~self._roster.in_formation
        if not apart.any():
            return tick.vel_ned_m_s
        return np.where(apart[:, None], self._fly_apart(now_ns, poses), tick.vel_ned_m_s)

    def _tell_out_of_turn(self) -> None:
        """Tells once that vehicles have exchanged roles for which the autopilots' turns to return are wrong."""
        roles = self._flight.role_of_agent
        if self._out_of_turn or np.array_equal(roles, self.failsafe.roles):
            return
        self._out_of_turn = out_of_turn(self.failsafe, self._flight.formation.points_enu_m[roles, 2])
        if self._out_of_turn:
            names = (f"{self.fleet.sysid[i]} below {self.fleet.sysid[j]}" for i, j in self._out_of_turn[:4])
            self._note(
                "alarm",
                f"roles were exchanged, vehicle {', '.join(names)}: should the ground station be lost now, who is below"
                " would return first; take over at once in that case",
            )

    def _fly_apart(self, now_ns: int, poses: Poses) -> FloatArray:
        """Those that no longer fly the formation: home, where they land, or standing where they are to land."""
        home = self._flight.gather_ned_m
        near = np.linalg.norm(poses.pos_team_ned_m - home, axis=1) < max(_PAD_TOLERANCE_M, self._spread_m)
        near &= self._roster.homeward
        self._home_since_ns = np.where(near, np.where(self._home_since_ns == NEVER, now_ns, self._home_since_ns), NEVER)
        arrived = np.flatnonzero(near & (now_ns - self._home_since_ns >= _STEADY_NS)).tolist()
        self._landing.want_here(arrived, home, now_ns)
        targets = np.where(self._roster.homeward[:, None], home, self._roster.place_ned_m)
        return self._guide_apart.to_targets(poses, targets).vel_ned_m_s

    def _going_on(self) -> bool:
        """Whether the mission goes on without a vehicle that is lost now."""
        phase = self._resume_to if self.phase is Phase.PAUSE else self.phase
        return self.plan.spec.on_lost != "return_all" and phase in FORMATION_PHASES

    def _part(self, reason: str, now_ns: int) -> None:
        """Some vehicles drop out: the others come back, or go on without them, as the mission says."""
        if not self._going_on():
            self._give_up(reason, now_ns)
            return
        why_not = self._flight.close_up(now_ns)
        if why_not:
            self._give_up(f"{reason}; {why_not}", now_ns)
            return
        self._abort(reason)
        self._steady_since_ns = NEVER
        if self.phase is Phase.PAUSE:
            self._resume_to, self._resume_phase_ns = Phase.FORM, NEVER
        else:
            self._enter(Phase.FORM, now_ns)

    def _return(self, now_ns: int, poses: Poses) -> FloatArray:
        offset = np.linalg.norm(poses.pos_team_ned_m - self._flight.gather_ned_m, axis=1)
        away = (offset >= max(_PAD_TOLERANCE_M, self._spread_m)) & self.fleet.armed
        away &= self._roster.waited_for & ~(self._monitor.blind | self._landing.lost(now_ns))
        if not away.any():
            if self._steady(now_ns):
                self._enter(Phase.LAND, now_ns)
        else:
            self._steady_since_ns = NEVER
            if now_ns - self._phase_ns >= self.plan.spec.land.timeout_s * _SECOND_NS:
                self._note("alarm", f"not everybody is back after {self.plan.spec.land.timeout_s:g} s; landing")
                self._enter(Phase.LAND, now_ns)
        return self._flight.fly_home(poses, self._absent(), self._targets_ned_m(self._flight.gather_ned_m))

    def _land(self, now_ns: int, poses: Poses) -> FloatArray:
        if self._takeoff_ns == NEVER:
            anew = self._arming.started_anew()  # a vehicle tells it seconds after it has fallen silent
            if anew is not None:
                self._abort(anew)
            self._landing.disarm_on_the_ground(now_ns)
        else:
            aside_m = np.linalg.norm((poses.pos_team_ned_m - self._flight.gather_ned_m)[:, :2], axis=1)
            waits = self._lands_here & (aside_m >= max(_PAD_TOLERANCE_M, self._spread_m))
            waits &= now_ns - self._phase_ns < self.plan.spec.land.timeout_s * _SECOND_NS
            self._landing.want(np.flatnonzero(~waits).tolist(), now_ns)
        self._come_down(now_ns)
        if not self._roster.follows.any():
            return np.zeros((self.plan.size, 3))  # the autopilots land by themselves, nobody is left to be steered
        return self._guide.to_targets(poses, self._targets_ned_m(self._flight.gather_ned_m)).vel_ned_m_s

    def _targets_ned_m(self, others_ned_m: FloatArray) -> FloatArray:
        """The places of those that land where they are, and those given for the others, shape (n, 3)."""
        return np.where(self._roster.lands_here[:, None], self._roster.place_ned_m, others_ned_m)

    def _pause(self, now_ns: int, poses: Poses) -> FloatArray:
        """Stands still at the operator's word, as long as that is safe; avoidance stays on."""
        why = self._too_low_to_hold()
        if why is None and now_ns - self._phase_ns >= self.plan.spec.limits.hold_s * _SECOND_NS:
            why = f"held for {self.plan.spec.limits.hold_s:g} s, which is the limit"
        if why is not None:
            self._give_up(f"{why}; the hold is over, everybody comes back", now_ns, urgent=True)
        elif not (self._roster.waited_for & self.fleet.armed).any():
            self._enter(Phase.LAND, now_ns)
        return self._guide.to_targets(poses, self._targets_ned_m(self._rest_ned_m)).vel_ned_m_s

    def _too_low_to_hold(self) -> str | None:
        """Words for a battery that does not allow standing still, None when all do."""
        minimum = self.plan.spec.limits.battery_min
        flying = self.airborne & self._roster.follows
        for vehicle in np.flatnonzero((self.fleet.battery_remaining < minimum) & flying):
            left = self.fleet.battery_remaining[vehicle]
            return f"vehicle {self.fleet.sysid[vehicle]}: battery at {left:.0%}, minimum is {minimum:.0%}"
        return None

    def _come_down(self, now_ns: int) -> None:
        """Ends the mission when everybody is down, or when nobody who is left can be waited for."""
        up = self._landing.still_up(self._phase_ns, now_ns)
        up |= self._killing.not_shown() & ~self._landing.lost(now_ns)
        down_max_ns = _DOWN_MAX_NS
        if self.phase is Phase.SILENT and np.isfinite(self.failsafe.down_s):
            down_max_ns += round(self.failsafe.down_s) * _SECOND_NS
        late = now_ns - self._phase_ns >= down_max_ns
        if up.any() and not late:
            self._steady_since_ns = NEVER
            return
        if not late and not self._steady(now_ns, _DISARMED_NS):
            return
        lost = self._landing.lost(now_ns)
        names = [f"vehicle {self.fleet.sysid[i]}" for i in np.flatnonzero(lost)]
        if names:
            self._abort(
                f"{', '.join(names)}: not heard from any more, whether it has landed is not known; if it flies,"
                f" {HELP_IN_THE_AIR}"
            )
        names = [f"vehicle {self.fleet.sysid[i]}" for i in np.flatnonzero(self._landing.unsure(now_ns))]
        if names:
            self._abort(f"{', '.join(names)}: stands on the ground and sends no heartbeat, it may still be armed")
        if up.any():
            height_m = (self._pads_ned_m - self._frame.poses(self.fleet, now_ns).pos_team_ned_m)[:, 2]
            for vehicle in np.flatnonzero(up & self._roster.killed).tolist():
                self._abort(
                    f"vehicle {self.fleet.sysid[vehicle]}: told to stop its motors, and still armed by its own report"
                    f" after {down_max_ns // _SECOND_NS:g} s; keep clear of it, stop it by remote control"
                )
            for vehicle in np.flatnonzero(up & ~self._roster.killed).tolist():
                self._abort(self._landing.words_of_late(vehicle, float(height_m[vehicle]), down_max_ns // _SECOND_NS))
        flying = self.airborne & ~lost & ~self._roster.killed & ~up
        for text in still_flying(self.fleet, self.plan, flying, now_ns):
            self._abort(text)
        self._finish(now_ns)

    # What the operator says

    def _obey(self, line: str, poses: Poses, now_ns: int) -> None:
        """Does what a line says, or says why not."""
        try:
            command = parse_command(line, self.fleet.sysid.tolist())
        except ValueError as error:
            self._note("alarm", str(error))
            return
        why = refusal(self.phase, command.order)
        if command.order is Order.HOLD and why is None:
            why = self._too_low_to_hold()
        if why is None and self._sightless_since_ns != NEVER and command.order in (Order.HOLD, Order.LAND):
            why = "where the vehicles are cannot be worked out at the moment"
        if why is not None:
            self._note("alarm", f"operator: {command.text} refused: {why}")
            return
        self._note("info", f"operator: {command.text}")
        if command.order is Order.KILL:
            self._kill(command, now_ns)
        elif command.order is Order.SILENCE:
            self._note("alarm", "operator: setpoints stop, the autopilots' own failsafe takes over")
            self._abort("stopped by the operator, setpoints ended")
            self._enter(Phase.SILENT, now_ns)
        elif command.order is Order.RESUME:
            self._resume(now_ns)
        elif command.order is Order.RETURN or self.phase in (Phase.CONNECT, Phase.ARM):
            self._give_up("stopped by the operator", now_ns, stop=True, urgent=True)
        elif command.order is Order.HOLD:
            self._hold_still(poses, now_ns)
        else:
            self._land_now(command, poses, now_ns)

    def _hold_still(self, poses: Poses, now_ns: int) -> None:
        """Everybody stops; what the team was doing goes on where it was when the operator says so."""
        self._resume_to, self._resume_phase_ns = self.phase, self._phase_ns
        self._rest_ned_m = self._rest(poses)
        # Who has left the ground stays where it is; a climb by command would go on to its end.
        self._roster.end_climb(self.airborne)
        self._enter(Phase.PAUSE, now_ns)

    def _resume(self, now_ns: int) -> None:
        held_ns = now_ns - self._phase_ns
        self._enter(self._resume_to, now_ns)
        if self._resume_phase_ns != NEVER:
            self._phase_ns = self._resume_phase_ns + held_ns
            self._flight.stood_still(held_ns)
        else:
            self._flight.begin_anew(now_ns)

    def _land_now(self, command: OperatorCommand, poses: Poses, now_ns: int) -> None:
        """Some, or all, come down where they are."""
        if self.phase is Phase.SILENT:
            self._spoken_to = True
            self._landing.want(command.vehicles, now_ns)
            return
        rest = self._rest(poses)
        if not command.everybody:
            vehicles = [vehicle for vehicle in command.vehicles if self._roster.ours[vehicle]]
            for vehicle in command.vehicles:
                name = f"vehicle {self.fleet.sysid[vehicle]}"
                if not self._roster.ours[vehicle]:
                    self._note("alarm", f"operator: {name} is released and not ours to land")
            self._landing.want_here(vehicles, rest, now_ns)
            if vehicles:
                names = ", ".join(f"vehicle {self.fleet.sysid[vehicle]}" for vehicle in vehicles)
                self._part(f"{names}: landed by the operator", now_ns)
            return
        self._abort("landed by the operator")
        ours = self._roster.waited_for & ~self._monitor.blind
        fence = Fence.from_enu(np.array(self.plan.spec.fence.min_m), np.array(self.plan.spec.fence.max_m))
        # They are called there when within the tolerance.
        tolerance_m = max(_PAD_TOLERANCE_M, self._spread_m)
        clearance_m = self.plan.spec.avoidance.activation_m + self.plan.margin_m + tolerance_m
        self._flight.gather_ned_m = clear_spots(rest, ours, clearance_m, fence.min_team_ned_m, fence.max_team_ned_m)
        aside_m = np.linalg.norm((self._flight.gather_ned_m - rest)[:, :2], axis=1)
        for vehicle in np.flatnonzero(aside_m > 0.0).tolist():
            name = f"vehicle {self.fleet.sysid[vehicle]}"
            self._note("info", f"{name}: moves {aside_m[vehicle]:.2f} m aside before it lands; somebody is below")
        self._lands_here = True
        self._roster.end_climb(self._roster.climbing)
        self._enter(Phase.LAND, now_ns)

    def _kill(self, command: OperatorCommand, now_ns: int) -> None:
        """Motors stop; whoever is killed is no longer ours."""
        names = ", ".join(f"vehicle {self.fleet.sysid[vehicle]}" for vehicle in command.vehicles)
        self._killing.want(command.vehicles, now_ns)
        reason = f"{'everybody' if command.everybody else names}: killed by the operator"
        if command.everybody or self.phase is Phase.CONNECT:
            self._abort(reason)
            if self.phase is not Phase.SILENT:
                self._enter(Phase.SILENT, now_ns)
        else:
            self._part(reason, now_ns)

    def _rest(self, poses: Poses) -> FloatArray:
        """Where everybody comes to rest when told to stop now, shape (n, 3)."""
        stopping_s = self.plan.profile.lag_s + self.plan.profile.delay_s
        return poses.pos_team_ned_m + stopping_s * poses.vel_ned_m_s

    # What the phases share

    def _absent(self) -> BoolArray:
        """Vehicles that do not follow setpoints at the moment, shape (n,)."""
        return self._monitor.hold | self._monitor.blind | self._monitor.foreign | ~self._roster.follows

    def _watch(self, poses: Poses, now_ns: int) -> Poses:
        """Acts on what the monitors find in the air; returns the poses to steer by, with obstacles marked."""
        fleet, pose_ns = self.fleet, self._frame.pose_ns(self.fleet)
        poses = self._monitor.trusted(poses, pose_ns, now_ns)
        roster, were = self._roster, self._roster.in_formation
        steered = roster.steered & ~(roster.lands_here | self._monitor.foreign | self._monitor.hold)
        sight = Sight(
            fleet=fleet,
            now_ns=now_ns,
            pos_team_ned_m=poses.pos_team_ned_m,
            vel_ned_m_s=poses.vel_ned_m_s,
            pose_ns=pose_ns,
            drift_m=self._frame.drift_m(fleet, now_ns),
            sent_ned_m_s=self._sent_ned_m_s,
            ours=roster.ours,
            steered=steered,
            lands_here=roster.lands_here,
            excused=roster.told_to_land,
            blind=self._monitor.blind,
            airborne=self.airborne,
            going_on=self._going_on(),
        )
        findings = self._monitor.look(sight)
        for text in findings.alarms:
            self._note("alarm", text)
        roster.release(findings.release)
        for vehicle in findings.release:
            self._station.commands.clear(vehicle)
        if findings.land:
            self._landing.want_here(findings.land, poses.pos_team_ned_m, now_ns)
        if findings.gone:
            roster.go_home(findings.home)
            if (were & ~roster.in_formation).any():
                self._part("; ".join(findings.gone), now_ns)
        if findings.aborts:
            reason = self._blame.of(findings.aborts, self.reason)
            self._give_up(reason, now_ns, urgent=findings.urgent, follows=not reason)
        if findings.silence:
            self._abort(findings.silence)
            self._enter(Phase.SILENT, now_ns)
        poses = self._monitor.obstacles(poses, fleet, pose_ns, roster, now_ns)
        # Nobody stays under a vehicle that comes down.
        sinking = poses.sinking | (roster.lands_here & fleet.armed) | self._killing.falling(now_ns)
        return replace(poses, sinking=sinking)

    def _give_up(
        self, reason: str, now_ns: int, *, stop: bool = False, urgent: bool = False, follows: bool = False
    ) -> None:
        """Ends the mission early: on the ground at once, in the air by way of the pads.

        Args:
            reason: for the report.
            now_ns: time of the tick.
            stop: stand still for a moment first; not when somebody may have to get out of another one's way.
            urgent: does not wait for the end of an operator's hold.
            follows: the reason only follows from one that was given before.
        """
        if not follows:
            self._abort(reason)
        if self.phase in (Phase.TAKEOVER, Phase.RETURN, Phase.LAND, Phase.SILENT, Phase.DONE, Phase.STOP):
            return
        if self.phase is Phase.PAUSE:
            # A hold is the operator's: whatever stands below may be why. The team comes back when it is over.
            self._resume_to, self._resume_phase_ns = Phase.RETURN, NEVER
            if urgent:
                self._enter(Phase.RETURN, now_ns)
        elif self.phase is Phase.CONNECT:
            self._enter(Phase.DONE, now_ns)
        elif self.phase is Phase.ARM:
            self._enter(Phase.LAND, now_ns)
        else:
            self._roster.end_climb(self._roster.climbing)
            self._enter(Phase.STOP if stop else Phase.RETURN, now_ns)

    def _abort(self, reason: str) -> None:
        """Notes why the mission is not completed; a later reason is added to the first."""
        if reason in self.reason:
            return
        self.outcome = "aborted"
        self.reason = f"{self.reason}; {reason}" if self.reason else reason
        self._note("alarm", f"aborted: {reason}")

    def _refuse(self, reasons: list[str], now_ns: int) -> None:
        self.outcome = "refused"
        self.reason = "; ".join(reasons)
        self.problems = reasons
        self._enter(Phase.DONE, now_ns)

    def _finish(self, now_ns: int) -> None:
        if self.outcome is None:
            self.outcome = "completed"
        self._enter(Phase.DONE, now_ns)

    def _enter(self, phase: Phase, now_ns: int) -> None:
        if self.phase in (Phase.ARM, Phase.TAKEOFF):
            # An arming, disarming or takeoff that is asked again now would be obeyed.
            for vehicle in np.flatnonzero(~self._roster.killed).tolist():
                self._station.commands.clear(vehicle)
        self.phase = phase
        self._phase_ns = now_ns
        self._steady_since_ns = NEVER
        self._note("phase", phase.value)

    def _note(self, kind: str, text: str, roles: tuple[int, ...] = ()) -> None:
        self._notes.append(Note(kind, text, roles))

    def _steady(self, now_ns: int, for_ns: int = _STEADY_NS) -> bool:
        """Whether the condition that the caller found true has been true for a while, without a break."""
        if self._steady_since_ns == NEVER:
            self._steady_since_ns = now_ns
        return now_ns - self._steady_since_ns >= for_ns

    def _listen(self) -> None:
        """Takes the vehicles' words and answers."""
        for outcome in self._station.commands.take_outcomes():
            self._arming.heard(outcome)
            self._landing.heard(outcome)
            if self._words.refused(outcome):
                self._note("info", f"vehicle {self.fleet.sysid[outcome.vehicle]}: {outcome.words()}")
        for text in self.fleet.take_texts():
            self._note("info", f"vehicle {self.fleet.sysid[text.vehicle]} says: {text.text}")
            self._words.said(text)

    def _measure(self, poses: Poses) -> None:
        counted = np.asarray(self.airborne & ~self._monitor.blind, dtype=np.bool_)
        distance = min_distance_m(poses.pos_team_ned_m, counted)
        self.figures.min_distance_m = min(self.figures.min_distance_m, distance)
        if isinstance(self._region, SafetySphere):
            self.figures.min_clearance = self.figures.min_distance_m / self._region.radius_m
        else:
            clearance = min_clearance(poses.pos_team_ned_m, self._region, counted)
            self.figures.min_clearance = min(self.figures.min_clearance, clearance)
