"""What wind does, held against vehicles that are simulated here, with code of their own."""

from __future__ import annotations

import numpy as np
import pytest

from groundstation.core.types import FloatArray
from groundstation.core.wind import Airframe, WindEstimate, blown_m, distance_deviation, velocity_deviation

GRAVITY_M_S2 = 9.80665
DT_S = 0.02
QUAD = Airframe(air_1_s=0.25, air_1_m=0.027, drag_1_s=0.25, push_lag_s=0.49, settle_s=4.1)


class Blown:
    """Vehicles with a proportional and an integral part, each in gusts of its own; tilt is what they lean with."""

    def __init__(self, n: int, gust_m_s: float, mean_m_s: tuple[float, float], seed: int, tau_s: float = 2.0) -> None:
        self.rng, self.tau_s, self.gust_m_s = np.random.default_rng(seed), tau_s, gust_m_s
        self.mean = np.array([*mean_m_s, 0.0])
        self.gust: FloatArray = gust_m_s * self.rng.normal(size=(n, 3)) * [1.0, 1.0, 0.0]
        self.vel, self.pos, self.missed = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3))
        self.lean = np.zeros((n, 3))

    def step(self, told: FloatArray) -> None:
        keep = np.exp(-DT_S / self.tau_s)
        fresh = self.rng.normal(size=self.gust.shape) * [1.0, 1.0, 0.0]
        self.gust = keep * self.gust + self.gust_m_s * np.sqrt(1.0 - keep**2) * fresh
        past = self.mean + self.gust - self.vel
        air = (0.25 + 0.027 * np.linalg.norm(past, axis=1, keepdims=True)) * past
        self.missed = self.missed + (told - self.vel) * DT_S
        self.lean = 1.8 * (told - self.vel) + 0.5 * self.missed
        self.vel = self.vel + (air + self.lean) * DT_S
        self.pos = self.pos + self.vel * DT_S

    @property
    def down_ned(self) -> FloatArray:
        """Of a vehicle that leans so while it keeps its height."""
        axis = np.concatenate([-self.lean[:, :2], np.full((len(self.lean), 1), GRAVITY_M_S2)], axis=1)
        return np.asarray(axis / np.linalg.norm(axis, axis=1, keepdims=True))


def test_the_air_that_pulls_so_is_found_again() -> None:
    air = np.random.default_rng(1).normal(0.0, 6.0, (50, 3))
    assert QUAD.air_m_s(QUAD.pull_m_s2(air)) == pytest.approx(air, abs=1e-9)
    assert QUAD.slope_1_s(8.0) == pytest.approx(
        (QUAD.pull_m_s2(np.array([[8.01, 0.0, 0.0]]))[0, 0] - 3.728) / 0.01, rel=1e-2
    )


@pytest.mark.parametrize("tau_s", [1.0, 4.0])
def test_velocities_in_gusts_deviate_as_reckoned(tau_s: float) -> None:
    team = Blown(400, 0.5, (0.0, 0.0), seed=1, tau_s=tau_s)
    seen = []
    for tick in range(2000):
        team.step(np.zeros((400, 3)))
        if tick > 1000:
            seen.append(team.vel[:, :2].copy())
    slope = 0.25 + 1.5 * 0.027 * 0.6  # of (a + b |u|) u in gusts of that size
    assert np.std(seen) == pytest.approx(0.5 * slope * velocity_deviation(QUAD, tau_s), rel=0.12)


def test_two_that_the_damper_holds_come_nearer_in_gusts_as_reckoned() -> None:
    rate, horizon, stale = 0.68, 1.1, 0.12
    team = Blown(600, 0.5, (0.0, 0.0), seed=2)
    old = [np.zeros(300)] * round(stale / DT_S)
    off = []
    for tick in range(3000):
        away, opening = (team.pos[300:] - team.pos[:300])[:, 0], (team.vel[300:] - team.vel[:300])[:, 0]
        old.append(-rate * (away + horizon * opening))
        told = np.zeros((600, 3))
        told[300:, 0] = 0.5 * old.pop(0)
        told[:300, 0] = -told[300:, 0]
        team.step(told)
        if tick > 1000:
            off.append(away)
    slope = 0.25 + 1.5 * 0.027 * 0.6
    reckoned = distance_deviation(QUAD, 2.0, rate_1_s=rate, horizon_s=horizon, stale_s=stale)
    assert np.std(off) == pytest.approx(0.5 * slope * reckoned, rel=0.15)


