"""Step responses, tilt and acceleration, ground, thrust limits, wind, downwash, noise."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sitl.dynamics import Dynamics
from sitl.environment import Downwash, Wind
from sitl.estimator import GPS, MOCAP, NOISELESS, Estimator, Noise
from sitl.loops import GRAVITY_M_S2, Shaping
from sitl.personalities import PROFILES

STEP_S = 0.004


def flying(
    *names: str, noise: Noise = NOISELESS, wind: Wind | None = None, downwash: Downwash | None = None, seed: int = 0
) -> Dynamics:
    """Vehicles of these profiles, 5 m apart, hovering at about 3 m."""
    n = len(names)
    pads = np.zeros((3, n))
    pads[0] = 5.0 * np.arange(n)
    estimator = Estimator([noise] * n, STEP_S, np.random.default_rng(seed))
    dynamics = Dynamics(
        [PROFILES[name] for name in names],
        pos_enu_m=pads,
        yaw_enu_rad=np.zeros(n),
        estimator=estimator,
        step_s=STEP_S,
        wind=wind,
        downwash=downwash,
    )
    dynamics.commands.flying[:] = True
    dynamics.commands.vel_sp_enu_m_s[2] = 1.0
    run(dynamics, 3.0)
    dynamics.commands.vel_sp_enu_m_s[2] = 0.0
    run(dynamics, 5.0)
    return dynamics


def run(dynamics: Dynamics, seconds: float) -> np.ndarray:
    """Velocities at every step, shape (steps, 3, n)."""
    out = np.empty((round(seconds / STEP_S), 3, dynamics.n))
    for k in range(len(out)):
        dynamics.step()
        out[k] = dynamics.motion.vel_enu_m_s
    return out


def step_response(name: str, speed_m_s: float, axis: int = 0) -> tuple[np.ndarray, np.ndarray]:
    dynamics = flying(name)
    dynamics.commands.vel_sp_enu_m_s[axis] = speed_m_s
    velocity = run(dynamics, 6.5)[:, axis, 0]
    return (np.arange(len(velocity)) + 1) * STEP_S, velocity


@pytest.mark.parametrize(
    ("name", "speed_m_s", "t63_s", "points"),
    [
        ("px4_quad", 2.0, 1.05, {1.0: 1.25, 3.0: 1.5, 6.0: 1.7}),
        ("arducopter", 2.0, 0.9, {1.0: 1.465, 2.0: 1.94, 3.0: 2.0}),
        ("crazyflie", 0.5, 0.2 + 0.05, {}),  # lag and delay of the prototype's Crazyflie
    ],
)
def test_step_response_as_measured(name: str, speed_m_s: float, t63_s: float, points: dict[float, float]) -> None:
    t_s, velocity = step_response(name, speed_m_s)
    assert t_s[np.argmax(velocity >= 0.632 * speed_m_s)] == pytest.approx(t63_s, rel=0.15)
    for at_s, expected in points.items():
        assert float(np.interp(at_s, t_s, velocity)) == pytest.approx(expected, rel=0.05)
    assert velocity.max() < 1.02 * speed_m_s


@pytest.mark.parametrize(
    ("axis", "speed_m_s", "lag_s"), [(0, 0.3, 0.5), (0, -1.0, 0.5), (2, 0.15, 0.2), (2, -0.15, 0.2)]
)
def test_arducopter_follows_small_changes_as_one_lag_of_its_acceleration_over_its_jerk(
    axis: int, speed_m_s: float, lag_s: float
) -> None:
    t_s, velocity = step_response("arducopter", speed_m_s, axis)
    share = velocity / speed_m_s
    # Dead time, attitude and, for 1 m/s, the jerk come before.
    assert t_s[np.argmax(share >= 0.632)] == pytest.approx(lag_s + 0.15, abs=0.1)
    assert float(np.interp(lag_s * 4.0 + 0.15, t_s, share)) > 0.95
    assert share.max() < 1.03


def test_shaped_commands_keep_acceleration_and_jerk_and_end_where_they_are_told() -> None:
    shaping = Shaping([PROFILES["arducopter"], PROFILES["px4_quad"]], STEP_S)
    rng = np.random.default_rng(5)
    told, before = np.zeros((3, 2)), np.zeros((3, 2))
    for k in range(4000):
        if k % 250 == 0:
            told = rng.uniform(-3.0, 3.0, (3, 2))
        vel, acc = (item.copy() for item in shaping.step(told))
        assert np.hypot(acc[0, 0], acc[1, 0]) <= 2.5 + 1e-9
        assert abs(acc[2, 0]) <= 1.0 + 1e-9
        assert np.hypot(*(acc - before)[:2, 0]) <= 5.0 * STEP_S + 1e-9
        np.testing.assert_array_equal(
            (vel[:, 1], acc[:, 1]), (told[:, 1], np.zeros(3))
        )  # PX4 follows commands as they are
        before = acc
    for _ in range(3000):
        vel, acc = shaping.step(told)
    np.testing.assert_allclose(vel, told, atol=1e-3)
    np.testing.assert_allclose(acc, 0.0, atol=1e-3)


def test_crazyflie_hardly_moves_within_its_delay_and_follows_like_a_first_order_lag() -> None:
    t_s, velocity = step_response("crazyflie", 0.5)
    assert float(np.interp(0.05, t_s, velocity)) < 0.05 * 0.5
    model = 0.5 * (1.0 - np.exp(-np.maximum(t_s - 0.05, 0.0) / 0.2))
    assert np.abs(velocity - model).max() < 0.12 * 0.5


def test_hover_is_level_and_its_thrust_is_the_weight() -> None:
    dynamics = flying(*PROFILES)
    assert dynamics.motion.up_enu[2] == pytest.approx(np.ones(len(PROFILES)), abs=1e-6)
    assert dynamics.motion.thrust_m_s2 == pytest.approx(np.full(len(PROFILES), GRAVITY_M_S2), rel=3e-3)
    assert np.abs(dynamics.motion.acc_enu_m_s2).max() < 0.01


def test_tilt_produces_the_acceleration() -> None:
    dynamics = flying(*PROFILES)
    dynamics.commands.vel_sp_enu_m_s[0], dynamics.commands.vel_sp_enu_m_s[1] = 1.0, -0.5
    tilted = 0.0
    for _ in range(500):
        before = dynamics.motion.vel_enu_m_s.copy()
        dynamics.step()
        drag = np.array([PROFILES[name].frame.drag_per_s for name in PROFILES]) * before
        weight = np.array([[0.0], [0.0], [GRAVITY_M_S2]])
        expected = dynamics.motion.up_enu * dynamics.motion.thrust_m_s2 - weight - drag
        assert (dynamics.motion.vel_enu_m_s - before) / STEP_S == pytest.approx(expected, abs=1e-9)
        tilted = max(tilted, float(np.degrees(np.arccos(dynamics.motion.up_enu[2])).max()))
    assert tilted > 10.0
    assert (np.linalg.norm(dynamics.motion.up_enu, axis=0)) == pytest.approx(np.ones(len(PROFILES)), abs=1e-12)


def test_tilt_and_thrust_stay_within_their_limits_under_wild_commands() -> None:
    dynamics = flying(*PROFILES)
    rng = np.random.default_rng(3)
    tilt_max = np.array([PROFILES[name].loops.tilt_max_rad for name in PROFILES])
    thrust_max = np.array([PROFILES[name].frame.thrust_max_g for name in PROFILES]) * GRAVITY_M_S2
    for _ in range(40):
        dynamics.commands.vel_sp_enu_m_s[:] = rng.uniform(-50.0, 50.0, (3, len(PROFILES)))
        for _ in range(50):
            dynamics.step()
            assert (np.arccos(np.clip(dynamics.motion.up_enu[2], -1, 1)) <= tilt_max * 1.1).all()
            assert (dynamics.motion.thrust_m_s2 <= thrust_max * 1.0001).all()
            assert (dynamics.motion.pos_enu_m[2] >= 0.0).all()


def test_standing_on_the_ground_nothing_moves_until_it_lifts() -> None:
    dynamics = flying("crazyflie")
    dynamics.commands.vel_sp_enu_m_s[2] = -1.0
    dynamics.commands.vel_sp_enu_m_s[0] = 0.3
    run(dynamics, 6.0)
    assert dynamics.motion.on_ground.all()
    start = dynamics.motion.pos_enu_m.copy()
    run(dynamics, 1.0)
    assert (dynamics.motion.pos_enu_m == start).all()
    assert dynamics.motion.up_enu[:, 0].tolist() == [0.0, 0.0, 1.0]
    dynamics.commands.flying[:] = False
    dynamics.commands.vel_sp_enu_m_s[2] = 1.0
    run(dynamics, 1.0)
    assert (dynamics.motion.pos_enu_m == start).all()
    dynamics.commands.flying[:] = True
    run(dynamics, 1.0)
    assert dynamics.motion.pos_enu_m[2, 0] > 0.5


def test_without_motors_it_falls_freely() -> None:
    dynamics = flying("crazyflie")
    dynamics.commands.flying[:] = False
    dynamics.motion.thrust_m_s2[:] = 0.0
    fallen = run(dynamics, 0.4)[:, 2, 0]
    assert fallen[-1] == pytest.approx(-GRAVITY_M_S2 * 0.4, rel=0.06)  # less a little drag


def test_a_failed_motor_brings_it_down() -> None:
    dynamics = flying("crazyflie", "crazyflie")
    dynamics.health.tumble(0, True)
    dynamics.health.power(0, 0.6)
    run(dynamics, 3.0)
    assert dynamics.motion.on_ground.tolist() == [True, False]


@pytest.mark.parametrize(("height_m", "crashes"), [(0.03, False), (0.5, True)])
def test_a_motor_that_fails_a_hand_above_the_ground_lets_it_down_before_it_leans(
    height_m: float, crashes: bool
) -> None:
    dynamics = flying("crazyflie")
    dynamics.commands.vel_sp_enu_m_s[2] = -0.5
    while dynamics.motion.pos_enu_m[2, 0] > height_m:
        dynamics.step()
    dynamics.health.tumble(0, True)
    dynamics.health.power(0, 0.8)
    run(dynamics, 1.0)
    assert dynamics.motion.on_ground[0]
    assert bool(dynamics.motion.crashed[0]) is crashes
    # What has crashed lies on its side, and its attitude tells so; what stands is level.
    assert math.degrees(math.acos(dynamics.motion.up_enu[2, 0])) == pytest.approx(80.0 if crashes else 0.0)


def test_one_that_lifts_off_with_a_broken_motor_turns_over_on_its_pad() -> None:
    dynamics = flying("px4_quad")
    dynamics.motion.pos_enu_m[2, 0] = 0.0
    dynamics.health.tumble(0, True)
    dynamics.health.power(0, 0.2)
    dynamics.commands.vel_sp_enu_m_s[2] = 0.5
    run(dynamics, 1.0)
    assert dynamics.motion.crashed[0]
    assert dynamics.motion.up_enu[2, 0] < 0.5


def test_wind_pushes_and_the_integral_holds_against_it() -> None:
    rng = np.random.default_rng(1)
    wind = Wind(mean_enu_m_s=(3.0, 0.0, 0.0), gust_sigma_m_s=0.0, gust_tau_s=2.0, n=1, step_s=STEP_S, rng=rng)
    dynamics = flying("px4_quad", wind=wind)
    run(dynamics, 20.0)
    assert abs(float(dynamics.motion.vel_enu_m_s[0, 0])) < 0.05
    lean = math.degrees(math.atan2(-float(dynamics.motion.up_enu[0, 0]), float(dynamics.motion.up_enu[2, 0])))
    profile = PROFILES["px4_quad"]
    expected = math.degrees(math.atan(3.0 * (profile.frame.air_per_s + 3.0 * profile.frame.air_per_m) / GRAVITY_M_S2))
    assert lean == pytest.approx(expected, rel=0.05)  # it leans into the wind by what the drag asks for


@pytest.mark.parametrize("name", ["px4_quad", "arducopter"])
def test_half_a_metre_leans_in_a_wind_of_8_m_s_as_such_vehicles_do_and_stands(name: str) -> None:
    wind = Wind(
        mean_enu_m_s=(8.0, 0.0, 0.0),
        gust_sigma_m_s=0.0,
        gust_tau_s=2.0,
        n=1,
        step_s=STEP_S,
        rng=np.random.default_rng(1),
    )
    dynamics = flying(name, wind=wind)
    run(dynamics, 30.0)
    assert 10.0 < math.degrees(math.acos(float(dynamics.motion.up_enu[2, 0]))) < 25.0
    assert abs(float(dynamics.motion.vel_enu_m_s[0, 0])) < 0.05


def test_a_wind_of_nothing_changes_next_to_nothing() -> None:
    still = Wind(
        mean_enu_m_s=(0.0, 0.0, 0.0),
        gust_sigma_m_s=0.0,
        gust_tau_s=2.0,
        n=3,
        step_s=STEP_S,
        rng=np.random.default_rng(1),
    )
    names = ("px4_quad", "arducopter", "crazyflie")
    in_it, without = flying(*names, wind=still), flying(*names)
    assert in_it.motion.pos_enu_m == pytest.approx(without.motion.pos_enu_m, abs=2e-3)


def test_drag_that_only_a_simulator_has_does_not_hold_a_vehicle_against_gusts() -> None:
    wind = Wind(
        mean_enu_m_s=(0.0, 0.0, 0.0),
        gust_sigma_m_s=1.0,
        gust_tau_s=2.0,
        n=40,
        step_s=STEP_S,
        rng=np.random.default_rng(2),
    )
    dynamics = flying(*["px4_quad"] * 40, wind=wind)
    spread = run(dynamics, 40.0)[:, :2].std()
    # v' = a - 2.05 v - 0.5 (integral of v): 0.37 s of an acceleration of 0.25 m/s^2 and a little more, for |u| u
    assert spread == pytest.approx(0.37 * 0.29, rel=0.2)


def test_gusts_have_the_stated_strength() -> None:
    rng = np.random.default_rng(1)
    wind = Wind(mean_enu_m_s=(1.0, 0.0, 0.0), gust_sigma_m_s=0.8, gust_tau_s=0.5, n=50, step_s=STEP_S, rng=rng)
    air = np.array([wind.step() for _ in range(5000)])
    assert air.mean(axis=(0, 2)) == pytest.approx([1.0, 0.0, 0.0], abs=0.05)
    assert air.std(axis=(0, 2)) == pytest.approx([0.8, 0.8, 0.4], rel=0.05)


def test_downwash_pushes_only_who_is_below() -> None:
    span = np.full(3, 0.13)
    downwash = Downwash(np.full(3, 0.033), span)
    thrust = np.full(3, GRAVITY_M_S2)
    pos = np.array([[0.0, 0.0, 1.5], [0.0, 0.0, 0.0], [1.5, 1.0, 1.0]])  # 1 above 2, 3 aside
    push = downwash.acceleration(pos, thrust)
    assert push[0] == 0.0
    assert push[1] > 0.5
    assert push[2] < 1e-3
    nearer = downwash.acceleration(pos - np.array([[0.0], [0.0], [0.3]]) * [1, 0, 0], thrust)
    assert nearer[1] > push[1]


def test_estimation_noise_has_the_stated_size_and_memory() -> None:
    estimator = Estimator([MOCAP] * 40, STEP_S, np.random.default_rng(5))
    samples = []
    for _ in range(15000):
        estimator.step(np.zeros(40, dtype=bool))
        samples.append(estimator.pos_error.copy())
    errors = np.array(samples)[::5]
    assert errors.std() == pytest.approx(0.005, rel=0.1)
    lag = 50  # one correlation time of 1 s in samples of 20 ms
    both = (errors[:-lag] * errors[lag:]).mean() / (errors**2).mean()
    assert both == pytest.approx(math.exp(-1.0), abs=0.1)


def test_with_gps_it_wanders_as_seen_at_zero_command() -> None:
    names = ["px4_quad"] * 16
    dynamics = flying(*names, noise=GPS)
    start = dynamics.motion.pos_enu_m.copy()
    run(dynamics, 60.0)
    wandered = np.hypot(*(dynamics.motion.pos_enu_m - start)[:2])
    assert 1.0 < float(np.median(wandered)) < 2.5


def test_mixed_profiles_do_not_touch_each_other() -> None:
    together = flying("px4_quad", "arducopter", "crazyflie")
    together.commands.vel_sp_enu_m_s[0] = 1.0
    both = run(together, 2.0)
    for k, name in enumerate(("px4_quad", "arducopter", "crazyflie")):
        alone = flying(name)
        alone.commands.vel_sp_enu_m_s[0] = 1.0
        assert run(alone, 2.0)[:, :, 0] == pytest.approx(both[:, :, k], abs=1e-9)
