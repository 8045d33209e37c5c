"""The part of a mission that is flown in formation: roles, the steps in their order, and when each is done.

Decides nothing about phases: it says which one follows, or why the team cannot go on, and the runner acts on it. The
steering itself is ``guidance``; nothing here moves a vehicle past avoidance and limits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from groundstation.core import frames
from groundstation.core.control import Task, auto_control_gain, rate_for_auto_gain_1_s, task_for_roles
from groundstation.core.formation import Formation
from groundstation.core.gridlock import GridlockParams, Gridlocks, Sensed
from groundstation.core.metrics import formation_error_m, free_scale_error_m, vertical_orientation
from groundstation.core.motion import Motion
from groundstation.core.places import own_places
from groundstation.core.reduction import task_for_those_left
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.mavlink.vehicle import NEVER
from groundstation.mission.flight.free_size import Sizes, missed, sizes_of, stands_at
from groundstation.mission.flight.guidance import Course, Guide, Poses
from groundstation.mission.phases.phase import Phase
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.schema import FormStep, HoldStep, Step
from groundstation.mission.plan.stages import Stage, roles_for
from groundstation.mission.roster import Roster
from groundstation.mission.verdict import Figures

_SECOND_NS = 1_000_000_000
_STEADY_NS = _SECOND_NS  # how long the formation has to stand before the team believes it
_HOLD_TOLERANCE = 2.0  # noise may exceed the tolerance for a moment; twice of it for a second is no noise
_PACE_UP_S = 1.0  # in which a move that was held up gets going again
_PACE_DOWN_S = 0.3
_MOVE_PATIENCE = 3.0  # times its duration, and _MOVE_SPARE_S, after which a move that is held up is given up
_MOVE_SPARE_S = 10.0


@dataclass(frozen=True)
class FormationTick:
    """What one tick of formation flight came to.

    Attributes:
        vel_ned_m_s: setpoints, shape (n, 3).
        enter: the phase that follows, None to go on.
        give_up: why the mission cannot go on; empty while it can.
    """

    vel_ned_m_s: FloatArray
    enter: Phase | None = None
    give_up: str = ""


class FormationFlight:
    """Formation flight of one team, and its way home.

    Args:
        plan: formations, gains, steps.
        roster: who flies with the team.
        guide: makes setpoints.
        figures: where times, errors and gridlocks are entered.
        note: takes what is worth the log: kind, text, roles.

    Attributes:
        role_of_agent: role per vehicle, shape (n,).
        gather_ned_m: place in the air above each pad, shape (n, 3).
    """

    def __init__(
        self,
        plan: MissionPlan,
        roster: Roster,
        guide: Guide,
        figures: Figures,
        note: Callable[[str, str, tuple[int, ...]], None],
    ) -> None:
        n = plan.size
        self.role_of_agent: IntArray = np.arange(n)
        self._roster = roster
        self.gather_ned_m: FloatArray = frames.ned_from_enu(plan.pads_enu_m)
        self._plan = plan
        self._guide = guide
        self._figures = figures
        self._note = note
        self._task: Task | None = None
        self._able_gain = np.inf
        self._stage_index = plan.stage_of_step[0]
        self._size = 1.0
        self._step_index = -1
        self._step_ns = NEVER
        self._steady_since_ns = NEVER
        self._last_ns = NEVER
        self._move_s = -1.0
        self._pace = 0.0
        self._room = 1.0
        self._move_from_enu_m: FloatArray = np.zeros(3)
        self._size_before = 1.0
        self._stood_at: Sizes = (1.0, 1.0)
        self._going_home = False
        self._gridlocks = Gridlocks(
            n,
            GridlockParams(
                speed_limit_m_s=plan.spec.speed_limit_m_s,
                keep_out_m=guide.keep_out_m,
                tick_s=1.0 / plan.spec.rate_hz,
                settle_s=guide.settle_s,
            ),
        )

    @property
    def stage(self) -> Stage:
        """The formation under way."""
        return self._plan.stages[self._stage_index]

    @property
    def formation(self) -> Formation:
        """Points and graph of the formation under way, at the size it has at the moment."""
        formation = self.stage.formation
        return replace(formation, points_enu_m=self._size * formation.points_enu_m) if self._size != 1.0 else formation

    def error_m(self, pos_m: FloatArray) -> float:
        """Largest |d_ij - d*_ij| over all pairs, of positions in any one frame, shape (n, 3); size free where it is."""
        members = self._roster.in_formation
        here, roles = pos_m[members], self.role_of_agent[members]
        if self.stage.scale.kind == "free":
            return free_scale_error_m(here, self.stage.formation.points_enu_m, roles)
        return formation_error_m(here, self.formation.distances_m, roles)

    def assign(self, roles: IntArray) -> None:
        """Gives every vehicle its role, and its place in the air above its pad.

        Args:
            roles: role per vehicle, shape (n,): those that the autopilots' failsafe heights were set for.
        """
        plan = self._plan
        self._fly_as(roles)
        # Where a mission does without the upright term, whoever ends higher can start a little higher: from one
        # common height the law alone leaves to chance whether the formation stands upright or on its head.
        height: FloatArray = self.stage.formation.points_enu_m[self.role_of_agent, 2]
        spread = float(np.ptp(height))
        share = (height - height.mean()) / spread if spread > 1e-9 else np.zeros(plan.size)
        self.gather_ned_m = frames.ned_from_enu(plan.pads_enu_m)
        self.gather_ned_m[:, 2] -= plan.spec.takeoff.height_m + plan.spec.takeoff.stagger_m * share

    def gather_at(self, places_ned_m: FloatArray) -> None:
        """Everybody gathers there, shape (n, 3), in place of above its pad."""
        self.gather_ned_m = places_ned_m

    def next_step(self, now_ns: int, poses: Poses) -> Phase:
        """Begins the next step of the mission and returns its phase; RETURN after the last one."""
        self._step_index += 1
        self._step_ns = now_ns
        self._steady_since_ns = NEVER
        self._move_s = -1.0
        self._gridlocks.forget()
        if self._step_index >= len(self._plan.spec.steps):
            return Phase.RETURN
        step = self._step()
        if step.form is not None:
            before, self._stage_index = self._stage_index, self._plan.stage_of_step[self._step_index]
            self._size = 1.0
            if self._stage_index != before:
                self._give_roles(poses)
            self._note_formation("1")
            return Phase.FORM
        return Phase.MOVE if step.move is not None else Phase.HOLD

    def close_up(self, now_ns: int) -> str:
        """Goes on without those who have dropped out, from the last ``form`` step on.

        Roles count in the order of the formation file, the first the most: with ``continue_take_over`` the vehicle in
        the last role that is taken moves up into one that has become free before it.

        Returns:
            Why the team cannot go on without them, empty when it can.
        """
        if len(self._plan.stages) > 1 or self._plan.moves:
            return "a mission of several formations, or with moves, is not flown on without one of its vehicles"
        gone = ~self._roster.in_formation
        n, left = self._plan.size, int((~gone).sum())
        if left < 2 or 2 * left <= n:
            return f"{left} of {n} vehicles are left in the formation, which needs more than half and two at least"
        roles = self.role_of_agent.copy()
        if self._plan.spec.on_lost == "continue_take_over":
            for free in sorted(roles[gone].tolist()):
                last = max(np.flatnonzero(~gone).tolist(), key=lambda agent: int(roles[agent]))
                holder = int(np.flatnonzero(roles == free)[0])
                if gone[holder] and roles[last] > free:
                    roles[holder], roles[last] = roles[last], free
                    self._figures.role_swaps += 1
        try:
            self._fly_as(roles)
        except ValueError as error:
            return str(error)
        while self._plan.spec.steps[self._step_index].form is None:
            self._step_index -= 1
        self._figures.converged = False
        self._gridlocks.forget()
        self.begin_anew(now_ns)
        return ""

    def begin_anew(self, now_ns: int) -> None:
        """The clock of the step under way begins now."""
        self._step_ns = now_ns
        self._steady_since_ns = NEVER

    def _fly_as(self, roles: IntArray) -> None:
        """Takes up roles, with the gains of those that are left where somebody is gone."""
        plan, stage, missing = self._plan, self.stage, ~self._roster.in_formation
        if missing.any():
            task, smaller, gains = task_for_those_left(stage.formation, stage.shape.gains, roles, missing)
            # Neighbours of a missing one have become neighbours of each other: the loop may be faster than before.
            rate_1_s = rate_for_auto_gain_1_s(smaller, gains, stage.scale, stage.upright_1_s)
            self._able_gain = auto_control_gain(rate_1_s, plan.profile.lag_s, plan.profile.delay_s, plan.lead_s)
        else:
            task = task_for_roles(stage.formation, stage.shape.gains, roles)
            self._able_gain = np.inf
        self.role_of_agent, self._task = roles, task
        numbers = " ".join("-" if gone else str(role + 1) for role, gone in zip(roles, missing, strict=True))
        self._note("roles", f"roles {numbers}", tuple(int(role) for role in roles))

    def stood_still(self, held_ns: int) -> None:
        """The operator held the team for a while: the step's clock did not run."""
        self._step_ns += held_ns
        self._steady_since_ns = NEVER
        self._last_ns = NEVER
        self._pace = 0.0

    def step(self, now_ns: int, poses: Poses, absent: BoolArray | None = None) -> FormationTick:
        """One tick of the step under way.

        Args:
            now_ns: time of the tick.
            poses: of the team.
            absent: vehicles that do not follow at the moment, shape (n,); a moving formation waits for them.

        Raises:
            RuntimeError: roles were never assigned.
        """
        absent = np.zeros(self._plan.size, dtype=np.bool_) if absent is None else absent
        absent = absent | ~np.isfinite(poses.pos_team_ned_m).all(axis=1)
        step, stage, members = self._step(), self.stage, self._roster.in_formation
        error_m = self.error_m(poses.pos_team_ned_m)
        enter, give_up = None, ""
        if step.form is not None:
            heights = stage.formation.points_enu_m[:, 2]
            here, roles = poses.pos_team_ned_m[members], self.role_of_agent[members]
            upright = vertical_orientation(-here[:, 2], heights, roles) >= 0.0
            enter, give_up = self._forming(step.form, error_m if upright else np.inf, now_ns, poses)
        elif step.hold is not None:
            enter, give_up = self._holding(step.hold, error_m, now_ns, poses)
        motion, present = None, None
        if step.move is not None:
            enter, give_up, motion, present = self._moving(error_m, now_ns, poses, absent)
        self._last_ns = now_ns
        if self._task is None:
            raise RuntimeError("formation flight without roles")
        forming = enter is None and step.form is not None
        course = Course(
            stage=self.stage,
            control_gain=self._control_gain(),
            members=members,
            points_by_agent_m=self.formation.points_enu_m[self.role_of_agent],
            detour_enu_m_s=self._gridlocks.wishes(frames.enu_from_ned(poses.vel_ned_m_s)) if forming else None,
            motion=motion,
            present=present,
        )
        guidance = self._guide.formation(poses, self._sized_task(self._task), course)
        self._room = guidance.room
        if forming:
            self._get_out(guidance.sensed, absent | ~members, course)
        return FormationTick(guidance.vel_ned_m_s, enter, give_up)

    def fly_home(self, poses: Poses, absent: BoolArray, target_ned_m: FloatArray) -> FloatArray:
        """One tick of everybody's way to its place, mostly the one above its pad; returns setpoints, shape (n, 3).

        Vehicles that lock each other in go round each other here: a pad belongs to its vehicle and is not swapped.
        """
        if not self._going_home:
            self._going_home = True
            self._gridlocks.forget()
        detours = self._gridlocks.wishes(frames.enu_from_ned(poses.vel_ned_m_s))
        setpoints = self._guide.to_targets(poses, target_ned_m, detours)
        to_goal_enu_m = frames.enu_from_ned(target_ned_m - poses.pos_team_ned_m)
        absent = absent | ~np.isfinite(poses.pos_team_ned_m).all(axis=1)
        self._get_out(setpoints.sensed, absent, to_goal_enu_m)
        return setpoints.vel_ned_m_s

    # Roles and gridlocks

    def _give_roles(self, poses: Poses) -> None:
        """Assigns roles for the formation under way from where everybody is."""
        self._fly_as(roles_for(self.stage, frames.enu_from_ned(poses.pos_team_ned_m)))

    def _sized_task(self, task: Task) -> Task:
        """The task at the size that the formation has at the moment: gains know no size."""
        if self._size == 1.0:
            return task
        return replace(task, distances_m=self._size * task.distances_m, rise_m=self._size * task.rise_m)

    def _control_gain(self) -> float:
        """The stage's k; an automatic one falls as distances grow, for what tilted views and f make of them grows."""
        stage = self.stage
        gain = stage.control_gain / max(1.0, self._size) if self._plan.spec.gain == "auto" else stage.control_gain
        return min(gain, self._able_gain)

    def _get_out(self, sensed: Sensed, absent: BoolArray, way: Course | FloatArray) -> None:
        """Finds agents that are locked in, and gets them out: by swaps in formation flight, by detours.

        Args:
            sensed: what each agent knows of itself.
            absent: vehicles that do not follow, shape (n,).
            way: the course of formation flight, or from each agent to its own place, ENU, shape (n, 3).
        """
        locks, ids = self._gridlocks, [vehicle.id for vehicle in self._plan.spec.vehicles]
        locks.sense(sensed, absent)
        self._figures.gridlocks += int(locks.begun.sum())
        if not locks.locked.any():
            return
        if isinstance(way, Course):
            free = way.stage.scale.kind == "free"
            seen = sensed.visible & self._roster.in_formation[None]
            places = own_places(sensed.rel_m, seen, way.points_by_agent_m, free_scale=free)
            to_goal_enu_m, patience_s, rarer = places.to_own_m, locks.params.detour_s, True
            pairs = locks.swaps(sensed, places, ~absent) if way.stage.swaps else []
            if pairs:
                roles = self.role_of_agent.copy()
                for i, j in pairs:
                    roles[i], roles[j] = roles[j], roles[i]
                    self._note("info", f"vehicles {ids[i]} and {ids[j]} are in each other's way: they swap roles", ())
                self._figures.role_swaps += len(pairs)
                self._fly_as(roles)
                return
        else:
            to_goal_enu_m, patience_s, rarer = way, locks.params.home_detour_s, False
        sent = locks.begin_detours(sensed, to_goal_enu_m, absent, patience_s, rarer=rarer)
        self._figures.detours += len(sent)
        if sent:
            others = ", ".join(str(ids[k]) for k in sent[1:])
            text = f"vehicle {ids[sent[0]]} is locked in: it goes round the others"
            self._note("info", text if not others else f"{text}, and {others} back off", ())

    # Steps

    def _step(self) -> Step:
        return self._plan.spec.steps[self._step_index]

    def _note_formation(self, scale: str) -> None:
        """Tells the log which formation is under way from now on, where there are several."""
        if len(self._plan.stages) > 1 or self._plan.moves:
            scale = "free" if self.stage.scale.kind == "free" else scale
            number = max(
                k for k, step in enumerate(self._plan.spec.steps[: self._step_index + 1]) if step.form is not None
            )
            self._note("info", f"formation of step {number + 1}: {self.stage.formation.name}, scale {scale}", ())

    def _sizes(self, poses: Poses) -> Sizes:
        return sizes_of(poses.pos_team_ned_m[self._roster.in_formation], self.stage)

    def _note_size(self, poses: Poses) -> None:
        """Tells the log how large a formation came out whose size is left to chance."""
        if self.stage.scale.kind == "free":
            self._note("info", stands_at(self._sizes(poses), self.stage), ())

    def _forming(self, step: FormStep, error_m: float, now_ns: int, poses: Poses) -> tuple[Phase | None, str]:
        if error_m <= step.tolerance_m:
            if self._steady(now_ns):
                took_s = (self._steady_since_ns - self._step_ns) / _SECOND_NS
                if np.isnan(self._figures.time_to_form_s):
                    self._figures.time_to_form_s = took_s
                if len(self._plan.stages) > 1:
                    self._note("info", f"formed {self.stage.formation.name} after {took_s:.2f} s", ())
                self._note_size(poses)
                later = self._plan.spec.steps[self._step_index + 1 :]
                self._figures.converged = all(item.form is None for item in later)
                return self.next_step(now_ns, poses), ""
            return None, ""
        self._steady_since_ns = NEVER
        if now_ns - self._step_ns >= step.timeout_s * _SECOND_NS:
            return None, (
                f"not formed after {step.timeout_s:g} s: a distance is {error_m:.3f} m off,"
                f" tolerance is {step.tolerance_m:g} m"
            )
        return None, ""

    def _tolerance_m(self) -> float:
        """What the last ``form`` step asked for."""
        steps = self._plan.spec.steps[: self._step_index]
        return next(item.form.tolerance_m for item in reversed(steps) if item.form is not None)

    def _holding(self, step: HoldStep, error_m: float, now_ns: int, poses: Poses) -> tuple[Phase | None, str]:
        self._figures.formation_error_m = float(np.fmax(self._figures.formation_error_m, error_m))
        lost = self._lost("holding", error_m, now_ns)
        if lost:
            return None, lost
        if now_ns - self._step_ns >= step.seconds * _SECOND_NS:
            return self.next_step(now_ns, poses), ""
        return None, ""

    def _lost(self, doing: str, error_m: float, now_ns: int, steady_ns: int = _STEADY_NS) -> str:
        tolerance_m = self._tolerance_m()
        if error_m <= _HOLD_TOLERANCE * tolerance_m:
            self._steady_since_ns = NEVER
        elif self._steady(now_ns, steady_ns):
            self._figures.converged = False
            return (
                f"formation lost while {doing}: a distance is {error_m:.3f} m off, limit is"
                f" {_HOLD_TOLERANCE:g} times the tolerance of {tolerance_m:g} m"
            )
        return ""

    def _moving(
        self, error_m: float, now_ns: int, poses: Poses, absent: BoolArray
    ) -> tuple[Phase | None, str, Motion | None, Motion | None]:
        """The move's own clock: it waits for whoever does not follow, for a wall, and for the formation to close up."""
        move = self._plan.moves[self._step_index]
        pos_enu_m = frames.enu_from_ned(poses.pos_team_ned_m)
        if self._move_s < 0.0:
            self._move_s, self._pace, self._room = 0.0, 0.0, 1.0
            self._size_before, self._last_ns = self._size, NEVER
            self._move_from_enu_m = pos_enu_m.mean(axis=0)
            self._stood_at = self._sizes(poses)
            outside = self._outside(pos_enu_m)
            if outside:
                return None, outside, None, None
            if move.scale != 1.0:
                self._note_formation("changing")
        self._figures.move_error_m = float(np.fmax(self._figures.move_error_m, error_m))
        elapsed_s = 0.0 if self._last_ns == NEVER else (now_ns - self._last_ns) / _SECOND_NS
        elapsed_s = min(elapsed_s, 2.0 / self._plan.spec.rate_hz)
        tolerance_m = self._tolerance_m()
        wanted = min(max((_HOLD_TOLERANCE * tolerance_m - error_m) / ((_HOLD_TOLERANCE - 1.0) * tolerance_m), 0.0), 1.0)
        wanted = 0.0 if absent.any() else min(wanted, self._room)
        step_up, step_down = elapsed_s / _PACE_UP_S, elapsed_s / _PACE_DOWN_S
        self._pace = min(max(wanted, self._pace - step_down), self._pace + step_up)
        self._move_s += self._pace * elapsed_s
        lost = self._lost("moving", error_m, now_ns, 3 * _STEADY_NS)
        if lost:
            return None, lost, None, None
        settle_s = self._guide.settle_s
        present = move.at(self._move_s, self._pace)
        self._size = self._size_before * present.scale
        if self._move_s >= move.seconds + 2.0 * settle_s:
            self._size = self._size_before * move.scale
            if move.scale != 1.0:
                self._note_formation(f"{self._size:.6g}")
            by = " ".join(f"{value:.2f}" for value in pos_enu_m.mean(axis=0) - self._move_from_enu_m)
            told = " ".join(f"{value:.2f}" for value in move.by_enu_m)
            self._note("info", f"the middle of the team has moved by {by} m (ENU), told were {told} m", ())
            self._note_size(poses)
            if self.stage.scale.kind == "free" and move.scale != 1.0:
                why = missed(self._sizes(poses), self._stood_at, move.scale, self.stage, self._guide.keep_out_m)
                if why:
                    self._figures.converged = False
                    return None, why, None, None
            return self.next_step(now_ns, poses), "", None, None
        if now_ns - self._step_ns >= (_MOVE_PATIENCE * move.seconds + _MOVE_SPARE_S) * _SECOND_NS:
            why = "a vehicle does not follow" if absent.any() else f"a distance is {error_m:.3f} m off"
            why = "the fence is in the way" if self._room < 1.0 else why
            return (
                None,
                f"move not finished: {100.0 * move.share(self._move_s):.0f} % of the way done, {why}",
                None,
                None,
            )
        return None, "", move.at(self._move_s, self._pace, settle_s), present

    def _outside(self, pos_enu_m: FloatArray) -> str:
        """Why a move would end outside the fence, from where the team is; empty if it would not."""
        move, spec = self._plan.moves[self._step_index], self._plan.spec
        centre = pos_enu_m.mean(axis=0)
        offset = move.scale * (pos_enu_m - centre)
        cos, sin = np.cos(move.turn_rad), np.sin(move.turn_rad)
        turned = np.stack(
            [cos * offset[:, 0] - sin * offset[:, 1], sin * offset[:, 0] + cos * offset[:, 1], offset[:, 2]], axis=1
        )
        end = centre + move.by_enu_m + turned
        low, high = np.array(spec.fence.min_m), np.array(spec.fence.max_m)
        low[2] = max(low[2], self._plan.min_altitude_m)
        beyond = np.maximum(low - end, end - high)
        vehicle, axis = (int(k) for k in np.unravel_index(int(np.argmax(beyond)), beyond.shape))
        if beyond[vehicle, axis] <= 0.05:
            return ""
        return (
            f"move not begun: it would take vehicle {spec.vehicles[vehicle].id} to {'xyz'[axis]} ="
            f" {end[vehicle, axis]:.2f} m, {beyond[vehicle, axis]:.2f} m beyond the fence or below min_altitude_m"
        )

    def _steady(self, now_ns: int, for_ns: int = _STEADY_NS) -> bool:
        """Whether the condition that the caller found true has been true for a while, without a break."""
        if self._steady_since_ns == NEVER:
            self._steady_since_ns = now_ns
        return now_ns - self._steady_since_ns >= for_ns
