"""Every fault, as it shows on the wire."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from groundstation.mavlink.codec import Frame
from sitl.estimator import GPS, Estimator
from sitl.faults import KINDS, LINK_KINDS, Fault, FaultError, load_faults, parse_faults
from sitl.world import World
from tests.sitl.virtual_ground import LAND, Ground, guided_at, hovering, world


def fault(kind: str, at_s: float = 0.0, for_s: float | None = None, **rest: Any) -> Fault:
    vehicles = rest.pop("vehicles", ())
    direction = rest.pop("direction", "both")
    return Fault(kind, at_s, for_s, vehicles, rest, direction)


def flying(*faults: Fault, n: int = 1) -> Ground:
    """Standing vehicles with LOCAL_POSITION_NED at 50 Hz and these faults."""
    ground = Ground(world(n, faults=faults))
    ground.run(2.0)
    for vehicle in range(n):
        ground.interval("LOCAL_POSITION_NED", 50, vehicle)
    return ground


def frames_in(ground: Ground, low_s: float, high_s: float, vehicle: int = 0) -> list[Frame]:
    return [frame for t_s, index, frame in ground.raw if index == vehicle and low_s <= t_s < high_s]


def lost_share(ground: Ground, low_s: float, high_s: float, vehicle: int = 0) -> float:
    """Share of frames that are missing by their sequence numbers."""
    numbers = [frame.seq for frame in frames_in(ground, low_s, high_s, vehicle)]
    gaps = sum((b - a - 1) % 256 for a, b in pairwise(numbers))
    return gaps / (gaps + len(numbers))


def test_loss_at_its_time_for_its_vehicle_and_its_rate() -> None:
    ground = flying(fault("loss", 3.0, 4.0, vehicles=(2,), probability=0.3, direction="down"), n=2)
    ground.run(8.0)
    assert lost_share(ground, 2.1, 3.0, 1) == 0.0
    assert lost_share(ground, 3.0, 7.0, 1) == pytest.approx(0.3, abs=0.06)
    assert lost_share(ground, 7.0, 9.9, 1) == 0.0
    assert lost_share(ground, 2.1, 9.9, 0) == 0.0


def test_loss_upwards_swallows_commands() -> None:
    ground = flying(fault("loss", 2.0, 2.0, probability=1.0, direction="up"))
    ground.run(0.1)
    for _ in range(5):
        ground.command(512, 148)
        ground.run(0.1)
    assert ground.acks() == []
    assert lost_share(ground, 2.1, 2.5) == 0.0
    ground.run(2.0)
    assert ground.ask(512, 148) == 0


def test_bursts_lose_runs_of_frames() -> None:
    ground = flying(fault("burst", 2.0, None, probability=0.01, length_s=0.4, direction="down"))
    ground.run(20.0)
    times = [t_s for t_s, _ in ground.all("LOCAL_POSITION_NED")]
    gaps = np.diff(times)
    long = gaps[gaps > 0.1]
    assert len(long) > 5
    assert 0.2 < float(long.mean()) < 0.8


def test_blackout() -> None:
    ground = flying(fault("blackout", 3.0, 1.5))
    ground.run(4.0)
    assert frames_in(ground, 3.01, 4.49) == []
    assert frames_in(ground, 4.5, 5.0)


def test_duplicates() -> None:
    ground = flying(fault("duplicate", 2.0, None, probability=0.2, direction="down"))
    ground.run(8.0)
    frames = frames_in(ground, 2.1, 10.0)
    twice = sum(a.raw == b.raw for a, b in pairwise(frames))
    datagrams = len({item.t_ns for item in ground.datagrams if item.t_ns > 2.1e9})
    assert twice > 0
    copies = sum(a.data == b.data for a, b in pairwise(ground.datagrams))
    assert copies / datagrams == pytest.approx(0.2, abs=0.05)


def test_reordering() -> None:
    ground = flying(fault("reorder", 2.0, None, probability=0.1, by_s=0.05, direction="down"))
    ground.run(6.0)
    numbers = [frame.seq for frame in frames_in(ground, 2.1, 7.9)]
    backwards = sum((b - a) % 256 > 128 for a, b in pairwise(numbers))
    assert backwards > 50
    boots = [m.time_boot_ms for _, m in ground.all("LOCAL_POSITION_NED", since_s=2.1)]
    assert boots != sorted(boots)


def test_delay() -> None:
    ground = flying(fault("delay", 2.5, None, seconds=0.4, direction="down"))
    ground.run(3.0)
    late = [t_s - m.time_boot_ms / 1000 for t_s, m in ground.all("LOCAL_POSITION_NED", since_s=3.0)]
    assert late == pytest.approx([0.4] * len(late), abs=0.0041)


def test_jitter() -> None:
    ground = flying(fault("jitter", 2.5, None, seconds=0.05, direction="down"))
    ground.run(8.0)
    late = np.array([t_s - m.time_boot_ms / 1000 for t_s, m in ground.all("LOCAL_POSITION_NED", since_s=3.0)])
    assert late.min() >= -1e-9
    # half-normal: mean sigma sqrt(2 / pi)
    assert late.mean() == pytest.approx(0.05 * math.sqrt(2 / math.pi), rel=0.15)


def test_corrupted_bytes() -> None:
    ground = flying(fault("corrupt", 2.5, None, probability=0.2, direction="down"))
    ground.run(6.0)
    assert len(ground.noise) > 50
    assert 0.02 < lost_share(ground, 2.6, 7.9) < 0.25
    assert lost_share(ground, 2.1, 2.5) == 0.0


def test_corrupted_bytes_upwards_are_not_understood() -> None:
    ground = flying(fault("corrupt", 2.0, None, probability=1.0, direction="up"))
    for _ in range(30):
        ground.command(512, 148)
        ground.run(0.04)
    assert len(ground.acks()) < 3


def test_frozen_position() -> None:
    ground = hovering(3.0, faults=(fault("position_frozen", 12.0, 3.0),))
    ground.stream = lambda: ground.velocity(0.5)
    ground.run(16.5 - ground.t_s)
    stuck = [m.x for t_s, m in ground.all("LOCAL_POSITION_NED") if 12.1 < t_s < 14.9]
    assert len(set(stuck)) == 1
    assert ground.last("LOCAL_POSITION_NED").x - stuck[0] > 1.0


def test_jumping_position() -> None:
    ground = flying(fault("position_jump", 3.0, 2.0, east_m=2.0, north_m=-1.0, up_m=0.5))
    ground.run(4.0)
    by_time = {round(t_s, 2): (m.x, m.y, m.z) for t_s, m in ground.all("LOCAL_POSITION_NED")}
    assert by_time[2.96] == pytest.approx((0, 0, 0), abs=1e-6)
    assert by_time[3.04] == pytest.approx((-1.0, 2.0, -0.5), abs=1e-6)
    assert by_time[5.04] == pytest.approx((0, 0, 0), abs=1e-6)


def test_a_jump_is_believed_and_flown_after() -> None:
    ground = hovering(3.0)
    ground.run(6.0, lambda: ground.velocity(mask=0x0DF8, x=0.0, y=0.0, z=-3.0))
    ground.world.inject(fault("position_jump", east_m=1.0))
    ground.run(6.0, lambda: ground.velocity(mask=0x0DF8, x=0.0, y=0.0, z=-3.0))
    assert ground.last("LOCAL_POSITION_NED").y == pytest.approx(0.0, abs=0.05)
    assert ground.world.truth.pos_enu_m[0, 0] == pytest.approx(-1.0, abs=0.05)


def test_drifting_position() -> None:
    ground = flying(fault("position_drift", 3.0, 4.0, north_m_s=0.25))
    ground.run(6.0)
    by_time = {round(t_s, 2): m.x for t_s, m in ground.all("LOCAL_POSITION_NED")}
    assert by_time[5.0] == pytest.approx(0.5, abs=0.02)
    assert by_time[7.1] == pytest.approx(1.0, abs=0.02)
    assert by_time[7.9] == by_time[7.1]


def test_without_a_fix_px4_goes_astray_and_says_nothing_for_almost_six_seconds() -> None:
    """As PX4 1.16 in its own simulator: off by 0.4 m after 3 s, 1.6 m after 5 s, "Failsafe activated" after 5.7 s."""
    ground = hovering(3.0)
    ground.interval("GPS_RAW_INT", 5.0)
    stay = lambda: ground.velocity(mask=0x0DF8, x=0.0, y=0.0, z=-3.0)  # noqa: E731
    ground.run(4.0, stay)
    since, at_enu_m = ground.t_s, ground.world.truth.pos_enu_m[0].copy()
    ground.world.inject(fault("gps_lost"))
    astray_m = []
    for _ in range(5):
        ground.run(1.0, stay)
        assert (ground.last("GPS_RAW_INT").fix_type, ground.last("GPS_RAW_INT").satellites_visible) == (1, 0)
        astray_m.append(float(np.linalg.norm(ground.world.truth.pos_enu_m[0, :2] - at_enu_m[:2])))
    assert astray_m[2] == pytest.approx(0.45, abs=0.15)
    assert astray_m[4] == pytest.approx(1.5, abs=0.3)
    local = ground.last("LOCAL_POSITION_NED")
    assert math.hypot(local.x, local.y) < 0.3  # it believes to stand
    assert ground.texts(since_s=since) == []
    ground.run(1.0, stay)
    assert (2, "Failsafe activated\t") in ground.texts(since_s=since)
    ground.run(1.0, stay)
    assert ground.last("HEARTBEAT").custom_mode == LAND


def test_errors_of_the_velocity_go_on_wandering_when_a_fault_of_the_position_is_over() -> None:
    """They stood still for the rest of the flight: what had added nothing to them was a copy that nobody renewed."""
    estimator, nobody = Estimator([GPS], 0.004, np.random.default_rng(1)), np.zeros(1, dtype=np.bool_)
    for by_m in (1.0, 0.0):
        estimator.offset_enu_m[:] = by_m
        estimator.refresh()
        seen = []
        for _ in range(50):
            estimator.step(nobody)
            seen.append(float(estimator.vel_error[0, 0]))
        assert len(set(seen)) > 10


def test_a_fix_that_comes_back_puts_the_estimate_right() -> None:
    ground = hovering(3.0)
    ground.interval("GPS_RAW_INT", 5.0)
    ground.world.inject(fault("gps_lost", for_s=3.0))
    ground.run(5.0, lambda: ground.velocity(mask=0x0DF8, x=0.0, y=0.0, z=-3.0))
    assert ground.last("GPS_RAW_INT").fix_type == 3
    local, truth = ground.last("LOCAL_POSITION_NED"), ground.world.truth.pos_enu_m[0]
    assert (local.y, local.x) == pytest.approx((truth[0], truth[1]), abs=0.1)
    assert not ground.world.state.estimator.faulty


def test_nan_position_is_reported_and_px4_descends() -> None:
    ground = hovering(3.0)
    since = ground.t_s
    ground.world.inject(fault("position_nan"))
    ground.run(2.0)
    local = ground.last("LOCAL_POSITION_NED")
    assert all(math.isnan(value) for value in (local.x, local.y, local.z))
    assert ground.last("HEARTBEAT").custom_mode == LAND
    assert (2, "Failsafe activated\t") in ground.texts(since_s=since)
    assert not ground.last("SYS_STATUS").onboard_control_sensors_health & 0x10000000
    ground.run_until(lambda: not ground.world.truth.armed[0], 20.0)


def test_nan_position_lands_arducopter() -> None:
    ground = guided_at(3.0)
    ground.world.inject(fault("position_nan"))
    ground.run(1.2)
    assert (2, "EKF Failsafe: changed to LAND Mode") in ground.texts()
    assert ground.last("HEARTBEAT").custom_mode == 9
    assert math.isnan(ground.last("LOCAL_POSITION_NED").x)


def test_missing_heartbeat_while_all_else_goes_on() -> None:
    ground = flying(fault("heartbeat_missing", 3.0, 5.0))
    ground.run(8.0)
    beats = [t_s for t_s, _ in ground.all("HEARTBEAT")]
    assert not [t_s for t_s in beats if 3.01 < t_s < 8.0]
    assert [t_s for t_s in beats if t_s > 8.0]
    assert len(ground.all("LOCAL_POSITION_NED", since_s=4.0)) > 150


def test_battery_drain_warns_and_acts_as_the_parameter_says() -> None:
    ground = hovering(3.0)
    ground.send("PARAM_SET", target_system=1, param_id=b"COM_LOW_BAT_ACT", param_type=6, param_value=2.8e-45)  # 2: land
    ground.world.inject(fault("battery_drain", percent_per_s=10.0))
    ground.run(9.2)
    percents = [m.battery_remaining for _, m in ground.all("SYS_STATUS")]
    assert percents == sorted(percents, reverse=True)
    assert percents[-1] < 10
    texts = [text for _, text in ground.texts()]
    assert "Low battery level, return advised\t" in texts
    ground.run(2.0)
    assert ground.last("HEARTBEAT").custom_mode == LAND
    voltages = [m.voltage_battery for _, m in ground.all("SYS_STATUS")]
    assert voltages[-1] < voltages[0]


def test_battery_level_and_an_empty_battery_falls() -> None:
    ground = hovering(3.0)
    ground.world.inject(fault("battery_level", percent=20.0))
    ground.run(1.0)
    assert ground.last("SYS_STATUS").battery_remaining == pytest.approx(20, abs=1)
    assert ground.last("BATTERY_STATUS").battery_remaining <= 100
    ground.world.inject(fault("battery_level", percent=0.0))
    ground.run(3.0)
    assert ground.height() == 0.0


def test_motor_failure_tumbles_and_crashes() -> None:
    ground = hovering(4.0)
    ground.world.inject(fault("motor_failure"))
    ground.run(0.5)
    roll_pitch = [max(abs(m.roll), abs(m.pitch)) for _, m in ground.all("ATTITUDE", since_s=ground.t_s - 0.3)]
    assert max(roll_pitch) > math.radians(45)
    ground.run(2.5)
    assert -ground.last("LOCAL_POSITION_NED").z == pytest.approx(0.0, abs=0.02)
    ground.stream = lambda: ground.velocity(vz=-1.0)
    ground.run(2.0)
    assert ground.height() == 0.0  # it will not fly again


def test_reboot_in_flight_falls_silent_and_starts_again() -> None:
    ground = hovering(4.0)
    at = ground.t_s
    ground.world.inject(fault("reboot"))
    ground.run(0.08)
    assert frames_in(ground, at + 0.01, at + 0.09) == []
    ground.stream = None
    ground.run(3.0)
    assert ground.height() == 0.0
    boots = [m.time_boot_ms for _, m in ground.all("ATTITUDE", since_s=at + 0.05)]
    assert boots[0] < 200
    beat = ground.last("HEARTBEAT")
    assert not beat.base_mode & 0x80


def test_refused_arming() -> None:
    for config, result, words in (
        (world(), 1, "Preflight Fail: "),
        (world(autopilot="arducopter", streams="ardupilot"), 4, "PreArm: "),
    ):
        ground = Ground(config)
        ground.run(2.5)
        ground.world.inject(fault("arming_refused", for_s=5.0))
        assert ground.ask(400, 1) == result
        assert any(text.startswith(words) for _, text in ground.texts())
        ground.run(5.1)
        assert ground.ask(400, 1) == 0


def test_ignored_commands() -> None:
    ground = flying(fault("commands_ignored", 3.0, 2.0))
    ground.run(1.1)
    before = ground.t_s
    ground.command(400, 1)
    ground.run(1.0)
    assert ground.acks(since_s=before) == []
    assert not ground.world.truth.armed[0]
    assert ground.all("HEARTBEAT", since_s=before)
    ground.run(1.0)
    assert ground.ask(400, 1) == 0


def test_clock_jump() -> None:
    ground = flying(fault("clock_jump", 3.0, None, seconds=-1.5))
    ground.run(3.0)
    boots = [(t_s, m.time_boot_ms / 1000) for t_s, m in ground.all("LOCAL_POSITION_NED")]
    before = [t_s - boot for t_s, boot in boots if t_s < 2.99]
    after = [t_s - boot for t_s, boot in boots if t_s > 3.01]
    assert before == pytest.approx([0.0] * len(before), abs=0.002)
    assert after == pytest.approx([1.5] * len(after), abs=0.002)


def test_clearing_mends_everything() -> None:
    ground = flying(fault("blackout", 2.0), fault("position_jump", 2.0, east_m=3.0), fault("blackout", 4.0))
    ground.run(0.5)
    assert [item.kind for item in ground.world.active_faults] == ["blackout", "position_jump"]
    ground.world.clear_faults()
    ground.run(2.5)
    assert ground.world.active_faults == ()
    assert ground.last("LOCAL_POSITION_NED").y == pytest.approx(0.0, abs=1e-6)
    assert len(ground.all("LOCAL_POSITION_NED", since_s=4.0)) > 20


def test_faults_add_up_on_one_link() -> None:
    delays = [fault("delay", 2.0, None, seconds=seconds) for seconds in (0.1, 0.2)]
    ground = flying(*delays, fault("loss", 2.0, probability=0.5))
    ground.run(4.0)
    late = [t_s - m.time_boot_ms / 1000 for t_s, m in ground.all("LOCAL_POSITION_NED", since_s=3.0)]
    assert late == pytest.approx([0.3] * len(late), abs=0.0041)
    assert lost_share(ground, 3.0, 5.9) == pytest.approx(0.5, abs=0.1)


def test_of_two_missing_heartbeats_the_longer_counts() -> None:
    ground = flying(fault("heartbeat_missing", 3.0, 10.0), fault("heartbeat_missing", 4.0, 2.0))
    ground.run(13.0)
    beats = [t_s for t_s, _ in ground.all("HEARTBEAT")]
    assert not [t_s for t_s in beats if 3.01 < t_s < 13.0]
    assert [t_s for t_s in beats if t_s > 13.0]


def test_overlapping_faults_of_a_vehicle_last_until_the_last_one_ends() -> None:
    kinds = ("position_frozen", "position_nan", "motor_failure", "arming_refused", "commands_ignored")
    ground = Ground(world())
    here, pilot = ground.world, ground.world.autopilots[0]
    for kind in kinds:
        here.inject(fault(kind, for_s=3.0))
    ground.run(1.0)
    stuck = here.state.broken.frozen_pos_enu_m.copy()
    here.state.estimator.pos_error = here.state.estimator.pos_error + 1.0
    for kind in kinds:
        here.inject(fault(kind, for_s=1.0))
    assert here.state.broken.frozen_pos_enu_m.tolist() == stuck.tolist()  # frozen already

    def wrong() -> list[bool]:
        state = (
            here.state.broken.frozen[0],
            here.state.broken.invalid[0],
            here.dynamics.health.tumbling[0],
            pilot.deny_arming,
            pilot.ignore_commands,
        )
        return [bool(item) for item in state]

    ground.run(1.5)
    assert wrong() == [True] * 5
    assert here.dynamics.health.thrust_share[0] == 0.6
    ground.run(0.6)
    assert wrong() == [False] * 5
    assert here.dynamics.health.thrust_share[0] == 1.0


def test_drains_add_up_and_end_one_by_one() -> None:
    ground = flying()
    battery = ground.world.autopilots[0].battery
    ground.world.inject(fault("battery_drain", for_s=4.0, percent_per_s=2.0))
    ground.world.inject(fault("battery_drain", for_s=2.0, percent_per_s=3.0))
    full = battery.left
    ground.run(2.0)
    middle = battery.left
    assert full - middle == pytest.approx(0.10, abs=0.003)
    ground.run(2.0)
    assert middle - battery.left == pytest.approx(0.04, abs=0.003)
    end = battery.left
    ground.run(1.0)
    assert end - battery.left < 0.001


def test_a_battery_that_is_charged_flies_again() -> None:
    ground = hovering(3.0)
    ground.world.inject(fault("battery_level", percent=0.0))
    ground.run(3.0)
    assert ground.height() == 0.0
    ground.world.inject(fault("battery_level", percent=100.0))
    ground.run(4.0, lambda: ground.velocity(vz=-1.0))
    assert ground.height() > 2.0


def test_a_clock_that_jumps_behind_its_start_stands_at_zero_and_does_not_wrap() -> None:
    ground = flying(fault("clock_jump", 3.0, None, seconds=-5.0))
    ground.run(4.5)
    boots = {round(t_s, 2): m.time_boot_ms for t_s, m in ground.all("LOCAL_POSITION_NED")}
    assert max(boots.values()) <= 3000
    assert boots[4.0] == 0
    assert boots[6.0] == pytest.approx(1000, abs=4)


def test_ignored_commands_are_ignored_in_every_shape() -> None:
    for config, mode in ((world(), LAND), (world(autopilot="arducopter", streams="ardupilot"), 9)):
        ground = Ground(config)
        ground.run(2.5)
        ground.world.inject(fault("commands_ignored", for_s=2.0))
        before = ground.world.autopilots[0].custom_mode()
        ground.send("SET_MODE", target_system=1, base_mode=1, custom_mode=mode)
        ground.run(1.5)
        assert ground.world.autopilots[0].custom_mode() == before
        assert ground.acks() == []
        ground.run(1.0)
        ground.send("SET_MODE", target_system=1, base_mode=1, custom_mode=mode)
        ground.run(0.1)
        assert ground.world.autopilots[0].custom_mode() == mode


def test_refused_arming_shows_in_the_prearm_bit() -> None:
    for config in (world(), world(autopilot="arducopter", streams="ardupilot")):
        ground = Ground(config)
        ground.run(2.5)
        bits = ground.world.autopilots[0].sensor_bits
        assert bits()[2] & 0x10000000
        ground.world.inject(fault("arming_refused", for_s=1.0))
        assert not bits()[2] & 0x10000000
        ground.run(1.1)
        assert bits()[2] & 0x10000000


def test_orders_for_vehicles_that_are_not_there_change_nothing() -> None:
    ground = flying(n=2)
    with pytest.raises(FaultError, match="77 is not among"):
        ground.world.inject(fault("blackout", vehicles=(1,)), fault("blackout", vehicles=(77,)))
    assert ground.world.active_faults == ()


def test_same_seed_same_faults() -> None:
    faults = tuple(fault(kind, 1.0, probability=0.1) for kind in ("loss", "duplicate", "reorder", "corrupt"))
    config = world(2, faults=faults)
    first, again, other = (World(config, seed).advance(3 * 10**9) for seed in (1, 1, 2))
    assert first == again
    assert first != other


TIMETABLE = """
faults:
  - {kind: loss, at_s: 10, for_s: 5.5, vehicles: [3], probability: 0.3, direction: down}
  - {kind: motor_failure, at_s: 20, vehicles: [2]}
  - {kind: position_jump, at_s: 1, east_m: 1.5}
