"""Fleets of PX4, ArduCopter and both, on virtual time: the missions that come along, and what may go wrong on the way.

The bound on the true formation error: the tolerance that reported distances are formed to, and three standard
deviations of what two of the emulator's positions are off against each other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from groundstation.app.emulator import world_config
from groundstation.app.verify import verify_log
from groundstation.core.errors import UserError
from groundstation.core.types import FloatArray
from groundstation.mavlink.codec import Encoder, FrameSplitter, message_id
from groundstation.mavlink.codec import Frame as WireFrame
from groundstation.mission.plan.schema import FormStep
from groundstation.mission.runner import Phase
from sitl.autopilot import Autopilot
from sitl.estimator import GPS
from sitl.network import LinkConfig
from sitl.world import Outgoing, World, WorldConfig
from tests.app.flights import SECOND_NS, Flight, mission, pair

HEARTBEAT = message_id("HEARTBEAT")
ORIGIN = message_id("GPS_GLOBAL_ORIGIN")
BOTH = (("px4", "px4"), ("px4", "arducopter"), ("arducopter", "arducopter"))


def _landed_on_pads(flight: Flight) -> bool:
    truth = flight.world.truth
    off_pad = np.linalg.norm(truth.pos_enu_m[:, :2] - flight.plan.pads_enu_m[:, :2], axis=1)
    return not truth.armed.any() and not truth.airborne.any() and bool(off_pad.max() < flight.plan.margin_m)


CALM = "wind={mean_m_s: 2, gust_m_s: 1}"
"""Two kinds whose commands are this late may be brought together by the 5 m/s of the first flight."""


def _assert_flown(flight: Flight) -> None:
    spec = flight.plan.spec
    assert (flight.runner.outcome, flight.runner.reason) == ("completed", "")
    assert flight.world.min_distance_airborne_m >= spec.avoidance.radius_m
    step = spec.steps[0]
    assert isinstance(step, FormStep)
    # The emulator's GPS is half as bad as the one that r is widened for.
    assert flight.meter.formation_error_m <= step.tolerance_m + 3.0 * np.sqrt(2.0) * GPS.pos_sigma_m
    assert _landed_on_pads(flight)


def _assert_on_the_ground(flight: Flight) -> None:
    assert flight.runner.outcome in ("refused", "aborted")
    assert not flight.world.truth.armed.any()
    assert Phase.TAKEOFF not in flight.phase_seen


def _verified(path: Path) -> None:
    result = verify_log(path)
    assert result.mismatches == 0
    assert result.setpoints > 1000


@pytest.mark.parametrize(
    ("name", "seed"), [("px4_cube8", 1), ("arducopter_two_squares8", 2), ("mixed8", 3), ("first_flight2", 4)]
)
def test_the_missions_that_come_along_are_flown_and_keep_r(name: str, seed: int, tmp_path: Path) -> None:
    """At half their rate, and held for a moment."""
    log = tmp_path / "flight.tlog" if name == "mixed8" else None  # that one has vehicles of both kinds
    held_enu_m: list[FloatArray] = []

    def watch(flight: Flight) -> bool:
        if flight.runner.phase is Phase.HOLD:
            held_enu_m.append(flight.world.truth.pos_enu_m)
        return False

    flight = Flight(mission(name, "steps.1.hold.seconds=6"), seed=seed, log=log, chatter=True, interrupt_when=watch)
    _assert_flown(flight)
    # A team that swings round its places keeps within the tolerance, and goes at 0.3 m/s and more all the time.
    speeds_m_s = np.linalg.norm(np.diff(held_enu_m, axis=0), axis=2) * flight.plan.spec.rate_hz
    assert np.sqrt((speeds_m_s[-len(speeds_m_s) // 3 :] ** 2).mean()) < 0.15
    last = speeds_m_s[-round(flight.plan.spec.rate_hz) :]
    assert flight.meter.hold_speed_m_s == pytest.approx(np.sqrt((last**2).mean(axis=0)).max(), abs=0.02)
    if log is not None:
        _verified(log)


@pytest.mark.parametrize("autopilots", BOTH)
@pytest.mark.parametrize(
    "changes",
    [
        (),
        ("set_gps_origin=true",),
        ("vehicles.0.position=global", "vehicles.1.position=global"),
        ("vehicles.1.position=global",),
    ],
    ids=["origins", "common origin", "global", "one global"],
)
def test_origins_fifty_metres_apart_and_off_make_one_frame(
    autopilots: tuple[str, str], changes: tuple[str, ...]
) -> None:
    def far(world: World) -> None:
        world.state.estimator.origin_error_enu_m += np.array([[50.0, -20.0], [10.0, 60.0], [0.5, -0.5]])

    _assert_flown(Flight(pair(*changes, autopilots=autopilots), seed=5, prepare=far))


def test_a_declared_origin_is_reckoned_with() -> None:
    def moved(world: World) -> None:
        world.state.estimator.origin_error_enu_m[:] = np.array([[0.0, 30.0], [0.0, -40.0], [0.0, 1.0]])

    changes = ("vehicles.0.origin=pad", "vehicles.1.origin=declared", "vehicles.1.origin_m=[32.5, -40.0, 1.0]")
    standing = world_config(pair("vehicles.0.origin=pad", "vehicles.1.origin=pad"), 6)
    _assert_flown(Flight(pair(*changes), seed=6, config=standing, prepare=moved))


def test_estimates_that_begin_half_a_metre_off_are_hung_on_the_pads() -> None:
    def off(world: World) -> None:
        world.state.estimator.origin_error_enu_m[:] = np.array([[0.5, -0.5], [-0.5, 0.5], [0.6, -0.6]])

    _assert_flown(Flight(pair("vehicles.0.origin=pad", "vehicles.1.origin=pad"), seed=6, prepare=off))


def test_a_fifth_of_all_datagrams_may_be_lost_both_ways(tmp_path: Path) -> None:
    log = tmp_path / "flight.tlog"
    lossy = LinkConfig(loss=0.2)
    plan = pair("limits.heartbeat_age_s=10")
    _assert_flown(Flight(plan, log=log, change=lambda world: replace(world, uplink=lossy, downlink=lossy)))
    _verified(log)


def _slow(world: WorldConfig) -> WorldConfig:
    link = LinkConfig(delay_ns=300_000_000)
    return replace(world, uplink=link, downlink=link)


def test_a_delay_that_nobody_reckoned_with_is_refused_with_the_one_to_reckon_with() -> None:
    flight = Flight(pair("limits.preflight_s=15"), change=_slow)
    _assert_on_the_ground(flight)
    assert "vehicle 1: its answers take 0.60 s, limit 0.27 s" in flight.runner.reason
    assert "set link_delay_s: 0.39" in flight.runner.reason


def test_a_delay_that_the_mission_reckons_with_is_flown() -> None:
    reckoned = ("link_delay_s=0.39", "limits.pose_age_s=1.0", "limits.pose_lost_s=2.0", CALM)
    with pytest.raises(UserError, match=r"tolerance_m: 0.4 m, minimum is 0.45 m: vehicles wander by GPS"):
        pair(*reckoned)
    plan = pair(*reckoned, "steps.0.form.tolerance_m=0.52")
    assert plan.control_gain == pytest.approx(0.52 * pair().control_gain, rel=0.01)
    flight = Flight(plan, change=_slow, limit_s=300)
    _assert_flown(flight)
    np.testing.assert_allclose(flight.runner.fleet.clocks.uncertainty_s(), 0.3, atol=0.02)


@pytest.mark.parametrize("autopilots", BOTH)
def test_a_start_up_as_long_as_the_real_one_is_waited_for(autopilots: tuple[str, str]) -> None:
    flight = Flight(pair(autopilots=autopilots), change=lambda world: replace(world, real_boot=True))
    _assert_flown(flight)


def _when(condition: Callable[[Flight], bool], act: Callable[[Flight], None]) -> Callable[[Flight], bool]:
    """Looks on after every tick and does something once."""
    done: list[int] = []

    def look(flight: Flight) -> bool:
        if not done and condition(flight):
            done.append(flight.now_ns)
            act(flight)
        return False

    return look


@pytest.mark.parametrize("reluctant", [0, 1])
def test_an_autopilot_that_refuses_to_arm_for_45_s_is_waited_for(reluctant: int) -> None:
    def deny(flight: Flight) -> bool:
        flight.world.autopilots[reluctant].deny_arming = flight.now_ns < 45 * SECOND_NS
        return False

    flight = Flight(pair(), interrupt_when=deny)
    _assert_flown(flight)
    assert flight.now_ns > 45 * SECOND_NS


def test_an_autopilot_that_never_arms_is_named_with_its_own_words() -> None:
    def deny(flight: Flight) -> bool:
        flight.world.autopilots[0].deny_arming = Phase.ARM in flight.phase_seen
        return False

    flight = Flight(pair("limits.arming_s=20", "limits.preflight_s=30"), interrupt_when=deny)
    _assert_on_the_ground(flight)
    assert flight.runner.reason.startswith("vehicle 1: not armed in mode OFFBOARD after 20 s: arm: temporarily")
    assert "it says: Preflight Fail: Sensor 0 missing" in flight.runner.reason
    # This one comes in two pieces.
    assert "it says: Arming denied: Resolve system health failures first" in flight.runner.reason
    assert "vehicle 2" not in flight.runner.reason


def test_nobody_stands_armed_for_long_while_another_refuses() -> None:
    armed_s = [0.0]

    def deny(flight: Flight) -> bool:
        flight.world.autopilots[1].deny_arming = flight.now_ns < 25 * SECOND_NS and Phase.ARM in flight.phase_seen
        armed_s[0] += 0.05 * bool(flight.world.truth.armed[0] and flight.runner.phase is Phase.ARM)
        return False

    plan = pair(autopilots=("arducopter", "px4"))
    _assert_flown(Flight(plan, interrupt_when=deny))
    assert armed_s[0] < 10.0


def _yes_man(autopilot: Autopilot) -> None:
    """Acknowledges and does nothing."""
    for command in (22, 176, 400):
        autopilot.commands[command] = lambda _params, _frame: 0


@pytest.mark.parametrize(
    ("vehicle", "words"),
    [
        (0, "vehicle 1: not armed in mode AUTO.LOITER after 10 s: it acknowledged OFFBOARD mode and did not do it"),
        (1, "vehicle 2: not armed in mode STABILIZE after 10 s: it acknowledged GUIDED mode and did not do it"),
    ],
)
def test_an_autopilot_that_says_yes_and_does_nothing_is_told_from_its_heartbeat(vehicle: int, words: str) -> None:
    look = _when(lambda flight: flight.now_ns > 0, lambda flight: _yes_man(flight.world.autopilots[vehicle]))
    flight = Flight(pair("limits.arming_s=10"), interrupt_when=look)
    _assert_on_the_ground(flight)
    assert flight.runner.reason == f"{words}; see what QGroundControl or Mission Planner show of its checks"


@pytest.mark.parametrize("vehicle", [0, 1])
def test_a_reboot_before_arming_is_waited_for_and_all_is_asked_again(vehicle: int) -> None:
    look = _when(lambda flight: flight.now_ns > 2.2 * SECOND_NS, lambda flight: flight.world.reboot(vehicle))
    _assert_flown(Flight(pair(), interrupt_when=look))


@pytest.mark.parametrize("vehicle", [0, 1])
def test_a_reboot_while_arming_ends_the_attempt_on_the_ground(vehicle: int) -> None:
    def arming(flight: Flight) -> bool:
        return flight.runner.phase is Phase.ARM

    flight = Flight(pair(), interrupt_when=_when(arming, lambda flight: flight.world.reboot(vehicle)))
    _assert_on_the_ground(flight)
    assert flight.runner.reason.startswith(f"vehicle {vehicle + 1}: ")
    assert "while the team was arming" in flight.runner.reason
    assert f"vehicle {vehicle + 1}: has started anew while the team was arming" in flight.runner.reason


def _forged_origin(
    vehicle: int, metres: float, when: Callable[[Flight], bool]
) -> Callable[[Outgoing, Flight], list[Outgoing]]:
    """A vehicle whose origin is told now here, now a few metres to the north."""
    encoder = Encoder(vehicle + 1)
    turn = [0]

    def forge(datagram: Outgoing, flight: Flight) -> list[Outgoing]:
        if datagram.vehicle_index != vehicle or not when(flight):
            return [datagram]
        turn[0] += 1
        if turn[0] % 50:
            return [datagram]
        lat = flight.world.config.home_lat_deg + (metres / 111_320.0 if turn[0] % 100 else 0.0)
        home = flight.world.config
        other = encoder.encode(
            "GPS_GLOBAL_ORIGIN", latitude=round(lat * 1e7), longitude=round(home.home_lon_deg * 1e7),
            altitude=round(home.home_alt_m * 1e3),
        )  # fmt: skip
        return [datagram._replace(data=datagram.data + other)]

    return forge


def test_a_vehicle_that_reports_two_origins_is_refused_with_their_distance() -> None:
    flight = Flight(pair("limits.preflight_s=15"), tamper=_forged_origin(0, 7.0, lambda _: True))
    _assert_on_the_ground(flight)
    assert "vehicle 1: reports two different origins, " in flight.runner.reason
    assert "vehicle 2" not in flight.runner.reason


def test_an_origin_that_moves_in_flight_brings_everybody_down() -> None:
    """By less than what two positions that part would show: one that moves further alone is not believed."""
    flight = Flight(pair(), tamper=_forged_origin(0, 2.0, lambda flight: Phase.HOLD in flight.phase_seen))
    assert flight.runner.outcome == "aborted"
    assert "vehicle 1: its origin has moved by " in flight.runner.reason
    assert not flight.world.truth.armed.any()


def test_two_positions_that_drift_apart_in_flight_bring_everybody_down() -> None:
    encoder = Encoder(2)
    place = message_id("GLOBAL_POSITION_INT")

    def spoof(datagram: Outgoing, flight: Flight) -> list[Outgoing]:
        if datagram.vehicle_index != 1 or Phase.HOLD not in flight.phase_seen:
            return [datagram]
        pieces = FrameSplitter().feed(datagram.data)
        kept = b"".join(piece.raw for piece in pieces if isinstance(piece, WireFrame) and piece.msgid != place)
        home = flight.world.config
        wrong = encoder.encode(
            "GLOBAL_POSITION_INT", time_boot_ms=flight.now_ns // 1_000_000, lat=round(home.home_lat_deg * 1e7),
            lon=round((home.home_lon_deg + 1e-4) * 1e7), alt=round((home.home_alt_m + 3.0) * 1e3),
        )  # fmt: skip
        return [datagram._replace(data=kept + wrong)]

    flight = Flight(pair("steps.1.hold.seconds=10"), tamper=spoof)
    assert flight.runner.outcome == "aborted"
    assert "vehicle 2: its local and global positions are" in flight.runner.reason
    assert not flight.world.truth.armed.any()


def test_two_vehicles_behind_one_address_under_one_id_are_told_by_their_times() -> None:
    """As behind one radio: the frames of the second cannot be told from those of the first but by their times."""
    encoder = Encoder(1)

    def second(datagram: Outgoing, flight: Flight) -> list[Outgoing]:
        if datagram.vehicle_index != 0:
            return [datagram]
        boot_ms = 900_000 + flight.now_ns // 1_000_000
        other = encoder.encode("LOCAL_POSITION_NED", time_boot_ms=boot_ms, x=1.0)
        return [datagram, datagram._replace(data=other)]

    flight = Flight(pair("limits.preflight_s=10"), tamper=second)
    _assert_on_the_ground(flight)
    assert "vehicle 1: two vehicles say that they are 1, both at emulator:1" in flight.runner.reason


def test_a_vehicle_that_is_heard_on_another_link_is_found_there() -> None:
    changes = ("vehicles.0.link=udpin://0.0.0.0:14551", "limits.preflight_s=3")
    flight = Flight(pair(*changes), tamper=_all_on_second_link)
    _assert_on_the_ground(flight)
    assert flight.runner.reason.startswith(
        "vehicle 1: no heartbeat on udpin://0.0.0.0:14551; a system 1 is heard on udpin://0.0.0.0:14541;"
    )


def _all_on_second_link(datagram: Outgoing, flight: Flight) -> list[Outgoing]:
    flight.session.deliver(1, f"emulator:{datagram.vehicle_index + 1}", datagram.data, datagram.t_ns)
    return []


def test_attitudes_as_euler_angles_do_as_well() -> None:
    quaternion = message_id("ATTITUDE_QUATERNION")

    def strip(datagram: Outgoing, _flight: Flight) -> list[Outgoing]:
        pieces = FrameSplitter().feed(datagram.data)
        kept = [piece.raw for piece in pieces if isinstance(piece, WireFrame) and piece.msgid != quaternion]
        return [datagram._replace(data=b"".join(kept))] if kept else []

    def ask(flight: Flight) -> None:
        flight.world.state.streams.set_interval(1, "ATTITUDE", 20_000_000, flight.now_ns)

    look = _when(lambda flight: flight.now_ns > SECOND_NS, ask)
    _assert_flown(Flight(pair(), tamper=strip, interrupt_when=look, chatter=True))


@pytest.mark.parametrize("autopilots", [("px4", "px4"), ("px4", "arducopter")])
def test_setpoints_begin_before_the_mode_and_never_stop_in_the_air(autopilots: tuple[str, str]) -> None:
    """PX4 gets them from a second before OFFBOARD; ArduCopter from the end of its climb, which they would end."""
    sent: list[tuple[int, int, str]] = []

    class Listening(Flight):
        def receive(self, vehicle_index: int, data: bytes, now_ns: int) -> None:
            for piece in FrameSplitter().feed(data):
                if isinstance(piece, WireFrame) and piece.msgid in (84, 76):
                    what = "setpoint" if piece.msgid == 84 else f"command {piece.payload[28] | piece.payload[29] << 8}"
                    sent.append((now_ns, vehicle_index, what))
            super().receive(vehicle_index, data, now_ns)

    flight = Listening(pair(autopilots=autopilots))
    _assert_flown(flight)
    for vehicle, autopilot in enumerate(autopilots):
        points = [t for t, who, what in sent if who == vehicle and what == "setpoint"]
        mode = next(t for t, who, what in sent if who == vehicle and what == "command 176")
        if autopilot == "px4":
            assert points[0] <= mode - SECOND_NS
        else:
            takeoff = next(t for t, who, what in sent if who == vehicle and what == "command 22")
            assert points[0] > takeoff
        assert max(np.diff(points)) <= 0.1 * SECOND_NS


def test_an_origin_that_is_never_told_is_taken_from_the_two_positions() -> None:
    """Some firmware answers no request for GPS_GLOBAL_ORIGIN."""

    def untold(datagram: Outgoing, _flight: Flight) -> list[Outgoing]:
        pieces = FrameSplitter().feed(datagram.data)
        kept = [piece.raw for piece in pieces if isinstance(piece, WireFrame) and piece.msgid != ORIGIN]
        return [datagram._replace(data=b"".join(kept))] if kept else []

    def far(world: World) -> None:
        world.state.estimator.origin_error_enu_m += np.array([[50.0, -20.0], [10.0, 60.0], [0.5, -0.5]])

    flight = Flight(pair(), tamper=untold, prepare=far)
    _assert_flown(flight)
    assert any("vehicle 2: does not tell its origin" in text for text in flight.texts("info"))


def test_a_vehicle_that_does_not_answer_timesync_is_flown_by_arrival_times() -> None:
    timesync = message_id("TIMESYNC")

    def mute(datagram: Outgoing, _flight: Flight) -> list[Outgoing]:
        pieces = FrameSplitter().feed(datagram.data)
        kept = [piece.raw for piece in pieces if isinstance(piece, WireFrame) and piece.msgid != timesync]
        return [datagram._replace(data=b"".join(kept))] if kept else []

    flight = Flight(pair(), tamper=mute)
    _assert_flown(flight)
    assert any("vehicle 1: does not answer TIMESYNC" in text for text in flight.texts("info"))


@pytest.mark.parametrize("autopilots", BOTH)
def test_the_same_vehicles_fly_again_and_again(autopilots: tuple[str, str]) -> None:
    """After a flight PX4 shows OFFBOARD and ArduCopter LAND, in which neither can be armed."""
    plan = pair(autopilots=autopilots)
    first = Flight(plan)
    _assert_flown(first)
    second = Flight(plan, world=first.world)
    _assert_flown(second)
    assert second.now_ns < first.now_ns + 10 * SECOND_NS


@pytest.mark.parametrize("vehicle", [0, 1])
def test_a_reboot_in_flight_is_told_and_the_other_comes_back(vehicle: int) -> None:
    def holding(flight: Flight) -> bool:
        return flight.runner.phase is Phase.HOLD

    flight = Flight(
        pair("steps.1.hold.seconds=10"),
        interrupt_when=_when(holding, lambda flight: flight.world.reboot(vehicle)),
    )
    assert flight.runner.outcome == "aborted"
    # Whether its clock or its missing positions tell first is a matter of when it was asked for the time.
    said = [text.partition(";")[0] for text in flight.texts("alarm")]
    assert f"vehicle {vehicle + 1}: its autopilot has started anew" in said
    assert flight.runner.reason.startswith(f"vehicle {vehicle + 1}: ")
    assert f"vehicle {2 - vehicle}: " not in flight.runner.reason
    assert not flight.world.truth.armed.any()


def test_jitter_disorder_and_copies_are_sorted_out_by_time_stamps() -> None:
    bad = LinkConfig(jitter_ns=50_000_000, reorder=0.1, duplicate=0.1)
    flight = Flight(pair("link_delay_s=0.2", CALM), change=lambda world: replace(world, uplink=bad, downlink=bad))
    _assert_flown(flight)
    assert flight.runner.fleet.counts["older than what was there"] > 100
