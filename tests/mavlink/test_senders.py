"""Whom we believe: what is no autopilot counts for nothing, two in turns are told, one word against all is none."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from groundstation.mavlink.kinds import MULTIROTORS, Kind, kind_of, type_words, unflown_words
from groundstation.mavlink.station import Station
from groundstation.mavlink.vehicle import NEVER, Fleet, ReceivedFrame
from tests.mavlink.sender import (
    ARDUPILOT,
    ARMED,
    COMPANION,
    DISARMED,
    FIXED_WING,
    IN_AIR,
    INVALID,
    LAND,
    LOITER,
    OFFBOARD,
    ON_GROUND,
    PX4,
    QUAD,
    Sender,
)

MS, SECOND = 1_000_000, 1_000_000_000
HERE = "10.0.0.3:14580"


class Scene:
    """One vehicle, system 3, heard at one address."""

    def __init__(self) -> None:
        self.fleet = Fleet([3], [0])
        self.station = Station(self.fleet, 0)
        self.sender = Sender(3)
        self.now_ns = 10 * SECOND

    def hear(self, *raw: bytes, peer: str = HERE, passed_ms: int = 0) -> None:
        self.now_ns += passed_ms * MS
        for item in raw:
            self.station.receive(0, peer, item, self.now_ns)
        self.station.ingest()

    def flies(self) -> None:
        """It says that it is armed and in the air."""
        self.hear(self.sender.heartbeat(), self.sender.landed(IN_AIR))


def _steps(scene: Scene, seconds: float, step_ms: int = 100) -> Iterator[int]:
    for k in range(round(seconds * 1000 / step_ms)):
        scene.now_ns += step_ms * MS
        yield k


@pytest.mark.parametrize("kind", [COMPANION, QUAD, 6, 26, 30, 0])
def test_the_heartbeat_of_what_is_no_autopilot_counts_for_nothing(kind: int) -> None:
    scene = Scene()
    scene.flies()
    before = scene.fleet.heartbeat_ns.copy(), scene.fleet.heard_ns.copy()
    scene.hear(scene.sender.heartbeat(DISARMED, 0, kind=kind, autopilot=INVALID), passed_ms=1000)
    assert scene.fleet.armed[0]
    assert (scene.fleet.custom_mode[0], scene.fleet.autopilot[0], scene.fleet.mav_type[0]) == (OFFBOARD, PX4, QUAD)
    assert (scene.fleet.heartbeat_ns, scene.fleet.heard_ns) == before
    assert scene.fleet.senders.part(0, scene.now_ns) == Kind(kind, INVALID)
    assert scene.fleet.twin(0, scene.now_ns) is None


def test_a_companion_that_speaks_first_does_not_take_the_vehicles_address() -> None:
    scene = Scene()
    scene.hear(scene.sender.heartbeat(DISARMED, 0, kind=COMPANION, autopilot=INVALID), peer="10.0.0.9:1")
    assert scene.fleet.peer == [None]
    scene.flies()
    assert (scene.fleet.peer, scene.fleet.twin(0, scene.now_ns)) == ([HERE], None)


def test_a_heartbeat_is_read_whole_where_its_zeros_are_cut_off() -> None:
    """In MAVLink 2 trailing zeros do not travel; that of a generic vehicle of no autopilot is almost nothing."""
    for version in (1, 2):
        sender = Sender(3, version=version)
        raw = sender.raw(dialect.MAVLink_heartbeat_message(0, 0, 0, 0, 0, 0))
        station = Station(Fleet([3], [0]), 0)
        station.receive(0, HERE, raw, SECOND)
        station.ingest()
        assert (station.fleet.mav_type[0], station.fleet.autopilot[0]) == (0, 0)


@pytest.mark.parametrize("forged_hz", [1, 10, 50])
def test_armed_and_disarmed_in_turns_are_two_senders(forged_hz: int) -> None:
    scene = Scene()
    scene.hear(scene.sender.heartbeat(), scene.sender.landed(ON_GROUND))
    for k in _steps(scene, 6.0, 20):
        if k % 50 == 0:
            scene.hear(scene.sender.heartbeat(ARMED))
        if (k + 25) % (50 // forged_hz) == 0:
            scene.hear(scene.sender.heartbeat(DISARMED))
    words = scene.fleet.twin_behind_one_address(0, scene.now_ns)
    assert words == f"two senders say that they are 3, both at {HERE}: their heartbeats say armed and disarmed in turns"
    assert scene.fleet.senders.in_doubt(scene.now_ns).all()
    scene.now_ns += 10 * SECOND
    assert scene.fleet.twin_behind_one_address(0, scene.now_ns) is None


def test_what_one_vehicle_does_is_no_turn_taking() -> None:
    """Arming that is refused and asked again, modes on the way up, a bounce on landing, a battery that sags."""
    scene = Scene()
    modes = [LOITER, OFFBOARD, OFFBOARD, 84148224, OFFBOARD, 100925440, OFFBOARD]
    for k in _steps(scene, 60.0, 1000):
        armed = ARMED if k % 5 > 0 and k > 10 else DISARMED
        scene.hear(scene.sender.heartbeat(armed, modes[k // 10]), scene.sender.battery(90 - k % 7))
        scene.hear(scene.sender.landed(ON_GROUND if k % 20 < 17 or k % 20 == 18 else IN_AIR))
        assert scene.fleet.twin_behind_one_address(0, scene.now_ns) is None


@pytest.mark.parametrize(
    ("one", "other", "words"),
    [
        (lambda s: s.heartbeat(ARMED, OFFBOARD), lambda s: s.heartbeat(ARMED, LOITER), "their modes alternate"),
        (
            lambda s: s.heartbeat(),
            lambda s: s.heartbeat(kind=FIXED_WING, autopilot=ARDUPILOT),
            "their kinds alternate (fixed wing (MAV_TYPE 1), MAV_AUTOPILOT 3; quadrotor (MAV_TYPE 2)",
        ),
        (lambda s: s.landed(ON_GROUND), lambda s: s.landed(IN_AIR), "their landed states alternate (in the air, on"),
        (lambda s: s.battery(80), lambda s: s.battery(5), "their batteries alternate (5 % and 80 %)"),
    ],
)
def test_values_that_two_senders_tell_in_turns_are_told(one, other, words: str) -> None:  # type: ignore[no-untyped-def]
    scene = Scene()
    scene.flies()
    for k in _steps(scene, 5.0, 500):
        scene.fleet.see_above(np.array([True]), scene.now_ns)
        scene.hear((other if k % 2 else one)(scene.sender))
    told = scene.fleet.twin_behind_one_address(0, scene.now_ns)
    assert told is not None
    assert words in told


@pytest.mark.parametrize(("armed", "told"), [(ARMED, False), (DISARMED, True)])
def test_one_that_hops_just_above_the_ground_is_no_two_and_one_that_is_disarmed_does_not_hop(
    armed: int, told: bool
) -> None:
    """Held by its failsafe as it took off (a network that was gone for 3 s): five changes in 4 s, then called two."""
    scene = Scene()
    for k in _steps(scene, 8.0, 100):
        hops = k % 10 in (3, 4, 7)
        scene.hear(scene.sender.heartbeat(armed), scene.sender.landed(IN_AIR if hops else ON_GROUND))
    assert (scene.fleet.twin_behind_one_address(0, scene.now_ns) is not None) == told


def test_positions_that_are_late_and_elsewhere_are_a_second_sender_and_late_ones_on_its_way_are_not() -> None:
    """The second one's clock runs 300 ms ahead: by their times alone the true ones are only late."""
    for elsewhere_m, found in ((0.0, False), (30.0, True)):
        scene = Scene()
        for k in _steps(scene, 3.0, 50):
            scene.hear(scene.sender.position(50_300 + 50 * k, elsewhere_m))
            scene.hear(scene.sender.position(50_000 + 50 * k, 0.0))
        told = scene.fleet.twin_behind_one_address(0, scene.now_ns)
        assert (told is not None and "their positions alternate" in told) == found


