"""Compensated commands: vehicles answer as quickly as they are to, by a simulation that shares no code with it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from groundstation.app.resources import packaged_configs
from groundstation.core.compensation import MOST_OVER_LIMIT, AxisResponse, Compensator, Response
from groundstation.core.errors import UserError
from groundstation.mission.plan.profiles import PROFILES
from groundstation.mission.plan.reading import load_mission, plan_from_record
from sitl.dynamics import Dynamics
from sitl.estimator import NOISELESS, Estimator
from sitl.personalities import PROFILES as FLOWN
from tests.mission.test_monitors import SECOND_NS, TICK_NS, Scene

TICK_S, STEP_S = 0.02, 0.004
LAG_S = 0.3
PX4_CUBE8 = packaged_configs() / "missions" / "px4_cube8.yaml"
RESPONSES = {name: profile.response for name, profile in PROFILES.items() if profile.response is not None}


def answers(name: str, axis: int, speed_m_s: float, response: Response | None) -> tuple[np.ndarray, np.ndarray]:
    """Velocities along an axis (0 east, 2 up) and commands of one emulated vehicle for a step, tick by tick.

    Without a response commands go as they are.
    """
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
    shape = Compensator([response], np.array([LAG_S]), TICK_S, speed_m_s) if response else None
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
    went, commands = answers(name, axis, 0.3, RESPONSES[name])
    # The lag behind it, and what is not inverted: dead time, attitude, motors.
    assert t63_s(went, 0.3) <= LAG_S + 1.8 * profile.delay_s
    assert went.max() <= 1.12 * 0.3
    assert went[-1] == pytest.approx(0.3, abs=0.012)
    assert commands.max() <= MOST_OVER_LIMIT * 0.3 + 1e-9


def test_it_is_the_compensation_that_makes_it_quick() -> None:
    by_itself, commands = answers("px4_quad", 0, 0.3, None)
    helped, _ = answers("px4_quad", 0, 0.3, RESPONSES["px4_quad"])
    assert t63_s(by_itself, 0.3) > 2.2 * t63_s(helped, 0.3)
    assert commands.max() == pytest.approx(0.3)


def test_vehicles_that_nobody_knows_get_their_commands_as_they_are() -> None:
    shape = Compensator([RESPONSES["px4_quad"], None], np.array([LAG_S, 1.0]), TICK_S, 0.5)
    rng = np.random.default_rng(2)
    for _ in range(100):
        told = rng.normal(0.0, 2.0, (2, 3))
        sent = shape(told)
        assert np.array_equal(sent[1], told[1])
        assert np.linalg.norm(sent[0]) <= MOST_OVER_LIMIT * 0.5 + 1e-9
    shape.rest(np.array([True, True]))
    assert not shape(np.zeros((2, 3))).any()


def test_everything_that_steers_counts_on_the_compensated_lag() -> None:
    plain, plan = load_mission(PX4_CUBE8, ["compensate_s=0"]), load_mission(PX4_CUBE8)
    assert (plain.profile.lag_s, plan.profile.lag_s, plan.lead_s) == (1.0, 0.75, 0.75)
    assert plan.control_gain > 1.1 * plain.control_gain
    assert plain.compensator() is None
    shape = plan.compensator()
    assert shape is not None
    assert shape.compensated.all()
    again = plan_from_record(plan.record(), plan.gains_npz, "record")
    assert (again.profile, again.spec.compensate_s) == (plan.profile, "auto")
    # A flight from before this was the default is read as it was flown.
    before = {key: value for key, value in plan.record().items() if key != "compensate_s"}
    assert plan_from_record(before, plan.gains_npz, "record").profile == plain.profile


def test_no_less_than_the_limits_of_setpoints_allow() -> None:
    # 1.5 m/s at 3 m/s^2: with 0.3 s px4_cube8 swung without end, its setpoints at the limit of their slope.
    with pytest.raises(UserError, match=r"compensate_s: 0.3 s, minimum is 0.75 s.*leave it out"):
        load_mission(PX4_CUBE8, ["compensate_s=0.3"])
    assert load_mission(PX4_CUBE8, ["compensate_s=0.3", "speed_limit_m_s=0.5"]).profile.lag_s == 0.3
    assert load_mission(PX4_CUBE8, ["compensate_s=auto", "acceleration_limit_m_s2=2.5"]).profile.lag_s == pytest.approx(
        0.9
    )


@pytest.mark.parametrize(
    "changes", [[], ["profiles={px4_quad: {lag_s: 0.9}}"], ["profiles={px4_quad: {drag_1_s: 0.4}}"]]
)
def test_whose_answer_is_not_known_is_not_compensated(changes: list[str]) -> None:
    mission = PX4_CUBE8 if changes else PX4_CUBE8.with_name("cube8.yaml")
    with pytest.raises(UserError, match="no vehicle answers quicker by it"):
        load_mission(mission, ["compensate_s=0.8", *changes])
    assert load_mission(mission, changes).compensator() is None


IDENTIFIED = """{
  like: px4_quad, lag_s: 0.95, lag_up_s: 0.22, delay_s: 0.16,
  response: {horizontal: {p_1_s: 1.8, i_1_s2: 0.5, drag_1_s: 1.35}, vertical: {p_1_s: 4.0, i_1_s2: 2.0, drag_1_s: 1.35}}
}"""


def _of_its_own(*changes: tuple[str, str]) -> list[str]:
    text = IDENTIFIED
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return [f"profiles={{px4_quad: {text}}}"]


def test_a_response_of_the_mission_is_flown_by_and_recorded() -> None:
    plan = load_mission(PX4_CUBE8, _of_its_own())
    shape = plan.compensator()
    assert shape is not None
    assert shape.compensated.all()
    assert (plan.profile.lag_s, plan.lead_s) == (0.75, 0.75)
    again = plan_from_record(plan.record(), plan.gains_npz, "record")
    assert again.vehicle_profiles == plan.vehicle_profiles
    assert load_mission(PX4_CUBE8, [*_of_its_own(), "compensate_s=0"]).compensator() is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        # By hand: (1.8 + 1.35) / (2 sqrt(9)) = 0.525.
        (("i_1_s2: 0.5", "i_1_s2: 9"), r"px4_quad\.response\.horizontal: damping 0\.5[23], minimum is 0\.7.*leave"),
        (("lag_s: 0.95", "lag_s: 0.3"), r"horizontal: 63 % of a step after 1\.\d+ s, limits 0\.18 and 0\.48 s.*both"),
        (("p_1_s: 4.0, i_1_s2: 2.0", "p_1_s: 0.3, i_1_s2: 0.01"), r"response\.vertical: 63 % of a step after"),
        (("p_1_s: 1.8", "p_1_s: -1"), r"response\.horizontal\.p_1_s"),
    ],
)  # fmt: skip
def test_a_response_that_cannot_be_is_refused_with_its_key(change: tuple[str, str], words: str) -> None:
    with pytest.raises(UserError, match=words):
        load_mission(PX4_CUBE8, _of_its_own(change))


def test_a_weak_loop_is_asked_for_no_more_than_passes_noise_on_three_times() -> None:
    weak = ("p_1_s: 1.8, i_1_s2: 0.5, drag_1_s: 1.35", "p_1_s: 0.9, i_1_s2: 0.3, drag_1_s: 0.2")
    slow = ["speed_limit_m_s=0.3", "lead_s=0"]  # which takes 0.15 s at the acceleration limit
    plan = load_mission(PX4_CUBE8, [*_of_its_own(weak, ("lag_s: 0.95", "lag_s: 1.2")), *slow])
    assert plan.profile.lag_s == pytest.approx(1.0 / (3.0 * 0.9))
    shape = plan.compensator()
    assert shape is not None
    at_once = np.abs(shape(np.full((8, 3), 0.01))) / 0.01
    assert at_once.max() <= 3.2
    with pytest.raises(UserError, match=r"compensate_s: 0.3 s, minimum is 0.37 s: p_1_s of a velocity loop"):
        load_mission(PX4_CUBE8, [*_of_its_own(weak, ("lag_s: 0.95", "lag_s: 1.2")), *slow, "compensate_s=0.3"])


@pytest.mark.parametrize("gains", [(1.8, 0.5, 1.35), (4.0, 2.0, 1.35), (0.9, 0.3, 0.2), (6.0, 40.0, 2.0)])
def test_when_63_percent_are_reached_is_what_scipy_says(gains: tuple[float, float, float]) -> None:
    p, i, drag = gains
    times_s, went = signal.step(([p, i], [1.0, p + drag, i]), T=np.arange(0.0, 8.0, 0.001))
    assert AxisResponse(p, i, drag).t63_s() == pytest.approx(times_s[np.argmax(went >= 0.632)], abs=0.01)
    assert AxisResponse(1e-3, 0.01, 8.0).t63_s() == np.inf


def test_in_a_mixed_team_nobody_stops_much_sooner_than_those_who_follow_it() -> None:
    team = ["vehicles.0.profile=arducopter", "vehicles.0.autopilot=arducopter"]
    plan = load_mission(PX4_CUBE8, [*team, "speed_limit_m_s=0.5"])  # which takes 0.3 s at the acceleration limit
    assert {profile.lag_s for profile in plan.vehicle_profiles} == {0.6}
    shape = plan.compensator()
    assert shape is not None
    assert shape.compensated.tolist() == [False] + [True] * 7


def test_a_vehicle_that_is_left_out_again_gets_its_commands_as_they_are() -> None:
    shape = Compensator([RESPONSES["px4_quad"]] * 2, np.full(2, LAG_S), TICK_S, 0.5)
    told = np.full((2, 3), 0.2)
    first = shape(told)
    assert np.linalg.norm(first[0]) > 1.3 * np.linalg.norm(told[0])
    shape.stop(np.array([True, False]))
    assert shape.compensated.tolist() == [False, True]
    sent = shape(told)
    assert np.array_equal(sent[0], told[0])
    assert not np.array_equal(sent[1], told[1])
    assert np.array_equal(shape(np.zeros((2, 3)))[0], np.zeros(3))


def _strays_on(answers_s: float) -> bool:
    """Whether one that strays, and then answers its setpoints with this lag, is said not to follow them still."""
    scene = Scene(
        *(f"vehicles.{k}.profile=px4_quad" for k in range(8)),
        "compensate_s=auto", "limits.tracking_m_s=0.1", "fence={min_m: [-60, -60, 0], max_m: [60, 60, 60]}",
    )  # fmt: skip
    went = np.zeros(3)

    def flies(answers: bool) -> None:
        nonlocal went
        angle_rad = 1.2 * scene.now_ns / SECOND_NS  # in circles: never right by chance
        scene.sent[0, :2] = 0.45 * np.cos(angle_rad), 0.45 * np.sin(angle_rad)
        went = went + (scene.sent[0] - went) * TICK_NS / SECOND_NS / answers_s if answers else np.zeros(3)
        scene.vel[0] = went
        scene.pos[0] += went * TICK_NS / SECOND_NS

    scene.pos = scene.pos.copy()
    scene.run(7.0, lambda: flies(False))
    assert any("vehicle 1: does not follow its setpoints" in text for text in scene.alarms)
    scene.run(20.0, lambda: flies(True))
    return any("vehicle 1: has not followed its setpoints for 6 s" in text for text in scene.alarms)


@pytest.mark.parametrize(("answers_s", "on"), [(1.0, False), (0.3, True)])
def test_who_strays_is_judged_by_the_lag_of_its_own_from_then_on(answers_s: float, on: bool) -> None:
    assert _strays_on(answers_s) == on


def test_nothing_is_left_of_what_was_told_before_a_pause() -> None:
    shape = Compensator([RESPONSES["px4_quad"]], np.array([LAG_S]), TICK_S, 0.5)
    first = shape(np.full((1, 3), 0.2))
    assert not np.array_equal(shape(np.full((1, 3), 0.2)), first)
    shape.rest(np.array([True]))
    assert np.array_equal(shape(np.full((1, 3), 0.2)), first)