"""


def test_timetable_from_yaml(tmp_path: Path) -> None:
    path = tmp_path / "faults.yaml"
    path.write_text(TIMETABLE)
    assert load_faults(path) == (
        Fault("loss", 10.0, 5.5, (3,), {"probability": 0.3}, "down"),
        Fault("motor_failure", 20.0, None, (2,), {}, "both"),
        Fault("position_jump", 1.0, None, (), {"east_m": 1.5}, "both"),
    )
    assert parse_faults("") == ()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("faults: [{kind: gremlins}]", r"faults\[0\].kind: 'gremlins' is unknown; choose one of loss"),
        ("faults: [{kind: loss, probability: 1.5}]", r"faults\[0\].probability: 1.5, limits 0.0 and 1.0"),
        ("faults: [{kind: loss}]", r"faults\[0\].probability: missing"),
        ("faults: [{kind: loss, probability: often}]", r"probability: 'often' is no number"),
        ("faults: [{kind: blackout, seconds: 3}]", r"seconds: unknown; blackout takes no numbers"),
        ("faults: [{kind: blackout, at_s: -1}]", r"at_s: -1.0, has to be 0 or more"),
        ("faults: [{kind: blackout, vehicles: 3}]", r"vehicles: 3, a list"),
        ("faults: [{kind: blackout, direction: left}]", r"direction: 'left' is unknown"),
        ("faults: [{kind: reboot, direction: up}]", r"direction: reboot has none"),
        ("faults: [3]", r"faults\[0\].3: a mapping"),
        ("faults: 3", "a list is needed"),
        ("fault: []", "fault: unknown key"),
        ("faults: [", "is no YAML"),
        ("[" * 5000, "faults: is nested too deeply"),
        ("[" * 5000 + "]" * 5000, "faults: is nested too deeply"),
        ("faults: [" + "[" * 60 + "]" * 60 + "]", r"faults\[0\]..*: a mapping"),
        ("faults: [{kind: [a], direction: up}]", r"kind: \['a'\] is unknown"),
        ("faults: [{kind: blackout, at_s: 1" + "0" * 400 + "}]", "at_s: 1000.*is out of all bounds"),
        ("faults: [{kind: blackout, at_s: -1" + "0" * 400 + "}]", "at_s: -1000.*is out of all bounds"),
        ("faults: [{kind: delay, seconds: 1" + "0" * 5000 + "}]", "a value that cannot be read"),
        ("faults: [{kind: blackout, at_s: 2020-13-45}]", "a value that cannot be read"),
        ("faults: [{kind: blackout, at_s: 1.0e+300}]", "at_s: 1e[+]300, has to be 0 or more, up to 1000000"),
        ("faults: [{kind: blackout, for_s: .inf}]", "for_s: inf, has to be"),
        ("faults: [{kind: blackout, for_s: .nan}]", "for_s: nan, has to be"),
        ("faults: [{kind: blackout, vehicles: [true]}]", r"vehicles: \[True\], a list"),
    ],
)
def test_wrong_timetables_are_refused_by_name(text: str, words: str) -> None:
    with pytest.raises(FaultError, match=words):
        parse_faults(text)


def test_faults_of_vehicles_that_are_not_there_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FaultError, match="9 is not among"):
        World(world(faults=(fault("blackout", vehicles=(9,)),)), 1)
    with pytest.raises(FaultError, match="cannot be read"):
        load_faults(tmp_path / "none.yaml")


def test_every_kind_of_fault_is_tested_here() -> None:
    source = Path(__file__).read_text()
    missing = [kind for kind in KINDS if f'fault("{kind}"' not in source]
    assert not missing


@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_is_written_down_as_it_is_read(kind: str) -> None:
    numbers = {name: number.high if number.default is None else number.default for name, number in KINDS[kind].items()}
    one = fault(kind, 3.5, 2.0, vehicles=(2, 5), direction="down" if kind in LINK_KINDS else "both", **numbers)
    plain = fault(kind, **numbers)
    assert parse_faults(yaml.safe_dump([one.record(), plain.record()])) == (one, plain)
