"""Keys of a mission file about positions that come from a motion capture system."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, model_validator

from groundstation.mocap.bodies import LINK


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

    @model_validator(mode="after")
    def _together(self) -> PositioningSpec:
        if (self.system is None) != (self.host is None):
            raise ValueError("system and host, the kind of the motion capture and where it streams from, go together")
        return self
