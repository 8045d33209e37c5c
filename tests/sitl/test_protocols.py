"""What both personalities share: parameters, missions, versions of MAVLink, time, several ground stations."""

from __future__ import annotations

import itertools
import math
import struct
from typing import Any

import pytest

from groundstation.mavlink.codec import Encoder
from sitl.faults import Fault
from sitl.world import World
from tests.sitl.virtual_ground import Ground, arducopter, hovering, world

INT32, REAL32 = 6, 9


def _param(ground: Ground, name: str) -> Any:
    ground.send("PARAM_REQUEST_READ", target_system=1, target_component=1, param_id=name.encode(), param_index=-1)
    ground.run(0.04)
    message = ground.last("PARAM_VALUE")
    assert message.param_id == name
    return message


def _set(ground: Ground, name: str, value: float, kind: int) -> None:
    ground.send(
        "PARAM_SET", target_system=1, target_component=1, param_id=name.encode(), param_value=value, param_type=kind
    )
    ground.run(0.04)


def _bits(value: int) -> float:
    return float(struct.unpack("<f", struct.pack("<i", value))[0])


@pytest.mark.parametrize(("config", "count"), [(world(), 300), (arducopter(), 300)])
def test_all_parameters_arrive_within_a_second_or_so(config: Any, count: int) -> None:
    ground = Ground(config)
    ground.run(2.5)
    ground.send("PARAM_REQUEST_LIST", target_system=1, target_component=1)
    ground.run(1.0)
    values = [message for _, message in ground.all("PARAM_VALUE")]
    total = values[0].param_count
    assert total > count
    assert [message.param_index for message in values] == list(range(total))
    names = [message.param_id for message in values]
    assert names == sorted(set(names))
    assert max(map(len, names)) <= 16


def test_px4_integers_travel_bytewise_and_are_set_and_read_back() -> None:
    ground = Ground(world())
    ground.run(2.5)
    message = _param(ground, "COM_LOW_BAT_ACT")
    assert (message.param_type, struct.pack("<f", message.param_value)) == (INT32, struct.pack("<i", 0))
    message = _param(ground, "COM_OF_LOSS_T")
    assert (message.param_type, message.param_value) == (REAL32, 1.0)
    _set(ground, "COM_LOW_BAT_ACT", _bits(3), INT32)
    assert struct.pack("<f", _param(ground, "COM_LOW_BAT_ACT").param_value) == struct.pack("<i", 3)
    _set(ground, "COM_OF_LOSS_T", 0.5, REAL32)
    assert _param(ground, "COM_OF_LOSS_T").param_value == 0.5
    since = ground.t_s
    _set(ground, "NO_SUCH_ONE", 1.0, REAL32)
    assert ground.all("PARAM_VALUE", since_s=since + 1e-6) == []


def test_ardupilot_sends_real_floats_and_its_own_types() -> None:
    ground = Ground(arducopter())
    ground.run(2.5)
    for name, value, kind in (("DISARM_DELAY", 10.0, 2), ("RTL_ALT", 1500.0, 4), ("GUID_TIMEOUT", 3.0, REAL32)):
        message = _param(ground, name)
        assert (message.param_value, message.param_type) == (value, kind)
    _set(ground, "RTL_ALT", 2000.0, REAL32)
    message = _param(ground, "RTL_ALT")
    assert (message.param_value, message.param_type) == (2000.0, 4)


def test_a_changed_parameter_changes_the_behaviour() -> None:
    ground = hovering(3.0)
    _set(ground, "COM_OF_LOSS_T", 0.4, REAL32)
    ground.run(0.1)
    since = ground.t_s
    ground.stream = None
    ground.run(0.5)
    assert (2, "Failsafe activated\t") in ground.texts(since_s=since)


def _upload(ground: Ground, items: list[dict[str, Any]]) -> None:
    ground.send("MISSION_COUNT", target_system=1, target_component=1, count=len(items))
    for seq, item in enumerate(items):
        ground.run(0.04)
        assert ground.last("MISSION_REQUEST_INT").seq == seq
        ground.send("MISSION_ITEM_INT", target_system=1, target_component=1, seq=seq, **item)
    ground.run(0.04)
    assert ground.last("MISSION_ACK").type == 0


def _item(command: int, north_m: float = 0.0, up_m: float = 3.0, wait_s: float = 0.0) -> dict[str, Any]:
    return {
        "command": command, "frame": 6, "x": 473977420 + round(north_m * 90), "y": 85455940, "z": up_m,
        "param1": wait_s, "autocontinue": 1,
    }  # fmt: skip


