"""Obstacles in the mission file: what stands in the place, or flies through it, and is no vehicle of the team."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from groundstation.core.obstacles import BoxObstacle, CylinderObstacle, Obstacle, SphereObstacle
from groundstation.mission.plan.fields import Point, Positive


class ObstacleSpec(BaseModel):
    """A sphere (``radius_m``), an upright cylinder (with ``height_m``) or a box (``size_m``)."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    name: Annotated[str, Field(min_length=1, max_length=60, pattern=r"^[A-Za-z0-9][A-Za-z0-9 ._-]*$")]
    at_m: Point
    radius_m: Positive | None = None
    height_m: Positive | None = None
    size_m: tuple[Positive, Positive, Positive] | None = None

    @model_validator(mode="after")
    def _one_shape(self) -> ObstacleSpec:
        if (self.radius_m is None) == (self.size_m is None) or (self.size_m is not None and self.height_m is not None):
            raise ValueError(
                "give radius_m for a sphere, radius_m and height_m for an upright cylinder, or size_m for a box"
            )
        return self

    @property
    def body(self) -> Obstacle:
        """The obstacle, team frame, ENU."""
        at = np.array(self.at_m, dtype=np.float64)
        if self.size_m is not None:
            size = np.array(self.size_m, dtype=np.float64)
            return BoxObstacle(self.name, at + np.array([0.0, 0.0, 0.5 * size[2]]), size)
        if self.height_m is not None and self.radius_m is not None:
            return CylinderObstacle(
                self.name, at + np.array([0.0, 0.0, 0.5 * self.height_m]), self.radius_m, self.height_m
            )
        return SphereObstacle(self.name, at, self.radius_m or 0.0)


class TrafficSpec(BaseModel):
    """Aircraft told by ADSB_VEHICLE, which the team keeps out of the way of."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    radius_m: Annotated[float, Field(gt=0, le=1000)]
    old_s: Annotated[float, Field(gt=0, le=60)] = 10.0
    within_m: Annotated[float, Field(gt=0, le=100_000)] = 2000.0
