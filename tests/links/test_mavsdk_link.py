"""The link through MAVSDK, in real time: frames pass both ways, setpoints are repeated, and not for long."""

from __future__ import annotations

import select
import socket
from collections.abc import Iterator
from contextlib import closing

import pytest

from groundstation.core.errors import UserError
from groundstation.links.link import Link
from groundstation.links.opening import open_link
from groundstation.mavlink.codec import Encoder, Frame, FrameSplitter, decode, message_id
from tests.links.waits import LIMIT_S, arrived_on

SETPOINT = message_id("SET_POSITION_TARGET_LOCAL_NED")
TIMESYNC = message_id("TIMESYNC")


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture
def ends() -> Iterator[tuple[Link, socket.socket]]:
    """A link and a vehicle, number 7, that it has heard."""
    port = _free_port()
    with (
        closing(open_link(f"mavsdk://udpin://127.0.0.1:{port}")) as link,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle,
    ):
        vehicle.connect(("127.0.0.1", port))
        beat = Encoder(7).encode("HEARTBEAT", type=2, autopilot=12, base_mode=0x81, mavlink_version=3)
        vehicle.send(beat)
        heard = b""
        while beat not in heard:
            heard += b"".join(data for _, data in arrived_on(link))
        assert link.state == ""
        yield link, vehicle


def _frames(vehicle: socket.socket, limit_s: float) -> list[Frame] | None:
    """Frames of the next datagram, None when none comes."""
    if not select.select([vehicle], [], [], limit_s)[0]:
        return None
    return [piece for piece in FrameSplitter().feed(vehicle.recv(65536)) if isinstance(piece, Frame)]


def _until(vehicle: socket.socket, msgid: int) -> Frame:
    while True:
        frames = _frames(vehicle, LIMIT_S)
        assert frames is not None, "nothing came"
        for frame in frames:
            if frame.msgid == msgid:
                return frame


def test_frames_pass_as_they_are_both_ways(ends: tuple[Link, socket.socket]) -> None:
    link, vehicle = ends
    raw = Encoder(255, 190).encode("TIMESYNC", tc1=0, ts1=123_456)
    link.send(link.peers()[0], raw)
    while _until(vehicle, TIMESYNC).raw != raw:
        pass
    answer = Encoder(7).encode("TIMESYNC", tc1=9, ts1=123_456)
    vehicle.send(answer)
    heard = b""
    while answer not in heard:
        heard += b"".join(data for _, data in arrived_on(link))


def test_setpoints_are_repeated_by_mavsdk_and_end_when_we_have_stopped(ends: tuple[Link, socket.socket]) -> None:
    link, vehicle = ends
    encoder = Encoder(255, 190)
    raw = encoder.encode(
        "SET_POSITION_TARGET_LOCAL_NED", target_system=7, target_component=1, coordinate_frame=1, type_mask=0x09C7,
        vx=0.5, vy=-0.25, vz=0.125, yaw=1.5,
    )  # fmt: skip
    link.service(0)
    link.send(link.peers()[0], raw)
    for _ in range(3):
        frame = _until(vehicle, SETPOINT)
        (batch,) = decode([frame])
        values = batch.values[0]
        assert (values["target_system"], values["coordinate_frame"]) == (7, 1)
        assert (values["vx"], values["vy"], values["vz"]) == (0.5, -0.25, 0.125)
        assert abs(values["yaw"] - 1.5) < 1e-5
    link.service(600_000_000)
    while _frames(vehicle, 0.0) is not None:
        pass
    quiet = _frames(vehicle, 0.2)
    assert not [frame for frame in quiet or [] if frame.msgid == SETPOINT]


def test_a_setpoint_for_somebody_who_is_not_there_is_counted(ends: tuple[Link, socket.socket]) -> None:
    link, _ = ends
    raw = Encoder(255, 190).encode("SET_POSITION_TARGET_LOCAL_NED", target_system=99, coordinate_frame=1)
    link.send(link.peers()[0], raw)
    assert link.errors == 1


def test_an_address_that_mavsdk_cannot_open_is_told() -> None:
    with pytest.raises(UserError, match="MAVSDK cannot open it"):
        open_link("mavsdk://serial:///dev/there_is_no_such_port:57600")
