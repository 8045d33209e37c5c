"""Vehicles whose own north is wrong are named, by which angle and to which side; healthy ones in wind never are."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.core.types import FloatArray
from groundstation.mission.monitors.headings import _LEAST_BY_GPS_M_S, _LEAST_M_S
from groundstation.mission.monitors.wind import Wind
from tests.mission.test_monitors import Scene

TICK_S = 0.02


class Flown:
    """Eight vehicles that fly changing setpoints with a lag, each turned by an angle, in a wind that carries them."""

    def __init__(self, turns_deg: list[float], *, seed: int, lag_s: float = 0.2, wind_m_s: float = 0.0) -> None:
        self.scene = Scene("limits.tracking_m_s=5")
        self._rng = np.random.default_rng(seed)
        self._turn: FloatArray = np.zeros((8, 3, 3))
        for vehicle, degrees in enumerate(turns_deg):
            self.turn(vehicle, degrees)
        self._lag_s, self._wind_m_s = lag_s, wind_m_s
        self._air: FloatArray = np.zeros((8, 3))
        self._vel: FloatArray = np.zeros((8, 3))

    def turn(self, vehicle: int, degrees: float) -> None:
        cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        self._turn[vehicle] = [[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]

    def step(self) -> None:
        scene, rng = self.scene, self._rng
        scene.status()
        if rng.random() < TICK_S / 0.8:  # now and then everybody is told something else
            scene.sent = rng.uniform(-0.4, 0.4, (8, 3)) * [1.0, 1.0, 0.2] * rng.integers(0, 2, (8, 1))
        wanted = np.einsum("nij,nj->ni", self._turn, scene.sent)
        self._vel += TICK_S / self._lag_s * (wanted - self._vel)
        self._air += TICK_S / 1.5 * (rng.normal(0.0, self._wind_m_s, (8, 3)) * np.sqrt(2.0 * 1.5 / TICK_S) - self._air)
        moves = self._vel + self._air
        scene.vel = moves + rng.normal(0.0, 0.02, (8, 3))
        scene.pos = scene.pos + TICK_S * moves * [1.0, 1.0, 0.0]

    def told(self, seconds: float) -> list[str]:
        self.scene.run(seconds, self.step)
        return [line for line in self.scene.alarms if "its heading is off" in line]


@pytest.mark.parametrize("degrees", [60.0, -75.0, -120.0, 180.0])
def test_one_that_flies_turned_is_named_with_the_angle_and_comes_back(degrees: float) -> None:
    flown = Flown([0.0, 0.0, degrees, 0.0, 0.0, 0.0, 0.0, 0.0], seed=3)
    told = flown.told(8.0)
    assert len(told) == 1, told
    assert told[0].startswith("vehicle 3: flies ")
    said = float(told[0].split(" flies ")[1].split(" degrees")[0])
    assert abs(said - abs(degrees)) < 15.0
    if abs(degrees) < 170.0:
        assert ("to the right" in told[0]) == (degrees > 0.0)
    assert "everybody comes back; see to its compass, or to how its body is defined" in told[0]


@settings(max_examples=4, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    lag_s=st.floats(0.15, 0.26),
    wind_m_s=st.floats(0.0, 0.04),
    turn_deg=st.floats(-10.0, 10.0),
)
def test_healthy_ones_in_gusts_with_another_lag_and_a_little_turn_are_left_alone(
    seed: int, lag_s: float, wind_m_s: float, turn_deg: float
) -> None:
    assert Flown([turn_deg] * 8, seed=seed, lag_s=lag_s, wind_m_s=wind_m_s).told(12.0) == []


@pytest.mark.parametrize(("lags_s", "round_s"), [((0.3, 0.3), 1.8), ((0.3, 0.3), 2.0), ((0.4,), 1.2), ((0.05,), 2.0)])
def test_a_healthy_one_that_flies_in_circles_is_no_turned_one(lags_s: tuple[float, ...], round_s: float) -> None:
    """Told velocities turned by 180 degrees a second and more: a lag that is not known looks like a turn there."""
    scene, flown = Scene("limits.tracking_m_s=5"), np.zeros((len(lags_s), 8, 3))

    def circle() -> None:
        angle = 2.0 * np.pi * scene.now_ns / 1e9 / round_s + np.arange(8.0)
        scene.sent = 0.5 * np.stack([np.cos(angle), np.sin(angle), np.zeros(8)], axis=1)
        goes = scene.sent
        for lag, lag_s in enumerate(lags_s):
            flown[lag] += TICK_S / lag_s * (goes - flown[lag])
            goes = flown[lag]
        scene.status()
        scene.vel = goes.copy()
        scene.pos = scene.pos + TICK_S * goes

    scene.run(10.0, circle)
    assert [line for line in scene.alarms if "its heading is off" in line] == []


@pytest.mark.parametrize(("up_m_s", "named"), [(0.45, False), (0.2, True)])
def test_one_that_climbs_steeply_and_is_carried_aside_is_no_turned_one(up_m_s: float, named: bool) -> None:
    """Seen in a random mission: told 1.9 m/s up and 0.17 aside, it went aside by 0.08 to 0.25 m/s elsewhere."""
    scene = Scene("limits.tracking_m_s=5")
    aside, elsewhere = [-0.12, -0.03, -up_m_s], [0.01, -0.12, -up_m_s]

    def climbs() -> None:
        scene.status()
        scene.sent = np.tile(aside, (8, 1))
        scene.vel = np.tile(aside, (8, 1))
        scene.vel[2] = elsewhere
        scene.pos = scene.pos + TICK_S * scene.vel

    scene.run(3.0, climbs)
    assert bool([line for line in scene.alarms if "its heading is off" in line]) == named


def test_who_is_told_to_stand_is_not_judged_by_what_carries_it() -> None:
    scene = Scene()

    def carried() -> None:
        scene.status()
        scene.vel = np.full((8, 3), 0.05)

    scene.run(6.0, carried)
    assert not [line for line in scene.alarms if "its heading is off" in line]


def test_who_was_found_is_told_everything_turned_back_and_the_others_as_ever() -> None:
    flown = Flown([0.0, 0.0, 60.0, 0.0, 0.0, 0.0, 0.0, 0.0], seed=3)
    wanted = np.tile([0.3, 0.0, -0.1], (8, 1))
    assert flown.scene.monitor.told(wanted) is wanted
    assert flown.told(8.0)
    told = flown.scene.monitor.told(wanted)
    np.testing.assert_array_equal(np.delete(told, 2, axis=0), np.delete(wanted, 2, axis=0))
    degrees = float(np.degrees(np.arctan2(told[2, 1], told[2, 0])))
    assert degrees == pytest.approx(-60.0, abs=15.0)
    assert np.linalg.norm(told[2]) == pytest.approx(np.linalg.norm(wanted[2]))


def test_who_is_not_turned_any_more_or_never_was_gets_its_setpoints_straight_again() -> None:
    """Otherwise one wrong judgement would turn a healthy vehicle's setpoints for the rest of the flight."""
    flown = Flown([0.0, 0.0, 60.0, 0.0, 0.0, 0.0, 0.0, 0.0], seed=3)
    assert flown.told(8.0)
    flown.turn(2, 0.0)
    flown.told(12.0)
    wanted = np.tile([0.3, 0.0, -0.1], (8, 1))
    np.testing.assert_allclose(flown.scene.monitor.told(wanted), wanted, atol=0.3 * np.sin(np.radians(15.0)))


