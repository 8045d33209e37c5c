"""The second order out of what was asked for and what was done: loops of a textbook integration are found again."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from groundstation.core.identify import STEP_S, Response, identify
from groundstation.core.types import FloatArray
from groundstation.core.velocity_loop import VelocityLoop, identify_loop


def _flown(asked: FloatArray, p: float, i: float, drag: float, delay_s: float) -> FloatArray:
    """A PI loop that fights drag, stepped by Euler at a tenth of the grid: no code of what is tested."""
    out, v, whole = np.zeros(len(asked)), 0.0, 0.0
    late, fine = round(delay_s / STEP_S), STEP_S / 10.0
    for k in range(len(asked)):
        out[k] = v
        told = asked[k - late] if k >= late else 0.0
        for _ in range(10):
            whole += i * (told - v) * fine
            v += (p * (told - v) + whole - drag * v) * fine
    return out


def _steps(seed: int, seconds: float = 24.0) -> FloatArray:
    rng = np.random.default_rng(seed)
    return np.repeat(rng.uniform(-0.5, 0.5, round(seconds / 1.5)), round(1.5 / STEP_S))


@pytest.mark.parametrize(
    ("p", "i", "drag", "delay_s"),
    [(1.8, 0.5, 1.35, 0.1), (4.0, 2.0, 1.35, 0.05), (0.8, 9.0, 3.0, 0.0)],  # PX4 level and upward, an S that overshoots
)
def test_a_loop_is_found_again_under_noise_and_its_step_is_right(
    p: float, i: float, drag: float, delay_s: float
) -> None:
    rng = np.random.default_rng(2)
    asked = [_steps(3), _steps(4)]
    done = [_flown(row, p, i, drag, delay_s) + 0.02 * rng.standard_normal(len(row)) + 0.01 for row in asked]
    done[1][200:260] = np.nan
    found = identify_loop(asked, done)
    assert found.problem == ""
    assert found.needed
    truth = _flown(np.ones(round(8.0 / STEP_S)), p, i, drag, delay_s)[::2]
    assert np.abs(found.step() - truth).max() < 0.06
    assert found.overshoot == pytest.approx(max(truth.max() - 1.0, 0.0), abs=0.05)
    assert found.reached_s() == pytest.approx(float(np.argmax(truth >= 1.0 - math.exp(-1.0))) * 2.0 * STEP_S, abs=0.06)


def test_one_lag_is_not_said_to_need_more() -> None:
    rng = np.random.default_rng(5)
    asked = _steps(6)
    found = identify_loop([asked], [_flown(asked, 5.0, 0.0, 0.0, 0.1) + 0.02 * rng.standard_normal(len(asked))])
    assert not found.needed
    assert found.lag_s == pytest.approx(0.2, abs=0.03)
    assert found.lag_delay_s == pytest.approx(0.1, abs=0.03)
    assert found.explained == pytest.approx(found.one_lag_explained, abs=0.01)


def test_what_the_record_does_not_tell_is_said() -> None:
    rng = np.random.default_rng(7)
    asked = _steps(8)
    assert identify_loop([asked[:200]], [asked[:200]]).problem == "2.0 s of flight by setpoints, 5 s needed"
    still = identify_loop([np.zeros(len(asked))], [np.zeros(len(asked))]).problem
    assert still == "setpoints vary by 0.000 m/s only, 0.05 m/s needed: fly something that moves"
    assert "of the motion only" in identify_loop([asked], [0.3 * rng.standard_normal(len(asked))]).problem


@pytest.mark.parametrize("fit", [identify, identify_loop])
def test_reports_that_come_too_seldom_to_tell_a_velocity_are_told(
    fit: Callable[[list[FloatArray], list[FloatArray]], Response | VelocityLoop],
) -> None:
    """What a log with one report a second comes to: no velocity is known between reports that far apart."""
    asked = _steps(9)
    nothing = np.full(len(asked), np.nan)
    for done in ([nothing, nothing], [nothing, asked]):
        assert "no velocity is known at any time" in fit([asked, asked], done).problem
