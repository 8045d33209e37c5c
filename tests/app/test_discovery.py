"""``gs vehicles``: what is there is found, named and ready for a mission file."""

from __future__ import annotations

import json
import math
import socket
from collections.abc import Iterator
from threading import Event, Thread

import pytest
import yaml

from groundstation.app.discovery import Discovery
from groundstation.mavlink.addresses import parse_address
from groundstation.mavlink.codec import Encoder
from groundstation.mission.plan.vehicle_spec import VehicleSpec
from sitl.server import Server
from sitl.world import VehicleConfig, World, WorldConfig
from tests.app.commands import gs
from tests.gateway.room import Room
from tests.mavlink.sender import COMPANION, INVALID, Sender
from tests.sitl.served import free_tcp_port, free_udp_port

MS = 1_000_000
SECOND = 1_000_000_000


def _world() -> World:
    vehicles = [
        VehicleConfig(sysid=3, autopilot="px4", pad_enu_m=(0.0, 0.0, 0.0)),
        VehicleConfig(sysid=7, autopilot="arducopter", streams="ardupilot", pad_enu_m=(5.0, -2.0, 0.0)),
    ]
    return World(WorldConfig(vehicles), 1)


def test_vehicles_of_both_kinds_are_found_with_their_places_as_a_block_for_a_mission() -> None:
    world = _world()
    discovery = Discovery([parse_address("udpin://0.0.0.0:14540")])
    for tick in range(1, 200):
        now_ns = tick * 20 * MS
        for sent in world.advance(now_ns):
            discovery.receive(0, f"emulator:{sent.vehicle_index}", sent.data, now_ns)
        for out in discovery.outgoing(now_ns):
            world.receive(int(out.peer.partition(":")[2]), b"".join(out.frames), now_ns)
    entries = [VehicleSpec.model_validate(entry) for entry in yaml.safe_load(discovery.block(4 * SECOND))["vehicles"]]
    assert [(entry.id, entry.autopilot, entry.origin) for entry in entries] == [
        (3, "px4", "gps"),
        (7, "arducopter", "gps"),
    ]
    assert math.dist(entries[1].pad_m, (5.0, -2.0, 0.0)) < 0.2
    assert [item.version for item in discovery.vehicles()] == ["1.17.0", "4.7.0"]
    assert discovery.doubles(4 * SECOND) == []


def test_a_crazyflie_behind_its_gateway_is_named_in_the_frame_of_its_room() -> None:
    room, discovery = Room(), Discovery([parse_address("udpin://0.0.0.0:14540")])
    for tick in range(1, 100):
        now_ns = room.now_ns + tick * 20 * MS
        for sent in room.gateway.advance(now_ns):
            discovery.receive(0, "gateway", sent.data, now_ns)
        for out in discovery.outgoing(now_ns):
            room.gateway.receive(0, b"".join(out.frames), now_ns)
    (entry,) = yaml.safe_load(discovery.block(now_ns))["vehicles"]
    assert (entry["autopilot"], entry["profile"], entry["origin"]) == ("crazyflie", "crazyflie", "team")


def test_two_under_one_id_are_named_on_one_link_and_on_two() -> None:
    discovery = Discovery([parse_address("udpin://0.0.0.0:14540"), parse_address("tcpout://10.0.0.1:5760")])
    beat = Encoder(4).encode("HEARTBEAT", type=2, autopilot=12)
    discovery.receive(0, "10.0.0.2:1", beat, SECOND)
    assert discovery.doubles(SECOND) == []
    discovery.receive(0, "10.0.0.3:1", beat, SECOND)
    discovery.receive(1, "10.0.0.1:5760", beat, SECOND)
    (line,) = discovery.doubles(2 * SECOND)
    assert line.startswith("system 4 is heard at 10.0.0.2:1 on udpin://0.0.0.0:14540 and 10.0.0.3:1 on udpin")
    assert "10.0.0.1:5760 on tcpout" in line
    assert discovery.doubles(20 * SECOND) == []


