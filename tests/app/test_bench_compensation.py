"""Compensated commands: vehicles answer as quickly as they are to, by a simulation that shares no code with it."""

from __future__ import annotations

import numpy as np
import pytest

from groundstation.app.law_bench.compensation import MOST_OVER_LIMIT, RESPONSES, Compensator
from groundstation.mission.plan.profiles import PROFILES
from sitl.dynamics import Dynamics
from sitl.estimator import NOISELESS, Estimator
from sitl.personalities import PROFILES as FLOWN

TICK_S, STEP_S = 0.02, 0.004


def answers(name: str, axis: int, speed_m_s: float, *, compensated: bool) -> tuple[np.ndarray, np.ndarray]:
    """Velocities along an axis (0 east, 2 up) and commands of one emulated vehicle for a step, tick by tick."""
    estimator = Estimator([NOISELESS], STEP_S, np.random.default_rng(0))
    start = np.zeros((3, 1))
    vehicle = Dynamics([FLOWN[name]], pos_enu_m=start, yaw_enu_rad=np.zeros(1), estimator=estimator, step_s=STEP_S)
    vehicle.commands.flying[:] = True
    vehicle.commands.vel_sp_enu_m_s[2] = 1.0
    for _ in range(round(3.0 / STEP_S)):
        vehicle.step()
    vehicle.commands.vel_sp_enu_m_s[2] = 0.0
    for _ in range(round(8.0 / STEP_S)):
        vehicle.step()
    shape = Compensator([RESPONSES[name]], RESPONSES[name].lag_s, TICK_S, speed_m_s) if compensated else None
    told = np.zeros((1, 3))
    told[0, [1, 0, 2][axis]] = -speed_m_s if axis == 2 else speed_m_s
    went, commands = [], []
    for _ in range(round(6.0 / TICK_S)):
        sent = told if shape is None else shape(told)
        vehicle.commands.vel_sp_enu_m_s[:] = np.array([sent[0, 1], sent[0, 0], -sent[0, 2]])[:, None]
        for _ in range(round(TICK_S / STEP_S)):
            vehicle.step()
        went.append(vehicle.motion.vel_enu_m_s[axis, 0])
        commands.append(float(np.linalg.norm(sent)))
    return np.array(went), np.array(commands)


def t63_s(went: np.ndarray, speed_m_s: float) -> float:
    return float(np.argmax(went >= 0.632 * speed_m_s)) * TICK_S


@pytest.mark.parametrize("axis", [0, 2])
@pytest.mark.parametrize("name", list(RESPONSES))
def test_a_compensated_vehicle_answers_with_the_lag_that_the_team_counts_on(name: str, axis: int) -> None:
    profile = PROFILES[name]
    went, commands = answers(name, axis, 0.3, compensated=True)
    # The lag behind it, and what is not inverted: dead time, attitude, motors.
    assert t63_s(went, 0.3) <= RESPONSES[name].lag_s + 1.8 * profile.delay_s
    assert went.max() <= 1.12 * 0.3
    assert went[-1] == pytest.approx(0.3, abs=0.012)
    assert commands.max() <= MOST_OVER_LIMIT * 0.3 + 1e-9


def test_it_is_the_compensation_that_makes_it_quick() -> None:
    by_itself, commands = answers("px4_quad", 0, 0.3, compensated=False)
    helped, _ = answers("px4_quad", 0, 0.3, compensated=True)
    assert t63_s(by_itself, 0.3) > 2.2 * t63_s(helped, 0.3)
    assert commands.max() == pytest.approx(0.3)


def test_vehicles_that_nobody_knows_get_their_commands_as_they_are() -> None:
    shape = Compensator([RESPONSES["px4_quad"], None], 0.3, TICK_S, 0.5)
    rng = np.random.default_rng(2)
    for _ in range(100):
        told = rng.normal(0.0, 2.0, (2, 3))
        sent = shape(told)
        assert np.array_equal(sent[1], told[1])
        assert np.linalg.norm(sent[0]) <= MOST_OVER_LIMIT * 0.5 + 1e-9
    shape.rest()
    assert not shape(np.zeros((2, 3))).any()
