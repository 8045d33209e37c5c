"""Places by what was reported over time: what wanders does not show, what moves does, and errors have an end."""

from __future__ import annotations

import numpy as np

from groundstation.core.smoothing import Smoother
from groundstation.core.types import FloatArray

TICK_S, RATE_1_S, MOST_M = 0.02, 0.5, 0.06
NOBODY, NOW = np.zeros(2, dtype=np.bool_), np.zeros(2)


def smoothed(pos_m: FloatArray, vel_m_s: FloatArray, *, most_m: float = MOST_M) -> FloatArray:
    """Places at each tick of reports of two vehicles, shape (k, 2, 3)."""
    smoother = Smoother(2, RATE_1_S, most_m)
    ticks = enumerate(zip(pos_m, vel_m_s, strict=True))
    return np.array([smoother(k * TICK_S, pos, vel, NOW, NOBODY) for k, (pos, vel) in ticks])


def wandering_m(ticks: int, sigma_m: float, tau_s: float) -> FloatArray:
    """Errors that last for tau, shape (ticks, 2, 3)."""
    rng, keep = np.random.default_rng(1), np.exp(-TICK_S / tau_s)
    error = sigma_m * rng.standard_normal((2, 3))
    errors = np.empty((ticks, 2, 3))
    for k in range(ticks):
        error = keep * error + sigma_m * np.sqrt(1.0 - keep**2) * rng.standard_normal((2, 3))
        errors[k] = error
    return errors


def test_what_positions_wander_by_is_taken_out_of_how_places_change() -> None:
    pos_m, still = wandering_m(3000, 0.02, 1.0), np.zeros((3000, 2, 3))
    places_m = smoothed(pos_m, still)
    # What the law makes of it: velocities in proportion to places, and their change.
    assert np.diff(places_m, axis=0).std() < 0.08 * np.diff(pos_m, axis=0).std()
    assert places_m[500:].std() < 0.7 * pos_m[500:].std()


def test_motion_shows_at_once() -> None:
    time_s = TICK_S * np.arange(300)[:, None, None]
    pos_m = np.array([1.0, 2.0, -3.0]) + 0.4 * (1.0 - np.cos(3.0 * time_s)) * np.ones((1, 2, 3))
    places_m = smoothed(pos_m, np.gradient(pos_m, TICK_S, axis=0))
    assert np.abs(places_m - pos_m).max() < 0.016  # 1.2 m/s for half a tick, no lag


def test_a_velocity_that_is_wrong_for_long_pulls_no_further_than_may_be() -> None:
    pos_m, wrong = np.zeros((2000, 2, 3)), np.full((2000, 2, 3), 0.01)
    places_m = smoothed(pos_m, wrong)
    np.testing.assert_allclose(places_m[-1], 0.01 / RATE_1_S, rtol=0.02)
    np.testing.assert_allclose(smoothed(pos_m, 50.0 * wrong)[-1], MOST_M)


def test_who_is_known_to_be_poor_or_was_away_is_where_it_was_reported() -> None:
    smoother = Smoother(2, RATE_1_S, MOST_M)
    vel = np.full((2, 3), 0.1)
    smoother(0.0, np.zeros((2, 3)), vel, NOW, NOBODY)
    places_m = smoother(TICK_S, np.zeros((2, 3)), vel, NOW, np.array([True, False]))
    assert np.array_equal(places_m[0], np.zeros(3))
    assert (places_m[1] > 0.0).all()
    lost = np.array([[np.nan] * 3, [0.0] * 3])
    assert np.isnan(smoother(2 * TICK_S, lost, vel, NOW, NOBODY)[0]).all()
    back = np.array([[5.0, 0.0, 0.0], [0.0] * 3])
    assert np.array_equal(smoother(3 * TICK_S, back, vel, NOW, NOBODY)[0], back[0])
    jumped = back + 3.0
    assert np.abs(smoother(4 * TICK_S, jumped, vel, NOW, NOBODY) - jumped).max() <= MOST_M + 1e-12
    assert np.array_equal(smoother(9.0, back, vel, NOW, NOBODY), back)  # after a pause


def test_where_positions_are_carried_on_to_they_are_smoothed_and_not_behind() -> None:
    """Reports that are 30 to 70 ms old, brought to the tick by the velocity of then."""
    smoother, rng, behind_m = Smoother(2, RATE_1_S, MOST_M), np.random.default_rng(3), 0.0
    for k in range(300):
        now_s = k * TICK_S
        old_s = np.asarray(0.03 + TICK_S * rng.integers(0, 3, 2), dtype=np.float64)
        then_s = (now_s - old_s)[:, None] * np.ones((1, 3))
        vel = 0.4 * np.sin(then_s)
        carried_m = 0.4 * (1.0 - np.cos(then_s)) + old_s[:, None] * vel
        behind_m = max(behind_m, float(np.abs(smoother(now_s, carried_m, vel, old_s, NOBODY) - carried_m).max()))
    assert behind_m < 0.02  # at 0.4 m/s a tick is 8 mm, the oldest report 28 mm
