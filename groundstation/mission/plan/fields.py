"""Kinds of numbers that the mission file knows."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator, Field

from groundstation.core.findings import no_boolean

Number = Annotated[float, BeforeValidator(no_boolean), Field(allow_inf_nan=False)]
Coordinate = Annotated[Number, Field(ge=-1_000_000, le=1_000_000)]
Point = tuple[Coordinate, Coordinate, Coordinate]
Positive = Annotated[Number, Field(gt=0, le=10_000)]
NotNegative = Annotated[Number, Field(ge=0, le=10_000)]
