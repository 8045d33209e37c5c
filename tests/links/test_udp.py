"""UDP links: they deliver, never block, and never raise."""

from __future__ import annotations

import itertools
import select
import selectors
import socket
from collections.abc import Iterator
from contextlib import ExitStack

import pytest

from groundstation.core.errors import UserError
from groundstation.links import udp
from groundstation.links.link import LONGEST_OF_STRANGERS
from groundstation.links.steering import program, steer
from groundstation.links.udp import UdpLink, open_udp
from tests.links.alone import alone_on_a_port
from tests.links.waits import LIMIT_S, arrived_on


def _port_of(link_socket: socket.socket) -> int:
    return int(link_socket.getsockname()[1])


def _all_of(link: UdpLink) -> list[tuple[str, bytes]]:
    """All that lies in a link; a turn may give nothing where something is left out."""
    taken = []
    while link.behind or select.select(link.sources(), [], [], 0)[0]:
        taken += link.receive()
    return taken


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


def _flooded(link: UdpLink, stack: ExitStack, *, strangers: int, big: int) -> tuple[str, list[tuple[str, bytes]]]:
    """A vehicle that is known speaks while strangers send much; returns it and what is taken in one piece."""
    where = link.socket.getsockname()
    vehicle, other = (stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(2))
    vehicle.sendto(b"hello", where)
    ((peer, _),) = arrived_on(link)
    link.know([peer])
    for number in range(strangers):
        other.sendto(bytes(big), where)
        if number % 100 == 50:
            vehicle.sendto(b"position", where)
    return peer, arrived_on(link)


def test_those_that_are_known_come_before_a_flood_of_strangers() -> None:
    with open_udp("udpin://127.0.0.1:0") as link, ExitStack() as stack:
        peer, arrived = _flooded(link, stack, strangers=400, big=1_400)
        assert [data for _, data in arrived[:4]] == [b"position"] * 4
        assert {name for name, _ in arrived[:4]} == {peer}
        assert sum(len(data) for _, data in arrived) < 20_000  # strangers get what is left of the piece


def test_a_full_queue_of_strangers_takes_no_room_from_those_that_are_known() -> None:
    with open_udp("udpin://127.0.0.1:0") as link, ExitStack() as stack:
        if link.own is None:
            pytest.skip("this system's kernel does not sort datagrams")
        link.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4_096)
        peer, arrived = _flooded(link, stack, strangers=1_000, big=1_400)
        assert [item for item in arrived if item[0] == peer] == [(peer, b"position")] * 10


def test_without_the_kernel_strangers_wait_and_what_is_too_much_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(udp, "open_pair", alone_on_a_port)
    monkeypatch.setattr(udp, "_STRANGERS_BYTES", 60_000)
    with open_udp("udpin://127.0.0.1:0") as link, ExitStack() as stack:
        peer, arrived = _flooded(link, stack, strangers=200, big=1_000)
        taken = list(arrived)
        while link.behind or arrived:
            arrived = link.receive()
            taken += arrived
        assert [item for item in taken if item[0] == peer] == [(peer, b"position")] * 2
        assert len(taken) + link.errors == 202
        names = [name == peer for name, _ in taken]
        assert names[0]
        assert link.receive() == []