def test_two_under_one_id_are_left_out_of_the_block_and_the_others_are_not() -> None:
    discovery = Discovery([parse_address("udpin://0.0.0.0:14540")])
    for peer, sysid in (("a", 4), ("b", 4), ("c", 5)):
        discovery.receive(0, peer, Encoder(sysid).encode("HEARTBEAT", type=2, autopilot=12), SECOND)
    block = discovery.block(SECOND)
    assert "# system 4 is left out: more than one vehicle bears it" in block
    assert [entry["id"] for entry in yaml.safe_load(block)["vehicles"]] == [5]


def test_two_under_one_id_behind_one_radio_are_told_by_their_times() -> None:
    """Asked where they are, both answer: one has been running for a minute longer."""
    discovery = Discovery([parse_address("serial:///dev/ttyUSB0:57600")])
    radio, encoder = "/dev/ttyUSB0", Encoder(4)
    asked = 0
    for tick in range(1, 41):
        now_ns = tick * 100 * MS
        discovery.receive(0, radio, encoder.encode("HEARTBEAT", type=2, autopilot=3), now_ns)
        for _ in discovery.outgoing(now_ns):
            asked += 1
            for boot_ms in (100 * tick, 60_000 + 100 * tick):
                raw = encoder.encode("GLOBAL_POSITION_INT", time_boot_ms=boot_ms, lat=1, lon=1)
                discovery.receive(0, radio, raw, now_ns)
    assert asked > 4
    (line,) = discovery.doubles(4 * SECOND)
    assert line.startswith("system 4 is heard twice at /dev/ttyUSB0 on serial:///dev/ttyUSB0:57600: two times since")
    assert yaml.safe_load(discovery.block(4 * SECOND))["vehicles"] is None


def test_strangers_are_shown_and_not_written_down() -> None:
    discovery = Discovery([parse_address("udpin://0.0.0.0:14540")])
    discovery.receive(0, "a", Encoder(255, 190).encode("HEARTBEAT", type=6, autopilot=8), 0)
    discovery.receive(0, "b", Encoder(9).encode("HEARTBEAT", type=2, autopilot=4), 0)
    assert [item.sysid for item in discovery.vehicles()] == [9]
    assert yaml.safe_load(discovery.block(0))["vehicles"] is None


@pytest.fixture
def served() -> Iterator[int]:
    """An ArduCopter that listens for TCP, and nothing else."""
    port = free_tcp_port()
    stop = Event()
    config = WorldConfig([VehicleConfig(sysid=5, autopilot="arducopter", streams="ardupilot")])
    with Server(config, 1, tcp_port=port, udp=False) as server:
        thread = Thread(target=server.run, args=(stop,), daemon=True)
        thread.start()
        yield port
        stop.set()
        thread.join()