def test_mission_up_and_down_and_flown() -> None:
    ground = Ground(world())
    ground.run(2.5)
    items = [_item(22), _item(16, 4.0), _item(16, 4.0, 4.0, 1.0), _item(21, 4.0, 0.0)]
    _upload(ground, items)
    ground.send("MISSION_REQUEST_LIST", target_system=1, target_component=1)
    ground.run(0.04)
    assert ground.last("MISSION_COUNT").count == 4
    for seq, item in enumerate(items):
        ground.send("MISSION_REQUEST_INT", target_system=1, target_component=1, seq=seq)
        ground.run(0.04)
        message = ground.last("MISSION_ITEM_INT")
        assert (message.seq, message.command, message.x, message.z) == (seq, item["command"], item["x"], item["z"])
    assert ground.ask(400, 1) == 0
    assert ground.ask(300) == 0
    ground.run_until(lambda: not ground.world.truth.armed[0], 60.0)
    assert [m.seq for _, m in ground.all("MISSION_ITEM_REACHED")] == [0, 1, 2]
    assert ground.world.truth.pos_enu_m[0] == pytest.approx([0.0, 4.05, 0.0], abs=0.6)


def test_mission_of_arducopter_starts_behind_its_home_item() -> None:
    ground = Ground(arducopter())
    ground.run(2.5)
    _upload(ground, [_item(16), _item(22), _item(20)])
    assert ground.ask(176, 1, 4) == 0
    assert ground.ask(400, 1) == 0
    assert ground.ask(300) == 0
    ground.run_until(lambda: ground.height() > 2.5, 20.0)
    ground.run_until(lambda: not ground.world.truth.armed[0], 60.0)
    assert [m.seq for _, m in ground.all("MISSION_ITEM_REACHED")] == [1]


def test_mission_upload_survives_a_bad_link() -> None:
    ground = Ground(world(faults=(Fault("loss", numbers={"probability": 0.4}),)), seed=4)
    ground.run(2.5)
    items = [_item(22), *[_item(16, float(k)) for k in range(8)]]
    answered = 0
    for _ in range(500):
        if not ground.all("MISSION_REQUEST_INT"):
            ground.send("MISSION_COUNT", target_system=1, target_component=1, count=len(items))
        asked = ground.all("MISSION_REQUEST_INT")
        for _, request in asked[answered:]:
            ground.send("MISSION_ITEM_INT", target_system=1, target_component=1, seq=request.seq, **items[request.seq])
        answered = len(asked)
        ground.run(0.04)
    assert [item["command"] for item in ground.world.autopilots[0].mission.items] == [item["command"] for item in items]


def test_mission_clear_and_empty() -> None:
    ground = Ground(world())
    ground.run(2.5)
    _upload(ground, [_item(22)])
    ground.send("MISSION_CLEAR_ALL", target_system=1, target_component=1)
    ground.send("MISSION_REQUEST_LIST", target_system=1, target_component=1)
    ground.run(0.04)
    assert ground.last("MISSION_COUNT").count == 0


def test_mavlink_1_goes_out_and_comes_in() -> None:
    ground = Ground(world(mavlink_version=1), version=1)
    ground.run(2.5)
    assert {frame.version for _, _, frame in ground.raw} == {1}
    assert ground.ask(400, 1) == 0
    assert ground.last("SYS_STATUS").battery_remaining == 100
    assert ground.count()["ODOMETRY"] == 0  # its id does not exist in MAVLink 1


def test_version_0_speaks_1_until_spoken_to_in_2() -> None:
    ground = Ground(world(mavlink_version=0))
    ground.run(1.5)
    assert {frame.version for _, _, frame in ground.raw} == {1}
    ground.send("HEARTBEAT", type=6, autopilot=8)
    before = ground.t_s
    ground.run(1.0)
    assert {frame.version for t, _, frame in ground.raw if t > before + 0.02} == {2}


def test_mavlink_1_is_understood_by_a_vehicle_that_sends_2() -> None:
    ground = Ground(world(), version=1)
    ground.run(2.5)
    assert ground.ask(400, 1) == 0


def test_several_ground_stations_are_answered_by_their_own_address() -> None:
    ground = Ground(world())
    ground.run(2.5)
    other = Encoder(42, 7)
    fields = {"target_system": 1, "target_component": 1, "command": 512, "param1": 148}
    ground.world.receive(0, other.encode("COMMAND_LONG", **fields), ground.now_ns, "other")
    ground.command(512, 148)
    ground.run(0.1)
    acks = [m for _, m in ground.all("COMMAND_ACK")]
    assert [(m.target_system, m.target_component) for m in acks] == [(42, 7), (255, 190)]


def test_kill_by_flight_termination() -> None:
    ground = hovering(3.0)
    assert ground.ask(185, 1) == 0
    assert not ground.world.truth.armed[0]
    ground.run(1.5)
    assert ground.height() == 0.0


