"""Errors of velocities, measured against positions."""

from __future__ import annotations

import numpy as np

from groundstation.core.speeds import AGREES_M_S, DISAGREES_M_S, Speeds
from groundstation.core.types import FloatArray

TICK_S = 0.02
FLIES = np.ones(1, dtype=np.bool_)


def _flown(error_m_s: FloatArray, noise_m: float = 0.002) -> tuple[Speeds, FloatArray]:
    """One vehicle that goes round, with errors of its velocity; returns what is left of them, tick by tick."""
    rng = np.random.default_rng(3)
    speeds, left = Speeds(1), []
    for tick, error in enumerate(error_m_s):
        angle = 0.4 * TICK_S * tick
        pos = np.array([[3.0 * np.sin(angle), 3.0 * np.cos(angle), -3.0]]) + rng.normal(0.0, noise_m, (1, 3))
        vel = 1.2 * np.array([[np.cos(angle), -np.sin(angle), 0.0]])
        speeds.take(pos, vel + error, TICK_S, FLIES)
        left.append(error - speeds.known_error_ned_m_s[0])
    return speeds, np.array(left)


def _wandering(sigma_m_s: float, seconds: float) -> FloatArray:
    rng, keep = np.random.default_rng(5), np.exp(-TICK_S / 2.5)
    error = np.zeros((round(seconds / TICK_S), 3))
    for tick in range(1, len(error)):
        error[tick] = keep * error[tick - 1] + sigma_m_s * np.sqrt(1.0 - keep**2) * rng.standard_normal(3)
    return error


def test_a_velocity_that_agrees_with_its_positions_is_left_to_the_last_bit() -> None:
    speeds, left = _flown(np.zeros((1000, 3)))
    assert 0.0 < speeds.rms_m_s[0] < 0.5 * AGREES_M_S
    assert not left.any()
    assert not speeds.left_m_s.any()


def test_an_error_that_wanders_is_measured_and_taken_off() -> None:
    error = _wandering(0.25, 60.0)
    speeds, left = _flown(error)
    true_m_s = np.sqrt((error[-500:] ** 2).sum(axis=1).mean())
    assert abs(speeds.rms_m_s[0] / true_m_s - 1.0) < 0.25  # over the last ten seconds
    assert speeds.rms_m_s[0] > DISAGREES_M_S
    assert np.sqrt((left[500:] ** 2).mean()) < 0.5 * np.sqrt((error[500:] ** 2).mean())
    assert 0.0 < speeds.left_m_s[0] < speeds.rms_m_s[0]


def test_noise_of_positions_is_no_error_of_the_velocity() -> None:
    speeds, left = _flown(np.zeros((1500, 3)), noise_m=0.03)
    assert speeds.rms_m_s[0] < AGREES_M_S
    assert not left.any()


def test_nothing_is_said_before_it_has_been_seen_for_two_seconds_and_over_a_gap() -> None:
    error = np.full((99, 3), 0.5)
    assert _flown(error)[0].rms_m_s[0] == 0.0
    speeds, _ = _flown(_wandering(0.3, 20.0))
    known = speeds.rms_m_s[0]
    nobody = np.zeros(1, dtype=np.bool_)
    for _ in range(100):
        speeds.take(np.full((1, 3), np.nan), np.zeros((1, 3)), TICK_S, nobody)
    assert speeds.rms_m_s[0] == known  # how good it was stays known
    assert not speeds.known_error_ned_m_s.any()  # what it is off by now does not
    speeds.take(np.full((1, 3), 50.0), np.zeros((1, 3)), TICK_S, FLIES)  # wherever it is seen again
    assert not speeds.known_error_ned_m_s.any()