def test_disarmed_is_not_believed_of_one_that_says_that_it_flies() -> None:
    scene = Scene()
    scene.flies()
    for k in _steps(scene, 5.0, 100):
        scene.hear(scene.sender.landed(IN_AIR))
        if k % 10 == 5:
            scene.hear(scene.sender.heartbeat(DISARMED, LOITER))
    assert scene.fleet.armed[0]
    assert scene.fleet.disarm_doubted[0]
    assert scene.fleet.custom_mode[0] == OFFBOARD
    # It has come down: autopilots say so as soon as they disarm.
    scene.hear(scene.sender.landed(ON_GROUND), passed_ms=100)
    assert not scene.fleet.armed[0]
    assert not scene.fleet.disarm_doubted[0]
    assert (scene.fleet.custom_mode[0], scene.fleet.heartbeat_ns[0] > scene.now_ns - SECOND) == (LOITER, True)


def test_disarmed_is_not_believed_while_it_is_seen_high_above_the_ground() -> None:
    scene = Scene()
    scene.flies()
    for k in _steps(scene, 3.0, 100):
        scene.fleet.see_above(np.array([True]), scene.now_ns)
        scene.hear(scene.sender.landed(ON_GROUND))
        if k % 10 == 5:
            scene.hear(scene.sender.heartbeat(DISARMED, LOITER))
    assert scene.fleet.armed[0]
    assert scene.fleet.disarm_doubted[0]
    # Half a second after it was last seen up there its words count again.
    scene.hear(scene.sender.landed(ON_GROUND), passed_ms=600)
    assert not scene.fleet.armed[0]
    assert not scene.fleet.disarm_doubted[0]