def test_reboot_command_on_the_ground_only() -> None:
    ground = hovering(3.0)
    assert ground.ask(246, 1) == 2
    ground = Ground(world())
    ground.run(3.0)
    assert ground.ask(246, 1) == 0
    ground.run(0.02)
    silent_from = ground.t_s
    ground.run(3.0)
    boots = [m.time_boot_ms for _, m in ground.all("ATTITUDE", since_s=silent_from)]
    assert boots[0] < 300
    assert ground.ask(400, 1) == 0


def test_sequence_numbers_count_every_frame() -> None:
    ground = Ground(world())
    ground.run(3.0)
    ground.ask(512, 148)
    sequence = [frame.seq for _, _, frame in ground.raw]
    assert all((a + 1) % 256 == b for a, b in itertools.pairwise(sequence))


def test_gps_position_is_the_pad_on_the_globe() -> None:
    import pymap3d

    ground = Ground(world(2))
    ground.run(2.5)
    for vehicle, east in ((0, 0.0), (1, 5.0)):
        lat, lon, alt = pymap3d.enu2geodetic(east, 0.0, 0.0, 47.397742, 8.545594, 488.0)
        for name in ("GLOBAL_POSITION_INT", "GPS_RAW_INT"):
            message = ground.last(name, vehicle)
            assert (message.lat, message.lon) == pytest.approx((lat * 1e7, lon * 1e7), abs=1)
            assert message.alt == pytest.approx(alt * 1000, abs=2)
    assert ground.last("GLOBAL_POSITION_INT").hdg == pytest.approx(0, abs=1)


def test_world_is_what_a_mission_needs_it_to_be() -> None:
    team = World(world(2), 3)
    truth = team.truth
    assert truth.pos_enu_m.shape == truth.vel_enu_m_s.shape == (2, 3)
    assert truth.quat.shape == (2, 4)
    assert truth.airborne.tolist() == truth.armed.tolist() == [False, False]


@pytest.mark.parametrize(
    ("x", "y", "refusal"),
    [
        (math.nan, 8.5, 10),
        (math.inf, 8.5, 10),
        (500.0, 8.5, 10),
        (1e30, 8.5, 10),
        (47.4, math.nan, 11),
        (47.4, -500.0, 11),
    ],
)
def test_a_mission_item_that_is_nowhere_is_refused_by_name(x: float, y: float, refusal: int) -> None:
    ground = Ground(world())
    ground.run(2.5)
    _upload(ground, [_item(22)])
    ground.send("MISSION_COUNT", target_system=1, target_component=1, count=1)
    ground.send("MISSION_ITEM", target_system=1, target_component=1, seq=0, command=16, frame=3, x=x, y=y, z=3.0)
    ground.run(0.04)
    assert ground.last("MISSION_ACK").type == refusal
    assert ground.world.frame_errors == [0]
    # the one before is still there
    assert [item["command"] for item in ground.world.autopilots[0].mission.items] == [22]
    for msg in ("MISSION_REQUEST_INT", "MISSION_REQUEST"):
        ground.send(msg, target_system=1, target_component=1, seq=0)
    ground.run(0.04)
    assert ground.last("MISSION_ITEM").x == pytest.approx(47.397742)


def test_a_frame_that_cannot_be_handled_ends_nothing_and_is_counted() -> None:
    ground = Ground(world(2))
    ground.run(2.5)

    def fails(_fields: Any, _frame: Any) -> None:
        raise ZeroDivisionError

    ground.world.autopilots[1].messages[4] = fails
    ground.world.receive(
        1,
        ground.encoder.encode("PING", seq=1)
        + ground.encoder.encode("COMMAND_LONG", target_system=2, target_component=1, command=512, param1=148),
        ground.now_ns,
    )
    ground.run(0.1)
    assert ground.world.frame_errors == [0, 1]
    assert ground.acks(1) == [(512, 0)]  # of the same datagram
    assert ground.ask(512, 148) == 0


def test_unknown_message_ids_are_skipped() -> None:
    ground = Ground(world())
    ground.run(2.5)
    unknown = bytes([0xFD, 3, 0, 0, 9, 255, 190, *(54321).to_bytes(3, "little"), 1, 2, 3, 0x12, 0x34])
    asks = ground.encoder.encode("COMMAND_LONG", target_system=1, target_component=1, command=512, param1=148)
    ground.world.receive(0, unknown + asks, ground.now_ns)
    ground.run(0.1)
    assert ground.acks() == [(512, 0)]
    assert ground.world.frame_errors == [0]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(
    ("config", "name"), [(world(), "MPC_LAND_SPEED"), (world(), "COM_OF_LOSS_T"), (arducopter(), "LAND_SPEED_HIGH")]
)
def test_parameters_that_are_no_numbers_are_refused(config: Any, name: str, value: float) -> None:
    ground = Ground(config)
    ground.run(2.5)
    before = _param(ground, name)
    _set(ground, name, value, before.param_type)
    assert ground.last("PARAM_VALUE").param_value == before.param_value
    assert _param(ground, name).param_value == before.param_value


