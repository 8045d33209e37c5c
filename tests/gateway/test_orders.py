"""Orders that must not get lost: asked for until they are answered, and told as each firmware understands them."""

from __future__ import annotations

from contextlib import nullcontext
from types import SimpleNamespace

import pytest

from groundstation.gateway.asked import Asked
from groundstation.gateway.bridge import Bridge
from groundstation.gateway.orders import Arm, EmergencyStop, GoTo, LandAt, Recover, SetpointsStop, TakeOff
from groundstation.gateway.packets import packet_of
from sitl.fleet import fleet
from sitl.world import World, WorldConfig
from tests.gateway.room import HOLD, Room

TAKE_OFF, LAND_AT, GO_TO = b"\x07", b"\x08", b"\x0c"


class _Deaf(World):
    """A vehicle that does not hear the first so many packets of a port that begin in a way."""

    port, begins, count = -1, b"", 0

    def receive(
        self, vehicle_index: int, data: bytes, now_ns: int, ground_station: str = "gcs", *, stream: bool = False
    ) -> None:
        if self.count and data[0] >> 4 == self.port and data[1:].startswith(self.begins):
            self.count -= 1
            return
        super().receive(vehicle_index, data, now_ns, ground_station, stream=stream)

    def loses(self, port: int, begins: bytes, count: int) -> None:
        self.port, self.begins, self.count = port, begins, count


def _room() -> tuple[Room, _Deaf]:
    world = _Deaf(WorldConfig(vehicles=fleet(1, autopilot="crazyflie")), 1)
    return Room(world=world), world


def test_a_takeoff_that_gets_lost_is_asked_for_again() -> None:
    room, world = _room()
    world.loses(8, TAKE_OFF, 2)
    room.fly()
    room.run(2.0)
    assert world.count == 0
    assert room.stage == "FLYING"
    assert room.place_enu_m[2] == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(("port", "begins"), [(8, LAND_AT), (7, b"\x00\x64")])  # the landing, and what goes before it
def test_a_landing_of_which_a_packet_gets_lost_is_no_fall(port: int, begins: bytes) -> None:
    room, world = _room()
    room.fly()
    room.setpoint = (0.1, 0.0, 0.0, None)
    room.run(1.0)
    world.loses(port, begins, 1 if port == 8 else 2)
    assert room.command(21) == 0
    room.run(8.0)
    assert world.count == 0
    assert room.stage in ("READY", "LANDED")
    assert "has landed" in room.texts()


def test_one_that_is_left_alone_stays_though_it_hears_that_at_the_third_time_only() -> None:
    room, world = _room()
    room.fly()
    room.setpoint = (0.2, 0.0, 0.0, None)
    room.run(1.0)
    world.loses(8, GO_TO, 2)
    room.setpoint = None
    room.run(1.5)
    north = room.place_enu_m[1]
    assert (room.bridge.pilot.mode, room.stage, world.count) == (HOLD, "FLYING", 0)
    room.run(5.0)
    assert room.place_enu_m[1] == pytest.approx(north, abs=0.1)


def test_what_is_answered_or_not_wanted_any_more_is_asked_for_once() -> None:
    asked, land, second = Asked(), LandAt(0.0, 2.0), 1_000_000_000
    asked.sent([land])
    assert asked.due(0) == []
    assert [asked.due(ms * 1_000_000) for ms in (100, 160, 200, 310)] == [[], [SetpointsStop()], [], [SetpointsStop()]]
    assert asked.due(second)[-1] == land
    assert asked.answered(8, 0) is None
    assert asked.due(3 * second) == []
    asked.sent([TakeOff(1.0, 2.0)])
    assert asked.answered(8, 0) is None  # of another one
    assert asked.answered(7, 16) == "its firmware refuses to take off: its supervisor lets it not"
    asked.sent([GoTo((0.0, 0.0, 0.0), True, 0.0, 1.0)])
    asked.sent([EmergencyStop()])
    assert (asked.due(4 * second), asked.due(9 * second)) == ([], [])


def test_a_kill_is_understood_by_firmware_without_a_port_for_its_supervisor() -> None:
    room, world = _room()
    room.fly()
    world.loses(9, b"", 1000)
    assert room.command(400, 0.0, 21196.0) == 0
    room.run(2.0)
    assert room.stage == "LOCKED"


@pytest.mark.parametrize("protocol", [10, 12])
def test_each_firmware_is_armed_brought_round_and_stopped_as_cflib_does_it(protocol: int) -> None:
    pytest.importorskip("cflib", reason="cflib is not installed")
    from cflib.crazyflie.supervisor import Supervisor

    sent: list[bytes] = []
    theirs = Supervisor(
        SimpleNamespace(
            add_port_callback=lambda *_: None,
            platform=SimpleNamespace(get_protocol_version=lambda: protocol),
            send_packet=lambda packet: sent.append(bytes((packet.header, *packet.data))),
        )
    )
    with pytest.warns() if protocol == 10 else nullcontext():
        theirs.send_arming_request(True)
        theirs.send_crash_recovery_request()
        theirs.send_emergency_stop()
    bridge = Bridge(1, 0)
    bridge.connected(protocol, {})
    bridge.pilot.orders += [Arm(True), Recover()]
    armed, recovered = (packet_of(order, {}) for order in bridge.take_orders())
    assert [armed, recovered] == sent[:2]
    bridge.pilot.kill()
    assert sent[2] in [packet_of(order, {}) for order in bridge.take_orders()]


def test_one_whose_last_client_has_closed_its_link_takes_off_all_the_same() -> None:
    room, world = _room()
    world.receive(0, b"\x3c" + bytes(14), room.now_ns)  # what cflib sends then: roll, pitch, yaw, thrust 0
    room.run(0.1)
    room.fly()
    assert room.stage == "FLYING"