def test_disarmed_is_believed_on_the_ground_and_where_no_landed_state_is_told() -> None:
    for landed, age_ms in ((ON_GROUND, 0), (0, 0), (IN_AIR, 4000)):
        scene = Scene()
        scene.hear(scene.sender.heartbeat(), scene.sender.landed(landed))
        scene.hear(scene.sender.heartbeat(DISARMED), passed_ms=age_ms)
        assert not scene.fleet.armed[0]


@pytest.mark.parametrize(("kind", "autopilot"), [(FIXED_WING, PX4), (QUAD, ARDUPILOT), (13, PX4)])
def test_in_flight_a_heartbeat_of_another_kind_counts_for_nothing_and_is_known(kind: int, autopilot: int) -> None:
    scene = Scene()
    scene.flies()
    scene.fleet.hold_addresses()
    heard_ns = scene.fleet.heard_ns.copy()
    scene.hear(scene.sender.heartbeat(DISARMED, LOITER, kind=kind, autopilot=autopilot), passed_ms=500)
    assert scene.fleet.armed[0]
    assert scene.fleet.custom_mode[0] == OFFBOARD
    assert scene.fleet.heard_ns == heard_ns
    assert scene.fleet.senders.strange_kind(0, scene.now_ns) == Kind(kind, autopilot)
    scene.hear(scene.sender.heartbeat(DISARMED, kind=kind, autopilot=autopilot), peer="10.0.0.9:1", passed_ms=20_000)
    assert scene.fleet.senders.strange_kind(0, scene.now_ns) is None
    assert scene.fleet.peer == [HERE]


def test_an_autopilot_on_another_component_is_known_and_a_camera_there_is_none() -> None:
    scene = Scene()
    scene.hear(Sender(3, 100).heartbeat(kind=30, autopilot=INVALID))
    assert scene.fleet.senders.component(0, scene.now_ns) is None
    scene.hear(Sender(3, 2).heartbeat())
    assert scene.fleet.senders.component(0, scene.now_ns) == 2
    assert scene.fleet.heartbeat_ns[0] == NEVER