def test_a_law_too_quick_for_its_delay_is_no_bound() -> None:
    assert distance_deviation(QUAD, 2.0, rate_1_s=50.0, horizon_s=0.1, stale_s=1.0) == np.inf


def test_how_far_a_vehicle_is_blown_when_it_lifts_off() -> None:
    team = Blown(1, 0.0, (8.0, 0.0), seed=3)
    farthest = 0.0
    for _ in range(1500):
        team.step(np.clip(-0.7 * (team.pos + team.vel), -0.25, 0.25))
        farthest = max(farthest, float(team.pos[0, 0]))
    assert blown_m(QUAD, 8.0, rate_1_s=0.7, lead_s=1.0, speed_m_s=0.25) == pytest.approx(farthest, rel=0.15)
    assert blown_m(QUAD, 0.0, rate_1_s=0.7, lead_s=1.0, speed_m_s=0.25) == 0.0


def estimated(team: Blown, told: FloatArray, seconds: float) -> WindEstimate:
    n = len(team.vel)
    estimate = WindEstimate([QUAD] * n, np.full(n, 0.5))
    for _ in range(round(seconds / DT_S)):
        team.step(told)
        estimate.step(DT_S, team.vel, team.down_ned, told, np.ones(n, dtype=np.bool_))
    return estimate


@pytest.mark.parametrize(
    ("mean_m_s", "gust_m_s"), [((0.0, 0.0), 1.0), ((4.0, 3.0), 0.5), ((0.0, -8.0), 1.0), ((8.0, 0.0), 2.0)]
)
def test_the_wind_is_found_from_how_vehicles_lean(mean_m_s: tuple[float, float], gust_m_s: float) -> None:
    estimate = estimated(Blown(8, gust_m_s, mean_m_s, seed=4), np.zeros((8, 3)), 40.0)
    assert estimate.known
    assert estimate.mean_ned_m_s[:2] == pytest.approx(mean_m_s, abs=0.3 + 0.35 * gust_m_s)
    assert estimate.gust_m_s == pytest.approx(gust_m_s, rel=0.3)


def test_own_motion_is_no_wind() -> None:
    told = np.zeros((2, 3))
    told[0], told[1] = [1.5, 0.0, -0.5], [0.0, -1.0, 0.5]
    estimate = estimated(Blown(2, 0.0, (0.0, 0.0), seed=5), told, 15.0)
    assert np.linalg.norm(estimate.mean_ned_m_s) < 0.6
    assert estimate.gust_m_s < 0.5


def test_nothing_is_known_of_vehicles_that_do_not_count_and_one_odd_one_makes_no_weather() -> None:
    n = 5
    estimate = WindEstimate([QUAD] * n, np.full(n, 0.5))
    level = np.tile([0.0, 0.0, 1.0], (n, 1))
    for _ in range(1000):
        estimate.step(DT_S, np.zeros((n, 3)), level, np.zeros((n, 3)), np.zeros(n, dtype=np.bool_))
    assert not estimate.known
    askew = level.copy()
    askew[3] = [0.5, 0.0, np.sqrt(0.75)]  # stands against nothing by its own report, and leans
    for _ in range(1000):
        estimate.step(DT_S, np.zeros((n, 3)), askew, np.zeros((n, 3)), np.ones(n, dtype=np.bool_))
    assert estimate.known
    assert np.linalg.norm(estimate.mean_ned_m_s) == pytest.approx(0.0, abs=1e-9)
    assert np.linalg.norm(estimate.push_m_s2[3]) > 3.0
