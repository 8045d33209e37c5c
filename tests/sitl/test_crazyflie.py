"""An emulated Crazyflie in virtual time: what it answers, how it flies, and what its supervisor does."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sitl.faults import Fault, parse_faults
from sitl.fleet import fleet
from sitl.personalities.crazyflie.crtp import packed_quaternion, unpacked_quaternion
from sitl.world import World, WorldConfig

PARAM, LOG, LOCALISATION, GENERIC, HIGH_LEVEL, SUPERVISOR, LINK = 2, 5, 6, 7, 8, 9, 15
TAKE_OFF, LAND, GO_TO = 7, 8, 12
TUMBLED, LOCKED = 5, 6


class Room:
    """n of them, and a client that speaks to them in bytes."""

    def __init__(self, n: int = 1, *, gps: bool = True, seed: int = 1) -> None:
        self.world = World(WorldConfig(vehicles=fleet(n, autopilot="crazyflie", gps=gps)), seed)
        self.heard: list[bytes] = []
        self.run(1.0)

    def send(self, port: int, channel: int, data: bytes, vehicle: int = 0) -> None:
        self.world.receive(vehicle, bytes((port << 4 | 12 | channel,)) + data, self.world.now_ns)

    def run(self, seconds: float) -> None:
        self.heard += [item.data for item in self.world.advance(self.world.now_ns + round(seconds * 1e9))]

    def ask(self, port: int, channel: int, data: bytes) -> bytes:
        self.heard.clear()
        self.send(port, channel, data)
        self.run(0.008)
        answers = [item[1:] for item in self.heard if item[0] & 0xF3 == port << 4 | channel]
        assert len(answers) == 1, answers
        return answers[0]

    def take_off(self, height_m: float = 1.0) -> None:
        self.ask(HIGH_LEVEL, 0, struct.pack("<BBff?f", TAKE_OFF, 0, height_m, 0.0, True, 2.0))
        self.run(3.0)

    def fly(self, seconds: float, x: float, y: float, z: float) -> None:
        for _ in range(round(seconds * 50)):
            self.send(GENERIC, 0, struct.pack("<Bffff", 8, x, y, z, 0.0))
            self.run(0.02)

    @property
    def stage(self) -> str:
        return self.world.autopilots[0].mode_name()

    @property
    def place(self) -> list[float]:
        return [float(v) for v in self.world.truth.pos_enu_m[0]]

    def bits(self) -> int:
        return int.from_bytes(self.ask(SUPERVISOR, 0, b"\x0c")[1:], "little")

    def stages(self, seconds: float) -> list[tuple[float, str]]:
        """The stages that follow, each with the time after which it began."""
        seen: list[tuple[float, str]] = []
        for k in range(round(seconds * 50)):
            if not seen or seen[-1][1] != self.stage:
                seen.append((k / 50, self.stage))
            self.run(0.02)
        return seen


def test_setpoints_that_stop_level_it_out_after_half_a_second_and_drop_it_after_two() -> None:
    room = Room()
    room.take_off()
    room.fly(1.0, 0.5, 0.0, 0.0)
    before = room.place[0]
    seen = room.stages(4.0)
    assert [name for _, name in seen] == ["FLYING", "LEVEL_OUT", "FREE_FALL", "LOCKED"]
    assert 0.45 <= seen[1][0] <= 0.6
    assert 1.95 <= seen[2][0] <= 2.5
    assert 0.3 < room.place[0] - before < 2.0  # nothing brakes it
    assert room.bits() >> LOCKED & 1
    room.take_off()
    assert room.place[2] == pytest.approx(0.0, abs=0.01)  # locked: no order helps


def test_a_landing_is_heard_only_after_the_client_has_said_that_its_setpoints_stop() -> None:
    room = Room()
    room.take_off()
    room.fly(0.5, 0.0, 0.0, 0.0)
    land = struct.pack("<BBff?f", LAND, 0, 0.0, 0.0, True, 2.0)
    room.send(GENERIC, 1, struct.pack("<BI", 0, 0))
    room.ask(HIGH_LEVEL, 0, land)
    room.run(3.0)
    assert room.stage == "LANDED"
    assert room.place[2] == pytest.approx(0.0, abs=0.01)
    room.run(3.5)
    assert room.stage == "READY"  # armed by itself again

    room.take_off()
    room.fly(0.5, 0.0, 0.0, 0.0)
    room.ask(HIGH_LEVEL, 0, land)  # without it: the last setpoint rules until it falls
    assert "FREE_FALL" in [name for _, name in room.stages(3.0)]


def test_setpoints_are_flown_in_the_frame_that_they_are_said_in() -> None:
    room = Room()
    room.take_off()
    room.fly(2.0, 0.3, -0.2, 0.1)
    assert room.world.truth.vel_enu_m_s[0] == pytest.approx([0.3, -0.2, 0.1], abs=0.05)
    for _ in range(100):  # facing north, forward is y
        room.send(GENERIC, 0, struct.pack("<Bffff", 10, 0.3, 0.0, 0.0, 1.0))
        room.run(0.02)
    assert room.world.truth.vel_enu_m_s[0] == pytest.approx([0.0, 0.3, 0.0], abs=0.06)
    for kind, sign in ((1, -1.0), (8, 1.0)):  # of the old type the yaw rate has the other sign
        room.send(GENERIC, 0, struct.pack("<Bffff", kind, 0.0, 0.0, 0.0, 90.0))
        before = room.world.autopilots[0].body.senses.yaw_enu_rad
        room.run(0.4)
        after = room.world.autopilots[0].body.senses.yaw_enu_rad
        assert math.copysign(1.0, math.remainder(after - before, math.tau)) == sign
    for _ in range(200):
        room.send(GENERIC, 0, struct.pack("<Bffff", 7, 0.0, 0.0, 1.2, 0.0))
        room.run(0.02)
    assert room.place == pytest.approx([0.0, 0.0, 1.2], abs=0.05)


def test_it_goes_where_the_high_level_commander_is_sent() -> None:
    room = Room()
    room.take_off()
    room.ask(HIGH_LEVEL, 0, struct.pack("<BBBBfffff", GO_TO, 0, 1, 0, 0.5, -0.5, 0.2, 0.0, 2.0))
    room.run(3.0)
    assert room.place == pytest.approx([0.5, -0.5, 1.2], abs=0.05)
    assert room.bits() & 0x300 == 0x300  # flies, and has finished
    assert room.ask(HIGH_LEVEL, 0, bytes((11, 0)))[-1] == 8  # spirals it does not know


@pytest.mark.parametrize("packet", [(SUPERVISOR, 1, b"\x03"), (LOCALISATION, 1, b"\x03")])
def test_an_emergency_stop_locks_it_where_it_is(packet: tuple[int, int, bytes]) -> None:
    room = Room()
    room.take_off()
    room.send(*packet)
    room.run(0.02)
    assert room.stage == "LOCKED"
    room.run(1.0)
    assert room.place[2] == pytest.approx(0.0, abs=0.01)
    room.world.reboot(0)
    room.run(1.0)
    assert room.stage == "READY"


def test_an_emergency_watchdog_that_is_fed_once_has_to_be_fed_again() -> None:
    room = Room()
    room.take_off()
    room.send(SUPERVISOR, 1, b"\x04")
    after_s, stage = room.stages(2.0)[-1]
    assert stage == "LOCKED"
    assert 0.98 <= after_s <= 1.06


def test_a_motor_that_fails_turns_it_over_and_that_is_told() -> None:
    room = Room()
    room.take_off()
    room.world.inject(*parse_faults("[{kind: motor_failure}]", "here"))
    room.run(3.0)
    assert room.stage == "CRASHED"
    assert room.bits() >> TUMBLED & 1
    assert room.ask(SUPERVISOR, 1, b"\x02") == b"\x82\x00\x00"  # it does not come back


def test_arming_by_request_where_it_does_not_arm_itself() -> None:
    room = Room()
    number = _number(room, PARAM, "system.autoArm")
    room.ask(PARAM, 2, struct.pack("<HB", number, 0))
    assert room.ask(SUPERVISOR, 1, b"\x01\x00") == b"\x81\x01\x00"
    room.run(0.1)
    room.take_off()
    assert room.place[2] == pytest.approx(0.0, abs=0.01)
    room.world.inject(Fault("arming_refused", at_s=0.0, for_s=1.0))
    assert room.ask(SUPERVISOR, 1, b"\x01\x01") == b"\x81\x00\x00"
    room.run(1.1)
    room.ask(HIGH_LEVEL, 0, bytes((3, 0)))
    assert room.ask(SUPERVISOR, 1, b"\x01\x01") == b"\x81\x01\x01"
    assert room.stage == "READY"
    room.run(31.0)
    assert room.stage == "CHECKS_PASS"  # 30 s without a flight


# -- positions from outside ------------------------------------------------------------------------------------------


def test_packed_poses_name_the_vehicles_that_they_are_for() -> None:
    room = Room(2, gps=False)
    variance = _log(room, "kalman.varPX", 2)
    assert next(variance) == pytest.approx(1.0)
    quaternion = struct.pack("<I", packed_quaternion(0.0, 0.0, 0.0, 1.0))
    bodies = [(1, (-500, 0, 0)), (2, (500, 0, 0))]
    packet = b"\x09" + b"".join(struct.pack("<Bhhh", who, *place) + quaternion for who, place in bodies)
    for _ in range(50):
        for vehicle in range(2):
            room.send(LOCALISATION, 1, packet, vehicle)
        room.run(0.01)
    for vehicle, (_, place) in enumerate(bodies):
        believed = room.world.autopilots[vehicle].body.senses.pos_enu_m
        assert believed == pytest.approx([v / 1000.0 for v in place], abs=0.02)
    assert next(variance) < 1e-4


def test_without_poses_it_loses_its_way_with_the_square_of_time() -> None:
    room = Room(gps=False)
    place = list(room.place)
    for k in range(350):
        x, y, z = room.place
        if k < 250:
            room.send(LOCALISATION, 0, struct.pack("<fff", x, y, z))
        if k == 100:
            room.send(HIGH_LEVEL, 0, struct.pack("<BBff?f", TAKE_OFF, 0, 1.0, 0.0, True, 2.0))
        room.run(0.02)
    place = room.place
    room.run(1.0)
    assert 0.2 < math.dist(place, room.place) < 3.0


# -- tables, logs, parameters ------------------------------------------------------------------------------------------


def _rows(room: Room, port: int) -> list[tuple[int, str]]:
    count, _ = struct.unpack("<HI", room.ask(port, 0, b"\x03")[1:])
    rows = []
    for k in range(count):
        answer = room.ask(port, 0, struct.pack("<BH", 2, k))
        rows.append((answer[3], answer[4:].rstrip(b"\0").replace(b"\0", b".").decode()))
    return rows


def _number(room: Room, port: int, name: str) -> int:
    return [row[1] for row in _rows(room, port)].index(name)


def _log(room: Room, name: str, seconds: float) -> Iterator[float]:
    kind, number = next((kind, k) for k, (kind, row) in enumerate(_rows(room, LOG)) if row == name)
    assert room.ask(LOG, 1, struct.pack("<BBBH", 6, 7, kind, number)) == b"\x06\x07\x00"
    assert room.ask(LOG, 1, bytes((3, 7, 10))) == b"\x03\x07\x00"
    return _values(room, seconds)


def _values(room: Room, seconds: float) -> Iterator[float]:
    while True:
        room.heard.clear()
        room.run(seconds / 10)
        yield struct.unpack("<f", [item for item in room.heard if item[0] & 0xF3 == LOG << 4 | 2][-1][5:])[0]


def test_log_blocks_come_at_their_rate_and_wrong_ones_are_refused() -> None:
    room = Room()
    values = _log(room, "stateEstimate.z", 10)
    assert next(values) == pytest.approx(0.0, abs=0.05)
    room.heard.clear()
    room.run(2.0)
    assert len(room.heard) == 20  # 100 ms
    stamps = [int.from_bytes(item[2:5], "little") for item in room.heard]
    assert np.diff(stamps).tolist() == [100] * 19
    assert room.ask(LOG, 1, struct.pack("<BBBH", 6, 7, 7, 0))[-1] == 17  # there is one
    assert room.ask(LOG, 1, struct.pack("<BBBH", 6, 8, 7, 999))[-1] == 2  # no such variable
    assert room.ask(LOG, 1, struct.pack("<BB", 6, 9) + struct.pack("<BH", 7, 0) * 7)[-1] == 7  # 28 bytes
    assert room.ask(LOG, 1, bytes((3, 99, 10)))[-1] == 2
    assert room.ask(LOG, 1, bytes((4, 7)))[-1] == 0
    room.heard.clear()
    room.run(1.0)
    assert room.heard == []


def test_parameters_are_read_written_and_kept_from_being_written() -> None:
    room = Room()
    rows = _rows(room, PARAM)
    assert [name for _, name in rows] == sorted(name for _, name in rows)
    numbers = {name: k for k, (_, name) in enumerate(rows)}
    x = numbers["posCtlPid.xVelMax"]
    assert struct.unpack("<HBf", room.ask(PARAM, 1, struct.pack("<H", x))) == (x, 0, 1.0)
    assert struct.unpack("<Hf", room.ask(PARAM, 2, struct.pack("<Hf", x, 1.5))) == (x, 1.5)
    assert struct.unpack("<BHBf", room.ask(PARAM, 3, struct.pack("<BH", 8, x))) == (8, x, 0, 1.0)
    fixed = numbers["cpu.flash"]
    assert rows[fixed][0] & 0x40
    assert struct.unpack("<HH", room.ask(PARAM, 2, struct.pack("<HH", fixed, 7))) == (fixed, 1024)
    assert room.ask(PARAM, 1, struct.pack("<H", 999))[-1] == 2
    assert room.ask(PARAM, 3, b"\x00led\x00bitmask\x00\x08\x05")[-1] == 0
    assert room.world.autopilots[0].params["led.bitmask"] == 5.0


@settings(max_examples=200, deadline=None)
@given(st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: math.hypot(*q) > 0.1))
def test_quaternions_come_back_as_they_went(q: tuple[float, float, float, float]) -> None:
    size = math.hypot(*q)
    back = unpacked_quaternion(packed_quaternion(*(v / size for v in q)))
    assert abs(sum(a * b / size for a, b in zip(q, back, strict=True))) == pytest.approx(1.0, abs=1e-4)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.binary(max_size=40), max_size=30))
def test_whatever_is_sent_to_it_nothing_breaks(datagrams: list[bytes]) -> None:
    room = Room()
    for data in datagrams:
        room.world.receive(0, data, room.world.now_ns)
    for port in range(16):
        for data in datagrams[:5]:
            for channel in range(3):
                room.send(port, channel, data)
    room.run(0.1)
    assert room.world.frame_errors == [0]
    assert all(1 <= len(item) <= 31 for item in room.heard)


def test_it_answers_from_its_first_moment_on() -> None:
    for real_boot, answers in ((False, [b"\xff"]), (True, [])):
        world = World(WorldConfig(vehicles=fleet(1, autopilot="crazyflie"), real_boot=real_boot), 1)
        world.receive(0, b"\xff", 0)
        assert [item.data for item in world.advance(8_000_000)] == answers


def test_it_says_that_it_is_there_when_a_scan_asks() -> None:
    room = Room()
    room.world.receive(0, b"\xff", room.world.now_ns)
    room.run(0.01)
    assert room.heard == [b"\xff"]
    assert room.ask(LINK, 0, b"echo") == b"echo"


def test_the_same_seed_gives_the_same_bytes() -> None:
    rooms = [Room(2, seed=5), Room(2, seed=5)]
    for room in rooms:
        _log(room, "stateEstimate.x", 10)
        room.take_off()
    assert rooms[0].heard == rooms[1].heard
    assert len(rooms[0].heard) > 20


def test_it_does_not_sign() -> None:
    with pytest.raises(ValueError, match="crazyflie does not sign, it speaks no MAVLink"):
        World(WorldConfig(vehicles=fleet(1, autopilot="crazyflie", signing_key=bytes(32))), 1)


def test_it_takes_off_out_of_rest_only_as_the_firmware_does() -> None:
    room = Room()
    takeoff, land = struct.pack("<BBff?f", 7, 0, 1.0, 0.0, True, 2.0), struct.pack("<BBff?f", 8, 0, 0.0, 0.0, True, 2.0)
    assert room.bits() & 0x700 == 0x200  # rests: has finished, is not disabled
    room.send(3, 0, bytes(14))  # a client closes its link
    room.run(0.1)
    assert room.bits() & 0x400
    assert room.ask(HIGH_LEVEL, 0, takeoff)[-1] == 1
    room.send(GENERIC, 1, struct.pack("<BI", 0, 0))
    assert room.ask(HIGH_LEVEL, 0, bytes((3, 0)))[-1] == 0
    assert room.ask(HIGH_LEVEL, 0, takeoff)[-1] == 0
    room.run(3.0)
    assert room.ask(HIGH_LEVEL, 0, takeoff)[-1] == 1
    assert [room.ask(HIGH_LEVEL, 0, land)[-1] for _ in range(2)] == [0, 1]
