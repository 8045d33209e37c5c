"""The part of a mission that is flown in formation: roles, the steps in their order, and when each is done.

Decides nothing about phases: it says which one follows, or why the team cannot go on, and the runner acts on it. The
steering itself is ``guidance``; nothing here moves a vehicle past avoidance and limits.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from groundstation.core import frames
from groundstation.core.control import Task, auto_control_gain, rate_for_auto_gain_1_s, task_for_roles
from groundstation.core.metrics import formation_error_m, vertical_orientation
from groundstation.core.reduction import task_for_those_left
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.mavlink.vehicle import NEVER
from groundstation.mission.guidance import Guide, Poses
from groundstation.mission.plan import MissionPlan
from groundstation.mission.schema import FormStep, HoldStep
from groundstation.mission.state import Figures, Phase

_SECOND_NS = 1_000_000_000
_STEADY_NS = _SECOND_NS  # how long the formation has to stand before the team believes it
_GRIDLOCK_NS = _SECOND_NS
_HOLD_TOLERANCE = 2.0  # noise may exceed the tolerance for a moment; twice of it for a second is no noise


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
    """Formation flight of one team.

    Args:
        plan: formation, gains, steps.
        guide: makes setpoints.
        figures: where time to form, error and gridlocks are entered.
        note: takes what is worth the log: kind, text, roles.

    Attributes:
        role_of_agent: role per vehicle, shape (n,).
        gather_ned_m: place in the air above each pad, shape (n, 3).
        gone: vehicles that no longer fly the formation, shape (n,).
    """

    def __init__(
        self, plan: MissionPlan, guide: Guide, figures: Figures, note: Callable[[str, str, tuple[int, ...]], None]
    ) -> None:
        n = plan.size
        self.role_of_agent: IntArray = np.arange(n)
        self.gone: BoolArray = np.zeros(n, dtype=np.bool_)
        self.gather_ned_m: FloatArray = frames.ned_from_enu(plan.pads_enu_m)
        self._plan = plan
        self._guide = guide
        self._figures = figures
        self._note = note
        self._task: Task | None = None
        self._control_gain = plan.control_gain
        self._step_index = -1
        self._step_ns = NEVER
        self._steady_since_ns = NEVER
        self._blocked_since_ns = np.full(n, NEVER, dtype=np.int64)
        self._blocked_counted: BoolArray = np.zeros(n, dtype=np.bool_)

    def assign(self, roles: IntArray) -> None:
        """Gives every vehicle its role, and its place in the air above its pad.

        Args:
            roles: role per vehicle, shape (n,): those that the autopilots' failsafe heights were set for.
        """
        plan = self._plan
        self._fly_as(roles)
        # Where a mission does without the upright term, whoever ends higher can start a little higher: from one
        # common height the law alone leaves to chance whether the formation stands upright or on its head.
        height: FloatArray = plan.formation.points_enu_m[roles, 2]
        spread = float(np.ptp(height))
        share = (height - height.mean()) / spread if spread > 1e-9 else np.zeros(plan.size)
        self.gather_ned_m = frames.ned_from_enu(plan.pads_enu_m)
        self.gather_ned_m[:, 2] -= plan.spec.takeoff.height_m + plan.spec.takeoff.stagger_m * share

    def next_step(self, now_ns: int) -> Phase:
        """Begins the next step of the mission and returns its phase; RETURN after the last one."""
        self._step_index += 1
        self._step_ns = now_ns
        self._steady_since_ns = NEVER
        if self._step_index >= len(self._plan.spec.steps):
            return Phase.RETURN
        return Phase.FORM if self._plan.spec.steps[self._step_index].form is not None else Phase.HOLD

    def leave(self, vehicles: Sequence[int], now_ns: int) -> str:
        """Goes on without some vehicles: their roles stay open, or others move up; back to the last ``form`` step.

        Roles count in the order of the formation file, the first the most: with ``continue_take_over`` the vehicle in
        the last role that is taken moves up into one that has become free before it.

        Returns:
            Why the team cannot go on without them, empty when it can.
        """
        self.gone[list(vehicles)] = True
        n, left = self._plan.size, int((~self.gone).sum())
        if left < 2 or 2 * left <= n:
            return f"{left} of {n} vehicles are left in the formation, which needs more than half and two at least"
        roles = self.role_of_agent.copy()
        if self._plan.spec.on_lost == "continue_take_over":
            for free in sorted(roles[self.gone].tolist()):
                last = max(np.flatnonzero(~self.gone).tolist(), key=lambda agent: int(roles[agent]))
                holder = int(np.flatnonzero(roles == free)[0])
                if self.gone[holder] and roles[last] > free:
                    roles[holder], roles[last] = roles[last], free
                    self._figures.role_swaps += 1
        try:
            self._fly_as(roles)
        except ValueError as error:
            return str(error)
        while self._plan.spec.steps[self._step_index].form is None:
            self._step_index -= 1
        self._step_ns = now_ns
        self._steady_since_ns = NEVER
        self._figures.converged = False
        return ""

    def _fly_as(self, roles: IntArray) -> None:
        """Takes up roles, with the gains of those that are left where somebody is gone."""
        plan = self._plan
        if self.gone.any():
            task, smaller, gains = task_for_those_left(plan.formation, plan.gains, roles, self.gone)
            # Neighbours of a missing one have become neighbours of each other: the loop may be faster than before.
            rate_1_s = rate_for_auto_gain_1_s(smaller, gains, plan.scale, plan.upright_1_s)
            able = auto_control_gain(rate_1_s, plan.profile.lag_s, plan.profile.delay_s, plan.lead_s)
            self._control_gain = min(plan.control_gain, able)
        else:
            task = task_for_roles(plan.formation, plan.gains, roles)
        self.role_of_agent, self._task = roles, task
        numbers = " ".join("-" if gone else str(role + 1) for role, gone in zip(roles, self.gone, strict=True))
        self._note("roles", f"roles {numbers}", tuple(int(role) for role in roles))

    def stood_still(self, held_ns: int) -> None:
        """The operator held the team for a while: the step's clock did not run."""
        self._step_ns += held_ns
        self._steady_since_ns = NEVER

    def step(self, now_ns: int, poses: Poses) -> FormationTick:
        """One tick of the step under way.

        Raises:
            RuntimeError: roles were never assigned.
        """
        step = self._plan.spec.steps[self._step_index]
        formation = self._plan.formation
        here, roles = poses.pos_team_ned_m[~self.gone], self.role_of_agent[~self.gone]
        error_m = formation_error_m(here, formation.distances_m, roles)
        enter, give_up = None, ""
        if step.form is not None:
            heights = formation.points_enu_m[:, 2]
            upright = vertical_orientation(-here[:, 2], heights, roles) >= 0.0
            enter, give_up = self._forming(step.form, error_m if upright else np.inf, now_ns)
        elif step.hold is not None:
            enter, give_up = self._holding(step.hold, error_m, now_ns)
        if self._task is None:
            raise RuntimeError("formation flight without roles")
        guidance = self._guide.formation(poses, self._task, self._control_gain)
        self.count_gridlocks(guidance.blocked, now_ns)
        return FormationTick(guidance.vel_ned_m_s, enter, give_up)

    def count_gridlocks(self, blocked: BoolArray, now_ns: int) -> None:
        """Counts each time that an agent has stood without a free direction for more than a second."""
        self._blocked_since_ns = np.where(
            blocked, np.where(self._blocked_since_ns == NEVER, now_ns, self._blocked_since_ns), NEVER
        )
        self._blocked_counted &= blocked
        stuck = blocked & (now_ns - self._blocked_since_ns >= _GRIDLOCK_NS) & ~self._blocked_counted
        self._figures.gridlocks += int(stuck.sum())
        self._blocked_counted |= stuck

    def _forming(self, step: FormStep, error_m: float, now_ns: int) -> tuple[Phase | None, str]:
        if error_m <= step.tolerance_m:
            if self._steady(now_ns):
                if np.isnan(self._figures.time_to_form_s):
                    self._figures.time_to_form_s = (self._steady_since_ns - self._step_ns) / _SECOND_NS
                later = self._plan.spec.steps[self._step_index + 1 :]
                self._figures.converged = all(item.form is None for item in later)
                return self.next_step(now_ns), ""
            return None, ""
        self._steady_since_ns = NEVER
        if now_ns - self._step_ns >= step.timeout_s * _SECOND_NS:
            return None, (
                f"not formed after {step.timeout_s:g} s: a distance is {error_m:.3f} m off,"
                f" tolerance is {step.tolerance_m:g} m"
            )
        return None, ""

    def _holding(self, step: HoldStep, error_m: float, now_ns: int) -> tuple[Phase | None, str]:
        self._figures.formation_error_m = float(np.fmax(self._figures.formation_error_m, error_m))
        tolerance_m = next(
            item.form.tolerance_m
            for item in reversed(self._plan.spec.steps[: self._step_index])
            if item.form is not None
        )
        if error_m <= _HOLD_TOLERANCE * tolerance_m:
            self._steady_since_ns = NEVER
        elif self._steady(now_ns):
            self._figures.converged = False
            return None, (
                f"formation lost while holding: a distance is {error_m:.3f} m off, limit is"
                f" {_HOLD_TOLERANCE:g} times the tolerance of {tolerance_m:g} m"
            )
        if now_ns - self._step_ns >= step.seconds * _SECOND_NS:
            return self.next_step(now_ns), ""
        return None, ""

    def _steady(self, now_ns: int) -> bool:
        """Whether the condition that the caller found true has been true for a while, without a break."""
        if self._steady_since_ns == NEVER:
            self._steady_since_ns = now_ns
        return now_ns - self._steady_since_ns >= _STEADY_NS