def test_places_that_are_not_on_earth_are_unknown() -> None:
    scene = Scene()
    zurich = (473_977_400, 85_456_000, 488_000)
    scene.hear(scene.sender.origin(*zurich))
    for lat, lon in ((0, 0), (2**31 - 1, 2**31 - 1), (-(2**31), 85_456_000), (473_977_400, 1_900_000_000)):
        scene.hear(scene.sender.origin(lat, lon), passed_ms=100)
        scene.hear(scene.sender.raw(dialect.MAVLink_global_position_int_message(1000, lat, lon, 0, 0, 0, 0, 0, 0)))
        scene.hear(
            scene.sender.raw(
                dialect.MAVLink_home_position_message(lat, lon, 0, 0.0, 0.0, 0.0, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0)
            )
        )
    np.testing.assert_allclose(scene.fleet.origin_deg_m[0], [47.39774, 8.5456, 488.0])
    assert scene.fleet.origin_moved_ns[0] == NEVER
    assert np.isnan(scene.fleet.place_deg_m).all()
    assert np.isnan(scene.fleet.home_deg_m).all()


def test_only_multirotors_are_flown() -> None:
    names = {number: entry.name for number, entry in dialect.enums["MAV_TYPE"].items()}
    flown = {names[number].removeprefix("MAV_TYPE_") for number in names if unflown_words(number) is None}
    assert flown == {
        "QUADROTOR", "COAXIAL", "HEXAROTOR", "OCTOROTOR", "TRICOPTER", "DODECAROTOR", "DECAROTOR", "GENERIC_MULTIROTOR",
    }  # fmt: skip
    assert len(MULTIROTORS) == len(flown)
    assert unflown_words(FIXED_WING) == "it says that it is a fixed wing (MAV_TYPE 1), and only multirotors are flown"
    assert type_words(200) == "MAV_TYPE 200"
    assert unflown_words(4) is not None  # helicopter


def test_a_kind_is_read_off_heartbeats_only() -> None:
    scene = Scene()
    other = scene.sender.landed(IN_AIR)
    frames: list[bytes] = [other]
    station = Station(Fleet([3], [0]), 0)
    station.receive(0, HERE, frames[0], SECOND)
    (received,) = station._received
    assert isinstance(received, ReceivedFrame)
    assert kind_of(received.frame) is None


# Texts


@pytest.mark.parametrize("lost", [0, 1, 2])
def test_a_long_text_of_which_a_piece_is_lost_is_shown_with_what_came(lost: int) -> None:
    scene = Scene()
    scene.flies()
    pieces = [b"PreArm: " + b"a" * 42, b"b" * 50, b"the end"]
    for number, piece in enumerate(pieces):
        if number != lost:
            scene.hear(scene.sender.text(piece, 7, number), passed_ms=20)
    assert scene.fleet.take_texts(scene.now_ns) == []
    (text,) = scene.fleet.take_texts(scene.now_ns + 2 * SECOND)
    expected = [piece.decode() if number != lost else "..." for number, piece in enumerate(pieces)]
    assert text.text == "".join(expected)
    assert scene.fleet.take_texts(scene.now_ns + 9 * SECOND) == []


def test_pieces_in_any_order_are_one_text_and_two_texts_at_once_are_two() -> None:
    scene = Scene()
    scene.flies()
    first, second = (b"x" * 50, b"one"), (b"y" * 50, b"two")
    for number, piece, data in ((8, 1, second[1]), (7, 0, first[0]), (8, 0, second[0]), (7, 1, first[1])):
        scene.hear(scene.sender.text(data, number, piece), passed_ms=20)
    assert [text.text for text in scene.fleet.take_texts(scene.now_ns)] == ["y" * 50 + "two", "x" * 50 + "one"]


