"""UDP links: they deliver, never block, and never raise."""

from __future__ import annotations

import selectors
import socket
from contextlib import ExitStack

import pytest

from groundstation.core.errors import UserError
from groundstation.links import udp
from groundstation.links.udp import open_udp
from tests.links.waits import LIMIT_S, arrived_on


def _port_of(link_socket: socket.socket) -> int:
    return int(link_socket.getsockname()[1])


def test_what_arrives_comes_with_its_sender_and_the_answer_goes_back_there() -> None:
    with open_udp("udpin://127.0.0.1:0") as link, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:
        vehicle.bind(("127.0.0.1", 0))
        vehicle.settimeout(5.0)
        vehicle.sendto(b"one", ("127.0.0.1", _port_of(link.socket)))
        vehicle.sendto(b"two", ("127.0.0.1", _port_of(link.socket)))
        with selectors.DefaultSelector() as selector:
            selector.register(link.socket, selectors.EVENT_READ)
            assert selector.select(5.0)
        arrived = link.receive()
        peer = f"127.0.0.1:{_port_of(vehicle)}"
        assert arrived == [(peer, b"one"), (peer, b"two")]
        assert link.receive() == []
        link.send(peer, b"answer")
        assert vehicle.recv(100) == b"answer"


def test_a_peer_that_went_away_or_was_never_heard_costs_a_count_and_nothing_else() -> None:
    with open_udp("udpin://127.0.0.1:0") as link:
        link.send("127.0.0.1:1", b"to nobody")
        assert link.errors == 1
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:
            vehicle.sendto(b"hello", ("127.0.0.1", _port_of(link.socket)))
            with selectors.DefaultSelector() as selector:
                selector.register(link.socket, selectors.EVENT_READ)
                assert selector.select(5.0)
            ((peer, _),) = link.receive()
        for _ in range(3):
            link.send(peer, b"gone")
        link.receive()


@pytest.mark.parametrize(
    "url", ["udpin://", "udpin://host", "udpin://127.0.0.1:x", "udpin://[", "tcp://1.2.3.4:5", "x"]
)
def test_addresses_of_another_form_are_refused(url: str) -> None:
    with pytest.raises(UserError, match="expected udpin://HOST:PORT"):
        open_udp(url)


def test_a_port_in_use_is_told() -> None:
    with open_udp("udpin://127.0.0.1:0") as link:
        url = f"udpin://127.0.0.1:{_port_of(link.socket)}"
        with pytest.raises(UserError, match=r"cannot listen.*another ground station"):
            open_udp(url)


def test_a_flood_of_addresses_does_not_make_a_vehicle_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    """Who was spoken to stays known; of the others the oldest goes."""
    monkeypatch.setattr(udp, "_PEERS_MAX", 4)
    with open_udp("udpin://127.0.0.1:0") as link, ExitStack() as stack:
        port = link.socket.getsockname()[1]
        sockets = [stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(8)]
        for item in sockets:
            item.bind(("127.0.0.1", 0))
        vehicle = sockets[0]
        vehicle.sendto(b"hello", ("127.0.0.1", port))
        ((peer, _),) = arrived_on(link)
        link.send(peer, b"first")
        for item in sockets[1:]:
            item.sendto(b"x", ("127.0.0.1", port))
            arrived_on(link)
        link.send(peer, b"second")
        assert link.errors == 0
        assert len(link._addresses) == 4
        vehicle.settimeout(LIMIT_S)
        assert [vehicle.recv(100), vehicle.recv(100)] == [b"first", b"second"]
