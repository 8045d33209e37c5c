"""Orders from a second terminal: who may give them, what becomes of them, and that no client holds up a tick."""

from __future__ import annotations

import json
import os
import socket
import stat
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from groundstation.app.order_client import flights, remove_stale, runtime_folder
from groundstation.app.order_socket import LINE_MAX, OrderSocket, prepare_folder
from groundstation.app.session import Session
from groundstation.core.errors import UserError
from groundstation.mission.runner import Runner
from tests.app.commands import gs
from tests.app.flights import pair

TICK_NS = 20_000_000


class Desk:
    """A flight that has not begun, and its socket."""

    def __init__(self, folder: Path, log: str = "/somewhere/a.tlog") -> None:
        self.session = Session(Runner(pair(), 0), None)
        self.about = {"mission": "first_flight2", "log": log, "pid": os.getpid(), "vehicles": [1, 2]}
        self.orders = OrderSocket(folder, self.about)
        self.now_ns = 0

    def tick(self) -> None:
        """What the loop does around a tick."""
        self.now_ns += TICK_NS
        self.orders.read()
        self.orders.apply(self.session, self.now_ns)
        self.session.tick(self.now_ns)
        self.orders.answer(self.session)

    def connect(self) -> socket.socket:
        client = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        client.settimeout(5.0)
        client.connect(str(self.orders.path))
        return client

    def ask(self, line: bytes) -> dict[str, Any]:
        with self.connect() as client:
            client.sendall(line)
            self.tick()
            answer = json.loads(client.makefile().readline())
        assert isinstance(answer, dict)
        return answer


def _is_cut_off(client: socket.socket) -> bool:
    try:
        return client.recv(100) == b""
    except ConnectionError:
        return True


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    item = Desk(tmp_path / "gs")
    with item.orders:
        yield item


def test_an_order_reaches_the_flight_and_is_answered(desk: Desk) -> None:
    answer = desk.ask(b'{"order": " Return "}\n')
    assert (answer["ok"], answer["order"], answer["phase"]) == (True, "return", "done")
    assert any("stopped by the operator" in text for text in answer["said"])
    assert desk.session.runner.outcome == "aborted"


@pytest.mark.parametrize(
    ("line", "why"),
    [
        (b'{"order": "dance"}\n', "operator command 'dance' is none of"),
        (b'{"order": "kill 9"}\n', "9 is no vehicle of this mission; those are 1, 2"),
        (b'{"order": "resume"}\n', "nothing is held"),
        (b'{"order": 3}\n', "expected a line"),
        (b"[1, 2]\n", "expected a line"),
        (b"hold\n", "expected a line"),
        (b"\xff\xfe\n", "expected a line"),
        (b'{"order": "\\ud800"}\n', "is none of"),
        (b'{"order": "kill \\udcff"}\n', "is no vehicle"),
        (b"[" * 900 + b"\n", "expected a line"),
    ],
)
def test_what_is_no_order_is_answered_in_words_and_changes_nothing(desk: Desk, line: bytes, why: str) -> None:
    answer = desk.ask(line)
    assert answer["ok"] is False
    assert why in answer["why"]
    assert desk.session.runner.outcome is None


def test_a_log_whose_name_is_no_text_is_told_all_the_same(tmp_path: Path) -> None:
    desk = Desk(tmp_path / "gs", log="/somewhere/u\udcff.tlog")
    with desk.orders:
        assert desk.ask(b'{"about": true}\n')["log"] == "/somewhere/u\udcff.tlog"


def test_only_the_owner_gets_in(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    assert stat.S_IMODE(desk.orders.path.parent.stat().st_mode) == 0o700
    assert stat.S_IMODE(desk.orders.path.stat().st_mode) == 0o600
    mine = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: mine + 1)  # the kernel says that the other end is me
    with desk.connect() as client:
        client.sendall(b'{"order": "return"}\n')
        desk.tick()
        assert _is_cut_off(client)
    assert desk.orders.refused == 1
    assert desk.session.runner.outcome is None


