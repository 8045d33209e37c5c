"""What a vehicle's autopilot is given at power-up beside its body: start-up times, parameters, streams."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from sitl.config import Boot
from sitl.params import ParamSet


@dataclass(frozen=True)
class Outfit:
    """One vehicle's.

    Attributes:
        boot: when it gets how far.
        params: its parameters.
        rates_hz: streams that run unasked.
    """

    boot: Boot
    params: ParamSet
    rates_hz: Mapping[str, float]
