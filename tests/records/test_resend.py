"""What `gs replay --to` sends: vehicles' words, and nothing that a vehicle could obey."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as dialect

from groundstation.app.replaying import stream
from groundstation.records.resend import TELLING, Passing
from groundstation.records.tlog import TlogWriter, read_tlog
from sitl.fleet import fleet
from sitl.world import World, WorldConfig

SECOND_NS = 1_000_000_000
POSES = ("LOCAL_POSITION_NED", "HEARTBEAT", "STATUSTEXT")


def orders(link: Any) -> list[bytes]:
    """All that a ground station may say to vehicle 1, among it what arms a PX4 and lets it climb."""
    messages = [
        dialect.MAVLink_heartbeat_message(dialect.MAV_TYPE_GCS, dialect.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3),
        dialect.MAVLink_param_set_message(1, 1, b"COM_DL_LOSS_T", 5.0, 9),
        dialect.MAVLink_param_request_list_message(1, 1),
        dialect.MAVLink_set_gps_global_origin_message(1, 470000000, 80000000, 450000),
        dialect.MAVLink_mission_count_message(1, 1, 1),
        dialect.MAVLink_mission_item_int_message(1, 1, 0, 6, 22, 0, 1, 0, 0, 0, 0, 470000000, 80000000, 10),
        dialect.MAVLink_mission_clear_all_message(1, 1),
        dialect.MAVLink_set_mode_message(1, 1, 393216),
        dialect.MAVLink_manual_control_message(1, 0, 0, 1000, 0, 0),
        dialect.MAVLink_rc_channels_override_message(1, 1, *[1500] * 8),
        dialect.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, 0x0DC7, 0, 0, 0, 0, 0, -1, 0, 0, 0, 0, 0),
        dialect.MAVLink_set_attitude_target_message(0, 1, 1, 0, [1, 0, 0, 0], 0, 0, 0, 0.9),
        dialect.MAVLink_file_transfer_protocol_message(0, 1, 1, [0] * 251),
        dialect.MAVLink_request_data_stream_message(1, 1, 0, 10, 1),
        dialect.MAVLink_timesync_message(0, 12345),
        dialect.MAVLink_ping_message(1, 1, 0, 0),
        dialect.MAVLink_setup_signing_message(1, 1, [7] * 32, 1),
        dialect.MAVLink_command_int_message(1, 1, 0, 400, 0, 0, 1, 0, 0, 0, 0, 0, 0),
        dialect.MAVLink_command_long_message(1, 1, dialect.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0),
        dialect.MAVLink_command_long_message(1, 1, dialect.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, *[float("nan")] * 3, 500),
    ]
    return [message.pack(link) for message in messages]


def sent_again(path: Path) -> tuple[list[bytes], Passing]:
    reader = read_tlog(path)
    passing = Passing(reader.survey())
    frames: list[bytes] = []
    stream(reader, passing, frames.append, lambda _: None)
    return frames, passing


def names_and_senders(frames: list[bytes]) -> set[tuple[str, int, int]]:
    """What pymavlink makes of them."""
    parser = dialect.MAVLink(None)
    messages = [message for frame in frames for message in parser.parse_buffer(frame) or ()]
    assert len(messages) == len(frames)
    return {(item.get_type(), item.get_srcSystem(), item.get_srcComponent()) for item in messages}


def write_log(path: Path, ground: tuple[int, int], *, native: bool) -> None:
    """A vehicle's words, and between them all orders of another ground station."""
    vehicle = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    says = [
        dialect.MAVLink_heartbeat_message(2, 12, 0x81, 393216, 4, 3).pack(vehicle),
        dialect.MAVLink_local_position_ned_message(5000, 1, 2, -3, 0, 0, 0).pack(vehicle),
        dialect.MAVLink_statustext_message(6, b"Takeoff detected").pack(vehicle),
    ]
    station = orders(dialect.MAVLink(None, srcSystem=ground[0], srcComponent=ground[1]))
    # Its heartbeat comes last: the whole log is looked at first.
    _write(path, says + station[1:] + says + station[:1], native=native)


