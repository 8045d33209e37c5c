"""TCP and serial links: they deliver, reconnect by themselves, and never send half a frame or raise into a flight."""

from __future__ import annotations

import os
import pty
import socket
import tty
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from groundstation.core.errors import UserError
from groundstation.links.link import BACKLOG_BYTES, RETRY_NS, STRANGERS_BYTES, Link
from groundstation.links.opening import open_link
from groundstation.links.serial_port import SerialLink
from groundstation.links.tcp import TcpClientLink, TcpServerLink
from groundstation.links.udp import UdpLink
from tests.links.waits import LIMIT_S, arrived_on


@pytest.fixture
def listener() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as item:
        item.bind(("127.0.0.1", 0))
        item.listen()
        item.settimeout(LIMIT_S)
        yield item


def _url(kind: str, item: socket.socket) -> str:
    return f"{kind}://127.0.0.1:{item.getsockname()[1]}"


def _accept(listener: socket.socket, link: Link, now_ns: int) -> socket.socket:
    link.service(now_ns)
    connection, _ = listener.accept()
    connection.settimeout(LIMIT_S)
    link.service(now_ns)
    return connection


def test_a_client_connects_by_itself_and_speaks_first(listener: socket.socket) -> None:
    link = open_link(_url("tcpout", listener))
    assert isinstance(link, TcpClientLink)
    assert link.sources() == ()
    with _accept(listener, link, 0) as vehicle:
        assert (link.state, len(link.sources())) == ("", 1)
        (peer,) = link.peers()
        link.send(peer, b"hello")
        assert vehicle.recv(100) == b"hello"
        vehicle.sendall(b"answer")
        assert arrived_on(link) == [(peer, b"answer")]
        assert link.receive() == []
    link.close()


def test_a_client_comes_back_when_the_other_end_does_and_not_in_a_hurry(listener: socket.socket) -> None:
    link = open_link(_url("tcpout", listener))
    _accept(listener, link, 0).close()
    assert arrived_on(link) == []
    assert link.state == "the other end closed the connection"
    assert link.sources() == ()
    link.send(link.peers()[0], b"into the void")
    assert link.errors == 2
    with _accept(listener, link, RETRY_NS) as vehicle:
        link.send(link.peers()[0], b"again")
        assert vehicle.recv(100) == b"again"
    link.close()


