"""Lag and delay out of what was asked for and what was done."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.core.identify import STEP_S, identify
from groundstation.core.types import FloatArray


def _flown(asked: FloatArray, tau: float, delay: float, gain: float = 1.0) -> FloatArray:
    """One lag behind a delay in whole steps, from standstill."""
    out, v, late = np.zeros(len(asked)), 0.0, round(delay / STEP_S)
    for k in range(len(asked)):
        out[k] = v
        v += (gain * (asked[k - late] if k >= late else 0.0) - v) * (1.0 - math.exp(-STEP_S / tau))
    return out


def _steps(rng: np.random.Generator, seconds: float) -> FloatArray:
    count = round(seconds / 1.5)
    return np.repeat(rng.uniform(-0.5, 0.5, count), round(1.5 / STEP_S))


@settings(max_examples=8, deadline=None)
@given(tau=st.floats(0.1, 1.2), delay=st.floats(0.0, 0.3), noise=st.floats(0.0, 0.05), seed=st.integers(0, 2**32 - 1))
def test_lag_and_delay_are_found_under_noise(tau: float, delay: float, noise: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    asked = [_steps(rng, 24.0) for _ in range(2)]
    done = [_flown(row, tau, delay) + noise * rng.standard_normal(len(row)) + 0.02 for row in asked]
    done[0][100:140] = np.nan
    found = identify(asked, done)
    assert found.problem == ""
    assert found.t63_s == pytest.approx(tau + delay, abs=0.03 + 0.06 * (tau + delay))
    assert found.delay_s == pytest.approx(delay, abs=0.05 + 0.1 * tau)


def test_the_time_to_63_percent_counts_from_what_was_asked_for() -> None:
    asked = _steps(np.random.default_rng(3), 30.0)
    found = identify([asked], [_flown(asked, 0.6, 0.1, gain=0.8)])
    assert found.gain == pytest.approx(0.8, abs=0.04)
    assert found.t63_s == pytest.approx(0.1 - 0.6 * math.log(1.0 - (1.0 - math.exp(-1.0)) / 0.8), abs=0.08)


def test_what_the_record_does_not_tell_is_said() -> None:
    rng = np.random.default_rng(4)
    asked = _steps(rng, 24.0)
    still = np.zeros(len(asked))
    assert "fly something that moves" in identify([still], [0.01 * rng.standard_normal(len(asked))]).problem
    assert "explain" in identify([asked], [0.3 * rng.standard_normal(len(asked))]).problem
    assert "5 s needed" in identify([asked[:200]], [asked[:200]]).problem
    assert "of what it is told within 3 s" in identify([asked], [_flown(asked, 0.3, 0.1, gain=0.5)]).problem
    assert math.isnan(identify([still], [still]).t63_s)
