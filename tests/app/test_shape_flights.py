"""Whole flights with safety regions that are no spheres: formed, landed, nobody inside of a region, and replayed."""

from __future__ import annotations

from pathlib import Path

import pytest

from groundstation.app.verify import verify_log
from tests.app.flights import Flight, cube8


@pytest.mark.parametrize(("shape", "half_height_m", "seed"), [("cylinder", 0.6, 1), ("ellipsoid", 0.75, 3)])
def test_the_cube_is_formed_and_nobody_enters_a_region(
    tmp_path: Path, shape: str, half_height_m: float, seed: int
) -> None:
    plan = cube8(f"avoidance.shape={shape}", f"avoidance.half_height_m={half_height_m}")
    log = tmp_path / "shape.tlog" if shape == "cylinder" else None
    flight = Flight(plan, seed=seed, log=log)
    assert flight.runner.outcome == "completed"
    assert flight.runner.figures.converged
    true = flight.meter.figures()
    assert true["min_clearance"] >= 1.0
    assert true["min_distance_m"] >= min(0.45, half_height_m)
    assert flight.runner.figures.min_clearance == pytest.approx(true["min_clearance"], abs=0.1)
    if log is not None:
        assert verify_log(log).mismatches == 0