def test_a_client_without_an_other_end_says_so_and_tries_once_a_second() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as taken:
        taken.bind(("127.0.0.1", 0))  # bound and not listening: refused at once
        link = open_link(_url("tcpout", taken))
        link.service(0)
        link.service(1)
        assert link.state == "cannot connect: Connection refused"
        taken.listen()
        taken.settimeout(LIMIT_S)
        link.service(RETRY_NS // 2)
        assert link.state
        with _accept(taken, link, RETRY_NS + 2):
            assert link.state == ""
        link.close()


def test_whoever_does_not_read_loses_whole_datagrams_and_no_half_ones(listener: socket.socket) -> None:
    link = open_link(_url("tcpout", listener))
    with _accept(listener, link, 0) as vehicle:
        piece = bytes(range(250)) * 4
        sent = 0
        while link.errors == 0:
            link.send(link.peers()[0], piece)
            sent += 1
            assert sent < 100_000
        taken = sent - 1
        left = taken * len(piece)
        got = bytearray()
        while left > len(got):
            got += vehicle.recv(1 << 16)
            link.service(0)
        assert got == piece * taken
        assert len(got) > BACKLOG_BYTES
    link.close()


def test_connections_of_strangers_share_what_those_that_are_known_leave() -> None:
    link = open_link("tcpin://127.0.0.1:0")
    assert isinstance(link, TcpServerLink)
    with ExitStack() as stack:
        stack.callback(link.close)

        def connected() -> socket.socket:
            return stack.enter_context(socket.create_connection(link.listener.getsockname(), LIMIT_S))

        def name(item: socket.socket) -> str:
            return f"127.0.0.1:{item.getsockname()[1]}"

        vehicle, strangers = connected(), [connected() for _ in range(20)]
        assert link.receive() == []
        link.know([name(vehicle)])
        for item in strangers:
            item.sendall(bytes(5_000))
        vehicle.sendall(b"position")
        heard: set[str] = set()
        for turn in range(20):
            arrived = link.receive()
            if turn == 0:
                assert arrived[0] == (name(vehicle), b"position")
                arrived = arrived[1:]
            assert 0 < sum(len(data) for _, data in arrived) <= STRANGERS_BYTES
            heard.update(peer for peer, _ in arrived)
        assert heard == {name(item) for item in strangers}


def test_a_server_takes_whoever_connects_and_answers_each() -> None:
    link = open_link("tcpin://127.0.0.1:0")
    assert isinstance(link, TcpServerLink)
    assert link.state == "nobody has connected"
    where = link.listener.getsockname()
    with socket.create_connection(where, LIMIT_S) as one, socket.create_connection(where, LIMIT_S) as two:
        one.sendall(b"1")
        heard = arrived_on(link)
        while len(heard) < 1:
            heard += arrived_on(link)
        two.sendall(b"2")
        while len(heard) < 2:
            heard += arrived_on(link)
        assert {data for _, data in heard} == {b"1", b"2"}
        for peer, data in heard:
            link.send(peer, b"to " + data)
        assert one.recv(10) == b"to 1"
        assert two.recv(10) == b"to 2"
        one.close()
        while len(link.peers()) > 1:
            arrived_on(link)
    link.close()


class _Port:
    """A pty pair whose near end can be unplugged and plugged in again under the same name."""

    def __init__(self, name: Path) -> None:
        self.name = name
        self.far = -1
        self._near = -1

    def plug_in(self) -> None:
        self.far, self._near = pty.openpty()
        tty.setraw(self._near)
        self.name.symlink_to(os.ttyname(self._near))

    def unplug(self) -> None:
        self.name.unlink()
        os.close(self.far)
        os.close(self._near)


@pytest.fixture
def port(tmp_path: Path) -> Iterator[_Port]:
    item = _Port(tmp_path / "ttyUSB0")
    item.plug_in()
    yield item
    item.unplug()


def test_a_serial_port_carries_bytes_both_ways(port: _Port) -> None:
    link = open_link(f"serial://{port.name}:57600")
    assert isinstance(link, SerialLink)
    (peer,) = link.peers()
    os.write(port.far, b"from the vehicle")
    assert arrived_on(link) == [(peer, b"from the vehicle")]
    link.send(peer, b"\x00\x03\x04\x11\x13\xff\n\r")  # bytes that a terminal would act upon
    assert os.read(port.far, 100) == b"\x00\x03\x04\x11\x13\xff\n\r"
    link.close()


def test_a_serial_port_that_is_unplugged_is_found_again(port: _Port) -> None:
    link = open_link(f"serial://{port.name}:57600")
    port.unplug()
    assert arrived_on(link) == []
    assert "is gone; waiting for it to come back" in link.state
    assert link.sources() == ()
    link.send(link.peers()[0], b"lost")
    link.service(0)
    assert "cannot open" in link.state
    port.plug_in()
    link.service(1)
    assert link.sources() == ()
    link.service(RETRY_NS // 4)
    assert link.state == ""
    os.write(port.far, b"back")
    assert arrived_on(link) == [(link.peers()[0], b"back")]
    link.close()


def test_a_serial_port_that_is_not_there_yet_is_waited_for(tmp_path: Path) -> None:
    item = _Port(tmp_path / "ttyACM0")
    link = open_link(f"serial://{item.name}:115200")
    link.service(0)
    assert "No such file" in link.state
    item.plug_in()
    link.service(RETRY_NS)
    assert link.state == ""
    link.close()
    item.unplug()


def test_a_serial_port_that_cannot_be_opened_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("not a port")
    with pytest.raises(UserError, match=r"cannot open .*file.*is another program using it"):
        open_link(f"serial://{tmp_path / 'file'}:57600")


def test_a_speaking_udp_link_knows_its_peer_before_it_has_heard_it() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:
        vehicle.bind(("127.0.0.1", 0))
        vehicle.settimeout(LIMIT_S)
        link = open_link(_url("udpout", vehicle))
        assert isinstance(link, UdpLink)
        (peer,) = link.peers()
        link.send(peer, b"hello")
        data, address = vehicle.recvfrom(100)
        assert data == b"hello"
        vehicle.sendto(b"answer", address)
        assert arrived_on(link) == [(peer, b"answer")]
        link.close()
