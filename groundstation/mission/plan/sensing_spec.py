"""Sensing in the mission file: what each agent's own sensor leaves of its neighbours."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from groundstation.core.findings import no_boolean
from groundstation.core.sensing import Sensor
from groundstation.mission.plan.fields import NotNegative, Number, Positive

_Turned = Annotated[Number, Field(ge=0, le=180)]


class SensingSpec(BaseModel):
    """What each agent's own sensor sees of its neighbours, and what it does without one of them."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    range_m: Positive | None = None
    field_of_view_deg: Annotated[Number, Field(gt=0, le=360)] = 360.0
    share: Literal["either", "both", "own"] = "either"
    loss: Annotated[Number, Field(ge=0, le=1)] = 0.0
    lost_for_s: Annotated[Number, Field(ge=0.02, le=1000)] = 1.0
    noise_m: NotNegative = 0.0
    heading_deg: _Turned = 0.0
    level_deg: _Turned = 0.0
    memory_s: NotNegative = 0.0
    unseen: Literal["wait", "leave_out"] = "wait"
    seed: Annotated[int, BeforeValidator(no_boolean), Field(ge=0, le=2**31)] = 1

    @property
    def sensor(self) -> Sensor:
        """In SI and radians."""
        return Sensor(
            range_m=math.inf if self.range_m is None else self.range_m,
            field_of_view_rad=math.radians(self.field_of_view_deg),
            share=self.share,
            loss=self.loss,
            lost_for_s=self.lost_for_s,
            noise_m=self.noise_m,
            heading_rad=math.radians(self.heading_deg),
            level_rad=math.radians(self.level_deg),
            seed=self.seed,
        )