def test_a_folder_that_others_can_look_into_is_closed_and_one_of_others_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "gs"
    folder.mkdir(mode=0o755)
    prepare_folder(folder)
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    monkeypatch.setattr(os, "geteuid", lambda: 12345)
    with pytest.raises(PermissionError, match="not a folder of this user"):
        prepare_folder(folder)
    with pytest.raises(UserError, match="no orders from a second terminal"), Desk(folder).orders:
        pass


def test_a_link_in_place_of_the_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "gs").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(PermissionError):
        prepare_folder(tmp_path / "gs")


def test_sockets_of_flights_that_have_died_are_cleaned_up(desk: Desk) -> None:
    dead = desk.orders.path.with_name("99999.sock")
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as item:
        item.bind(str(dead))
    assert dead.exists()
    remove_stale(dead.parent)
    assert not dead.exists()
    assert desk.orders.path.exists()


def test_the_socket_goes_with_the_flight(tmp_path: Path) -> None:
    desk = Desk(tmp_path)
    with pytest.raises(ZeroDivisionError), desk.orders:
        raise ZeroDivisionError
    assert not desk.orders.path.exists()
    assert flights(tmp_path) == ([], [])


def test_a_client_that_floods_is_cut_off_until_the_next_tick_and_others_are_heard(desk: Desk) -> None:
    with desk.connect() as flood, desk.connect() as calm:
        flood.setblocking(False)
        sent = flood.send(b"\n" * 200_000)
        calm.sendall(b'{"order": "hold"}\n')
        for _ in range(100):
            desk.orders.read()
        taken = sum(4096 - client.budget for client in desk.orders._clients)
        assert sent > 100_000 > 4096 + 2 * LINE_MAX >= taken
        assert len(desk.orders.sources()) == 2  # the listener and the calm one: the loop does not spin
        desk.tick()
        assert json.loads(calm.makefile().readline())["order"] == "hold"


def test_a_line_without_an_end_and_a_client_that_never_reads_are_dropped(desk: Desk) -> None:
    with desk.connect() as endless, desk.connect() as deaf:
        endless.sendall(b"x" * 3 * LINE_MAX)
        for _ in range(3):
            desk.tick()
        assert _is_cut_off(endless)
        deaf.setblocking(False)
        for _ in range(3000):
            try:
                deaf.send(b'{"about": true}\n' * 4)
            except BlockingIOError:
                pass
            except OSError:
                break
            desk.tick()
        assert len(desk.orders._clients) == 0


def test_connections_are_few_and_the_silent_ones_make_room(desk: Desk) -> None:
    clients = []
    for _ in range(12):
        clients.append(desk.connect())
        desk.tick()
    assert len(desk.orders._clients) == 8
    assert desk.ask(b'{"about": true}\n')["mission"] == "first_flight2"
    for _ in range(600):
        desk.tick()
    assert len(desk.orders._clients) == 0
    for client in clients:
        client.close()


def test_one_who_asks_and_hangs_up_is_obeyed(desk: Desk) -> None:
    with desk.connect() as client:
        client.sendall(b'{"order": "return"}\n')
    desk.tick()
    assert desk.session.runner.outcome == "aborted"
    assert desk.orders.sources() == desk.orders.sources()[:1]


def test_the_folder_is_the_users_own(tmp_path: Path) -> None:
    assert runtime_folder({"XDG_RUNTIME_DIR": str(tmp_path)}, Path("/home/x")) == tmp_path / "gs"
    assert runtime_folder({"XDG_RUNTIME_DIR": "relative"}, Path("/home/x")) == Path("/home/x/.gs/run")
    assert runtime_folder({"XDG_RUNTIME_DIR": "/does/not/exist"}, Path("/home/x")) == Path("/home/x/.gs/run")
    assert runtime_folder({}, Path("/home/x")) == Path("/home/x/.gs/run")


# gs command


