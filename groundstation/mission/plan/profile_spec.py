"""Keys of a mission file about kinds of vehicles: what they can do, and how their velocity loops answer."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from groundstation.mission.plan.fields import Number, Positive


class _OfAKind(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class AxisResponseSpec(_OfAKind):
    """One axis of a velocity loop: v' = p (u - v) + i x - drag v with x' = u - v."""

    p_1_s: Annotated[Number, Field(ge=0.05, le=40)]
    i_1_s2: Annotated[Number, Field(ge=0.01, le=60)]
    drag_1_s: Annotated[Number, Field(ge=0, le=8)]


class ResponseSpec(_OfAKind):
    """How a velocity loop answers, as ``gs identify`` finds it: what setpoints are shaped by."""

    horizontal: AxisResponseSpec
    vertical: AxisResponseSpec


class ProfileSpec(_OfAKind):
    """A profile of this mission, or other figures for one that is known; what is not given is as in ``like``."""

    like: str | None = None
    lag_s: Annotated[Number, Field(ge=0, le=10)] | None = None
    lag_up_s: Annotated[Number, Field(gt=0, le=10)] | None = None
    delay_s: Annotated[Number, Field(ge=0, le=10)] | None = None
    response: ResponseSpec | None = None
    acceleration_max_m_s2: Annotated[Number, Field(gt=0, le=100)] | None = None
    position_error_m: Positive | None = None
    air_1_s: Annotated[Number, Field(ge=0.01, le=10)] | None = None
    air_1_m: Annotated[Number, Field(ge=0, le=10)] | None = None
    drag_1_s: Annotated[Number, Field(ge=0, le=10)] | None = None
    push_lag_s: Annotated[Number, Field(ge=0.01, le=10)] | None = None
    wind_settle_s: Annotated[Number, Field(ge=0.1, le=1000)] | None = None
    wind_mean_m_s: Annotated[Number, Field(ge=0, le=30)] | None = None
    wind_gust_m_s: Annotated[Number, Field(ge=0, le=15)] | None = None
