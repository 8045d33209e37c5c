"""Pads at different heights, as on posts or stairs: nobody climbs into whoever is above, or lands beside who hovers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from groundstation.core.types import BoolArray, FloatArray
from tests.app.flights import Flight, four

PROFILES = {"px4": "px4_quad", "arducopter": "arducopter"}


@pytest.mark.parametrize(
    "autopilots", [("arducopter", "arducopter", "arducopter"), ("arducopter", "px4", "arducopter")]
)
def test_on_stairs_whoever_is_above_climbs_first_and_lands_last(autopilots: tuple[str, ...]) -> None:
    pads = [[0.0, 0.0, 0.0], [0.2, 0.0, 0.5], [0.0, 0.0, 1.0], [2.0, 0.0, 0.0]]  # neighbours 0.54 m apart
    changes = [
        f"vehicles.{number}.{key}={value}"
        for number, (pad, autopilot) in enumerate(zip(pads, (*autopilots, "px4"), strict=True))
        for key, value in (("pad_m", pad), ("autopilot", autopilot), ("profile", PROFILES[autopilot]))
    ]
    plan = four(*changes, "position_error_m=0.02", "steps.0.form.tolerance_m=0.1", "steps.1.hold.seconds=1")
    up: list[BoolArray] = []
    heights: list[FloatArray] = []

    def look(flight: Flight) -> None:
        up.append(flight.world.truth.airborne)
        heights.append(flight.world.truth.pos_enu_m[:, 2])

    flight = Flight(plan, intrude=look, change=lambda config: replace(config, floor_m=0.0))
    assert flight.runner.outcome == "completed"
    assert flight.meter.figures()["min_distance_m"] > 1.05 * plan.spec.avoidance.radius_m
    flying, height_m = np.array(up), np.array(heights)
    lifts, lands = flying.argmax(axis=0), len(flying) - flying[::-1].argmax(axis=0)
    for low in (0, 1):
        if autopilots[low] == "arducopter":
            assert lifts[low] > lifts[low + 1]
        assert lands[low] < lands[low + 1]
        assert height_m[lands[low], low + 1] > pads[low + 1][2] + 0.8 * plan.spec.takeoff.height_m
