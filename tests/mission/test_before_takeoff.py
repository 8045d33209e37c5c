"""Where the team is, and what is looked at before it is armed, each part alone and in milliseconds."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega, common

from groundstation.mavlink.station import Station
from groundstation.mavlink.vehicle import LANDED_IN_AIR, LANDED_ON_GROUND, NEVER, Fleet
from groundstation.mission.flight.poses import Poses
from groundstation.mission.flight.team_frame import TeamFrame
from groundstation.mission.ground.checks import Checks
from groundstation.mission.ground.failsafe import make_failsafe
from groundstation.mission.ground.parameters import ParameterCheck
from groundstation.mission.ground.preflight import GroundState, Preflight
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.timing import SECOND_NS
from tests.app.flights import pair
from tests.mission.on_pads import looked_at, standing

AHRS = 0x200000


@pytest.fixture(scope="module")
def plan() -> MissionPlan:
    """PX4 and ArduCopter by GPS, pads 2.5 m west and 2.5 m east of the team's origin."""
    return pair()


@pytest.fixture
def fleet(plan: MissionPlan) -> Fleet:
    """Both stand on their pads and are well."""
    return standing(plan)


# Where the team is


def test_axes_of_a_vehicle_that_looks_east_are_east_north_and_up() -> None:
    quat = np.array([[math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)]])
    poses = Poses(np.zeros((1, 3)), np.zeros((1, 3)), quat, np.zeros(1, dtype=np.bool_))
    forward, left, up = poses.rot_ned_from_flu[0].T
    np.testing.assert_allclose([forward, left, up], [(0, 1, 0), (1, 0, 0), (0, 0, -1)], atol=1e-12)
    assert poses.extra_radius_m.tolist() == [0.0]
    with pytest.raises(ValueError, match=r"shape \(2,\), expected \(1,\)"):
        Poses(np.zeros((1, 3)), np.zeros((1, 3)), quat, np.zeros(1, dtype=np.bool_), np.zeros(2))


def test_the_frame_hangs_on_the_first_pad_and_heights_count_from_the_pads(plan: MissionPlan, fleet: Fleet) -> None:
    fleet.origin_deg_m[1, 2] += 7.0
    frame = looked_at(plan, fleet)
    before = frame.poses(fleet, SECOND_NS).pos_team_ned_m
    np.testing.assert_allclose(before, [(0.0, -2.5, 0.0), (0.0, 2.5, -7.0)], atol=0.02)
    np.testing.assert_allclose(frame.off_pad_m(before), [0.0, 7.0 / 3.0], atol=0.02)
    frame.settle(fleet, SECOND_NS)
    fleet.pos_local_ned_m[1] = (3.0, 0.5, -2.0)
    fleet.origin_deg_m[1, 0] += 1.0  # in flight no origin is followed
    frame.placement.look(fleet, 9 * SECOND_NS)
    after = frame.poses(fleet, SECOND_NS).pos_team_ned_m
    np.testing.assert_allclose(after, [(0.0, -2.5, 0.0), (3.0, 3.0, -2.0)], atol=0.02)


def test_a_position_is_brought_to_the_tick_by_its_velocity_no_further_than_its_age_may_be(
    plan: MissionPlan, fleet: Fleet
) -> None:
    frame = looked_at(plan, fleet)
    fleet.vel_ned_m_s[0] = (2.0, 0.0, -1.0)
    for now_s, way_s in ((0.9, 0.0), (1.0, 0.0), (1.2, 0.2), (9.0, 0.5)):
        at = frame.poses(fleet, round(now_s * SECOND_NS)).pos_team_ned_m[0]
        np.testing.assert_allclose(at, (2.0 * way_s, -2.5, -way_s), atol=0.02)


