"""Flies one mission: bytes and times in, bytes out.

Flight, dry run, replay and tests all run this object. It reads no clock, sleeps never and draws nothing at random;
``step`` is called on a fixed tick with the time, and all that it does follows from what it was given before.

The team goes through the phases of ``Phase`` together. Whatever goes wrong in the air ends in RETURN and LAND; before
arming it ends at once, with nothing armed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from groundstation.core import frames
from groundstation.core.metrics import min_distance_m
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.mavlink.station import Outgoing, Station
from groundstation.mavlink.vehicle import LANDED_ON_GROUND, NEVER, Fleet
from groundstation.mission.arming import Arming
from groundstation.mission.climb import Climb
from groundstation.mission.formation_flight import FormationFlight
from groundstation.mission.guidance import Guide, Poses
from groundstation.mission.landing import Landing
from groundstation.mission.monitor import Monitor, Sight
from groundstation.mission.plan import MissionPlan
from groundstation.mission.poses import TeamFrame
from groundstation.mission.preflight import Preflight
from groundstation.mission.state import AIRBORNE_PHASES, FORMATION_PHASES, Figures, Note, Phase
from groundstation.mission.words import Words

__all__ = ["AIRBORNE_PHASES", "FORMATION_PHASES", "Figures", "Note", "Phase", "Runner"]

_SECOND_NS = 1_000_000_000
_STREAM_FIRST_NS = _SECOND_NS  # PX4 wants about a second of setpoints before it takes OFFBOARD
_STEADY_NS = _SECOND_NS  # how long a condition has to hold before the team believes it
_DISARMED_NS = 5 * _SECOND_NS // 2  # two heartbeats that say so
_STOP_NS = _SECOND_NS  # standing still between an abort and the way back
_DOWN_MAX_NS = 120 * _SECOND_NS  # nobody is waited for longer than this while the team comes down
_FAULTS_NOTED = 5
_TAKEOFF_TOLERANCE_M = 0.1
_PAD_TOLERANCE_M = 0.15
_OF_MARGIN = 0.35  # share of the positions' own error that those tolerances are widened to


class Runner:
    """One mission under way.

    Args:
        plan: what to fly.
        start_ns: time at which it begins, on the clock of all other times.
        check_only: stop after the preflight checks, arm nothing.
        whole_frames: ``receive`` is given whole frames on every link, as from a log, whatever the links were.

    Attributes:
        phase: what the team is doing.
        outcome: None until done; then completed, aborted or refused.
        reason: why it was aborted or refused, "" otherwise.
        figures: see ``Figures``.
        fleet: state of the vehicles.
    """

    def __init__(
        self, plan: MissionPlan, start_ns: int, *, check_only: bool = False, whole_frames: bool = False
    ) -> None:
        n = plan.size
        self.plan = plan
        self.phase = Phase.CONNECT
        self.outcome: str | None = None
        self.reason = ""
        self.figures = Figures()
        self.fleet = Fleet([vehicle.id for vehicle in plan.spec.vehicles], plan.link_of_vehicle)
        self.problems: list[str] = []
        self._station = Station(
            self.fleet,
            start_ns,
            streams=() if whole_frames else plan.stream_links,
            greeted=[(link, address.peer) for link, address in enumerate(plan.addresses) if address.peer],
        )
        self._frame = TeamFrame(plan)
        self._preflight = Preflight(plan, self._station, self._frame)
        self._arming = Arming(plan, self.fleet, self._station.commands)
        self._climb = Climb(plan)
        self._guide = Guide(plan)
        self._monitor = Monitor(plan)
        self._check_only = check_only
        self._period_ns = round(_SECOND_NS / plan.spec.rate_hz)
        self._start_ns = start_ns
        self._phase_ns = start_ns
        self._takeoff_ns = NEVER
        self._last_step_ns = NEVER
        self._steady_since_ns = NEVER
        self._notes: list[Note] = [Note("phase", Phase.CONNECT.value)]
        self._flight = FormationFlight(plan, self._guide, self.figures, self._note)
        self._landing = Landing(plan, self.fleet, self._station.commands)
        self._faults = 0
        self._released: BoolArray = np.zeros(n, dtype=np.bool_)
        self._yaw_ned_rad: FloatArray = np.zeros(n)
        self._words = Words()
        self._abort_requested = False
        self._pads_ned_m: FloatArray = frames.ned_from_enu(plan.pads_enu_m)
        self._spread_m = _OF_MARGIN * plan.margin_m
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

    def operator(self, command: str) -> None:
        """Takes a command of the operator; it is acted upon in the next step.

        Args:
            command: ``return`` (everyone stops, flies back and lands) or ``silence`` (setpoints stop; the autopilots'
                own failsafe acts).

        Raises:
            ValueError: another command.
        """
        if command == "return":
            self._abort_requested = True
        elif command == "silence":
            self._note("alarm", "operator: setpoints stop, the autopilots' own failsafe takes over")
            self._abort("stopped by the operator, setpoints ended")
            if self.phase is not Phase.DONE:
                self._enter(Phase.SILENT, self._last_step_ns)
        else:
            raise ValueError(f"operator command {command!r} is none of return, silence")

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
        """Vehicles that are armed and do not report to stand on the ground, shape (n,)."""
        airborne: BoolArray = self.fleet.armed & (self.fleet.landed_state != LANDED_ON_GROUND)
        return airborne

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
        self._station.ingest()
        self._listen()
        n = self.plan.size
        velocity: FloatArray = np.zeros((n, 3))
        poses = self._frame.poses(self.fleet, now_ns)
        if self._abort_requested:
            self._abort_requested = False
            self._give_up("stopped by the operator", now_ns, stop=True)
        if self._takeoff_ns != NEVER:
            self.figures.flight_time_s = (now_ns - self._takeoff_ns) / _SECOND_NS
        if self.phase in AIRBORNE_PHASES and self._takeoff_ns != NEVER:
            self._watch(poses, now_ns)
            # Whoever does not follow us, or cannot be seen, may come down at any moment: nobody stays underneath.
            poses = replace(poses, sinking=(self._monitor.blind | self._monitor.foreign) & self.fleet.armed)
            self._measure(poses)
        if self.phase is Phase.CONNECT:
            self._connect(now_ns)
        elif self.phase is Phase.ARM:
            self._arm(now_ns, poses)
        elif self.phase is Phase.SILENT:
            self._come_down(now_ns)
        elif self.phase in AIRBORNE_PHASES:
            velocity = self._steer(now_ns, poses)
        streaming = np.full(n, self.phase in AIRBORNE_PHASES or self.phase is Phase.ARM) & ~self._released
        streaming &= ~self._climb.under_way
        streaming &= (self.figures.ticks + np.arange(n)) % self._setpoint_every == 0
        velocity = np.where((self._monitor.hold | self._landing.asked | self._released)[:, None], 0.0, velocity)
        return self._station.transmit(now_ns, velocity, self._yaw_ned_rad, streaming)

    def _steer(self, now_ns: int, poses: Poses) -> FloatArray:
        """One tick of a phase in the air: the only place where a fault in our own mathematics is caught.

        Whatever goes wrong there, the vehicles get a setpoint: to stand still. The team comes back, and where that
        fails too it stands still until the time for it is over and then lands.
        """
        try:
            if self.phase is Phase.TAKEOFF:
                return self._takeoff(now_ns, poses)
            if self.phase in FORMATION_PHASES:
                return self._formation(now_ns, poses)
            if self.phase is Phase.RETURN:
                return self._return(now_ns, poses)
            if self.phase is Phase.LAND:
                return self._land(now_ns, poses)
            self._guide.rest()
            if now_ns - self._phase_ns >= _STOP_NS:
                self._enter(Phase.RETURN, now_ns)
        except Exception as error:
            self._faults += 1
            text = f"fault in the ground station, {type(error).__name__}: {error}"
            if self._faults <= _FAULTS_NOTED:
                self._note("alarm", f"{text}; standing still")
            self._guide.rest()
            self._give_up(text, now_ns)
        return np.zeros((self.plan.size, 3))

    # Phases

    def _connect(self, now_ns: int) -> None:
        plan = self.plan
        state = self._preflight.step(now_ns, self._words.by_vehicle())
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
                self._monitor.begin(self.fleet)
                self._yaw_ned_rad = frames.yaw_ned_from_quat(self.fleet.quat_ned_from_frd)
                for line in self._frame.words():
                    self._note("info", line)
                self._words = Words()
                self._arming = Arming(plan, self.fleet, self._station.commands)
                self._enter(Phase.ARM, now_ns)

    def _arm(self, now_ns: int, poses: Poses) -> None:
        if now_ns - self._phase_ns < _STREAM_FIRST_NS:
            return
        limits = self.plan.spec.limits
        blind = np.flatnonzero(now_ns - self._frame.pose_ns(self.fleet) > limits.pose_lost_s * _SECOND_NS)
        problem = self._arming.started_anew()
        if problem is None and len(blind):
            name = f"vehicle {self.fleet.sysid[blind[0]]}"
            problem = f"{name}: no position for {limits.pose_lost_s:g} s while the team was arming"
        if problem is not None:
            self._give_up(problem, now_ns)
        elif self._arming.step(now_ns):
            self._flight.assign(poses)
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
        if bool((near & ~self._climb.under_way).all()):
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
        if tick.give_up:
            self._give_up(tick.give_up, now_ns)
        elif tick.enter is not None:
            self._enter(tick.enter, now_ns)
        return tick.vel_ned_m_s

    def _return(self, now_ns: int, poses: Poses) -> FloatArray:
        offset = np.linalg.norm(poses.pos_team_ned_m - self._flight.gather_ned_m, axis=1)
        away = (offset >= max(_PAD_TOLERANCE_M, self._spread_m)) & self.fleet.armed
        away &= ~(self._released | self._landing.asked | self._monitor.blind | self._landing.lost(now_ns))
        if not away.any():
            if self._steady(now_ns):
                self._enter(Phase.LAND, now_ns)
        else:
            self._steady_since_ns = NEVER
            if now_ns - self._phase_ns >= self.plan.spec.land.timeout_s * _SECOND_NS:
                self._note("alarm", f"not everybody is back after {self.plan.spec.land.timeout_s:g} s; landing")
                self._enter(Phase.LAND, now_ns)
        return self._flight.fly_home(poses, self._absent())

    def _land(self, now_ns: int, poses: Poses) -> FloatArray:
        if self._takeoff_ns == NEVER:
            self._landing.disarm_on_the_ground(now_ns)
        else:
            self._landing.want(range(self.plan.size), now_ns)
        self._come_down(now_ns)
        return self._guide.to_targets(poses, self._flight.gather_ned_m).vel_ned_m_s

    def _come_down(self, now_ns: int) -> None:
        """Ends the mission when everybody is down, or when nobody who is left can be waited for."""
        up = self._landing.still_up(self._phase_ns, now_ns, self._released)
        late = now_ns - self._phase_ns >= _DOWN_MAX_NS
        if up.any() and not late:
            self._steady_since_ns = NEVER
            return
        if not late and not self._steady(now_ns, _DISARMED_NS):
            return
        names = [f"vehicle {self.fleet.sysid[i]}" for i in np.flatnonzero(self._landing.lost(now_ns))]
        if names:
            self._abort(f"{', '.join(names)}: not heard from any more, whether it has landed is not known")
        names = [f"vehicle {self.fleet.sysid[i]}" for i in np.flatnonzero(self._landing.unsure(now_ns))]
        if names:
            self._abort(f"{', '.join(names)}: stands on the ground and sends no heartbeat, it may still be armed")
        if up.any():
            names = [f"vehicle {self.fleet.sysid[i]}" for i in np.flatnonzero(up)]
            self._abort(f"{', '.join(names)}: still armed after {_DOWN_MAX_NS // _SECOND_NS} s of landing")
        self._finish(now_ns)

    # What the phases share

    def _absent(self) -> BoolArray:
        """Vehicles that do not follow setpoints at the moment, shape (n,)."""
        return self._monitor.hold | self._monitor.blind | self._monitor.foreign | self._released | self._landing.asked

    def _watch(self, poses: Poses, now_ns: int) -> None:
        """Acts on what the monitors find in the air."""
        pose_ns, drift_m = self._frame.pose_ns(self.fleet), self._frame.drift_m(self.fleet, now_ns)
        sight = Sight(poses.pos_team_ned_m, pose_ns, drift_m)
        findings = self._monitor.look(self.fleet, sight, now_ns, self._landing.asked)
        for text in findings.alarms:
            self._note("alarm", text)
        for vehicle in findings.release:
            self._released[vehicle] = True
            self._station.commands.clear(vehicle)
        self._landing.want(findings.land, now_ns)
        self._landing.step(now_ns, poses, self._released)
        if findings.abort:
            self._give_up(findings.abort, now_ns)

    def _give_up(self, reason: str, now_ns: int, *, stop: bool = False) -> None:
        """Ends the mission early: on the ground at once, in the air by way of the pads.

        Args:
            reason: for the report.
            now_ns: time of the tick.
            stop: stand still for a moment first; not when somebody may have to get out of another one's way.
        """
        self._abort(reason)
        if self.phase in (Phase.RETURN, Phase.LAND, Phase.SILENT, Phase.DONE, Phase.STOP):
            return
        if self.phase is Phase.CONNECT:
            self._enter(Phase.DONE, now_ns)
        elif self.phase is Phase.ARM:
            for vehicle in range(self.plan.size):
                self._station.commands.clear(vehicle)
            self._enter(Phase.LAND, now_ns)
        else:
            self._climb.under_way[:] = False
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
            if self._words.refused(outcome):
                self._note("info", f"vehicle {self.fleet.sysid[outcome.vehicle]}: {outcome.words()}")
        for text in self.fleet.take_texts():
            self._note("info", f"vehicle {self.fleet.sysid[text.vehicle]} says: {text.text}")
            self._words.said(text)

    def _measure(self, poses: Poses) -> None:
        distance = min_distance_m(poses.pos_team_ned_m, self.airborne)
        self.figures.min_distance_m = min(self.figures.min_distance_m, distance)