def test_a_text_of_fifty_letters_sharp_comes_out_and_so_does_one_of_pieces_without_end() -> None:
    scene = Scene()
    scene.flies()
    scene.hear(scene.sender.text(b"z" * 50, 3, 0), scene.sender.text(b"", 3, 1))
    assert [text.text for text in scene.fleet.take_texts(scene.now_ns)] == ["z" * 50]
    for number in range(40):
        scene.hear(scene.sender.text(b"w" * 50, 4, number % 256))
    assert [len(text.text) for text in scene.fleet.take_texts(scene.now_ns + 9 * SECOND)] == [503]
    for number in range(1, 60):
        scene.hear(scene.sender.text(b"v" * 50, number, 0))
    assert len(scene.fleet.take_texts(scene.now_ns)) == 59 - 4  # no more than four wait at once


# Quirks from public reports


def test_two_boards_that_answer_to_one_id_are_two_vehicles_and_one_that_starts_anew_is_not() -> None:
    """Powered by one switch, their times since start-up are alike; each board has a number of its own."""
    scene = Scene()
    scene.flies()

    def version(uid: int, uid2: int = 0) -> bytes:
        numbers = list(uid2.to_bytes(18, "little"))
        empty = [0] * 8
        return scene.sender.raw(
            dialect.MAVLink_autopilot_version_message(0, 0x01110000, 0, 0, 0, empty, empty, empty, 0, 0, uid, numbers)
        )

    scene.hear(version(0), version(5), version(5), passed_ms=100)
    assert scene.fleet.twin(0, scene.now_ns) is None
    scene.hear(version(5, 9), passed_ms=100)
    words = scene.fleet.twin(0, scene.now_ns)
    assert words is not None
    assert "two boards answer to its id" in words
    scene.fleet._start_anew(0)
    assert scene.fleet.twin(0, scene.now_ns) is None


def test_positions_of_two_whose_clocks_are_alike_are_told() -> None:
    scene = Scene()
    for k in _steps(scene, 2.0, 100):
        scene.hear(scene.sender.position(50_000 + 100 * k, 0.0))
        scene.hear(scene.sender.position(50_001 + 100 * k, 4.0), passed_ms=1)
    told = scene.fleet.twin_behind_one_address(0, scene.now_ns)
    assert told is not None
    assert "their positions alternate" in told


def test_one_jump_before_many_positions_that_arrive_at_once_is_no_second_sender() -> None:
    """Seen of PX4 1.16 on a busy computer: its origin was set, and 15 positions came in one datagram."""
    for apart_m, found in ((5.0, False), (0.0, True)):
        scene = Scene()
        scene.hear(scene.sender.position(50_000, 0.0))
        scene.hear(
            *(scene.sender.position(50_020 + 20 * k, 5.0 if k % 2 else apart_m) for k in range(15)), passed_ms=300
        )
        told = scene.fleet.twin_behind_one_address(0, scene.now_ns)
        assert (told is not None and "their positions alternate" in told) == found


def test_one_jump_of_a_position_is_no_second_sender() -> None:
    scene = Scene()
    for k in _steps(scene, 4.0, 100):
        scene.hear(scene.sender.position(50_000 + 100 * k, 4.0 if k >= 20 else 0.0))
        assert scene.fleet.twin_behind_one_address(0, scene.now_ns) is None


@pytest.mark.parametrize(("speed_m_s", "armed"), [(0.5, True), (0.02, False)])
def test_firmware_that_says_landing_for_ever_is_believed_to_be_disarmed_when_it_stands(
    speed_m_s: float, armed: bool
) -> None:
    """PX4 1.7 did so: disarmed, and the landed state stayed at "landing"."""
    scene = Scene()
    scene.flies()
    for k in _steps(scene, 2.0, 100):
        position = dialect.MAVLink_local_position_ned_message(50_000 + 100 * k, 0.0, 0.0, -1.0, 0.0, 0.0, speed_m_s)
        scene.hear(scene.sender.raw(position), scene.sender.landed(4))
    scene.hear(scene.sender.heartbeat(DISARMED, LOITER))
    assert bool(scene.fleet.armed[0]) is armed