def test_a_pose_is_as_old_as_the_older_of_position_and_attitude(plan: MissionPlan, fleet: Fleet) -> None:
    frame = looked_at(plan, fleet)
    fleet.pose_ns[:], fleet.attitude_ns[:] = (50, 80), (70, 30)
    assert frame.pose_ns(fleet).tolist() == [50, 30]
    fleet.attitude_ns[0] = NEVER
    assert frame.pose_ns(fleet)[0] == NEVER


def test_two_positions_that_disagree_count_when_they_do_so_twice(plan: MissionPlan, fleet: Fleet) -> None:
    frame = looked_at(plan, fleet)
    assert np.isnan(frame.drift_m(fleet, SECOND_NS)).all()  # one comparison says nothing
    fleet.place_ns[:] = fleet.pose_ns[:] = 2 * SECOND_NS
    fleet.pos_local_ned_m[1, 0] = 4.0
    np.testing.assert_allclose(frame.drift_m(fleet, 2 * SECOND_NS), 0.0, atol=0.02)
    fleet.place_ns[:] = 3 * SECOND_NS
    fleet.pose_ns[:] = 3 * SECOND_NS - SECOND_NS // 10
    fleet.vel_ned_m_s[1, 0] = 10.0  # it has gone 1 m since that position
    np.testing.assert_allclose(frame.drift_m(fleet, 3 * SECOND_NS), [0.0, 4.0], atol=0.02)
    assert np.isnan(frame.drift_m(fleet, 14 * SECOND_NS)).all()  # too long ago


# What a safety officer looks at


def _checks(plan: MissionPlan, fleet: Fleet) -> tuple[Checks, Station]:
    station = Station(fleet, 0)
    return Checks(plan, station), station


def test_firmware_is_refused_when_it_is_too_old_and_told_when_it_is_only_old(plan: MissionPlan, fleet: Fleet) -> None:
    checks, _ = _checks(plan, fleet)
    oldest, tried = plan.autopilots[0].oldest, plan.autopilots[0].tried
    versions = {"old": (oldest[0], oldest[1] - 1), "oldest": oldest, "tried": tried}
    said = {}
    for name, (major, minor) in versions.items():
        fleet.firmware[0] = major << 24 | minor << 16 | 9 << 8 | 255
        said[name] = (
            [line for line in checks.grave(0) if "firmware" in line],
            [line for line in checks.notes(0, SECOND_NS) if "firmware" in line],
        )
    assert len(said["old"][0]) == 1
    assert f"its firmware is {oldest[0]}.{oldest[1] - 1}.9, " in said["old"][0][0]
    assert [len(part) for part in said["oldest"]] == [0, 1]
    assert said["tried"] == ([], [])


def test_a_battery_with_less_than_the_mission_needs_is_refused_one_that_is_not_told_is_not(
    plan: MissionPlan, fleet: Fleet
) -> None:
    checks, _ = _checks(plan, fleet)
    need = checks.checked(0, SECOND_NS).battery_need
    fleet.status_ns[:] = SECOND_NS
    refused = []
    for left in (need - 0.01, need, math.nan):
        fleet.battery_remaining[0] = left
        refused.append(any("battery" in line for line in checks.grave(0)))
    assert refused == [True, False, False]
    assert any("does not tell what is left" in line for line in checks.notes(0, SECOND_NS))


def test_an_estimator_counts_when_it_is_switched_on_and_ill(plan: MissionPlan, fleet: Fleet) -> None:
    checks, _ = _checks(plan, fleet)
    apart = np.array([(0.0, 0.0, 0.0), (9.0, 0.0, 0.0)])
    ill = []
    for enabled, healthy in ((AHRS, 0), (AHRS, AHRS), (0, 0), (AHRS | 1, AHRS)):
        fleet.sensors_enabled[0], fleet.sensors_healthy[0] = enabled, healthy
        ill.append("SYS_STATUS" in (checks.waiting(0, SECOND_NS, apart) or ""))
    assert ill == [True, False, False, False]