def _write(path: Path, frames: list[bytes], *, native: bool) -> None:
    if native:
        with TlogWriter(path, 0) as writer:
            for k, frame in enumerate(frames):
                writer.received(0, "10.0.0.1:14550", frame, k * SECOND_NS // 10)
        return
    stamps = (1_700_000_000_000_000 + 100_000 * k for k in range(len(frames)))
    path.write_bytes(b"".join(struct.pack(">Q", stamp) + frame for stamp, frame in zip(stamps, frames, strict=True)))


@pytest.mark.parametrize("native", [False, True], ids=["foreign", "ours"])
@pytest.mark.parametrize("ground", [(42, 190), (255, 190), (1, 190), (1, 1), (250, 1)])
def test_nothing_that_a_ground_station_sent_is_sent_again(
    ground: tuple[int, int], *, native: bool, tmp_path: Path
) -> None:
    path = tmp_path / "flight.tlog"
    write_log(path, ground, native=native)
    frames, passing = sent_again(path)
    assert names_and_senders(frames) <= {(name, 1, 1) for name in POSES}
    if ground == (1, 1):  # a ground station that bears the vehicle's own ids: whose words are whose nobody can tell
        assert not frames
        return
    assert len(frames) == 6
    if native:  # in foreign logs it counts as sent, and what was sent is not looked at
        told = " ".join(passing.words())
        for name in ("COMMAND_LONG 2", "SET_POSITION_TARGET_LOCAL_NED 1", "PARAM_SET 1", "SET_GPS_GLOBAL_ORIGIN 1"):
            assert name in told


@pytest.mark.parametrize("native", [False, True], ids=["foreign", "ours"])
def test_what_an_autopilot_itself_asks_of_others_is_not_sent_again(*, native: bool, tmp_path: Path) -> None:
    """PX4 does send COMMAND_LONG, to cameras and gimbals; whoever hears it again obeys it as a vehicle's."""
    path, vehicle = tmp_path / "flight.tlog", dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    says = [
        dialect.MAVLink_heartbeat_message(2, 12, 0x81, 393216, 4, 3),
        dialect.MAVLink_command_long_message(1, 1, dialect.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0),
        dialect.MAVLink_command_long_message(0, 0, dialect.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 0, 5),
        dialect.MAVLink_local_position_ned_message(5000, 1, 2, -3, 0, 0, 0),
    ]
    _write(path, [message.pack(vehicle) for message in says], native=native)
    frames, passing = sent_again(path)
    assert names_and_senders(frames) == {("HEARTBEAT", 1, 1), ("LOCAL_POSITION_NED", 1, 1)}
    assert any("system 1, component 1" in line and "COMMAND_LONG 2" in line for line in passing.words())


def test_a_vehicle_that_hears_the_replay_stays_on_the_ground(tmp_path: Path) -> None:
    """The emulator as the witness: with the whole log it arms and climbs, with what is sent again it does neither."""
    path = tmp_path / "flight.tlog"
    write_log(path, (42, 190), native=True)

    def highest_m(frames: list[bytes]) -> float:
        world = World(WorldConfig(vehicles=tuple(fleet(1))), 1)
        world.advance(10 * SECOND_NS)
        for k, frame in enumerate(frames):
            world.receive(0, frame, 10 * SECOND_NS + k)
        height = 0.0
        for tick in range(100):
            world.advance(10 * SECOND_NS + (tick + 1) * SECOND_NS // 10)
            height = max(height, float(world.truth.pos_enu_m[0, 2]))
        return height

    log = mavutil.mavlink_connection(str(path), dialect="ardupilotmega")
    everything = []
    while (message := log.recv_msg()) is not None:
        everything.append(bytes(message.get_msgbuf()))
    log.close()
    assert highest_m(everything) > 0.5
    frames, _ = sent_again(path)
    assert frames
    assert highest_m(frames) < 0.05


def test_what_tells_asks_for_nothing() -> None:
    """By pymavlink's own definitions: nothing on the list is addressed to anybody, or sets anything."""
    types = {item.msgname: item for item in dialect.mavlink_map.values()}
    for name in TELLING:
        assert not {"target_system", "target", "target_component"} & set(types[name].fieldnames), name
        assert not name.startswith(("SET_", "COMMAND_", "MISSION_ITEM_INT", "PARAM_SET", "MANUAL_", "HIL_", "VISION_"))
