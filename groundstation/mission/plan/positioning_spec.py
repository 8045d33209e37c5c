"""Keys of a mission file about positions that come from a motion capture system."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from groundstation.mocap.bodies import LINK


class MovingBodySpec(BaseModel):
    """A body of the motion capture that is no vehicle, and that the team keeps out of the way of: a person, a cart."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    body: Annotated[str, Field(min_length=1, max_length=60)]
    radius_m: Annotated[float, Field(gt=0, le=10)]
    shape: Literal["column", "sphere"] = "column"
    speed_m_s: Annotated[float, Field(gt=0, le=10)] = 1.5


class PositioningSpec(BaseModel):
    """Positions from outside, as frames of a motion capture system."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    source: Literal["mocap"]
    system: str | None = None
    host: str | None = None
    link: str = LINK
    bodies: Literal["name", "place"] = "name"
    up: Literal["z", "y"] = "z"
    unit: Literal["m", "mm"] = "m"
    obstacles: Annotated[tuple[MovingBodySpec, ...], Field(max_length=200)] = ()

    @model_validator(mode="after")
    def _together(self) -> PositioningSpec:
        if (self.system is None) != (self.host is None):
            raise ValueError("system and host, the kind of the motion capture and where it streams from, go together")
        names = [item.body for item in self.obstacles]
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise ValueError(f"obstacles: body {twice} stands there twice; each body once")
        return self
