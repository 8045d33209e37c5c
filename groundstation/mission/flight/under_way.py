"""What of a mission is being flown at the moment: the step, the formation with its size, and who is part of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from groundstation.core.formation import Formation
from groundstation.core.types import BoolArray
from groundstation.mission.flight.guidance import Guide
from groundstation.mission.flight.keeping import PlaceKeeper
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.schema import Step
from groundstation.mission.plan.stages import Stage
from groundstation.mission.roster import Duties
from groundstation.mission.verdict import Figures


class UnderWay:
    """The step under way and its formation.

    Args:
        plan: formations, steps.
        roster: who flies with the team.
        guide: for its figures.
        figures: where times, errors and gridlocks are entered.
        note: takes what is worth the log: kind, text, roles.

    Attributes:
        number: of the step, from 0; -1 before the first.
        size: of the formation, against its points.
        settle_s: lag and delay of the slowest vehicle.
        keep_out_m: distance that vehicles keep from each other, margin included.
        keeper: of the team's place.
    """

    def __init__(
        self,
        plan: MissionPlan,
        roster: Duties,
        guide: Guide,
        figures: Figures,
        note: Callable[[str, str, tuple[int, ...]], None],
    ) -> None:
        self.plan, self.figures, self.note = plan, figures, note
        self.settle_s, self.keep_out_m = guide.settle_s, guide.keep_out_m
        self.number, self.size = -1, 1.0
        self.keeper = PlaceKeeper(plan.keep_place_1_s, plan.spec.speed_limit_m_s)
        self._roster = roster
        self._stage_index = plan.stage_of_step[0]

    @property
    def step(self) -> Step | None:
        """The step under way, None before the first and after the last."""
        steps = self.plan.spec.steps
        return steps[self.number] if 0 <= self.number < len(steps) else None

    @property
    def stage(self) -> Stage:
        """The formation under way."""
        return self.plan.stages[self._stage_index]

    @property
    def formation(self) -> Formation:
        """Points and graph of the formation under way, at the size it has at the moment."""
        formation = self.stage.formation
        return replace(formation, points_enu_m=self.size * formation.points_enu_m) if self.size != 1.0 else formation

    @property
    def members(self) -> BoolArray:
        """Who flies it, shape (n,)."""
        return self._roster.in_formation

    def advance(self) -> bool:
        """Goes on to the next step; returns whether another formation begins with it."""
        self.number += 1
        step, before = self.step, self._stage_index
        if step is not None and step.form is not None:
            self._stage_index = self.plan.stage_of_step[self.number]
            self.size = 1.0
        return self._stage_index != before

    def back_to_form(self) -> None:
        """Goes back to the last ``form`` step."""
        while self.plan.spec.steps[self.number].form is None:
            self.number -= 1

    def resize(self, size: float) -> None:
        """The formation has this size from now on."""
        self.size = size

    def tell(self, text: str) -> None:
        """A line for the log."""
        self.note("info", text, ())

    def tell_formation(self, scale: str) -> None:
        """Tells the log which formation is under way from now on, where there are several."""
        if len(self.plan.stages) > 1 or self.plan.moved:
            scale = "free" if self.stage.scale.kind == "free" else scale
            steps = self.plan.spec.steps[: self.number + 1]
            number = max(k for k, step in enumerate(steps) if step.form is not None)
            self.tell(f"formation of step {number + 1}: {self.stage.formation.name}, scale {scale}")
