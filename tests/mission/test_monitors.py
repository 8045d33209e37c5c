"""Every monitor by itself: its limit, what it asks for, its words, and that it leaves brief disturbances alone."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from groundstation.app.resources import packaged_configs
from groundstation.core.types import FloatArray
from groundstation.mavlink.vehicle import LANDED_IN_AIR, LANDED_LANDING, NEVER, Fleet
from groundstation.mission.flight.poses import Poses
from groundstation.mission.monitors.board import Board
from groundstation.mission.monitors.findings import Findings, Lasting, Reaction, Sight
from groundstation.mission.monitors.flight import bounded_growth_m
from groundstation.mission.monitors.positions import PoseJump
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.reading import load_mission
from groundstation.mission.roster import enlist
from tests.mission.accuser import Accuser

SECOND_NS = 1_000_000_000
TICK_NS = 20_000_000
OFFBOARD, LOITER, LAND = 393216, 50593792, 100925440
ACTIVE, CRITICAL = 4, 5  # MAV_STATE
CUBE8 = packaged_configs() / "missions" / "cube8.yaml"


@cache
def _plan(*changes: str) -> MissionPlan:
    return load_mission(CUBE8, changes)


class Scene:
    """Eight vehicles that hover, all well, seen tick by tick; tests spoil what they are about."""

    def __init__(self, *changes: str) -> None:
        self.plan = _plan(*changes)
        n = self.plan.size
        self.monitor = Board(self.plan)
        self.fleet = Fleet([vehicle.id for vehicle in self.plan.spec.vehicles], self.plan.link_of_vehicle)
        self.fleet.armed[:] = True
        self.fleet.custom_mode[:] = OFFBOARD
        self.fleet.landed_state[:] = LANDED_IN_AIR
        self.fleet.quat_ned_from_frd[:] = [1.0, 0.0, 0.0, 0.0]
        self.fleet.battery_remaining[:] = 0.9
        self.now_ns = 10 * SECOND_NS
        self.pos: FloatArray = self.plan.pads_enu_m[:, [1, 0, 2]] - [0.0, 0.0, 1.0]
        self.vel: FloatArray = np.zeros((n, 3))
        self.sent: FloatArray = np.zeros((n, 3))
        self.drift: FloatArray = np.full(n, np.nan)
        self.age_ns = np.zeros(n, dtype=np.int64)
        self.silent_since_ns = np.full(n, NEVER)
        self.roster = enlist(self.plan)
        self.frozen = np.zeros(n, dtype=np.bool_)
        self.going_on = False
        self.stands = np.zeros(n, dtype=np.bool_)
        self.monitor.begin(self.fleet)
        self.found = Findings()
        self.alarms: list[str] = []

    def tick(self, tick_ns: int = TICK_NS) -> Findings:
        self.now_ns += tick_ns
        heard = np.where(self.silent_since_ns != NEVER, self.silent_since_ns, self.now_ns)
        self.fleet.heard_ns[:] = heard
        self.fleet.pose_ns[:] = self.now_ns - self.age_ns
        # Estimates always stir a little, in the last bits.
        self.fleet.pos_local_ned_m[:] = self.pos + 1e-6 * np.where(self.frozen, 0, self.now_ns // TICK_NS % 7)[:, None]
        self.fleet.heartbeat_ns[:] = np.minimum(heard, np.where(self.fleet.heartbeat_ns < 0, self.now_ns, heard))
        pose_ns = self.now_ns - self.age_ns
        poses = self.monitor.trusted(
            Poses(self.pos, self.vel, self.fleet.quat_ned_from_frd, np.zeros(len(self.fleet), dtype=np.bool_)),
            pose_ns,
            self.fleet.armed & ~self.stands,
            self.now_ns,
        )
        self.poses = poses
        findings = self.monitor.look(
            Sight(
                fleet=self.fleet,
                now_ns=self.now_ns,
                pos_team_ned_m=poses.pos_team_ned_m,
                vel_ned_m_s=poses.vel_ned_m_s,
                pose_ns=pose_ns,
                drift_m=self.drift,
                sent_ned_m_s=self.sent,
                ours=self.roster.ours,
                steered=~self.monitor.hold,
                lands_here=self.roster.lands_here,
                excused=self.roster.told_to_land,
                blind=self.monitor.blind,
                airborne=self.fleet.armed & ~self.stands,
                going_on=self.going_on,
                vel_error_ned_m_s=self.monitor.speeds.known_error_ned_m_s,
            )
        )
        self.alarms += findings.alarms
        self.roster.release(findings.release)
        self.roster.land_here(findings.land, self.pos, self.now_ns)
        return findings

    def run(self, seconds: float, each: Callable[[], None] | None = None) -> list[Findings]:
        """Ticks for a while; returns the findings of ticks that found something."""
        found = []
        for _ in range(round(seconds * SECOND_NS / TICK_NS)):
            if each is not None:
                each()
            findings = self.tick()
            if findings != Findings():
                found.append(findings)
        return found

    def obstacle_m(self) -> FloatArray:
        pose_ns = self.now_ns - self.age_ns
        return self.monitor.obstacles(self.poses, self.fleet, pose_ns, self.roster, self.now_ns).extra_radius_m

    def status(self) -> None:
        """One more SYS_STATUS of everybody."""
        self.fleet.status_ns[:] = self.now_ns


def test_a_team_that_is_well_is_left_alone() -> None:
    scene = Scene()
    rng = np.random.default_rng(1)

    def wander() -> None:
        scene.status()
        scene.vel = rng.normal(0.0, 0.02, (8, 3))
        scene.pos = scene.pos + 0.02 * scene.vel + rng.normal(0.0, 0.0005, (8, 3))

    assert scene.run(12.0, wander) == []
    assert not scene.monitor.hold.any()
    assert not scene.obstacle_m().any()


def test_old_poses_hold_the_vehicle_and_lost_ones_land_it() -> None:
    scene = Scene()
    scene.run(0.1)

    def ages() -> None:
        scene.age_ns[2] += TICK_NS

    found = scene.run(0.6, ages)
    assert [item.alarms for item in found] == [["vehicle 3: position is 0.52 s old, limit 0.50 s; holding"]]
    assert (found[0].abort, scene.monitor.hold.tolist()) == (None, [False, False, True] + 5 * [False])
    (lost,) = scene.run(0.6, ages)
    words = "vehicle 3: no position for 1 s; it lands where it is when nobody is below, the others come back"
    told = f"{words}; see to its link, and to its GPS or motion capture"  # what a person can do is no part of a reason
    assert (lost.land, lost.abort, lost.alarms) == ([2], words, [told])
    assert scene.monitor.blind[2]
    assert scene.run(3.0, ages) == []  # said once


def test_a_pose_that_comes_back_ends_the_hold_and_is_told_again_the_next_time() -> None:
    scene = Scene()
    for _ in range(2):
        scene.age_ns[2] = 600_000_000
        assert len(scene.run(0.1)) == 1
        scene.age_ns[2] = 0
        assert scene.run(0.1) == []
        assert not scene.monitor.hold.any()


@settings(max_examples=30, deadline=None)
@given(
    jump=st.lists(st.floats(-1e30, 1e30), min_size=3, max_size=3), speed=st.floats(-1e6, 1e6), vehicle=st.integers(0, 7)
)
@example(jump=[0.0, 0.0, 0.0], speed=19.0, vehicle=0)  # once believed, it takes the next two positions for wrong
def test_a_single_absurd_report_is_never_steered_by_and_changes_nothing(
    jump: list[float], speed: float, vehicle: int
) -> None:
    scene = Scene()
    scene.run(0.1)
    good, limit_m = scene.pos.copy(), scene.plan.limits.pose_jump_m
    scene.pos = good.copy()
    scene.pos[vehicle] += jump
    scene.vel[vehicle, 0] = speed
    assert scene.tick() == Findings()
    assert np.linalg.norm(scene.poses.pos_team_ned_m - good, axis=1).max() <= limit_m + 1e-6
    scene.pos, scene.vel = good, np.zeros((8, 3))
    assert scene.run(2.0) == []
    assert not scene.monitor.hold.any()


@pytest.mark.parametrize(
    ("share", "words"),
    [
        (0.0, "its position is "),
        (1.0, "its position is "),
        (0.5, "its velocity has changed by 30.0 m/s at once, more than a vehicle can"),
    ],
)
def test_a_velocity_that_no_vehicle_reaches_at_once_and_that_stays_is_nothing_to_steer_by(
    share: float, words: str
) -> None:
    scene = Scene()
    scene.run(0.1)
    scene.vel[2, 1] = 30.0
    found: list[Findings] = []
    while not found:
        scene.pos = scene.pos + 0.02 * share * scene.vel
        tick = scene.tick()
        found += [tick] if tick != Findings() else []
        assert (scene.poses.vel_ned_m_s == 0.0).all()
    assert found[0].land == [2]
    assert found[0].alarms[0].startswith(f"vehicle 3: {words}")


def test_a_gust_that_comes_at_once_is_flown_through() -> None:
    scene = Scene()
    scene.run(0.1)
    scene.vel[4, 2] = -2.0  # 100 m/s2 for a tick, and then it goes where that leads
    for _ in range(25):
        scene.pos = scene.pos + 0.02 * scene.vel
        assert scene.tick() == Findings()


@pytest.mark.parametrize("how", ["no message", "no figures in it"])
def test_a_battery_that_nobody_tells_any_more_brings_its_vehicle_back(how: str) -> None:
    scene = Scene()
    scene.fleet.status_ns[:5] = scene.now_ns  # of the others it was never told

    def told() -> None:
        scene.fleet.status_ns[:4] = scene.now_ns
        if how != "no message":
            scene.fleet.status_ns[4] = scene.now_ns
            scene.fleet.battery_remaining[4] = np.nan

    scene.tick()
    assert scene.run(9.9, told) == []
    (found,) = scene.run(0.3, told)
    words = "vehicle 5: its battery was last told 10 s ago, limit 10 s; see to its battery monitor and its link"
    assert (found.alarms, found.abort) == ([words], None)
    (found,) = scene.run(20.5, told)
    assert found.home == [4]
    assert found.abort == "vehicle 5: its battery was last told 30 s ago, limit 30 s; everybody comes back"
    assert scene.run(60.0, told) == []


def test_a_jump_that_stays_is_an_unknown_position_and_the_others_keep_clear_of_where_it_was() -> None:
    scene = Scene()
    scene.run(0.1)
    was = scene.pos[4].copy()
    scene.pos = scene.pos.copy()
    scene.pos[4] += [0.0, 0.8, 0.0]
    (found,) = scene.run(0.5)
    assert found.land == [4]
    assert found.abort is not None
    assert found.abort.startswith("vehicle 5: its position is 0.80 m from where its velocity leads, limit 0.37 m; it")
    np.testing.assert_allclose(scene.poses.pos_team_ned_m[4], was)
    assert scene.monitor.hold[4]
    first_m = scene.obstacle_m()[4]
    scene.run(3.0)
    assert 0.0 < first_m < scene.obstacle_m()[4] == pytest.approx(0.5 * 0.45)
    assert (np.delete(scene.obstacle_m(), 4) == 0.0).all()


def test_a_drift_that_no_velocity_explains_is_found_and_a_real_motion_is_not() -> None:
    scene = Scene()
    scene.run(0.1)

    def move() -> None:
        scene.vel[0] = [0.0, 0.0, -0.4]
        scene.sent[0] = scene.vel[0]
        scene.pos = scene.pos + 0.02 * scene.vel
        scene.pos[1] -= [0.0, 0.0, 0.3 * 0.02]

    found = scene.run(4.0, move)
    assert [item.land for item in found] == [[1]], scene.alarms


def test_the_silence_of_one_that_is_gone_is_no_jump_and_its_place_stays_an_obstacle() -> None:
    scene = Scene("speed_limit_m_s=1.5")
    gone_ns = scene.now_ns + SECOND_NS // 2
    scene.vel[2] = scene.sent[2] = [0.0, 0.0, -1.5]

    def flies_on() -> None:
        scene.status()
        if scene.now_ns >= gone_ns:  # its process has ended: no word, and nobody carries it on for more than 0.5 s
            scene.age_ns[2] += TICK_NS
            scene.silent_since_ns[2] = gone_ns
        if scene.age_ns[2] <= SECOND_NS // 2:
            scene.pos[2] += 0.02 * scene.vel[2]

    found = scene.run(20.0, flies_on)
    assert [text.partition(";")[0] for text in scene.alarms] == [
        "vehicle 3: position is 0.52 s old, limit 0.50 s",
        "vehicle 3: no position for 1 s",
        "vehicle 3: nothing heard for 4 s",
    ]
    assert any(item.land == [2] for item in found)
    assert scene.obstacle_m()[2] == scene.plan.limits.lost_radius_m  # long after
    assert np.array_equal(scene.poses.pos_team_ned_m[2], scene.pos[2])  # where it was last seen


def test_a_velocity_that_changes_unseen_in_a_gap_is_no_jump() -> None:
    plan = _plan()
    watch = PoseJump(plan)
    quat = np.tile([1.0, 0.0, 0.0, 0.0], (8, 1))
    nobody = np.zeros(8, dtype=np.bool_)
    pos, vel, pose_ns = np.zeros((8, 3)), np.zeros((8, 3)), np.zeros(8, dtype=np.int64)
    for tick in range(60):
        now_ns = tick * TICK_NS
        if not 10 <= tick < 55:
            pose_ns = np.full(8, now_ns)
        if tick == 55:
            pos = pos + np.array([0.9, 0.0, 0.0])  # after 0.9 s without a word, at up to 4 m/s^2
        watch.take(Poses(pos, vel, quat, nobody), pose_ns, np.zeros(8), now_ns)
        assert not watch.suspect.any()
        if tick == 55:
            watch.take(Poses(pos, vel, quat, nobody), pose_ns, np.zeros(8), now_ns + TICK_NS)
            assert not watch.suspect.any()
            break


def test_a_position_that_does_not_stir_by_a_bit_is_frozen_and_one_that_is_only_rare_is_not() -> None:
    scene = Scene()
    scene.frozen[2] = True
    assert scene.run(1.5) == []
    (found,) = scene.run(0.4)
    assert found.abort == (
        "vehicle 3: its position has not changed by a bit in 1.5 s; it lands where it is when nobody is below, the"
        " others come back"
    )
    rare = Scene("limits.pose_age_s=5", "limits.pose_lost_s=9")
    rare.run(0.1)
    rare.frozen[4] = True
    assert rare.run(4.0, lambda: rare.age_ns.__setitem__(4, rare.age_ns[4] + TICK_NS)) == []


def test_a_link_that_is_silent_altogether_is_told_once_and_all_on_it_land() -> None:
    scene = Scene()
    scene.run(0.1)
    scene.silent_since_ns[:] = scene.now_ns

    def ages() -> None:
        scene.age_ns += TICK_NS

    found = scene.run(4.5, ages)
    assert sum("link udpin://127.0.0.1:14540: nothing heard of anybody for 0.8 s" in text for text in scene.alarms) == 1
    assert [vehicle for item in found for vehicle in item.land] == list(range(8))
    assert scene.monitor.blind.all()
    assert not any("no position for" in text for text in scene.alarms)


def _silent(scene: Scene, seconds: float, rows: slice | int) -> None:
    """Nothing is heard of these for a while; then it is again."""

    def ages() -> None:
        scene.age_ns[rows] += TICK_NS

    scene.silent_since_ns[rows] = scene.now_ns
    scene.run(seconds, ages)
    scene.silent_since_ns[rows], scene.age_ns[rows] = NEVER, 0


def test_who_is_heard_again_is_found_again_after_two_seconds_and_can_be_lost_again() -> None:
    scene = Scene()
    scene.run(0.1)
    for times in (1, 2):
        _silent(scene, 3.0, slice(None))
        assert scene.monitor.blind.all()
        scene.run(1.9)
        assert scene.monitor.blind.all()
        scene.run(0.2)
        assert not scene.monitor.blind.any()
        assert sum("vehicle 3: its position is told again, 0.0 m" in text for text in scene.alarms) == times
        assert sum("nothing heard of anybody for 0.8 s" in text for text in scene.alarms) == times
    assert not scene.obstacle_m().any()
    assert scene.roster.lands_here.all()  # it goes on landing, on a place that is free


@pytest.mark.parametrize(("gone_m", "found"), [(3.0, True), (4.5, False)])
def test_who_is_heard_again_from_farther_than_it_could_have_flown_stays_lost(gone_m: float, found: bool) -> None:
    scene = Scene("limits.pose_jump_m=1.0")  # 0.5 m/s for 5 s, and that
    scene.run(0.1)
    _silent(scene, 5.0, 2)
    scene.pos[2] += [gone_m, 0.0, 0.0]
    scene.run(2.2)
    assert scene.monitor.blind[2] == (not found)


def test_who_is_heard_again_with_gaps_or_without_heartbeats_stays_lost() -> None:
    gaps = Scene()
    gaps.run(0.1)
    _silent(gaps, 3.0, 4)
    for _ in range(4):
        gaps.run(1.5)
        _silent(gaps, 0.6, 4)
    assert gaps.monitor.blind[4]
    mute = Scene()
    mute.run(0.1)
    _silent(mute, 6.0, 4)
    mute.silent_since_ns[4] = mute.now_ns - 20 * SECOND_NS  # positions come, heartbeats do not
    mute.run(4.0)
    assert mute.monitor.blind[4]


def test_a_position_that_contradicted_itself_stays_lost_however_it_is_told() -> None:
    scene = Scene()
    scene.run(0.1)
    scene.pos[2] += [2.0, 0.0, 0.0]  # a jump
    scene.drift[5] = 9.0  # local and global positions part
    scene.run(1.0)
    _silent(scene, 3.0, slice(None))
    scene.run(4.0)
    assert np.flatnonzero(scene.monitor.blind).tolist() == [2, 5]
    again = Scene()
    again.run(0.1)
    _silent(again, 3.0, 6)
    again.fleet.restarts[6] += 1  # its frame is another one: the later reason counts
    again.run(4.0)
    assert again.monitor.blind[6]


def test_one_silent_vehicle_is_no_silent_link() -> None:
    scene = Scene()
    scene.run(0.1)
    scene.silent_since_ns[:7] = scene.now_ns
    scene.run(2.0)
    assert not any("link" in text for text in scene.alarms)


def test_silence_and_missing_heartbeats_bring_everybody_back() -> None:
    scene = Scene()
    scene.run(0.1)
    scene.silent_since_ns[0] = scene.now_ns
    (found,) = scene.run(4.5)
    assert found.abort == "vehicle 1: nothing heard for 4 s; everybody comes back"
    quiet = Scene()
    quiet.run(0.1)
    stopped_ns = quiet.now_ns
    alarms = []
    for _ in range(650):
        quiet.now_ns += TICK_NS
        quiet.fleet.heard_ns[:] = quiet.now_ns
        quiet.fleet.heartbeat_ns[:] = quiet.now_ns
        quiet.fleet.heartbeat_ns[5] = stopped_ns
        pose_ns = np.full(8, quiet.now_ns)
        findings = quiet.monitor.look(_sight(quiet, pose_ns))
        alarms += findings.alarms
    assert alarms == [
        "vehicle 6: no heartbeat for 12 s, whether it is armed and follows is not known any more; everybody comes back;"
        " see to its link"
    ]


def _sight(scene: Scene, pose_ns: np.ndarray) -> Sight:
    return Sight(
        scene.fleet, scene.now_ns, scene.pos, scene.vel, pose_ns, scene.drift, scene.sent, scene.roster.ours,
        np.ones(8, dtype=np.bool_), scene.roster.lands_here, scene.roster.told_to_land, scene.monitor.blind,
        scene.fleet.armed,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("mode", "armed", "what"),
    [(LOITER, True, "left for mode AUTO.LOITER"), (OFFBOARD, False, "disarmed by itself")],
)
def test_a_vehicle_that_leaves_is_released_after_two_heartbeats_and_said_nothing_more_of(
    mode: int, armed: bool, what: str
) -> None:
    scene = Scene()
    scene.run(0.1)
    scene.fleet.custom_mode[3], scene.fleet.armed[3] = mode, armed
    assert scene.run(2.4) == []
    assert scene.monitor.foreign[3] == armed
    assert (scene.obstacle_m()[3] > 0.0) == armed
    (found,) = scene.run(0.2)
    words = f"vehicle 4: {what}; it is released and not fought over, the others come back"
    assert (found.release, found.abort) == ([3], words)
    scene.age_ns[3], scene.fleet.battery_remaining[3] = 10 * SECOND_NS, 0.01
    scene.pos[3] += 100.0
    assert scene.run(3.0, scene.status) == []


def test_whom_its_own_failsafe_holds_is_waited_for_and_follows_again() -> None:
    scene = Scene()
    scene.run(0.1)
    for _ in range(2):
        scene.fleet.custom_mode[3], scene.fleet.system_status[3] = LOITER, CRITICAL
        (told,) = scene.run(9.9)
        words = "vehicle 4: hears no setpoints, its own failsafe holds it in mode AUTO.LOITER; it is waited for, 10 s"
        words += "; see to the link towards it"
        assert (told.alarms, told.release, told.abort) == ([words], [], None)
        assert scene.monitor.foreign[3]
        assert scene.obstacle_m()[3] > 0.0
        scene.fleet.custom_mode[3], scene.fleet.system_status[3] = OFFBOARD, ACTIVE
        assert scene.run(1.0) == []
        assert not scene.obstacle_m().any()


@pytest.mark.parametrize(("status", "released_s"), [(5, 10.0), (4, 2.5 + 1.0)])
def test_who_never_follows_again_or_is_taken_by_its_pilot_is_released(status: int, released_s: float) -> None:
    scene = Scene()
    scene.run(0.1)
    scene.fleet.custom_mode[3], scene.fleet.system_status[3] = LOITER, CRITICAL
    begun_ns = scene.now_ns
    scene.run(1.0)
    scene.fleet.system_status[3] = status
    (found,) = scene.run(10.0)
    assert (found.release, scene.alarms[-1]) == (
        [3], "vehicle 4: left for mode AUTO.LOITER; it is released and not fought over, the others come back",
    )  # fmt: skip
    left_ns = released_s * SECOND_NS
    assert scene.now_ns - begun_ns > left_ns
    early = Scene()
    early.run(0.1)
    early.fleet.custom_mode[3], early.fleet.system_status[3] = LOITER, CRITICAL
    early.run(1.0)
    early.fleet.system_status[3] = status
    assert early.run(released_s - 1.1) == []


def test_who_only_waits_and_goes_down_again_by_setpoints_does_not_come_down_by_itself() -> None:
    scene = Scene()
    scene.pos[3] = scene.pos[4] + [0.0, 0.0, -1.0]
    scene.run(0.1)
    scene.fleet.custom_mode[3], scene.fleet.system_status[3] = LOITER, CRITICAL
    scene.run(1.0)
    scene.vel[3, 2] = 0.3  # it follows again, and its heartbeat is late
    scene.run(0.5)
    assert not any("comes down by itself" in text for text in scene.alarms)
    scene.fleet.system_status[3] = ACTIVE  # in LOITER by somebody's hand
    scene.run(0.5)
    assert any("vehicle 4: comes down by itself, vehicle 5 is" in text for text in scene.alarms)


def test_who_was_never_ours_is_an_obstacle_and_no_more() -> None:
    scene = Scene()
    scene.roster.release([6])
    scene.fleet.custom_mode[6], scene.fleet.battery_remaining[6] = LOITER, 0.01
    scene.pos[6, 0] = 9.0
    assert scene.run(4.0, scene.status) == []
    assert scene.obstacle_m()[6] > 0.0


def test_who_lands_at_our_word_may_leave_the_mode_and_is_no_obstacle() -> None:
    scene = Scene()
    scene.roster.land([3], scene.now_ns)
    scene.roster.tell_to_land(3, scene.now_ns)
    scene.fleet.custom_mode[3], scene.fleet.landed_state[3] = LAND, LANDED_LANDING
    assert scene.run(4.0) == []
    assert not scene.obstacle_m().any()


@pytest.mark.parametrize(
    ("share", "reaction", "words"),
    [
        (0.29, "say", "vehicle 8: battery at 29%, warning below 30%"),
        (0.19, "home", "vehicle 8: battery at 19%, minimum is 20%; everybody comes back"),
        (
            0.09,
            "land",
            "vehicle 8: battery at 9%, lands below 10%; it lands where it is when nobody is below, the others come"
            " back",
        ),
    ],
)
def test_batteries_escalate_and_one_report_alone_is_not_believed(share: float, reaction: str, words: str) -> None:
    scene = Scene()
    scene.status()
    scene.fleet.battery_remaining[7] = share
    assert scene.run(3.0) == []  # the same report
    scene.fleet.battery_remaining[7] = 0.9
    scene.status()
    assert scene.run(0.1) == []
    scene.fleet.battery_remaining[7] = share
    scene.status()
    assert scene.run(1.0) == []
    scene.status()
    found = scene.run(1.0)
    assert found[0].alarms[0] == words
    assert (found[0].abort is not None, found[0].urgent) == (reaction != "say", reaction != "say")
    assert found[0].land == ([7] if reaction == "land" else [])
    assert len(scene.alarms) == 1


def test_voltages_count_where_the_mission_gives_them() -> None:
    assert Scene("limits.battery_land_v=3.0").plan.limits.battery_land_v == 3.0
    scene = Scene("limits.battery_min_v=3.4")
    scene.fleet.battery_v[:] = 3.9
    scene.run(1.0, scene.status)
    scene.fleet.battery_v[2] = 3.3
    scene.run(1.0, scene.status)
    scene.fleet.battery_v[2] = 3.2
    scene.run(1.0, scene.status)
    assert scene.alarms == [
        "vehicle 3: battery at 3.3 V, minimum is 3.4 V; everybody comes back",
        "vehicle 3: battery at 3.2 V, lands below 3.23 V; it lands where it is when nobody is below, the others come"
        " back",
    ]


def test_the_fence_is_for_everybody_whose_place_is_known() -> None:
    scene = Scene()
    scene.pos = scene.pos.copy()
    scene.pos[1, 0] = 3.29
    assert scene.run(1.0) == []
    scene = Scene()
    scene.pos[1, 0] = 3.4
    found = scene.run(1.0)
    assert [item.abort for item in found] == ["vehicle 2: 0.40 m outside the fence, limit 0.3 m; everybody comes back"]


@pytest.mark.parametrize("says_takeoff", [False, True])
def test_the_floor_of_the_fence_is_for_those_who_have_risen_above_it(says_takeoff: bool) -> None:
    scene = Scene()
    scene.pos = scene.pos.copy()
    scene.pos[6, 2] = 0.4  # heights wander on the ground
    scene.stands[6] = not says_takeoff
    assert scene.run(1.0) == []
    scene = Scene()
    scene.sent[6, 2] = scene.vel[6, 2] = 1.0
    words = "vehicle 7: 0.40 m outside the fence, limit 0.3 m; everybody comes back"

    def sinks() -> None:
        scene.pos = scene.pos + scene.vel * (TICK_NS / SECOND_NS) * (scene.pos[6, 2] < 0.4)

    assert words in [item.abort for item in scene.run(2.0, sinks)]


def test_who_stands_outside_the_walls_of_the_fence_is_told() -> None:
    scene = Scene()
    scene.pos = scene.pos.copy()
    scene.pos[6, 0] = 3.4
    scene.stands[6] = True
    found = scene.run(1.0)
    assert [item.abort for item in found] == ["vehicle 7: 0.40 m outside the fence, limit 0.3 m; everybody comes back"]


def test_frames_that_change_land_the_vehicle() -> None:
    cases: list[tuple[Callable[[Scene], None], str]] = [
        (lambda scene: scene.fleet.restarts.__setitem__(0, 1), "its autopilot has started anew"),
        (
            lambda scene: (
                scene.fleet.origin_moved_ns.__setitem__(0, scene.now_ns),
                scene.fleet.origin_moved_m.__setitem__(0, 7.0),
            )[0],
            "its origin has moved by 7.00 m",
        ),
        (lambda scene: scene.drift.__setitem__(0, 1.5), "its local and global positions are 1.50 m apart, limit 0.54"),
    ]
    for spoil, words in cases:
        scene = Scene()
        scene.run(0.1)
        spoil(scene)
        (found,) = scene.run(1.0)
        assert found.land == [0]
        assert str(found.abort).startswith(f"vehicle 1: {words}")


def _told_an_origin(scene: Scene, moved_m: float) -> None:
    scene.fleet.origin_moved_ns[0], scene.fleet.origin_moved_m[0] = scene.now_ns, moved_m


def test_a_far_origin_that_neither_position_follows_counts_for_nothing_and_everybody_comes_home() -> None:
    scene = Scene()
    scene.drift[:] = 0.1
    scene.run(0.1)
    _told_an_origin(scene, 832_804.0)
    assert scene.run(2.4) == []
    (found,) = scene.run(1.0)
    assert not found.land
    assert str(found.abort).startswith("vehicle 1: an origin 832804 m from its own is told under its id")


@pytest.mark.parametrize(("moved_m", "drift_m"), [(7.0, 7.0), (0.6, 0.1), (7.0, np.nan)])
def test_an_origin_that_positions_follow_or_say_nothing_of_lands_the_vehicle(moved_m: float, drift_m: float) -> None:
    scene = Scene()
    scene.run(0.1)
    _told_an_origin(scene, moved_m)
    scene.drift[0] = drift_m
    (found,) = scene.run(1.0)
    assert found.land == [0]
    assert "its origin has moved by" in str(found.abort)


def test_two_vehicles_behind_one_address_bring_everybody_back(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene()
    monkeypatch.setattr(Fleet, "twins_behind_one_address", lambda _self, _now: {2: "two of them"})
    (found,) = scene.run(1.0)
    assert found.abort == "vehicle 3: two of them; everybody comes back"


@pytest.mark.parametrize(("degrees", "found"), [(55.0, False), (70.0, True), (180.0, True)])
def test_a_tilt_of_a_gust_is_left_alone_and_a_tumble_is_not(degrees: float, found: bool) -> None:
    scene = Scene()
    half = np.radians(degrees) / 2.0
    scene.run(0.1)
    scene.fleet.quat_ned_from_frd[6] = [np.cos(half), np.sin(half), 0.0, 0.0]
    assert scene.run(0.25) == []
    scene.fleet.quat_ned_from_frd[6] = [1.0, 0.0, 0.0, 0.0]
    assert scene.run(0.1) == []
    scene.fleet.quat_ned_from_frd[6] = [np.cos(half), 0.0, np.sin(half), 0.0]
    assert bool(scene.run(0.5)) == found
    if found:
        assert scene.alarms[0].startswith(f"vehicle 7: is tilted by {degrees:.0f} degrees, limit 60 degrees; it lands")


def test_who_does_not_follow_is_brought_back_and_then_landed() -> None:
    scene = Scene()
    scene.run(4.0)
    scene.sent[5] = [0.5, 0.0, 0.0]
    found = scene.run(12.0)
    assert len(found) == 2
    assert str(found[0].abort).startswith("vehicle 6: does not follow its setpoints by 0.")
    assert found[0].home == [5]
    assert found[1].land == [5]
    assert "has not followed its setpoints for 6 s" in found[1].alarms[0]
    assert scene.obstacle_m()[5] > 0.0


def test_a_gust_of_a_second_and_a_takeoff_are_no_disobedience() -> None:
    scene = Scene()
    scene.sent[:, 2] = -0.5  # motors spin up: for two seconds nothing moves
    scene.run(2.0)
    scene.sent[:] = 0.0
    scene.run(5.0)
    scene.vel[2] = [0.0, 0.0, -0.6]
    scene.run(1.0, lambda: scene.pos.__setitem__(2, scene.pos[2] - [0.0, 0.0, 0.012]))
    scene.vel[2] = 0.0
    scene.run(3.0)
    assert scene.alarms == []
    assert not scene.obstacle_m().any()


def test_two_vehicles_below_r_bring_everybody_back() -> None:
    scene = Scene()
    scene.pos[1] = scene.pos[0] + [0.0, 0.0, 0.44]
    assert scene.run(0.2) == []
    (found,) = scene.run(0.5)
    assert found.abort == "vehicles 1 and 2: 0.44 m apart, minimum is 0.45 m; everybody comes back"


@pytest.mark.parametrize("going_on", [False, True])
@pytest.mark.parametrize("reaction", Reaction)
def test_a_monitor_that_judges_one_that_is_not_ours_cannot_name_it(reaction: Reaction, going_on: bool) -> None:
    scene = Scene()
    scene.going_on = going_on
    scene.monitor._monitors = (Accuser(reaction), *scene.monitor._monitors)
    scene.roster.kill([3], scene.now_ns)
    scene.roster.release([6])
    found = scene.tick()
    names = {text.split(": ")[0] for text in scene.alarms if text.startswith("vehicle")}
    assert names == {*(f"vehicle {k}" for k in (1, 2, 3, 5, 6, 8)), "vehicles 1 and 2", "vehicles 2 and 3",
                     "vehicles 5 and 6", "vehicles 8 and 1"}  # fmt: skip
    told = [*found.failed, *found.gone, *found.aborts, *found.aborts.values(), found.silence or ""]
    assert not any(name in text for text in told for name in ("vehicle 4", "vehicle 7", "and 4", "and 7"))
    concerned = {*found.home, *found.land, *found.release}
    assert concerned == ({0, 1, 2, 4, 5, 7} if reaction in (Reaction.HOME, Reaction.LAND, Reaction.RELEASE) else set())
    assert not scene.monitor.blind[[3, 6]].any()


def test_of_two_that_are_too_near_the_finding_keeps_the_one_that_is_ours() -> None:
    scene = Scene()
    scene.pos[1] = scene.pos[0] + [0.0, 0.0, 0.44]
    scene.roster.kill([0], scene.now_ns)
    (found,) = scene.run(0.5)
    assert found.aborts == {
        "vehicle 2": "vehicle 2: too near to vehicle 1, 0.44 m apart, minimum is 0.45 m; everybody comes back"
    }
    scene = Scene()
    scene.pos[1] = scene.pos[0] + [0.0, 0.0, 0.44]
    scene.roster.release([0, 1])
    assert scene.run(0.5) == []


def _told_to_land(scene: Scene, *rows: int) -> None:
    scene.roster.land(rows, scene.now_ns)
    for row in rows:
        scene.roster.tell_to_land(row, scene.now_ns)


@pytest.mark.parametrize("stood_s", [None, 0.5, 2.0])
@pytest.mark.parametrize("says_first", [False, True])
def test_who_starts_anew_before_it_stood_has_fallen_and_who_has_stood_for_a_while_has_not(
    stood_s: float | None, says_first: bool
) -> None:
    scene = Scene()
    scene.pos[0, 2] = -0.2
    _told_to_land(scene, 0)
    scene.run(0.2)
    if stood_s is not None:
        scene.stands[0] = True
        scene.run(stood_s)
    if says_first:  # its heartbeat and where it stands come before anything that shows its clock
        scene.fleet.armed[0] = False
        scene.run(0.3)
    scene.fleet.restarts[0] += 1
    found = scene.run(0.5)  # its clock may show before its heartbeat
    scene.fleet.armed[0] = False
    found += scene.run(3.0)
    assert [text.split(": ")[1][:42] for item in found for text in item.failed] == (
        ["its autopilot has started anew before it s"] if stood_s != 2.0 else []
    )
    assert scene.monitor.blind[0] == (stood_s != 2.0)


def test_a_clock_that_jumps_back_while_its_vehicle_lands_is_no_fall() -> None:
    scene = Scene()
    scene.pos[0, 2] = -0.2
    _told_to_land(scene, 0)
    scene.run(0.2)
    scene.fleet.restarts[0] += 1
    assert scene.run(4.0) == []
    scene.stands[0] = True
    scene.run(0.5)
    scene.fleet.armed[0] = False
    assert scene.run(4.0) == []


@pytest.mark.parametrize(("silent_after_s", "told"), [(-0.3, True), (0.0, True), (0.4, True), (2.0, False)])
def test_who_is_disarmed_and_tells_no_more_where_it_is_may_have_fallen(silent_after_s: float, told: bool) -> None:
    scene = Scene()
    scene.pos[0, 2] = -0.2
    _told_to_land(scene, 0)
    since_ns = scene.now_ns + round((0.5 + silent_after_s) * SECOND_NS)

    def falls_silent() -> None:
        scene.age_ns[0] = max(scene.now_ns - since_ns, 0)

    scene.run(0.5, falls_silent)
    scene.fleet.armed[0] = False
    words = [text for item in scene.run(4.5, falls_silent) for text in item.failed]
    assert words == (
        [
            "vehicle 1: is disarmed, and has told no position since it was in the air; whether it has fallen is not"
            " known; keep people away and look after it"
        ]
        if told
        else []
    )


@pytest.mark.parametrize("lands", [False, True])
def test_whoever_flies_counts_against_one_that_stands_or_lands(lands: bool) -> None:
    scene = Scene()
    scene.pos[1] = scene.pos[0] + [0.0, 0.0, 0.44]
    scene.fleet.armed[1] = False  # which is how tests here tell who stands
    _told_to_land(scene, *range(not lands, 2))
    (found,) = scene.run(0.5)
    assert found.abort == "vehicles 1 and 2: 0.44 m apart, minimum is 0.45 m; everybody comes back"


def test_two_that_stand_are_as_they_were_put_and_a_place_that_is_not_known_is_nobodys() -> None:
    scene = Scene()
    scene.pos[1] = scene.pos[0] + [0.3, 0.0, 0.0]
    scene.fleet.armed[:2] = False
    _told_to_land(scene, 0, 1)
    assert scene.run(0.5) == []
    scene = Scene()
    scene.pos[1] = scene.pos[0] + [0.3, 0.0, 0.0]
    scene.fleet.armed[1] = False
    _told_to_land(scene, 1)
    scene.age_ns[1] = 2 * SECOND_NS
    assert [item for item in scene.run(0.5) if item.abort and "apart" in item.abort] == []


def test_safety_regions_of_other_shapes_have_words_of_their_own() -> None:
    scene = Scene("avoidance={radius_m: 0.45, activation_m: 0.5, shape: cylinder, half_height_m: 0.6}")
    scene.pos[1] = scene.pos[0] + [0.1, 0.0, 0.5]
    (found,) = scene.run(0.5)
    assert found.abort == (
        "vehicles 1 and 2: 0.51 m apart, 83% of what their safety region asks for; everybody comes back"
    )


def test_standing_still_and_a_slow_ground_station_bring_everybody_back() -> None:
    scene = Scene()
    scene.run(1.0)
    assert scene.tick(900_000_000).abort is None
    scene.run(3.0)
    found = scene.tick(1_200_000_000)
    assert found.abort == "the ground station stood still for 1.20 s, limit 1 s; everybody comes back"
    slow = Scene()
    for _ in range(40):
        slow.tick(150_000_000)
    assert slow.alarms == [
        "the ground station makes 7.0 ticks a second, minimum is 10; everybody comes back;"
        " end what else this computer does, and keep it from sleeping"
    ]


def test_a_stream_that_flickers_is_ended() -> None:
    scene = Scene()
    scene.run(1.0)
    silences = [text for _ in range(12) if (text := scene.tick(700_000_000).silence) is not None]
    assert silences == [
        "the ground station makes less than 2 ticks a second, autopilots come and go with that; setpoints end, the"
        " autopilots' own failsafe takes over"
    ]


def test_the_words_say_who_comes_back_and_who_goes_on() -> None:
    scene = Scene("on_lost=continue_open")
    scene.going_on = True
    scene.run(0.1)
    scene.fleet.battery_remaining[0] = 0.19
    found = scene.run(0.1, scene.status)
    words = "vehicle 1: battery at 19%, minimum is 20%; it comes back, the others go on"
    assert (found[0].home, found[0].gone, found[0].abort) == ([0], [words], None)
    scene.age_ns[1] = 2 * SECOND_NS
    scene.silent_since_ns[1] = scene.now_ns
    lost = scene.run(5.0)
    assert lost[0].land == [1]
    assert lost[0].gone[0].endswith("the others go on")
    # What is found of it later brings nobody back: it is lost already.
    assert lost[-1].alarms == ["vehicle 2: nothing heard for 4 s; see to its link"]
    assert (lost[-1].home, lost[-1].abort) == ([], None)


@given(st.floats(0, 10), st.floats(0.01, 10), st.floats(0, 1e9), st.floats(0, 100))
def test_an_obstacle_grows_with_time_and_is_bounded(first: float, rate: float, age: float, most: float) -> None:
    sizes = bounded_growth_m(first, rate, np.array([-1.0, 0.0, age, age + 1.0, np.nan]), most)
    assert (np.diff(sizes[:4]) >= 0.0).all()
    assert sizes[4] == most == sizes.max() or most == sizes[4]
    assert (sizes <= most).all()


def test_a_condition_is_believed_when_it_lasts_and_told_once() -> None:
    lasting, again = Lasting(2, 1.0), Lasting(2, 1.0, again=True)
    seen: list[tuple[list[int], list[int]]] = []
    for second, row in enumerate([True, True, True, False, True, True]):
        state = np.array([row, False])
        seen.append((lasting(state, second * SECOND_NS), again(state, second * SECOND_NS)))
    assert seen == [([], []), ([0], [0]), ([], []), ([], []), ([], []), ([], [0])]


def test_radius_of_obstacles_can_be_set_and_left_out() -> None:
    scene = Scene("limits.lost_radius_m=0")
    scene.fleet.custom_mode[3] = LOITER
    scene.run(0.1)
    assert not scene.obstacle_m().any()
    assert scene.plan.limits.lost_radius_m == 0.0


def _put_above(scene: Scene, beside_m: float) -> None:
    """The seventh vehicle above the fourth, from the beginning: nobody jumps."""
    scene.pos[6] = scene.pos[3] - [beside_m, 0.0, 0.9]
    scene.run(0.1)


def _tell_to_land(scene: Scene, row: int) -> None:
    scene.roster.land([row], scene.now_ns)
    scene.roster.tell_to_land(row, scene.now_ns)


@pytest.mark.parametrize("told_by", ["mode", "landed state"])
@pytest.mark.parametrize("below", ["flies", "stands", "falls too", "was told to land"])
def test_one_that_comes_down_by_itself_onto_somebody_is_told_at_once_with_both_names(told_by: str, below: str) -> None:
    scene = Scene()
    _put_above(scene, 0.05)
    if told_by == "mode":
        scene.fleet.custom_mode[6], scene.vel[6, 2] = LAND, 0.4
    else:
        scene.fleet.landed_state[6] = LANDED_LANDING
    if below == "stands":
        scene.fleet.armed[3] = False
        scene.roster.release([3])
    elif below == "falls too":
        scene.fleet.landed_state[3] = LANDED_LANDING
    elif below == "was told to land":
        _tell_to_land(scene, 3)
    said = [text for text in scene.tick().alarms if "comes down by itself" in text]
    then = "which gets out of the way" if below == "flies" else "and cannot be told to leave; keep people away"
    assert said == [f"vehicle 7: comes down by itself, vehicle 4 is 0.9 m below and 0.05 m beside, {then}"]
    assert not [text for found in scene.run(1.0) for text in found.alarms if "comes down by itself" in text]


@pytest.mark.parametrize("below", ["flies", "falls too", "is not ours either", "was told to land"])
def test_those_below_one_that_is_not_ours_are_told_that_it_comes_down(below: str) -> None:
    scene = Scene()
    _put_above(scene, 0.05)
    scene.roster.release([6] if below != "is not ours either" else [3, 6])
    scene.fleet.landed_state[[6, 3] if below == "falls too" else [6]] = LANDED_LANDING
    if below == "was told to land":
        _tell_to_land(scene, 3)
    said = [text for text in scene.tick().alarms if "comes down by itself" in text]
    then = "it gets out of the way" if below == "flies" else "it cannot be told to leave; keep people away"
    words = f"vehicle 4: vehicle 7 comes down by itself 0.9 m above and 0.05 m beside, {then}"
    assert said == ([] if below == "is not ours either" else [words])


def test_two_senders_in_the_name_of_one_that_is_not_ours_bring_nobody_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Fleet, "twins_behind_one_address", lambda _self, _now: {4: "two senders"})
    for ours in (True, False):
        scene = Scene()
        if not ours:
            scene.roster.kill([4], scene.now_ns)
        found = scene.tick()
        assert [*found.aborts] == (["vehicle 5"] if ours else [])


def test_one_that_lands_at_our_word_or_beside_others_or_only_leaves_its_mode_does_not_come_down_by_itself() -> None:
    for case in ("told", "beside", "level"):
        scene = Scene()
        _put_above(scene, 0.45 if case == "beside" else 0.05)
        if case == "told":
            scene.roster.land([6], scene.now_ns)
            scene.roster.tell_to_land(6, scene.now_ns)
        scene.fleet.custom_mode[6] = LOITER if case == "level" else LAND
        scene.vel[6, 2] = 0.0 if case == "level" else 0.5
        assert not [text for found in scene.run(1.0) for text in found.alarms if "comes down by itself" in text], case