def test_an_estimator_that_throws_measured_velocities_away_is_waited_for(plan: MissionPlan, fleet: Fleet) -> None:
    checks, station = _checks(plan, fleet)
    apart = np.array([(0.0, 0.0, 0.0), (9.0, 0.0, 0.0)])
    mav = common.MAVLink(None, srcComponent=1)
    refused: list[tuple[str, ...]] = []
    for ratio in (0.05, 1.6):
        px4 = common.MAVLink_estimator_status_message(0, 0x3FF, ratio, 0.03, 0.03, 0.1, 0.0, math.nan, 0.3, 0.3)
        copter = ardupilotmega.MAVLink_ekf_status_report_message(0x33F, ratio, 0.01, 0.0, 0.0, 0.0)
        for vehicle, message in enumerate((px4, copter)):
            mav.srcSystem = plan.spec.vehicles[vehicle].id
            station.receive(plan.link_of_vehicle[vehicle], "there", message.pack(mav), 2 * SECOND_NS)
        station.ingest()
        refused.append(tuple(checks.waiting(vehicle, 2 * SECOND_NS, apart) or "" for vehicle in (0, 1)))
    assert not any("velocity" in words for words in refused[0])
    assert all("its velocity is 1.6 times as far off what it measures" in words for words in refused[1]), refused


def test_a_velocity_that_runs_while_the_vehicle_stands_is_waited_for_and_a_new_origin_is_not(
    plan: MissionPlan, fleet: Fleet
) -> None:
    frame = looked_at(plan, fleet)
    fleet.prearm_ok[:] = True
    preflight = Preflight(plan, Station(fleet, 0), frame)
    for rates in preflight.streams.rates:
        rates.good, rates.hz, rates.restarts = True, (50.0, 50.0), 0
    limit_m_s = plan.spec.limits.velocity_error_m_s

    def stands(seconds: float, from_s: float) -> str:
        state = GroundState()
        for tick in range(round(seconds * 20)):
            now_ns = round((from_s + tick / 20.0) * SECOND_NS)
            for told_ns in (fleet.pose_ns, fleet.place_ns, fleet.attitude_ns, fleet.heard_ns, fleet.heartbeat_ns):
                told_ns[:] = now_ns
            fleet.pos_local_ned_m[:] += 1e-4 * (-1) ** tick
            state = preflight.step(now_ns, {}, frame.poses(fleet, now_ns).pos_team_ned_m)
        return "; ".join(state.waiting)

    preflight._clock = lambda *_: None  # type: ignore[method-assign]
    preflight._place = lambda *_: None  # type: ignore[method-assign]
    assert "velocity" not in stands(3.0, 1.0)
    fleet.pos_local_ned_m[1] += 5.0
    assert "velocity" not in stands(3.0, 4.0)
    fleet.vel_ned_m_s[0] = (0.0, 1.6 * limit_m_s, 0.0)
    words = stands(10.0, 7.0)
    assert "vehicle 1: its velocity is wrong:" in words
    assert f"limit {limit_m_s:g} m/s" in words
    assert "vehicle 2: its velocity" not in words


def test_neighbours_nearer_than_r_are_waited_for_and_unknown_ones_accuse_nobody(
    plan: MissionPlan, fleet: Fleet
) -> None:
    checks, _ = _checks(plan, fleet)
    fleet.estimator_flags[:] = 0x33F  # everything that is flown by
    fleet.estimator_ns[:] = SECOND_NS
    radius_m = plan.spec.avoidance.radius_m
    said = []
    for away in (radius_m - 0.01, radius_m, math.nan):
        words = checks.waiting(0, SECOND_NS, np.array([(0.0, 0.0, 0.0), (0.0, 0.0, away)])) or ""
        said.append("from vehicle 2, minimum is 2.5 m" in words)
    assert said == [True, False, False]