def test_the_command_finds_a_vehicle_over_tcp(
    served: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    url = f"tcpout://127.0.0.1:{served}"
    code, out, _ = gs(["vehicles", url, "--seconds", "3", "--json"], monkeypatch, capsys)
    assert code == 0
    answer = json.loads(out.splitlines()[-1])
    (vehicle,) = answer["vehicles"]
    assert (vehicle["id"], vehicle["autopilot"], vehicle["link"]) == (5, "arducopter", url)
    assert yaml.safe_load(answer["block"])["vehicles"][0]["id"] == 5


def test_the_command_fails_where_two_bear_one_id_and_names_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two vehicles under one id on one UDP port."""
    port = free_udp_port()
    stop = Event()
    config = WorldConfig([VehicleConfig(sysid=5)])
    with Server(config, 1, port=port) as one, Server(config, 2, port=port) as two:
        threads = [Thread(target=server.run, args=(stop,), daemon=True) for server in (one, two)]
        for thread in threads:
            thread.start()
        arguments = ["vehicles", f"udpin://127.0.0.1:{port}", "--seconds", "3", "--json"]
        code, out, err = gs(arguments, monkeypatch, capsys)
        stop.set()
        for thread in threads:
            thread.join()
    answer = json.loads(out.splitlines()[-1])
    assert code == 1
    assert "system 5 is heard at 127.0.0.1:" in err
    assert "system 5 is heard at" in answer["problems"][0]
    assert yaml.safe_load(answer["block"])["vehicles"] is None


def test_nobody_there_is_said_with_what_is_wrong_with_the_link(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))
        url = f"tcpout://127.0.0.1:{closed.getsockname()[1]}"
        code, out, err = gs(["vehicles", url, "--seconds", "0.5"], monkeypatch, capsys)
        json_code, json_out, _ = gs(["vehicles", url, "--seconds", "0.5", "--json"], monkeypatch, capsys)
    assert code == json_code == 1
    (line,) = json_out.splitlines()
    answer = json.loads(line)
    assert (answer["vehicles"], answer["exit_code"]) == ([], 1)
    assert "cannot connect: Connection refused" in answer["problems"][0]
    assert answer["error"].startswith("no vehicle was heard in 0.5 s")
    assert "cannot connect: Connection refused" in out
    assert "no vehicle was heard in 0.5 s" in err


def test_one_of_several_links_that_does_not_work_is_a_failure_with_the_others_found(
    served: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))
        dead = f"tcpout://127.0.0.1:{closed.getsockname()[1]}"
        urls = [f"tcpout://127.0.0.1:{served}", dead]
        code, out, err = gs(["vehicles", *urls, "--seconds", "3", "--json"], monkeypatch, capsys)
    assert code == 1
    (line,) = out.splitlines()
    answer = json.loads(line)
    assert [vehicle["id"] for vehicle in answer["vehicles"]] == [5]
    assert answer["error"].startswith(f"link {dead}: ")
    assert f"gs: link {dead}: " in err


def test_what_no_mission_takes_is_named_and_left_out_of_the_block() -> None:
    """Frames by pymavlink. On 1719c84 ids 0 and 251 were printed, and fixed wings as if they were multirotors."""
    discovery = Discovery([parse_address("udpin://0.0.0.0:14540")])
    for sysid, kind in ((0, 2), (1, 13), (2, 1), (3, 10), (4, 4), (250, 2), (251, 2), (255, 2)):
        discovery.receive(0, f"p{sysid}", Sender(sysid).heartbeat(kind=kind), SECOND)
    discovery.receive(0, "p7", Sender(7, 2).heartbeat(), SECOND)
    discovery.receive(0, "p8", Sender(8).heartbeat(kind=COMPANION, autopilot=INVALID), SECOND)
    discovery.receive(0, "p1", Sender(1, 2).heartbeat(), SECOND)  # a second one beside it
    discovery.receive(0, "p9", Sender(9).heartbeat(), SECOND)  # a helicopter of ArduPilot begins as a quadrotor
    discovery.receive(0, "p9", Sender(9).heartbeat(kind=4), SECOND)
    block = discovery.block(SECOND)
    assert [entry["id"] for entry in yaml.safe_load(block)["vehicles"]] == [1, 250]
    assert [VehicleSpec.model_validate(entry).id for entry in yaml.safe_load(block)["vehicles"]] == [1, 250]
    low, high = "missions take ids 1 to 250; give it one (MAV_SYS_ID, MAV_SYSID, SYSID_THISMAV)", "only multirotors"
    assert [line for line in discovery.unflown() if low in line] == [f"system {i}: {low}" for i in (0, 251, 255)]
    assert f"  # system 251 is left out: {low}\n" in block
    assert [line.partition(":")[0] for line in discovery.unflown() if high in line] == [
        f"system {i}" for i in (2, 3, 4, 9)
    ]
    assert "  # system 2 is left out: it says that it is a fixed wing (MAV_TYPE 1), and only multirotors" in block
    assert discovery.unflown()[-1].startswith(
        "system 7: heard as component 2 on udpin://0.0.0.0:14540, and an autopilot"
    )
    assert [item.sysid for item in discovery.vehicles()] == [0, 1, 2, 3, 4, 9, 250, 251, 255]
    assert discovery.vehicles()[1].type_name == "hexarotor (MAV_TYPE 13)"