def test_of_one_that_stands_still_as_it_begins_to_land_disarmed_is_not_believed_when_two_speak() -> None:
    scene = Scene()
    scene.flies()
    for k in range(6):
        scene.hear(scene.sender.heartbeat(ARMED, LAND if k % 2 else OFFBOARD), passed_ms=200)
    still = dialect.MAVLink_local_position_ned_message(50_000, 0.0, 0.0, -3.0, 0.0, 0.0, 0.0)
    scene.hear(scene.sender.raw(still), scene.sender.landed(4), scene.sender.heartbeat(DISARMED, LAND), passed_ms=100)
    assert scene.fleet.armed[0]


def _at_zurich(scene: Scene) -> bytes:
    place = dialect.MAVLink_global_position_int_message(60_000, 473_977_400, 85_456_000, 488_000, 0, 0, 0, 0, 0)
    return scene.sender.position(60_000, 3.0) + scene.sender.raw(place)


def test_an_origin_that_neither_position_agrees_with_is_not_taken() -> None:
    """A vehicle whose origin was really set far away is far from it by its local position as well."""
    here, away = (473_977_100, 85_456_000, 488_000), (400_000_000, 100_000_000, 0)
    scene = Scene()
    scene.hear(scene.sender.origin(*away))  # before there are positions anything is possible
    scene.hear(_at_zurich(scene), scene.sender.origin(*away), passed_ms=100)
    assert np.isnan(scene.fleet.origin_deg_m).all()
    scene.hear(scene.sender.origin(*here), scene.sender.origin(*away), passed_ms=100)
    scene.hear(scene.sender.home(*here[:2], 500.0), scene.sender.home(*away[:2], 900.0))
    np.testing.assert_allclose(scene.fleet.home_deg_m[0], [47.39771, 8.5456, 0.0])
    assert scene.fleet.home_local_ned_m[0, 0] == 500.0
    np.testing.assert_allclose(scene.fleet.origin_deg_m[0], [47.39771, 8.5456, 488.0])
    assert scene.fleet.origin_moved_ns[0] == NEVER
    assert scene.fleet.counts["origin that neither position agrees with"] == 2
    scene.hear(scene.sender.position(60_500, 900_000.0), scene.sender.origin(*away), passed_ms=500)
    assert scene.fleet.origin_deg_m[0, 0] == pytest.approx(40.0)


def test_whoever_was_told_to_stop_its_motors_is_believed_when_it_says_disarmed() -> None:
    scene = Scene()
    scene.flies()
    scene.fleet.disarm_expected[0] = True
    scene.hear(scene.sender.heartbeat(DISARMED), passed_ms=100)
    assert not scene.fleet.armed[0]


@pytest.mark.parametrize("percent", [-1, 101, 127, -128])
def test_a_battery_that_cannot_be_is_not_known(percent: int) -> None:
    scene = Scene()
    scene.hear(scene.sender.battery(percent))
    assert np.isnan(scene.fleet.battery_remaining[0])


def test_a_helicopter_that_begins_as_a_quadrotor_is_one_by_its_next_heartbeat() -> None:
    """ArduPilot's first heartbeat after start-up."""
    scene = Scene()
    scene.hear(scene.sender.heartbeat(DISARMED, 0, autopilot=ARDUPILOT))
    scene.hear(scene.sender.heartbeat(DISARMED, 0, kind=4, autopilot=ARDUPILOT), passed_ms=1000)
    assert unflown_words(int(scene.fleet.mav_type[0])) is not None
    assert scene.fleet.twin(0, scene.now_ns) is None
