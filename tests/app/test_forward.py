"""Another ground station watches along: it hears what vehicles tell, reaches nobody, and costs no tick."""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from groundstation.app.emulator import world_config
from groundstation.app.forwarding import Forward
from groundstation.app.session import Session
from groundstation.core.errors import UserError
from groundstation.mavlink.addresses import LinkAddress, parse_address
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.reading import load_mission, plan_from_record
from groundstation.mission.runner import Runner
from sitl.world import World
from tests.app.flights import CUBE8, mission, pair, without_chatter

os.environ.setdefault("MAVLINK20", "1")
TICK_NS = 50_000_000


def _fly(plan: MissionPlan, ticks: int, onward: Callable[[bytes], None] | None, look: Any = None) -> list[bytes]:
    """The first ticks of a flight on the emulator; returns all that was sent to vehicles."""
    world = World(without_chatter(world_config(plan, 1)), 1)
    session = Session(Runner(plan, 0), None)
    session.onward = onward
    told: list[bytes] = []
    for tick in range(1, ticks + 1):
        now_ns = tick * TICK_NS
        for sent in world.advance(now_ns):
            row = sent.vehicle_index
            session.deliver(plan.link_of_vehicle[row], f"emulator:{row}", sent.data, sent.t_ns)
        for datagram in session.tick(now_ns):
            told.append(b"".join(datagram.frames))
            world.receive(int(datagram.peer.partition(":")[2]), told[-1], now_ns)
        if look is not None:
            look(tick)
    return told


def test_a_client_of_pymavlink_hears_both_vehicles_and_reaches_neither() -> None:
    from pymavlink import mavutil

    plan = pair(autopilots=("px4", "arducopter"))
    client = mavutil.mavlink_connection("udpin:127.0.0.1:0", source_system=254)
    port = client.port.getsockname()[1]
    heard: dict[tuple[int, str], int] = {}
    opened: list[socket.socket] = []

    def connect(address: LinkAddress) -> tuple[socket.socket, Callable[[bytes], object]]:
        own = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        opened.append(own)
        return own, lambda data: own.sendto(data, (address.host, address.port))

    def speak(tick: int) -> None:
        """What QGroundControl would do: land everybody, and ask for a list of parameters."""
        while (message := client.recv_match(blocking=False)) is not None:
            key = message.get_srcSystem(), message.get_type()
            heard[key] = heard.get(key, 0) + 1
        if heard:
            for system in (1, 2):
                client.mav.command_long_send(system, 1, 21, 0, 0, 0, 0, 0, 0, 0, 0)
                client.mav.param_request_list_send(system, 1)

    with Forward(parse_address(f"udpout://127.0.0.1:{port}"), connect) as forward:
        watched = _fly(plan, 100, forward.put, speak)
    speak(0)
    assert forward.lost == 0
    assert forward.words() == ""
    for system in (1, 2):
        assert heard[system, "HEARTBEAT"] >= 4
        assert heard[system, "GLOBAL_POSITION_INT"] + heard.get((system, "LOCAL_POSITION_NED"), 0) > 10
    # ArduCopter says something at its start that is no MAVLink; of ours there is nothing.
    assert {system for system, kind in heard if kind != "BAD_DATA"} == {1, 2}
    assert watched == _fly(plan, 100, None)  # to the byte what is sent without anybody watching
    client.close()


def test_frames_of_a_stream_and_signed_ones_are_forwarded_whole() -> None:
    plan = mission("hello1", "vehicles.0.link=tcpout://127.0.0.1:5760")
    got: list[bytes] = []
    session = Session(Runner(plan, 0), None)
    session.onward = got.append
    world = World(without_chatter(world_config(plan, 1)), 1)
    stream = b"".join(sent.data for sent in world.advance(2_000_000_000))
    for start in range(0, len(stream), 7):
        session.deliver(0, "127.0.0.1:5760", stream[start : start + 7], start)
    assert b"".join(got) == stream
    assert all(piece[0] == 0xFD for piece in got)


def test_an_other_end_that_takes_nothing_costs_no_tick_and_is_told() -> None:
    stuck, free = threading.Event(), threading.Event()

    def connect(address: LinkAddress) -> tuple[socket.socket, Callable[[bytes], object]]:
        def send(data: bytes) -> None:
            stuck.set()
            free.wait()
            raise OSError(101, "Network is unreachable")

        return socket.socket(socket.AF_INET, socket.SOCK_DGRAM), send

    forward = Forward(parse_address("udpout://127.0.0.1:9"), connect)
    with forward:
        forward.put(b"first")
        stuck.wait()
        for _ in range(10_000):  # with the thread stuck, each of these returns all the same
            forward.put(b"x")
        assert forward.lost == 8_000
        free.set()
    assert (
        forward.words()
        == "forward udpout://127.0.0.1:9: 10001 of 10001 datagrams were not sent: Network is unreachable"
    )


def test_an_address_that_nobody_has_is_told_and_no_more() -> None:
    def connect(address: LinkAddress) -> tuple[socket.socket, Callable[[bytes], object]]:
        raise OSError(-2, "Name or service not known")

    with Forward(parse_address("udpout://nowhere.invalid:14550"), connect) as forward:
        forward.put(b"x")
    assert forward.words().endswith("1 of 1 datagrams were not sent: Name or service not known")


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("udpout://127.0.0.1:14540", "port 14540 is that of the vehicles' link udpin://127.0.0.1:14540"),
        ("tcpout://127.0.0.1:14550", "expected udpout://HOST:PORT, for example udpout://127.0.0.1:14550"),
        ("udpin://127.0.0.1:14550", "expected udpout://HOST:PORT"),
        ("udpout://127.0.0.1:0", "expected udpout://HOST:PORT"),
        ("mavsdk://udpout://127.0.0.1:14550", "expected udpout://HOST:PORT"),
        ("QGroundControl", "expected udpout://HOST:PORT"),
    ],
)
def test_where_nobody_can_watch_from_is_refused(address: str, words: str) -> None:
    with pytest.raises(UserError) as refused:
        load_mission(CUBE8, [f"forward={address}"])
    assert f"{CUBE8}: forward: {address}: " in str(refused.value)
    assert words in str(refused.value)


def test_vehicles_links_and_records_know_of_it(tmp_path: Path) -> None:
    plan = load_mission(CUBE8, ["forward=udpout://127.0.0.1:14550"])
    assert plan.forward == parse_address("udpout://127.0.0.1:14550")
    assert plan_from_record(plan.record(), plan.gains_npz, "m").forward == plan.forward
    spoken = [f"vehicles.{k}.link=udpout://127.0.0.1:14550" for k in range(8)]
    with pytest.raises(UserError, match="is that of the vehicles' link udpout"):
        load_mission(CUBE8, ["forward=udpout://127.0.0.1:14550", *spoken])
