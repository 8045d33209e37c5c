"""Pads at different heights, as on posts or stairs: nobody climbs into whoever is above, or lands beside who hovers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from groundstation.core.types import BoolArray, FloatArray
from tests.app.flights import Flight, four

LOW, HIGH = 0, 1


@pytest.mark.parametrize("autopilot", ["px4", "arducopter"])
def test_of_two_on_posts_one_above_the_other_nobody_gets_nearer_than_the_posts_allow(autopilot: str) -> None:
    profile = {"px4": "px4_quad", "arducopter": "arducopter"}[autopilot]
    pads = [[0.0, 0.0, 0.4], [0.38, 0.28, 0.9], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0]]  # the first two 0.47 m apart, level
    changes = [
        f"vehicles.{number}.{key}={value}"
        for number, pad in enumerate(pads)
        for key, value in (("pad_m", pad), ("autopilot", autopilot), ("profile", profile))
    ]
    plan = four(*changes, "position_error_m=0.02", "steps.0.form.tolerance_m=0.1", "steps.1.hold.seconds=1")
    up: list[BoolArray] = []
    heights: list[FloatArray] = []

    def look(flight: Flight) -> None:
        up.append(flight.world.truth.airborne)
        heights.append(flight.world.truth.pos_enu_m[:, 2])

    flight = Flight(plan, intrude=look, change=lambda config: replace(config, floor_m=0.0))
    assert flight.runner.outcome == "completed"
    assert flight.meter.figures()["min_distance_m"] > 0.5
    flying, height_m = np.array(up), np.array(heights)
    lifts, lands = flying.argmax(axis=0), len(flying) - flying[::-1].argmax(axis=0)
    if autopilot == "arducopter":
        assert height_m[lifts[LOW], HIGH] > 0.9 + 0.8 * plan.spec.takeoff.height_m
    assert lands[LOW] < lands[HIGH]
    assert height_m[lands[LOW], HIGH] > 0.9 + 0.8 * plan.spec.takeoff.height_m