class Answering:
    """Stands in for the flights of a machine; those with ``!`` are suspended, and known by their process alone."""

    def __init__(self, *missions: str) -> None:
        self.orders: list[tuple[str, str]] = []
        self._found = [
            (Path(f"/run/{name}.sock"), {"mission": name, "log": f"/logs/{name}.tlog", "pid": k, "vehicles": [1, 3, 5]})
            for k, name in enumerate(missions, start=70)
            if not name.endswith("!")
        ]
        self._silent = [Path(f"/run/{name[:-1]}.sock") for name in missions if name.endswith("!")]

    def flights(self, _folder: Path) -> tuple[list[tuple[Path, dict[str, Any]]], list[Path]]:
        return self._found, self._silent

    def ask(self, path: Path, request: dict[str, Any], _timeout_s: float) -> dict[str, Any]:
        self.orders.append((path.stem, request["order"]))
        if request["order"] == "resume":
            return {"ok": False, "order": "resume", "why": "nothing is held", "said": []}
        return {"ok": True, "order": request["order"], "phase": "pause", "said": ["operator: hold"]}


@pytest.mark.parametrize(
    ("missions", "arguments", "code", "orders", "words"),
    [
        (["a"], ["hold"], 0, [("a", "hold")], "a: hold: taken, phase pause"),
        (["a"], ["land", "3"], 0, [("a", "land 3")], "taken"),
        (["a"], ["kill", "5", "3", "--yes"], 0, [("a", "kill 3 5")], "taken"),
        (["a"], ["move", "-1", "0", "-.50"], 0, [("a", "move -1 0 -0.5")], "taken"),
        (["a"], ["turn", "-90"], 0, [("a", "turn -90")], "taken"),
        (["a"], ["turn", "-90", "--yse"], 2, [], "--yse: unknown option, did you mean --yes?"),
        (["a"], ["turn", "-x"], 2, [], "-x: unknown option"),
        (["a"], ["move", "1"], 2, [], "move takes 3 numbers from -1000 to 1000, for example `move 1 0 0.5`"),
        (["a"], ["kill", "3"], 2, [], "add --yes where nobody can be asked"),
        (["a"], ["land", "4"], 2, [], "4 is no vehicle of this mission; those are 1, 3, 5"),
        (["a"], ["resume"], 1, [("a", "resume")], "a: resume: nothing is held"),
        ([], ["hold"], 1, [], "no flight of this user is under way on this machine"),
        (["a", "b"], ["hold"], 2, [], "choose one with --flight"),
        (["a", "b"], ["hold", "--flight", "b"], 0, [("b", "hold")], "b: hold: taken"),
        (["a", "b"], ["hold", "--flight", "b.tlog"], 0, [("b", "hold")], "b: hold: taken"),
        (["a", "b"], ["hold", "--flight", "70"], 0, [("a", "hold")], "a: hold: taken"),
        (["a", "b"], ["hold", "--flight", "c"], 1, [], "--flight c: no such flight answers; there are: a, log"),
        (["a", "9!"], ["hold", "--flight", "9"], 1, [], "--flight 9: process 9 does not answer"),
        (["a", "9!"], ["hold", "--flight", "c"], 1, [], "process 9 does not answer, and may be the one that is meant"),
        (["9!"], ["hold", "--flight", "c"], 1, [], "process 9 does not answer, and may be the one that is meant"),
        (["9!"], ["hold"], 1, [], "under way on this machine; process 9 does not answer"),
        (["8!", "9!"], ["hold"], 1, [], "processes 8, 9 do not answer"),
        (["a", "9!"], ["hold"], 0, [("a", "hold")], "process 9 does not answer"),
        (["9!"], [], 0, [], "process 9 does not answer"),
        (["a"], [], 0, [], "/logs/a.tlog"),
    ],
)
def test_gs_command(  # noqa: PLR0917 - a row of the table above
    missions: list[str],
    arguments: list[str],
    code: int,
    orders: list[tuple[str, str]],
    words: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    from groundstation.app.commands import command

    answering = Answering(*missions)
    monkeypatch.setattr(command, "flights", answering.flights)
    monkeypatch.setattr(command, "ask", answering.ask)
    monkeypatch.setattr(sys, "stdin", open(os.devnull))  # noqa: SIM115 - nobody can be asked
    got, out, err = gs(["command", *arguments, "--json"], monkeypatch, capsys)
    assert (got, answering.orders) == (code, orders)
    assert words in err
    assert "Traceback" not in err
    json.loads(out.splitlines()[-1])
