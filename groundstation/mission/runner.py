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
from groundstation.core.control import Task, task_for_roles
from groundstation.core.metrics import formation_error_m, min_distance_m, vertical_orientation
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.mavlink.station import Outgoing, Station
from groundstation.mavlink.vehicle import LANDED_ON_GROUND, NEVER, Fleet
from groundstation.mission.arming import Arming
from groundstation.mission.check_table import CheckRow
from groundstation.mission.climb import Climb
from groundstation.mission.failsafe import FailsafePlan
from groundstation.mission.guidance import Guide, Poses
from groundstation.mission.landing import Landing
from groundstation.mission.monitor import Monitor, Sight
from groundstation.mission.plan import MissionPlan
from groundstation.mission.poses import TeamFrame
from groundstation.mission.preflight import Preflight
from groundstation.mission.schema import FormStep, HoldStep
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
_HOLD_TOLERANCE = 2.0  # noise may exceed the tolerance for a moment; twice of it for a second is no noise
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
        role_of_agent: role per vehicle, shape (n,).
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
        self.role_of_agent: IntArray = np.arange(n)
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
        self._step_index = -1
        self._task: Task | None = None
        self._notes: list[Note] = [Note("phase", Phase.CONNECT.value)]
        self._landing = Landing(plan, self.fleet, self._station.commands)
        self._faults = 0
        self._released: BoolArray = np.zeros(n, dtype=np.bool_)
        self._blocked_since_ns = np.full(n, NEVER, dtype=np.int64)
        self._blocked_counted: BoolArray = np.zeros(n, dtype=np.bool_)
        self._yaw_ned_rad: FloatArray = np.zeros(n)
        self._words = Words()
        self._abort_requested = False
        self._pads_ned_m: FloatArray = frames.ned_from_enu(plan.pads_enu_m)
        self._gather_ned_m: FloatArray = self._pads_ned_m.copy()
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
        if self.phase is Phase.SILENT:
            return []  # heartbeats too: some autopilots act only when those are gone
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
            self._assign(poses)
            self._takeoff_ns = now_ns
            self._enter(Phase.TAKEOFF, now_ns)
        elif now_ns - self._phase_ns >= limits.arming_s * _SECOND_NS:
            self._give_up(self._arming.why_not(limits.arming_s, self._words.by_vehicle()), now_ns)

    def _takeoff(self, now_ns: int, poses: Poses) -> FloatArray:
        offset = np.linalg.norm(poses.pos_team_ned_m - self._gather_ned_m, axis=1)
        height_m = (self._pads_ned_m - poses.pos_team_ned_m)[:, 2]
        target_m = (self._pads_ned_m - self._gather_ned_m)[:, 2]
        self._climb.step(now_ns, self.fleet, self._station.commands, height_m, target_m)
        near = offset < max(_TAKEOFF_TOLERANCE_M, self._spread_m)
        if bool((near & ~self._climb.under_way).all()):
            if self._steady(now_ns):
                self._next_step(now_ns, poses)
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
        return self._guide.to_targets(poses, self._gather_ned_m).vel_ned_m_s

    def _formation(self, now_ns: int, poses: Poses) -> FloatArray:
        step = self.plan.spec.steps[self._step_index]
        formation = self.plan.formation
        error = formation_error_m(poses.pos_team_ned_m, formation.distances_m, self.role_of_agent)
        if step.form is not None:
            heights = formation.points_enu_m[:, 2]
            upright = vertical_orientation(-poses.pos_team_ned_m[:, 2], heights, self.role_of_agent) >= 0.0
            self._forming(step.form, error if upright else np.inf, now_ns, poses)
        elif step.hold is not None:
            self._holding(step.hold, error, now_ns, poses)
        guidance = self._guide.formation(poses, self._given_task(), self.plan.control_gain)
        self._count_gridlocks(guidance.blocked, now_ns)
        return guidance.vel_ned_m_s

    def _forming(self, step: FormStep, error_m: float, now_ns: int, poses: Poses) -> None:
        if error_m <= step.tolerance_m:
            if self._steady(now_ns):
                if np.isnan(self.figures.time_to_form_s):
                    self.figures.time_to_form_s = (self._steady_since_ns - self._phase_ns) / _SECOND_NS
                self.figures.converged = all(
                    later.form is None for later in self.plan.spec.steps[self._step_index + 1 :]
                )
                self._next_step(now_ns, poses)
            return
        self._steady_since_ns = NEVER
        if now_ns - self._phase_ns >= step.timeout_s * _SECOND_NS:
            self._give_up(
                f"not formed after {step.timeout_s:g} s: a distance is {error_m:.3f} m off,"
                f" tolerance is {step.tolerance_m:g} m",
                now_ns,
            )

    def _holding(self, step: HoldStep, error_m: float, now_ns: int, poses: Poses) -> None:
        self.figures.formation_error_m = float(np.fmax(self.figures.formation_error_m, error_m))
        tolerance_m = next(
            item.form.tolerance_m
            for item in reversed(self.plan.spec.steps[: self._step_index])
            if item.form is not None
        )
        if error_m <= _HOLD_TOLERANCE * tolerance_m:
            self._steady_since_ns = NEVER
        elif self._steady(now_ns):
            self.figures.converged = False
            self._give_up(
                f"formation lost while holding: a distance is {error_m:.3f} m off, limit is"
                f" {_HOLD_TOLERANCE:g} times the tolerance of {tolerance_m:g} m",
                now_ns,
            )
            return
        if now_ns - self._phase_ns >= step.seconds * _SECOND_NS:
            self._next_step(now_ns, poses)

    def _return(self, now_ns: int, poses: Poses) -> FloatArray:
        offset = np.linalg.norm(poses.pos_team_ned_m - self._gather_ned_m, axis=1)
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
        setpoints = self._guide.to_targets(poses, self._gather_ned_m)
        self._count_gridlocks(setpoints.blocked, now_ns)
        return setpoints.vel_ned_m_s

    def _land(self, now_ns: int, poses: Poses) -> FloatArray:
        if self._takeoff_ns == NEVER:
            self._landing.disarm_on_the_ground(now_ns)
        else:
            self._landing.want(range(self.plan.size), now_ns)
        self._come_down(now_ns)
        return self._guide.to_targets(poses, self._gather_ned_m).vel_ned_m_s

    def _come_down(self, now_ns: int) -> None:
        """Ends the mission when everybody is down, or when nobody who is left can be waited for."""
        up = self._landing.still_up(self._phase_ns, now_ns, self._released)
        down_max_ns = _DOWN_MAX_NS
        if self.phase is Phase.SILENT and np.isfinite(self.failsafe.down_s):
            down_max_ns += round(self.failsafe.down_s) * _SECOND_NS
        late = now_ns - self._phase_ns >= down_max_ns
        if up.any() and not late:
            self._steady_since_ns = NEVER
            return
        if not late and not self._steady(now_ns, _DISARMED_NS):
            return
        names = [f"vehicle {self.fleet.sysid[i]}" for i in np.flatnonzero(self._landing.lost(now_ns))]
        if names:
            self._abort(f"{', '.join(names)}: not heard from any more, whether it has landed is not known")
        if up.any():
            names = [f"vehicle {self.fleet.sysid[i]}" for i in np.flatnonzero(up)]
            self._abort(f"{', '.join(names)}: still armed after {down_max_ns // _SECOND_NS} s of landing")
        self._finish(now_ns)

    # What the phases share

    def _next_step(self, now_ns: int, poses: Poses) -> None:
        self._step_index += 1
        if self._step_index >= len(self.plan.spec.steps):
            self._enter(Phase.RETURN, now_ns)
            return
        step = self.plan.spec.steps[self._step_index]
        if step.form is not None:
            self._enter(Phase.FORM, now_ns)
        else:
            self._enter(Phase.HOLD, now_ns)

    def _assign(self, poses: Poses) -> None:
        """Gives every vehicle its role, and its place in the air above its pad."""
        plan = self.plan
        roles = self.failsafe.roles  # from the pads: what the autopilots were told holds for these
        self.role_of_agent = roles
        self._task = task_for_roles(plan.formation, plan.gains, roles)
        self._note("roles", "roles " + " ".join(str(role + 1) for role in roles), tuple(int(role) for role in roles))
        # Where a mission does without the upright term, whoever ends higher can start a little higher: from one
        # common height the law alone leaves to chance whether the formation stands upright or on its head.
        height = self._height_of_agent()
        spread = float(np.ptp(height))
        share = (height - height.mean()) / spread if spread > 1e-9 else np.zeros(plan.size)
        self._gather_ned_m = self._pads_ned_m.copy()
        self._gather_ned_m[:, 2] -= plan.spec.takeoff.height_m + plan.spec.takeoff.stagger_m * share

    def _given_task(self) -> Task:
        if self._task is None:
            raise RuntimeError("formation flight without roles")
        return self._task

    def _height_of_agent(self) -> FloatArray:
        heights: FloatArray = self.plan.formation.points_enu_m[self.role_of_agent, 2]
        return heights

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

    def _count_gridlocks(self, blocked: BoolArray, now_ns: int) -> None:
        """Counts each time that an agent has stood without a free direction for more than a second."""
        self._blocked_since_ns = np.where(
            blocked, np.where(self._blocked_since_ns == NEVER, now_ns, self._blocked_since_ns), NEVER
        )
        self._blocked_counted &= blocked
        stuck = blocked & (now_ns - self._blocked_since_ns >= _SECOND_NS) & ~self._blocked_counted
        self.figures.gridlocks += int(stuck.sum())
        self._blocked_counted |= stuck
