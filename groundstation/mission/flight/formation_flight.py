"""The part of a mission that is flown in formation: roles, the steps in their order, and when each is done.

Decides nothing about phases: it says which one follows, or why the team cannot go on, and the runner acts on it. The
steering itself is ``guidance``; nothing here moves a vehicle past avoidance and limits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from groundstation.core import frames
from groundstation.core.control import Task, task_for_roles
from groundstation.core.formation import Formation
from groundstation.core.gridlock import GridlockParams, Gridlocks, Sensed
from groundstation.core.metrics import free_scale_error_m, team_error_m, vertical_orientation
from groundstation.core.phases import Phase
from groundstation.core.places import own_places
from groundstation.core.quick import finite_rows, some
from groundstation.core.reduction import task_for_those_left
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.mission.flight.guidance import Course
from groundstation.mission.flight.helm import Helm
from groundstation.mission.flight.keeping import added
from groundstation.mission.flight.leading import Leading
from groundstation.mission.flight.poses import Poses
from groundstation.mission.flight.sensing import Eyes
from groundstation.mission.flight.step import Now, StepFlight
from groundstation.mission.flight.steps import step_flight
from groundstation.mission.flight.under_way import UnderWay
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.profiles import bearable_gain
from groundstation.mission.plan.stages import roles_for
from groundstation.mission.roster import Duties
from groundstation.mission.verdict import Figures

_CLEAR_OF_FLOOR_M = 0.05  # how far above the floor the lowest are kept: it is in nobody's way then


@dataclass(frozen=True)
class FormationTick:
    """What one tick of formation flight came to.

    Attributes:
        vel_ned_m_s: setpoints, shape (n, 3).
        follows: the phase that follows, None to go on; RETURN when all steps are done.
        give_up: why the mission cannot go on; empty while it can.
    """

    vel_ned_m_s: FloatArray
    follows: Phase | None = None
    give_up: str = ""


class FormationFlight:
    """Formation flight of one team, and its way home.

    Args:
        plan: formations, gains, steps.
        roster: who flies with the team.
        helm: makes setpoints.
        figures: where times, errors and gridlocks are entered.
        note: takes what is worth the log: kind, text, roles.

    Attributes:
        role_of_agent: role per vehicle, shape (n,).
        gather_ned_m: place in the air above each pad, shape (n, 3).
    """

    def __init__(
        self,
        plan: MissionPlan,
        roster: Duties,
        helm: Helm,
        figures: Figures,
        note: Callable[[str, str, tuple[int, ...]], None],
    ) -> None:
        n = plan.size
        self.role_of_agent: IntArray = np.arange(n)
        self._roster = roster
        self.gather_ned_m: FloatArray = frames.ned_from_enu(plan.pads_enu_m)
        self._plan = plan
        self._helm, guide = helm, helm.guide
        self._now = UnderWay(plan, roster, guide, figures, note)
        self._task: Task | None = None
        self._sized: tuple[Task, float, Task] | None = None
        self._able_gain = np.inf
        self._doing: StepFlight | None = None
        self._going_home = False
        self._eyes = Eyes(plan, self._now.tell)
        self._gridlocks = Gridlocks(
            n,
            GridlockParams(
                speed_limit_m_s=plan.spec.speed_limit_m_s,
                keep_out_m=guide.keep_out_m,
                tick_s=1.0 / plan.spec.rate_hz,
                settle_s=guide.settle_s,
            ),
            plan.obstacles,
        )

    @property
    def formation(self) -> Formation:
        """Points and graph of the formation under way, at the size it has at the moment."""
        return self._now.formation

    @property
    def led(self) -> Leading | None:
        """The step in which the operator leads the team; None while there is none under way."""
        return self._doing if isinstance(self._doing, Leading) else None

    @property
    def step_number(self) -> int:
        """Of the mission's step under way, from 1; 0 before the first."""
        return self._now.number + 1

    def error_m(self, pos_m: FloatArray) -> float:
        """Largest |d_ij - d*_ij| over all pairs, of positions in any one frame, shape (n, 3); size free where it is."""
        if self._doing is not None and not self._doing.formed:
            return float("nan")
        members = self._roster.in_formation
        here, roles = pos_m[members], self.role_of_agent[members]
        if self._now.stage.scale.kind == "free":
            return free_scale_error_m(here, self._now.stage.formation.points_enu_m, roles)
        return team_error_m(here, self._now.formation, roles)

    def assign(self, roles: IntArray) -> None:
        """Gives every vehicle its role, and its place in the air above its pad.

        Args:
            roles: role per vehicle, shape (n,): those that the autopilots' failsafe heights were set for.
        """
        plan = self._plan
        self._fly_as(roles)
        # Where a mission does without the upright term, whoever ends higher can start a little higher: from one
        # common height the law alone leaves to chance whether the formation stands upright or on its head.
        height: FloatArray = self._now.stage.formation.points_enu_m[self.role_of_agent, 2]
        spread = float(np.ptp(height))
        share = (height - height.mean()) / spread if spread > 1e-9 else np.zeros(plan.size)
        self.gather_ned_m = frames.ned_from_enu(plan.pads_enu_m)
        self.gather_ned_m[:, 2] -= plan.spec.takeoff.height_m + plan.spec.takeoff.stagger_m * share

    def gather_at(self, places_ned_m: FloatArray) -> None:
        """Everybody gathers there, shape (n, 3), in place of above its pad."""
        self.gather_ned_m = places_ned_m

    def next_step(self, now_ns: int, poses: Poses) -> Phase:
        """Begins the next step of the mission and returns its phase; RETURN after the last one."""
        now = self._now
        another = now.advance()
        self._gridlocks.forget()
        step = now.step
        if step is None:
            self._doing = None
            return Phase.RETURN
        if another:
            self._give_roles(poses)
        if step.form is not None:
            now.tell_formation("1")
            self._begin_place(poses)
        self._doing = step_flight(now, now_ns, step)
        return self._doing.phase

    def close_up(self, now_ns: int) -> str:
        """Goes on without those who have dropped out, from the last ``form`` step on.

        Roles count in the order of the formation file, the first the most: with ``continue_take_over`` the vehicle in
        the last role that is taken moves up into one that has become free before it.

        Returns:
            Why the team cannot go on without them, empty when it can.
        """
        if len(self._plan.stages) > 1 or self._plan.moved or self._plan.places_enu_m:
            return "a mission of several formations, or with moves, is not flown on without one of its vehicles"
        gone = ~self._roster.in_formation
        n, left = self._plan.size, int((~gone).sum())
        if left < 2 or 2 * left <= n:
            return f"{left} of {n} vehicles are left in the formation, which needs more than half and two at least"
        roles = self.role_of_agent.copy()
        if self._plan.spec.on_lost == "continue_take_over":
            for free in sorted(roles[gone].tolist()):
                last = max((~gone).nonzero()[0].tolist(), key=lambda agent: int(roles[agent]))
                holder = int((roles == free).nonzero()[0][0])
                if gone[holder] and roles[last] > free:
                    roles[holder], roles[last] = roles[last], free
                    self._now.figures.locked_in(swaps=1)
        try:
            self._fly_as(roles)
        except ValueError as error:
            return str(error)
        self._now.back_to_form()
        self._now.figures.lost()
        self._gridlocks.forget()
        self._now.keeper.let_turn()
        self.begin_anew(now_ns)
        return ""

    def begin_anew(self, now_ns: int) -> None:
        """The step under way begins anew, now."""
        step = self._now.step
        if step is not None:
            self._doing = step_flight(self._now, now_ns, step)

    def _fly_as(self, roles: IntArray) -> None:
        """Takes up roles, with the gains of those that are left where somebody is gone."""
        plan, stage, missing = self._plan, self._now.stage, ~self._roster.in_formation
        if some(missing):
            task, smaller, gains = task_for_those_left(stage.formation, stage.shape.gains, roles, missing)
            # Neighbours of a missing one have become neighbours of each other: the loop may be faster than before.
            self._able_gain = bearable_gain(
                smaller,
                gains,
                stage.scale,
                stage.upright_1_s,
                profile=plan.profile,
                rate_hz=plan.spec.rate_hz,
                lead_s=plan.lead_s,
            )
        else:
            task = task_for_roles(stage.formation, stage.shape.gains, roles)
            self._able_gain = np.inf
        self.role_of_agent, self._task = roles, task
        numbers = " ".join("-" if gone else str(role + 1) for role, gone in zip(roles, missing, strict=True))
        self._now.note("roles", f"roles {numbers}", tuple(int(role) for role in roles))

    def stood_still(self, held_ns: int) -> None:
        """The operator held the team for a while: the step's clock did not run."""
        if self._doing is not None:
            self._doing.stood_still(held_ns)

    def step(self, now_ns: int, poses: Poses, absent: BoolArray | None = None, sway_m: float = 0.0) -> FormationTick:
        """One tick of the step under way.

        Args:
            now_ns: time of the tick.
            poses: of the team.
            absent: vehicles that do not follow at the moment, shape (n,); a moving formation waits for them.
            sway_m: how far distances may sway in gusts and by poor velocities; allowed beside the tolerance.

        Raises:
            RuntimeError: roles were never assigned, or no step was begun.
        """
        absent = np.zeros(self._plan.size, dtype=np.bool_) if absent is None else absent
        absent = absent | ~finite_rows(poses.pos_team_ned_m)
        doing, members = self._doing, self._roster.in_formation
        if doing is None:
            raise RuntimeError("formation flight without a step")
        tick = doing.tick(Now(now_ns, poses, self.error_m(poses.pos_team_ned_m), self._upright(poses), absent, sway_m))
        pos_enu_m, counts = frames.enu_from_ned(poses.pos_team_ned_m), members & ~absent
        if tick.done and doing.swaps:
            self._now.keeper.settle(pos_enu_m, counts, self._now.formation.points_enu_m[self.role_of_agent])
        follows = self.next_step(now_ns, poses) if tick.done else None
        if self._task is None:
            raise RuntimeError("formation flight without roles")
        if tick.places_ned_m is not None:
            flown = self._helm.to_targets(poses, tick.places_ned_m)
            return FormationTick(flown.vel_ned_m_s, follows, tick.give_up)
        forming = follows is None and doing.swaps
        points_m = self._now.formation.points_enu_m[self.role_of_agent]
        kept = self._now.keeper.motion(pos_enu_m, counts, points_m)
        places_ned_m = self._eyes.places_ned_m(now_ns, poses)
        course = Course(
            stage=self._now.stage,
            control_gain=self._control_gain(),
            members=members,
            points_by_agent_m=points_m,
            detour_enu_m_s=_detours(self._gridlocks, poses) if forming else None,
            motion=added(tick.motion, kept),
            present=tick.present,
            places_ned_m=places_ned_m,
            sight=self._eyes.sight(now_ns, poses, places_ned_m, self._task.neighbours),
        )
        guidance = self._helm.formation(poses, self._sized_task(self._task), course)
        for words in self._helm.guide.take_words():
            self._now.tell(words)
        doing.left_room(guidance.room)
        if forming:
            self._get_out(guidance.sensed, absent | ~members, course)
        return FormationTick(guidance.vel_ned_m_s, follows, tick.give_up)

    def _begin_place(self, poses: Poses) -> None:
        """The team's place is where it is, high enough for the formation to be clear of the floor."""
        pos_enu_m = frames.enu_from_ned(poses.pos_team_ned_m)
        heights_m = self._now.stage.formation.points_enu_m[:, 2]
        clear_m = _CLEAR_OF_FLOOR_M + 0.25 * self._plan.margin_m
        middle_m = self._plan.min_altitude_m + float(heights_m.mean() - heights_m.min()) + clear_m
        counts = self._roster.in_formation & finite_rows(pos_enu_m)
        self._now.keeper.begin(pos_enu_m, counts, middle_m)

    def _upright(self, poses: Poses) -> bool:
        """Whether the formation does not stand on its head: all distances are right then, too."""
        members, heights = self._roster.in_formation, self._now.stage.formation.points_enu_m[:, 2]
        here, roles = poses.pos_team_ned_m[members], self.role_of_agent[members]
        return not vertical_orientation(-here[:, 2], heights, roles) < 0.0  # an unknown position is not on its head

    def fly_home(self, poses: Poses, absent: BoolArray, target_ned_m: FloatArray) -> FloatArray:
        """One tick of everybody's way to its place, mostly the one above its pad; returns setpoints, shape (n, 3).

        Vehicles that lock each other in go round each other here: a pad belongs to its vehicle and is not swapped.
        """
        if not self._going_home:
            self._going_home = True
            self._gridlocks.forget()
        setpoints = self._helm.to_targets(poses, target_ned_m, _detours(self._gridlocks, poses))
        to_goal_enu_m = frames.enu_from_ned(target_ned_m - poses.pos_team_ned_m)
        absent = absent | ~finite_rows(poses.pos_team_ned_m)
        self._get_out(setpoints.sensed, absent, to_goal_enu_m)
        return setpoints.vel_ned_m_s

    # Roles and gridlocks

    def _give_roles(self, poses: Poses) -> None:
        """Assigns roles for the formation under way from where everybody is."""
        self._fly_as(roles_for(self._now.stage, frames.enu_from_ned(poses.pos_team_ned_m)))

    def _sized_task(self, task: Task) -> Task:
        """The task at the size that the formation has at the moment: gains know no size."""
        size = self._now.size
        if size == 1.0:
            return task
        if self._sized is None or self._sized[0] is not task or self._sized[1] != size:
            sized = replace(task, distances_m=size * task.distances_m, rise_m=size * task.rise_m)
            self._sized = task, size, sized
        return self._sized[2]

    def _control_gain(self) -> float:
        """The stage's k; an automatic one falls as distances grow, for what tilted views and f make of them grows."""
        stage = self._now.stage
        gain = stage.control_gain / max(1.0, self._now.size) if self._plan.spec.gain == "auto" else stage.control_gain
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
        self._now.figures.locked_in(gridlocks=int(locks.begun.sum()))
        if not some(locks.locked):
            return
        sensed = sensed.of_all()
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
                    self._now.note(
                        "info", f"vehicles {ids[i]} and {ids[j]} are in each other's way: they swap roles", ()
                    )
                self._now.figures.locked_in(swaps=len(pairs))
                self._fly_as(roles)
                return
            if not self._plan.spec.avoidance.detours:
                return
        else:
            to_goal_enu_m, patience_s, rarer = way, locks.params.home_detour_s, False
        sent = locks.begin_detours(sensed, to_goal_enu_m, absent, patience_s, rarer=rarer)
        self._now.figures.locked_in(detours=len(sent))
        if sent:
            others = ", ".join(str(ids[k]) for k in sent[1:])
            what = "what is in its way" if len(self._plan.obstacles) else "the others"
            text = f"vehicle {ids[sent[0]]} is locked in: it goes round {what}"
            self._now.note("info", text if not others else f"{text}, and {others} back off", ())


def _detours(locks: Gridlocks, poses: Poses) -> FloatArray | None:
    """What those on a detour wish, NaN for all others, shape (n, 3), ENU; None where nobody is on one."""
    wishes = locks.wishes(frames.enu_from_ned(poses.vel_ned_m_s))
    return wishes if some(locks.detours) else None
