"""Emulated vehicles that sign, as pymavlink's own connection meets them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from sitl.fleet import fleet
from sitl.world import World, WorldConfig

KEY = bytes(range(32))
SECOND = 1_000_000_000


class Peer:
    """A ground station of pymavlink's making in front of one emulated vehicle."""

    def __init__(self, key: bytes | None, *, autopilot: str = "px4", vehicle_key: bytes | None = KEY) -> None:
        (vehicle,) = fleet(1, autopilot=autopilot)
        self.world = World(WorldConfig(vehicles=(replace(vehicle, signing_key=vehicle_key),)), 1)
        self.mav = dialect.MAVLink(None, srcSystem=255, srcComponent=190)
        self.mav.robust_parsing = True
        self.use(key)
        self.now_ns = 0
        self.run(3.0)

    def use(self, key: bytes | None) -> None:
        signing = self.mav.signing
        signing.secret_key, signing.sign_outgoing, signing.link_id = key, key is not None, 9
        signing.timestamp = (self.world.state.unix_us() - 1_420_070_400_000_000) // 10

    def run(self, seconds: float) -> list[Any]:
        """Types of what is heard in that time; what pymavlink does not accept is BAD_DATA."""
        self.now_ns += round(seconds * SECOND)
        raw = b"".join(out.data for out in self.world.advance(self.now_ns))
        return self.mav.parse_buffer(bytearray(raw)) or []

    def ask(self) -> bool:
        """Whether the vehicle answers a PING."""
        ping = dialect.MAVLink_ping_message(1, self.now_ns // SECOND, 0, 0)
        self.world.receive(0, bytes(ping.pack(self.mav)), self.now_ns)
        return any(message.get_type() == "PING" for message in self.run(0.2))


@pytest.mark.parametrize("autopilot", ["px4", "arducopter"])
def test_all_that_vehicles_with_a_key_send_is_signed(autopilot: str) -> None:
    peer = Peer(KEY, autopilot=autopilot)
    messages = peer.run(2.0)
    assert len(messages) >= 2
    assert all(message.get_signed() and message.get_type() != "BAD_DATA" for message in messages)
    stranger = Peer(bytes(32), autopilot=autopilot)
    assert {message.get_type() for message in stranger.run(2.0)} == {"BAD_DATA"}


def test_vehicles_with_a_key_obey_signed_frames_only() -> None:
    assert Peer(KEY).ask()
    for key in (None, bytes(32)):
        peer = Peer(KEY)
        assert peer.ask()
        peer.use(key)
        refused = peer.world.signing[0].refused
        assert not peer.ask()
        assert peer.world.signing[0].refused == refused + 1


def test_a_frame_is_obeyed_once() -> None:
    peer = Peer(KEY)
    ping = bytes(dialect.MAVLink_ping_message(1, 5, 0, 0).pack(peer.mav))
    answers = []
    for _ in range(3):
        peer.world.receive(0, ping, peer.now_ns)
        answers.append(sum(message.get_type() == "PING" for message in peer.run(0.2)))
    assert answers == [1, 0, 0]


def test_setup_signing_gives_a_key_takes_it_and_is_refused_while_armed() -> None:
    peer = Peer(None, vehicle_key=None)
    assert peer.ask()

    def setup(key: bytes) -> None:
        message = dialect.MAVLink_setup_signing_message(1, 1, list(key), 0)
        peer.world.receive(0, bytes(message.pack(peer.mav)), peer.now_ns)
        peer.run(0.1)

    peer.world.autopilots[0].armed = True
    setup(KEY)
    assert not peer.world.signing[0].on
    peer.world.autopilots[0].armed = False
    setup(KEY)
    assert not peer.ask()
    peer.use(KEY)
    assert peer.ask()
    setup(bytes(32))
    assert not peer.world.signing[0].on


def test_radio_status_needs_no_signature_and_a_reboot_keeps_the_key() -> None:
    peer = Peer(KEY)
    peer.use(None)
    radio = dialect.MAVLink_radio_status_message(1, 1, 1, 1, 1, 1, 1)
    peer.world.receive(0, bytes(radio.pack(peer.mav)), peer.now_ns)
    peer.run(0.1)
    assert peer.world.signing[0].refused == 0
    peer.world.reboot(0)
    peer.run(3.0)
    assert not peer.ask()
    peer.use(KEY)
    assert peer.ask()