def test_px4_takes_parameters_of_their_own_type_only() -> None:
    ground = Ground(world())
    ground.run(2.5)
    before = ground.t_s
    _set(ground, "COM_OF_LOSS_T", _bits(5), INT32)
    _set(ground, "COM_LOW_BAT_ACT", 3.0, REAL32)
    told = [(m.param_id, m.param_value) for _, m in ground.all("PARAM_VALUE", since_s=before)]
    assert told == [("COM_OF_LOSS_T", 1.0), ("COM_LOW_BAT_ACT", 0.0)]


@pytest.mark.parametrize("kind", [1, 2])
def test_fences_and_rally_points_are_kept_beside_the_mission_and_leave_it_alone(kind: int) -> None:
    ground = Ground(world())
    ground.run(2.5)
    _upload(ground, [_item(22), _item(16)])
    command, vertices = (5001, 3.0) if kind == 1 else (5100, 0.0)

    def put(count: int, *commands: int) -> list[int]:
        """Uploads items of these commands; returns how that was answered."""
        before = ground.t_s
        ground.send("MISSION_COUNT", target_system=1, target_component=1, mission_type=kind, count=count)
        for seq, item in enumerate(commands):
            ground.run(0.04)
            ground.send(
                "MISSION_ITEM_INT", target_system=1, target_component=1, mission_type=kind, seq=seq, command=item,
                frame=0, param1=vertices, x=473977420 + seq, y=85455940,
            )  # fmt: skip
        ground.run(0.04)
        return [m.type for _, m in ground.all("MISSION_ACK", since_s=before) if m.mission_type == kind]

    assert put(3, command, command, command) == [0]
    assert put(2, command, 16) == [3]  # a waypoint is no part of either
    assert put(2, command, command) == ([1] if kind == 1 else [0])  # two corners enclose nothing
    ground.send("MISSION_REQUEST_LIST", target_system=1, target_component=1, mission_type=kind)
    ground.send("MISSION_REQUEST_INT", target_system=1, target_component=1, seq=1, mission_type=kind)
    ground.run(0.04)
    assert ground.last("MISSION_COUNT").count == (3 if kind == 1 else 2)
    told = ground.last("MISSION_ITEM_INT")
    assert (told.seq, told.command, told.x, told.mission_type) == (1, command, 473977421, kind)
    ground.send("MISSION_REQUEST_INT", target_system=1, target_component=1, seq=3, mission_type=kind)
    ground.run(0.04)
    assert (ground.last("MISSION_ACK").type, ground.last("MISSION_ACK").mission_type) == (13, kind)
    ground.send("MISSION_CLEAR_ALL", target_system=1, target_component=1, mission_type=kind)
    ground.run(0.04)
    assert (ground.last("MISSION_ACK").type, ground.world.autopilots[0].mission.beside[kind]) == (0, [])
    ground.send("MISSION_COUNT", target_system=1, target_component=1, mission_type=7, count=2)
    ground.run(0.04)
    assert (ground.last("MISSION_ACK").type, ground.last("MISSION_ACK").mission_type) == (3, 7)
    assert len(ground.world.autopilots[0].mission.items) == 2
    ground.send("MISSION_CLEAR_ALL", target_system=1, target_component=1, mission_type=255)
    ground.run(0.04)
    assert (ground.last("MISSION_ACK").type, ground.last("MISSION_ACK").mission_type) == (0, 255)
    assert ground.world.autopilots[0].mission.items == []


def test_another_mission_item_can_be_made_the_current_one() -> None:
    ground = Ground(world())
    ground.run(2.5)
    _upload(ground, [_item(22), _item(16, 40.0), _item(16, 3.0), _item(21, 3.0, 0.0)])
    assert ground.ask(224, 4) == 2
    assert ground.ask(224, -1) == 2
    assert ground.ask(400, 1) == 0
    assert ground.ask(300) == 0
    ground.run_until(lambda: ground.world.autopilots[0].mission.seq == 1, 20.0)
    ground.run(2.0)
    assert ground.ask(224, 2) == 0
    assert ground.last("MISSION_CURRENT").seq == 2
    ground.run_until(lambda: ground.world.autopilots[0].mission.seq == 3, 20.0)
    assert [m.seq for _, m in ground.all("MISSION_ITEM_REACHED")] == [0, 2]
    ground.send("MISSION_SET_CURRENT", target_system=1, target_component=1, seq=1)
    ground.run(0.04)
    assert ground.last("MISSION_CURRENT").seq == 1