@pytest.mark.parametrize(("outdoors", "named"), [(True, False), (False, True)])
def test_one_that_more_wind_pushes_than_is_allowed_is_no_turned_one(
    monkeypatch: pytest.MonkeyPatch, *, outdoors: bool, named: bool
) -> None:
    """mixed8 in 8 m/s and gusts of 2 m/s, limit 5.5 and 1: one was told everything turned by 151 degrees, and fled."""
    monkeypatch.setattr(Wind, "blame", lambda _self, vehicle: "; a wind of 10.5 m/s pushes it" if vehicle == 2 else "")
    flown = Flown([0.0, 0.0, 120.0, 0.0, 0.0, 0.0, 0.0, 0.0], seed=3)
    flown.scene.monitor._headings._least_m_s = _LEAST_BY_GPS_M_S if outdoors else _LEAST_M_S
    assert bool(flown.told(8.0)) == named


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_one_whose_velocity_is_poor_goes_aside_by_it_and_is_no_turned_one(seed: int) -> None:
    """As eight PX4 in their simulator as it comes: 0.43 m/s off, it was sent home, "flies 52 degrees to the left"."""
    scene, rng = Scene("limits.tracking_m_s=5", "limits.pose_jump_m=1.8"), np.random.default_rng(seed)
    error, keep = np.zeros((8, 3)), np.exp(-TICK_S / 2.0)

    def led_astray() -> None:
        scene.status()
        if rng.random() < TICK_S / 2.5:
            aside = rng.uniform(0.0, 2.0 * np.pi, 8)
            scene.sent = 0.5 * np.stack([np.cos(aside), np.sin(aside), np.zeros(8)], axis=1)
        error[:, :2] = keep * error[:, :2] + 0.35 * np.sqrt(1.0 - keep**2) * rng.standard_normal((8, 2))
        scene.vel = scene.vel + TICK_S / 0.2 * (scene.sent - scene.vel)
        scene.pos = scene.pos + TICK_S * (scene.vel - error)

    scene.run(40.0, led_astray)
    assert [line for line in scene.alarms if "its velocity is poor" in line]
    assert [line for line in scene.alarms if "its heading is off" in line] == []