@pytest.mark.parametrize("alone", [False, True])
@pytest.mark.parametrize("piece", [1, 20, 10_000])
def test_what_a_vehicle_sent_before_it_was_known_comes_before_what_it_sends_then(
    piece: int, *, alone: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise old reports come between new ones, as if two vehicles had one name."""
    if alone:
        monkeypatch.setattr(udp, "open_pair", alone_on_a_port)
    with ExitStack() as stack:
        link = stack.enter_context(open_udp("udpin://127.0.0.1:0"))
        vehicles = [stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(3)]
        there = ("127.0.0.1", _port_of(link.socket))
        for vehicle in vehicles:
            vehicle.bind(("127.0.0.1", 0))

        def send(first: int, last: int) -> None:
            for number in range(first, last):
                for vehicle in vehicles:
                    vehicle.sendto(f"{number}".encode(), there)

        names = [f"127.0.0.1:{_port_of(vehicle)}" for vehicle in vehicles]
        send(0, 1)
        heard = [arrived_on(link)]
        send(1, 30)
        link.know(names[:1])
        send(30, 40)
        heard.append(link.receive(piece))
        link.know(names[:2])
        send(40, 50)
        while len(list(itertools.chain(*heard))) < 150:
            heard.append(link.receive(piece))
            assert heard[-1]
        for name in names:
            assert [int(data) for peer, data in itertools.chain(*heard) if peer == name] == list(range(50))


@pytest.mark.parametrize("alone", [False, True])
@pytest.mark.parametrize(("size", "count"), [(60_000, 400), (20_000, 800), (4_000, 2_500), (1_400, 3_000), (40, 6_000)])
def test_however_much_strangers_sent_nothing_of_a_vehicle_comes_behind_what_it_said_later(
    size: int, count: int, *, alone: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Time that runs back is how an autopilot looks that has started anew."""
    if alone:
        monkeypatch.setattr(udp, "open_pair", alone_on_a_port)
    with open_udp("udpin://127.0.0.1:0") as link, ExitStack() as stack:
        where = link.socket.getsockname()
        vehicle, other = (stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(2))
        numbers = itertools.count()
        vehicle.sendto(str(next(numbers)).encode(), where)
        taken = arrived_on(link)
        ((peer, _),) = taken
        for _ in range(count):
            other.sendto(bytes(size), where)
            vehicle.sendto(str(next(numbers)).encode(), where)
        link.know([peer])
        sent_then = [next(numbers) for _ in range(20)]
        for number in sent_then:
            vehicle.sendto(str(number).encode(), where)
        taken += _all_of(link)
        said = [int(data) for name, data in taken if name == peer]
        assert said == sorted(said)
        if link.own is not None:
            assert said[-20:] == sent_then


def test_old_datagrams_that_are_found_too_late_are_left_out_and_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(udp, "_SORTED_MAX", 10)
    with open_udp("udpin://127.0.0.1:0") as link, ExitStack() as stack:
        if link.own is None:
            pytest.skip("this system's kernel does not sort datagrams")
        vehicle = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        vehicle.sendto(b"0", link.socket.getsockname())
        said = arrived_on(link)
        peer = said[0][0]
        for number in range(1, 81):
            if number == 51:
                link.know([peer])
            vehicle.sendto(str(number).encode(), link.socket.getsockname())
        said += _all_of(link)
        assert [int(data) for _, data in said] == [*range(11), *range(51, 81)]
        assert link.too_late == link.errors == 40


def test_who_is_not_sorted_out_any_more_is_heard_through_the_other_socket() -> None:
    """The kernel's program has room for two thousand senders: one more is a stranger to it, and no less a vehicle."""
    with open_udp("udpin://127.0.0.1:0") as link, socket.socket(type=socket.SOCK_DGRAM) as vehicle:
        if link.own is None:
            pytest.skip("the kernel does not sort senders here")
        here = link.socket.getsockname()
        vehicle.bind(("127.0.0.1", 0))
        peer = f"127.0.0.1:{vehicle.getsockname()[1]}"
        vehicle.sendto(b"first", here)
        assert link.receive() == [(peer, b"first")]
        link.know([peer])
        vehicle.sendto(b"second", here)
        assert link.receive() == [(peer, b"second")]
        assert link.receive() == []
        steer(link.socket, [])  # as for one that does not fit any more
        vehicle.sendto(b"third", here)
        assert link.receive() == [(peer, b"third")]
        assert link.too_late == 0


def test_who_is_known_again_before_all_was_read_is_heard_in_order() -> None:
    with open_udp("udpin://127.0.0.1:0") as link, ExitStack() as stack:
        vehicle = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        vehicle.sendto(b"0", link.socket.getsockname())
        said = arrived_on(link)
        for number, known in enumerate((True, False, True), start=1):
            link.know([said[0][0]] if known else [])
            vehicle.sendto(str(number).encode(), link.socket.getsockname())
        said += _all_of(link)
        told = [int(data) for _, data in said]
        assert told == sorted(told)
        assert {0, 1, 3} <= set(told)


@pytest.fixture(params=[False, True], ids=["sorted by the kernel", "one queue for all"])
def two_senders(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> Iterator[tuple[UdpLink, socket.socket, socket.socket]]:
    """A link, a vehicle's socket and a stranger's."""
    if request.param:
        monkeypatch.setattr(udp, "open_pair", alone_on_a_port)
    with open_udp("udpin://127.0.0.1:0") as link, ExitStack() as stack:
        vehicle, other = (stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(2))
        yield link, vehicle, other


def test_long_datagrams_of_strangers_are_left_out_and_those_of_vehicles_are_not(
    two_senders: tuple[UdpLink, socket.socket, socket.socket],
) -> None:
    link, vehicle, other = two_senders
    where = link.socket.getsockname()
    longest, longer = bytes(LONGEST_OF_STRANGERS), bytes(LONGEST_OF_STRANGERS + 1)
    vehicle.sendto(longest, where)
    ((peer, data),) = arrived_on(link)
    assert data == longest
    assert link.left_out == ""
    link.know([peer])
    for item in (other, vehicle):
        item.sendto(longer, where)
        item.sendto(longest, where)
    taken = _all_of(link)
    assert [data for name, data in taken if name == peer] == [longer, longest]
    assert [data for name, data in taken if name != peer] == [longest]
    assert link.errors == 1
    assert link.left_out == "1 datagrams of unknown senders, longer than 4096 bytes"
    with open_udp("udpin://127.0.0.1:0", len(longer)) as link, socket.socket(type=socket.SOCK_DGRAM) as room:
        room.sendto(longer, link.socket.getsockname())
        assert [data for _, data in arrived_on(link)] == [longer]


def test_strangers_get_a_share_when_those_that_are_known_have_no_more(
    two_senders: tuple[UdpLink, socket.socket, socket.socket],
) -> None:
    link, vehicle, other = two_senders
    where = link.socket.getsockname()
    vehicle.sendto(b"hello", where)
    ((peer, _),) = arrived_on(link)
    link.know([peer])
    for _ in range(20):
        other.sendto(bytes(500), where)
        vehicle.sendto(bytes(500), where)
    turns = []
    while arrived := link.receive(4_096):
        turns.append([name == peer for name, _ in arrived])
    assert turns[0] == [True] * 9
    assert turns[1] == [True] * 9
    assert turns[2] == [True, True, *[False] * 3]
    assert all(turn == [False] * 3 for turn in turns[3:-1])
    assert sum(turn.count(False) for turn in turns) == 20


def test_whom_a_link_speaks_to_is_known_before_it_was_heard() -> None:
    with ExitStack() as stack:
        vehicle, other = (stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(2))
        vehicle.bind(("127.0.0.1", 0))
        link = stack.enter_context(open_udp(f"udpout://127.0.0.1:{_port_of(vehicle)}"))
        link.know([])  # nobody was heard yet
        where = ("127.0.0.1", _port_of(link.socket))
        for _ in range(20):
            other.sendto(bytes(1_000), where)
        vehicle.sendto(b"hello", where)
        assert arrived_on(link)[0] == (link.peers()[0], b"hello")


def test_who_moves_to_another_port_is_heard_there_and_known_then() -> None:
    with open_udp("udpin://127.0.0.1:0") as link, ExitStack() as stack:
        where = link.socket.getsockname()
        for _ in range(3):
            vehicle = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            vehicle.settimeout(LIMIT_S)
            for again in range(2):
                vehicle.sendto(b"hello", where)
                ((peer, data),) = arrived_on(link)
                assert (peer, data) == (f"127.0.0.1:{_port_of(vehicle)}", b"hello"), again
                link.know([peer])
            link.send(peer, b"answer")
            assert vehicle.recv(100) == b"answer"


def _choice(steps: list[tuple[int, int, int, int]], host: str, port: int, first_byte: int = 0x45) -> int:
    """Runs a classic BPF program over an IPv4 and UDP header; written anew from the description in linux/filter.h."""
    header = bytes([first_byte]) + bytes(11) + socket.inet_aton(host) + bytes(4) + port.to_bytes(2, "big") + bytes(6)
    register, at = 0, 0
    for _ in range(10_000):
        code, true, false, k = steps[at]
        at += 1
        if code in (0x30, 0x28, 0x20):
            start = k - (1 << 32) + 0x100000
            register = int.from_bytes(header[start : start + {0x30: 1, 0x28: 2, 0x20: 4}[code]], "big")
        elif code == 0x15:
            at += true if register == k else false
        elif code == 0x05:
            at += k
        elif code == 0x06:
            return k
    raise AssertionError("does not end")


def test_the_program_knows_whom_it_was_told_and_no_others() -> None:
    known = [("10.0.0.1", 14580), ("10.0.0.1", 14581), ("10.0.0.2", 14580), ("192.168.1.255", 1), ("not a number", 5)]
    steps = program(known)
    for host, port in itertools.product(
        ("10.0.0.1", "10.0.0.2", "192.168.1.255", "10.0.0.3"), (14580, 14581, 1, 2, 65535)
    ):
        assert _choice(steps, host, port) == ((host, port) in known), (host, port)
    assert _choice(steps, "10.0.0.1", 14580, 0x46) == 0
    assert _choice(program([]), "10.0.0.1", 14580) == 0


def test_a_program_of_a_thousand_vehicles_fits_and_takes_those_that_do() -> None:
    known = [("10.0.0.1", 1_000 + number) for number in range(1_000)]
    assert all(_choice(program(known), *item) == 1 for item in known[::97])
    many = [(f"10.0.{number // 200}.{number % 200 + 1}", 5) for number in range(1_000)]
    assert len(program(many)) <= 4_096
    assert _choice(program(many), *many[0]) == 1
    with open_udp("udpin://127.0.0.1:0") as link:
        link.know([])
        assert link.receive() == []