def test_what_is_only_nice_to_know_is_asked_for_now_and_then_and_given_up(plan: MissionPlan, fleet: Fleet) -> None:
    checks, station = _checks(plan, fleet)
    asked = []
    for tenth in range(120):
        checks.ask(0, tenth * SECOND_NS // 10)
        asked += [tenth for sending in station.commands.due(tenth * SECOND_NS // 10) if sending.vehicle == 0]
        station.commands.clear(0)
    version, estimator = asked[0::2], asked[1::2]
    assert [version[0], estimator[0]] == [0, 1]  # one question at a time
    assert max(asked) < 80
    assert min(np.diff(version).min(), np.diff(estimator).min()) >= 20


# Parameters


class Parameters:
    """One vehicle that keeps and tells parameters, in pymavlink's bytes, and who asks for them.

    Args:
        plan: of the mission that asks.
        vehicle: its row.
        wrong: parameters that are not as they should be, and their values.
        stubborn: it acknowledges what it is told, and keeps what it had.
        look_only: asked by a run that sets nothing.
    """

    def __init__(
        self,
        plan: MissionPlan,
        vehicle: int,
        wrong: dict[str, int],
        *,
        stubborn: bool = False,
        look_only: bool = False,
    ) -> None:
        self.vehicle, self.sysid = vehicle, plan.spec.vehicles[vehicle].id
        self.link = plan.link_of_vehicle[vehicle]
        self.fleet = Fleet([spec.id for spec in plan.spec.vehicles], plan.link_of_vehicle)
        self.station = Station(self.fleet, 0)
        failsafe = make_failsafe(plan)
        self.check = ParameterCheck(plan, self.station, failsafe, look_only=look_only)
        self.stubborn = stubborn
        autopilot = plan.autopilots[vehicle]
        self.bytewise, self.wrong = autopilot.params_bytewise, wrong
        self.kept = autopilot.failsafes.settings(failsafe.wishes[vehicle]) | {
            name: float(value) for name, value in wrong.items()
        }
        self.asked: list[str] = []
        self.set: list[tuple[str, float]] = []
        self.end = common.MAVLink(None, srcSystem=self.sysid, srcComponent=1)
        self.now_ns = 0
        kind = common.MAV_AUTOPILOT_PX4 if autopilot.name == "px4" else common.MAV_AUTOPILOT_ARDUPILOTMEGA
        self._hear(common.MAVLink_heartbeat_message(common.MAV_TYPE_QUADROTOR, kind, 0, 0, 3, 3))

    def _hear(self, message: common.MAVLink_message) -> None:
        self.station.receive(self.link, "a", message.pack(self.end), self.now_ns)
        self.station.ingest()

    def _tell(self, name: str) -> None:
        whole, value = name in self.wrong, self.kept[name]
        kind = common.MAV_PARAM_TYPE_INT32 if whole else common.MAV_PARAM_TYPE_REAL32
        if whole and self.bytewise:
            value = float(np.array([round(value)], dtype="<i4").view("<f4")[0])
        self._hear(common.MAVLink_param_value_message(name.encode(), value, kind, 1, 0))

    def run(self, seconds: float) -> None:
        """Whatever is asked is answered at once."""
        for _ in range(round(seconds * 10)):
            self.now_ns += SECOND_NS // 10
            self.check.step(self.vehicle)
            nobody = np.zeros(2, dtype=np.bool_)
            for out in self.station.transmit(self.now_ns, np.zeros((2, 3)), np.zeros(2), nobody):
                ear = common.MAVLink(None)
                for message in (item for raw in out.frames for item in ear.parse_buffer(raw) or []):
                    if message.get_type() == "PARAM_REQUEST_READ":
                        self.asked.append(message.param_id)
                        if message.param_id in self.kept:
                            self._tell(message.param_id)
                    elif message.get_type() == "PARAM_SET":
                        value = float(message.param_value)
                        if message.param_type == common.MAV_PARAM_TYPE_INT32 and self.bytewise:
                            value = float(np.array([value], dtype="<f4").view("<i4")[0])
                        self.set.append((message.param_id, value))
                        if not self.stubborn:
                            self.kept[message.param_id] = value
                        self._tell(message.param_id)


WRONG = [(0, "NAV_DLL_ACT", 6), (1, "FS_GCS_ENABLE", 3)]  # motors off; lands where it is not asked to


@pytest.mark.parametrize(("vehicle", "name", "value"), WRONG)
def test_a_wrong_parameter_is_refused_by_name_and_left_alone(
    plan: MissionPlan, vehicle: int, name: str, value: int
) -> None:
    of = Parameters(plan, vehicle, {name: value})
    assert of.check.waiting(vehicle) is not None
    of.run(8.0)
    assert of.check.waiting(vehicle) is None
    assert [(finding.name, finding.value) for finding in of.check.findings(vehicle)] == [(name, value)]
    assert of.set == []


@pytest.mark.parametrize(("vehicle", "name", "value"), WRONG)
def test_a_wrong_parameter_is_set_in_the_autopilots_own_packing_and_told_with_what_it_was(
    vehicle: int, name: str, value: int
) -> None:
    plan = pair("failsafe.set_parameters=true")
    wanted = plan.autopilots[vehicle].failsafes.settings(make_failsafe(plan).wishes[vehicle])[name]
    of = Parameters(plan, vehicle, {name: value})
    of.run(8.0)
    assert of.set == [(name, wanted)]
    assert of.check.grave_findings(vehicle) == []
    assert f"parameters were set: {name} from {value} to {wanted:g}" in of.check.notes(vehicle)
    asked = len(of.asked)
    of.fleet.restarts[vehicle] += 1
    of.run(8.0)
    assert len(of.asked) == 2 * asked  # one that has started anew may have forgotten


@pytest.mark.parametrize(("vehicle", "name", "value"), WRONG)
def test_what_was_left_alone_is_set_by_an_order(plan: MissionPlan, vehicle: int, name: str, value: int) -> None:
    of = Parameters(plan, vehicle, {name: value})
    of.run(8.0)
    assert (of.set, of.check.why_not_fix()) == ([], None)
    of.check.fix()
    assert of.check.why_not_fix() == "whatever is wrong of them is set already"
    of.run(8.0)
    wanted = plan.autopilots[vehicle].failsafes.settings(make_failsafe(plan).wishes[vehicle])[name]
    assert (of.set, of.check.grave(vehicle)) == ([(name, wanted)], [])
    assert of.check.before[vehicle][name][0] == value
    looks = Parameters(plan, vehicle, {name: value}, look_only=True)
    assert "only looks" in (looks.check.why_not_fix() or "")


@pytest.mark.parametrize(("vehicle", "name", "value"), WRONG)
def test_one_that_keeps_what_it_had_is_told_twice_and_then_left_to_people(vehicle: int, name: str, value: int) -> None:
    of = Parameters(pair("failsafe.set_parameters=true"), vehicle, {name: value}, stubborn=True)
    of.run(20.0)
    wanted = dict(of.set)[name]
    assert of.set == [(name, wanted)] * 4  # each order twice: the first other answer may be of before
    (line,) = of.check.grave(vehicle)
    assert line.startswith(f"{name} is {value}: ")
    assert line.endswith("; it was told to, and keeps it: set it by hand")
    assert not any("parameters were set" in note for note in of.check.notes(vehicle))


def test_what_nothing_may_fly_with_is_told_with_its_remedy_and_in_short_where_it_is_much(plan: MissionPlan) -> None:
    two = {"NAV_DLL_ACT": 6, "COM_OBL_RC_ACT": 7}
    of = Parameters(plan, 0, two)
    of.run(8.0)
    lines = of.check.grave(0)
    assert sorted(line.split(" is ")[0] for line in lines) == sorted(two)
    assert all(line.endswith("; `gs check --fix` sets it") for line in lines)
    of = Parameters(plan, 0, {**two, "COM_LOW_BAT_ACT": 0})
    of.run(8.0)
    (line,) = of.check.grave(0)
    assert line.startswith("3 parameters are not as they have to be: ")
    assert all(f"{name} is {value}" in line for name, value in {**two, "COM_LOW_BAT_ACT": 0}.items())
    assert line.endswith("; `gs check --fix` sets them")
    assert Parameters(plan, 0, two).check.grave(0) == []  # nothing is known yet


def test_what_the_flight_will_set_by_itself_is_told_by_a_look_and_refuses_nothing() -> None:
    of = Parameters(pair("failsafe.set_parameters=true"), 0, {"NAV_DLL_ACT": 6}, look_only=True)
    of.run(8.0)
    assert (of.set, of.check.grave(0)) == ([], [])
    assert [finding.name for finding in of.check.later(0)] == ["NAV_DLL_ACT"]
    assert any("to be set before arming" in note and "NAV_DLL_ACT from 6 to" in note for note in of.check.notes(0))


def test_one_that_is_armed_is_asked_and_told_nothing() -> None:
    of = Parameters(pair("failsafe.set_parameters=true"), 0, {"NAV_DLL_ACT": 0})
    of.check.step(0)
    of.check.stop(0)
    assert of.station.parameters.due(SECOND_NS) == []


# The way to arming


def _looked(preflight: Preflight, frame: TeamFrame, fleet: Fleet, now_ns: int) -> GroundState:
    """One tick on the ground."""
    frame.placement.look(fleet, now_ns)
    return preflight.step(now_ns, {}, frame.poses(fleet, now_ns).pos_team_ned_m)


def test_each_vehicle_is_told_the_first_thing_that_is_wrong_with_it(plan: MissionPlan, fleet: Fleet) -> None:
    frame = looked_at(plan, fleet)
    preflight = Preflight(plan, Station(fleet, 0), frame)
    heard_s = plan.spec.limits.heartbeat_age_s
    fleet.heard_ns[1] = fleet.heartbeat_ns[1] = fleet.pose_ns[1] = fleet.attitude_ns[1] = 20 * SECOND_NS
    now_ns = 20 * SECOND_NS + SECOND_NS // 10
    first, second = _looked(preflight, frame, fleet, now_ns).waiting
    assert first.startswith(f"vehicle 1: last heard 19.1 s ago, limit {heard_s:g} s")
    assert second.startswith("vehicle 2: message rates asked for")
    fleet.heard_ns[0] = fleet.heartbeat_ns[0] = now_ns
    first, _ = _looked(preflight, frame, fleet, now_ns).waiting
    assert first.startswith("vehicle 1: position and attitude: 19.10 s old, limit 0.5 s")
    fleet.mav_type[0] = 1  # MAV_TYPE_FIXED_WING
    state = _looked(preflight, frame, fleet, now_ns)
    assert len(state.waiting) == 1
    assert any(line.startswith("vehicle 1: ") for line in state.fatal)


@pytest.mark.parametrize(
    ("landed", "words"),
    [
        (LANDED_ON_GROUND, "is armed already; disarm it before the mission"),
        (LANDED_IN_AIR, "is in the air, in "),
        (0, "is armed, in "),
    ],
)
def test_one_that_is_armed_is_refused_when_it_is_known_whether_it_flies(
    plan: MissionPlan, fleet: Fleet, landed: int, words: str
) -> None:
    frame = looked_at(plan, fleet)
    preflight = Preflight(plan, Station(fleet, 0), frame)
    fleet.armed[1], fleet.landed_state[1] = True, landed
    for now_s, fatal in ((1.0, 0), (3.9, 0), (4.0, 1)):
        state = _looked(preflight, frame, fleet, round(now_s * SECOND_NS))
        told = [line for line in state.fatal if line.startswith("vehicle 2: ")]
        assert len(told) == fatal
    assert told[0].startswith(f"vehicle 2: {words}")
    assert ("disarm it" in told[0]) == (landed == LANDED_ON_GROUND)  # who disarms one that flies lets it fall
