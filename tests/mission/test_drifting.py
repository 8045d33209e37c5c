"""Positions that move while everything else stands, and positions that leave their velocities, phase by phase."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from groundstation.core.phases import Phase
from groundstation.core.types import BoolArray, FloatArray
from groundstation.mavlink.vehicle import LANDED_IN_AIR, LANDED_ON_GROUND, Fleet
from groundstation.mission.flight.poses import Poses
from groundstation.mission.flight.resting import still_limit_m
from groundstation.mission.ground.still_check import StillCheck
from groundstation.mission.monitors.findings import Reaction, Sight
from groundstation.mission.monitors.positions import PoseJump
from groundstation.mission.monitors.resting import Resting
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.timing import SECOND_NS
from sitl.faults import Fault
from tests.app.flights import HALF_RATE, Flight, pair
from tests.mission.on_pads import looked_at, standing

TICK_NS = 40_000_000
TICK_S = TICK_NS / SECOND_NS


@pytest.fixture(scope="module")
def plan() -> MissionPlan:
    """Two by GPS, pads 5 m apart."""
    return pair()


def _sight(fleet: Fleet, now_ns: int, pos: FloatArray, airborne: BoolArray, **more: Any) -> Sight:
    nobody = np.zeros(2, dtype=np.bool_)
    return Sight(
        fleet=fleet, now_ns=now_ns, pos_team_ned_m=pos, vel_ned_m_s=np.zeros((2, 3)), pose_ns=fleet.pose_ns,
        drift_m=np.full(2, np.nan), sent_ned_m_s=np.zeros((2, 3)), ours=~nobody, steered=~nobody, lands_here=nobody,
        blind=nobody, airborne=airborne, **({"excused": nobody} | more),
    )  # fmt: skip


# Before takeoff


@pytest.mark.parametrize("speed_m_s", [0.2, 0.5, 1.0, 2.0])
@pytest.mark.parametrize(
    ("vel_m_s", "words"),
    [(0.0, "its position has moved by 0."), (1.0, "is being moved; put it on its pad and let it stand still")],
)
def test_who_stands_before_takeoff_and_says_to_move_is_waited_for(
    plan: MissionPlan, speed_m_s: float, vel_m_s: float, words: str
) -> None:
    fleet = standing(plan)
    fleet.prearm_ok[:] = True
    check, pos = StillCheck(plan, fleet), looked_at(plan, fleet).poses(fleet, SECOND_NS).pos_team_ned_m
    fleet.vel_ned_m_s[1, 0] = vel_m_s
    now_ns = SECOND_NS
    while (said := check.words(1)) is None:
        assert pos[1, 0] <= still_limit_m(plan) + speed_m_s * TICK_S
        pos[1, 0] += speed_m_s * TICK_S
        now_ns += TICK_NS
        check.look(now_ns, pos, np.full(2, now_ns))
    assert said.startswith(words)
    assert check.words(0) is None
    if vel_m_s == 0.0:
        assert "limit 0.61 m" in said
        assert "restart it there" in said
        fleet.restarts[1] += 1  # the remedy helps
        check.look(now_ns + TICK_NS, pos, np.full(2, now_ns))
        assert check.words(1) is None


def test_what_settles_wanders_or_is_given_another_origin_is_no_drift(plan: MissionPlan) -> None:
    fleet = standing(plan)
    check, pos = StillCheck(plan, fleet), looked_at(plan, fleet).poses(fleet, SECOND_NS).pos_team_ned_m
    rng, wander = np.random.default_rng(3), np.zeros((2, 3))
    for tick in range(1500):  # a minute
        fleet.prearm_ok[:] = tick > 100
        wander = wander * np.exp(-TICK_S / 60.0) + 0.12 * np.sqrt(2.0 * TICK_S / 60.0) * rng.standard_normal((2, 3))
        settling = [2.0 * np.exp(-tick / 20.0), 0.0, 0.0]
        origin = [0.0, 4.8 * (tick > 700), 0.0]
        now_ns = SECOND_NS + tick * TICK_NS
        check.look(now_ns, pos + wander + settling + origin, np.full(2, now_ns))
        assert check.words(0) is None
        assert check.words(1) is None


@pytest.mark.parametrize("speed_m_s", [0.2, 0.5, 1.0, 2.0])
def test_arming_stops_when_a_position_moves(plan: MissionPlan, speed_m_s: float) -> None:
    watch, now_ns = Resting(plan), 0
    said: dict[int, str] = {}
    while not said:
        now_ns += TICK_NS
        assert now_ns < 5 * SECOND_NS
        said = watch.while_arming(np.array([[0.0, 0.0, 0.0], [0.0, speed_m_s * now_ns / SECOND_NS, 0.0]]), now_ns)
    assert list(said) == [1]
    assert "while the team was arming, limit 0.61 m; see to its GPS or motion capture, and restart it" in said[1]


@pytest.mark.parametrize("speed_m_s", [0.2, 0.5, 1.0, 2.0])
@pytest.mark.parametrize("landed", [False, True])
def test_who_stands_armed_or_has_landed_and_says_to_move_is_told_and_stays_where_it_stands(
    plan: MissionPlan, speed_m_s: float, landed: bool
) -> None:
    fleet = standing(plan)
    watch, now_ns = Resting(plan), 0
    if landed:
        fleet.landed_state[:] = LANDED_IN_AIR
        watch.take(np.zeros((2, 3)), np.ones(2, dtype=np.bool_))
        fleet.landed_state[:] = LANDED_ON_GROUND
    ground = np.zeros(2, dtype=np.bool_)
    found: list[Any] = []
    while not found:
        now_ns += TICK_NS
        assert now_ns < 5 * SECOND_NS
        pos = np.array([[0.0, 0.0, 0.0], [0.0, speed_m_s * now_ns / SECOND_NS, 0.0]])
        watch.take(pos, ground)
        assert watch.moves[1] == (pos[1, 1] - speed_m_s * TICK_S > still_limit_m(plan))
        found = list(watch.look(_sight(fleet, now_ns, pos, ground), ~ground))
    (finding,) = found
    assert (finding.vehicles, finding.lost) == ((1,), True)
    assert finding.reaction is (Reaction.FAILED if landed else Reaction.LAND)
    assert "its position has moved by" in finding.what
    remedy = "see to its GPS or motion capture"
    if landed:
        assert finding.what.endswith("after it landed")
        assert finding.remedy == remedy
    else:
        assert finding.what.endswith(f"before it took off; it stays there, {remedy} and restart it on its pad")


# In the air


def _drifted(
    plan: MissionPlan, speed_m_s: float, for_s: float, *, lands: bool, noise: float = 0.0, rate_hz: float = 25.0
) -> tuple[PoseJump, list[Any], FloatArray]:
    """A vehicle by its pad whose position goes east, which flies by its velocity, or lands and follows its position."""
    watch, fleet = PoseJump(plan), Fleet([1, 2], plan.link_of_vehicle)
    fleet.landed_state[:] = LANDED_IN_AIR
    pads = plan.pads_enu_m[:, [1, 0, 2]] - [0.0, 0.0, 3.0]
    up, rng = np.ones(2, dtype=np.bool_), np.random.default_rng(5)
    found: list[Any] = []
    wind, true = np.zeros((2, 3)), pads.copy()
    gone, tick_s = np.zeros((2, 3)), 1.0 / rate_hz
    keep = np.exp(-tick_s / 15.0)
    for tick in range(round((for_s + 2.0) * rate_hz)):
        now_ns = round((1.0 + tick * tick_s) * SECOND_NS)
        moving = np.array([0.0, speed_m_s * (tick * tick_s < for_s), 0.0])
        gone[1] += moving * tick_s
        vel = np.zeros((2, 3))
        vel[1] = -moving if lands else 0.0
        true = true + vel * tick_s
        wind = keep * wind + noise * np.sqrt(1.0 - keep**2) * rng.standard_normal((2, 3))
        fleet.pose_ns[:] = now_ns
        quat = np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))
        poses = Poses(true + gone, vel + wind, quat, np.zeros(2, dtype=np.bool_))
        trusted = watch.take(poses, fleet.pose_ns, np.zeros(2), now_ns, airborne=up)
        found += watch.look(_sight(fleet, now_ns, trusted.pos_team_ned_m, up, excused=up if lands else ~up), up)
    return watch, found, trusted.pos_team_ned_m - true


@pytest.mark.parametrize(("speed_m_s", "for_s"), [(0.3, 10.0), (0.5, 4.0), (1.0, 2.5), (2.0, 1.5)])
@pytest.mark.parametrize("lands", [False, True])
def test_a_position_that_leaves_its_velocity_is_told_and_how_far_its_vehicle_may_stand(
    plan: MissionPlan, speed_m_s: float, for_s: float, lands: bool
) -> None:
    watch, found, off_m = _drifted(plan, speed_m_s, for_s, lands=lands)
    assert [(item.vehicles, item.reaction, item.lost) for item in found] == [
        ((1,), Reaction.FAILED if lands else Reaction.LAND, True)
    ]
    assert "from where its velocity leads, limit 1.6 m" in found[0].what
    assert ("it lands by it" in found[0].what) == lands
    told = watch.may_stand_off_m(1)
    assert told is not None
    assert speed_m_s * for_s <= told[0] < 1.6 * speed_m_s * for_s + 1.0
    assert watch.may_stand_off_m(0) is None
    # It is where its velocity has led: a drift that landing follows too.
    assert np.linalg.norm(off_m[1]) < 0.2 * speed_m_s * for_s


def test_a_drift_that_ends_short_of_the_limit_is_no_reason_to_land_and_said_in_the_end(plan: MissionPlan) -> None:
    watch, found, _ = _drifted(plan, 0.5, 3.0, lands=False)
    assert found == []
    told = watch.may_stand_off_m(1)
    assert told is not None
    assert told[1] == pytest.approx(1.5, rel=0.1)


def test_by_motion_capture_a_slower_drift_is_found() -> None:
    watch, found, _ = _drifted(pair("positioning=mocap"), 0.2, 5.0, lands=True)
    assert [item.reaction for item in found] == [Reaction.FAILED]
    told = watch.may_stand_off_m(1)
    assert told is not None
    assert 1.0 <= told[0] < 2.0


def test_velocities_by_gps_that_wander_are_no_drift(plan: MissionPlan) -> None:
    watch, found, _ = _drifted(plan, 0.0, 120.0, lands=False, noise=0.035)
    assert found == []
    assert [watch.may_stand_off_m(row) for row in (0, 1)] == [None, None]


# Flown


@pytest.mark.parametrize(
    ("phase", "speed_m_s", "words"),
    [
        (Phase.ARM, 0.5, "vehicle 1: its position has moved by 0.7"),
        (Phase.FORM, 0.5, "vehicle 1: may stand up to "),  # it has not flown for long, and its velocity is blamed first
        (Phase.LAND, 1.0, "; it lands by it, keep people away; vehicle 1: may stand up to "),
    ],
)
def test_a_drift_is_told_and_no_flight_with_it_is_called_completed(phase: Phase, speed_m_s: float, words: str) -> None:
    begun: list[int] = []

    def drift(flight: Flight) -> None:
        if not begun and flight.runner.phase is phase:
            begun.append(flight.now_ns)
            numbers = {"east_m_s": speed_m_s, "north_m_s": 0.0, "up_m_s": 0.0}
            flight.world.inject(Fault("position_drift", 0.0, 4.0, (1,), numbers, "both"))

    plan = pair(HALF_RATE, "steps.1.hold.seconds=1")
    flight = Flight(plan, intrude=drift)
    assert flight.runner.outcome == "aborted"
    assert words in flight.runner.reason
    off_m = np.linalg.norm((flight.world.dynamics.motion.pos_enu_m.T - plan.pads_enu_m)[:, :2], axis=1)
    if phase is not Phase.ARM:
        told_m = float(flight.runner.reason.partition("may stand up to ")[2].split()[0])
        assert off_m[0] > 1.5  # it did follow
        assert off_m[0] <= told_m < off_m[0] + 2.0
    else:
        assert off_m.max() < 0.01  # nobody flew
