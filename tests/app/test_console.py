"""The console: what a flight sends it, what it makes of that, and who may look or give orders."""

from __future__ import annotations

import asyncio
import os
import socket
from contextlib import suppress
from dataclasses import fields, replace
from itertools import groupby
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.app.console.feed import Feed, ghost_enu_m, largest_error_m, remove_dead, smallest_distance_m
from groundstation.app.console.guard import Guard, Keys, Message, Receive, Role, Scope, Send
from groundstation.app.console.helm import HelmSeat
from groundstation.app.console.link_loss import LinkLoss
from groundstation.app.console.snapshot import (
    AIRBORNE,
    BYTES_MAX,
    FIGURES,
    FOREIGN,
    NOTES_MAX,
    Snapshot,
    decode,
    encode,
)
from groundstation.app.console.viewers import Viewers
from groundstation.app.flying import fly_dry
from groundstation.app.order_socket import prepare_folder
from groundstation.app.output import Output
from groundstation.app.resources import find_config
from groundstation.app.session import Session
from groundstation.core.phases import Phase
from groundstation.mavlink.codec import Encoder
from groundstation.mission.operator import Order
from groundstation.mission.plan.reading import load_mission
from sitl.world import World
from tests.app.flights import Flight, pair
from tests.app.test_order_socket import Desk

TICK_NS = 20_000_000
HOST = "127.0.0.1:8088"
KEYS = Keys("look" * 8, "steer" * 8, frozenset({HOST, "localhost:8088"}), "gs_console_8088", frozenset({"/flat"}))


@pytest.fixture(scope="module")
def flown() -> tuple[Flight, list[tuple[Snapshot, np.ndarray[tuple[int, ...], np.dtype[np.float64]]]]]:
    """A flight of two, and about every second what a console reads of it, and where they were by the emulator."""
    plan = pair()
    viewers = Viewers(Path("/nowhere"), plan)
    seen: list[tuple[Snapshot, np.ndarray[tuple[int, ...], np.dtype[np.float64]]]] = []

    def look(flight: Flight) -> bool:
        if flight.runner.done or flight.runner.figures.ticks % 40 == 0:
            snapshot = decode(encode(viewers.snapshot(flight.session, flight.now_ns)))
            seen.append((snapshot, np.array(flight.world.truth.pos_enu_m)))
        return False

    flight = Flight(plan, interrupt_when=look)
    seen.append(
        (decode(encode(viewers.snapshot(flight.session, flight.now_ns))), np.array(flight.world.truth.pos_enu_m))
    )
    return flight, seen


def test_what_is_shown_is_where_they_are_and_what_the_answer_says(
    tmp_path: Path,
    flown: tuple[Flight, list[tuple[Snapshot, np.ndarray[tuple[int, ...], np.dtype[np.float64]]]]],
) -> None:
    flight, seen = flown
    in_the_air = [(snapshot, truth) for snapshot, truth in seen if ((snapshot.state & AIRBORNE) != 0).all()]
    assert len(in_the_air) > 5
    for snapshot, truth in in_the_air:
        np.testing.assert_allclose(snapshot.pos_team_enu_m, truth, atol=0.8)  # GPS
        assert smallest_distance_m(snapshot) == pytest.approx(np.linalg.norm(truth[0] - truth[1]), abs=0.8)
    feed = Feed(tmp_path, 1)
    for snapshot, _ in seen:
        feed.take(snapshot)
    feed.close()
    told = {row[0]: row[1] for row in feed.pairs}
    for snapshot, _ in in_the_air:
        assert told[snapshot.t_s] == pytest.approx(smallest_distance_m(snapshot))  # of two it is the one distance
    assert np.isnan(feed.pairs[0][1])  # as they were put
    last = seen[-1][0]
    assert (last.words.outcome, last.words.phase) == ("completed", "done")
    for name in ("min_distance_m", "formation_error_m", "time_to_form_s", "ticks"):
        assert last.figure(name) == getattr(flight.runner.figures, name)
    assert last.figure("setpoints") == flight.runner.setpoints_sent
    assert {"takeoff", "form", "hold", "return", "land"} <= {snapshot.words.phase for snapshot, _ in seen}
    for snapshot, _ in seen:  # who lands as it was told to does so by a mode of its own, and is no alarm
        assert snapshot.words.phase != "land" or not (snapshot.state & FOREIGN).any()
    holding = [snapshot for snapshot, _ in seen if snapshot.words.phase == "hold"]
    assert largest_error_m(holding[-1]) < 0.6
    ghost_m = ghost_enu_m(holding[-1])
    assert ghost_m is not None
    np.testing.assert_allclose(ghost_m, holding[-1].pos_team_enu_m, atol=0.6)


def test_whoever_stands_below_one_that_flies_counts_in_the_smallest_distance(desk: Desk) -> None:
    """One lands on one that stands: the monitors see it, so the page does."""
    here = _one(desk)
    pos_m = np.full_like(here.pos_team_enu_m, np.nan)
    pos_m[0], pos_m[1] = (0.0, 0.0, 0.3), (0.0, 0.0, 0.0)
    nobody = np.zeros_like(here.state)
    flies = nobody.copy()
    flies[0] = AIRBORNE
    assert smallest_distance_m(replace(here, pos_team_enu_m=pos_m, state=flies)) == pytest.approx(0.3)
    assert np.isnan(smallest_distance_m(replace(here, pos_team_enu_m=pos_m, state=nobody)))  # as they were put


def _one(desk: Desk) -> Snapshot:
    return Viewers(Path("/nowhere"), desk.session.runner.plan).snapshot(desk.session, desk.now_ns)


@pytest.fixture
def desk(tmp_path: Path) -> Desk:
    item = Desk(tmp_path / "gs")
    with item.orders:
        item.tick()
    return item


_BYTES = encode(_one(Desk(Path("/nowhere"))))


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 40), st.integers(0, 2**32 - 1))
def test_a_snapshot_comes_back_as_it_was(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    first = decode(_BYTES)
    grown: dict[str, object] = {}
    for field in fields(Snapshot):
        value = getattr(first, field.name)
        if isinstance(value, np.ndarray) and field.name not in ("fence_enu_m", "figures", "edges", "anchor_deg_m"):
            whole = value.dtype.kind == "i"
            drawn = rng.integers(0, n, (n, *value.shape[1:])) if whole else rng.normal(size=(n, *value.shape[1:]))
            grown[field.name] = drawn if whole else np.where(rng.random(drawn.shape) < 0.1, np.nan, np.float32(drawn))
    words = replace(first.words, modes=("é",) * n, said=('"\n',) * n, notes=((1.5, "alarm", "näher"),))
    tick_ms = float(rng.choice([np.nan, 0.25]))
    one = replace(first, words=words, tick_ms=tick_ms, edges=rng.integers(0, n, (rng.integers(0, n), 2)), **grown)  # type: ignore[arg-type]
    back = decode(encode(one))
    assert (back.words, back.t_s) == (one.words, one.t_s)
    np.testing.assert_equal(back.tick_ms, tick_ms)
    for field in fields(Snapshot):
        if isinstance(getattr(one, field.name), np.ndarray):
            np.testing.assert_array_equal(getattr(back, field.name), getattr(one, field.name))


@settings(max_examples=300, deadline=None)
@given(st.one_of(st.binary(max_size=400), st.tuples(st.integers(0, len(_BYTES) - 1), st.integers(1, 255))))
def test_bytes_that_are_no_snapshot_are_refused_in_words(bent: bytes | tuple[int, int]) -> None:
    data = bytearray(_BYTES if isinstance(bent, tuple) else bent)
    if isinstance(bent, tuple):
        data[bent[0]] ^= bent[1]
    with suppress(ValueError):
        decode(bytes(data))
    for cut in (len(_BYTES) - 1, 40, 3):
        with pytest.raises(ValueError, match="snapshot: "):
            decode(_BYTES[:cut])
    with pytest.raises(ValueError, match="version 4, expected 3"):
        decode(_BYTES[:6] + b"\x04\x00" + _BYTES[8:])


def test_nothing_is_built_while_nobody_looks_and_who_never_reads_costs_nothing_more(
    desk: Desk, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    built: list[int] = []
    with Viewers(tmp_path, desk.session.runner.plan) as viewers:
        snapshot = viewers.snapshot

        def counted(session: Session, now_ns: int) -> Snapshot:
            built.append(1)
            return snapshot(session, now_ns)

        monkeypatch.setattr(viewers, "snapshot", counted)
        for tick in range(100):
            viewers(desk.session, tick * TICK_NS)
        assert built == []
        feed = Feed(tmp_path, os.getpid())
        for tick in range(100, 600):  # 10 s
            viewers(desk.session, tick * TICK_NS)
        assert 150 <= len(built) <= 200  # 20 a second and no more
        assert viewers.lost > 100
        assert viewers.sent + viewers.lost == len(built)
        feed.read()
        assert feed.last is not None
        assert feed.last.words.mission == "first_flight2"
        sent = viewers.sent
        feed.close()  # gone: the flight goes on, and finds the next one
        viewers(desk.session, 700 * TICK_NS)
        again = Feed(tmp_path, os.getpid())
        viewers(desk.session, 800 * TICK_NS)
        again.read()
        assert (viewers.sent, viewers.problem) == (sent + 1, "")
        assert again.last is not None
        again.close()


def test_a_fault_of_the_stream_is_kept_from_the_flight(desk: Desk, tmp_path: Path) -> None:
    feed = Feed(tmp_path, os.getpid())
    with Viewers(tmp_path, desk.session.runner.plan) as viewers:
        viewers.snapshot = None  # type: ignore[assignment, method-assign]
        viewers(desk.session, TICK_NS)
        assert "TypeError" in viewers.problem
        viewers(desk.session, 10 * TICK_NS)
    feed.close()


def test_each_note_is_kept_once_though_every_snapshot_tells_it_again(desk: Desk, tmp_path: Path) -> None:
    feed, one = Feed(tmp_path, 1), _one(desk)
    happened = [(float(number), "info", f"note {number % 3}") for number in range(100)]
    for end in (0, 5, 5, 30, 31, 90, 100):  # the stream tells the newest 40; between 31 and 90 some are missed
        told = tuple(happened[max(0, end - NOTES_MAX) : end])
        feed.take(replace(one, words=replace(one.words, notes=told)))
    assert feed.notes == happened[:31] + happened[50:]
    feed.close()


def test_sockets_of_dead_consoles_are_removed(tmp_path: Path) -> None:
    feed, dead = Feed(tmp_path, 1), tmp_path / "1-99999.view"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as item:
        item.bind(str(dead))
    remove_dead(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [f"1-{os.getpid()}.view"]
    feed.close()


def _ask(kind: str, query: str = "", path: str = "/", **headers: str) -> tuple[bool, Message]:
    """Whether a request came through the guard, and what was answered first."""
    through: list[Scope] = []
    answers: list[Message] = []

    async def app(scope: Scope, _receive: Receive, _send: Send) -> None:
        through.append(scope)

    async def receive() -> Message:
        return {"type": "websocket.connect"}

    async def send(message: Message) -> None:
        answers.append(message)

    listed = [(name.encode(), value.encode()) for name, value in headers.items()]
    scope: Scope = {"type": kind, "query_string": query.encode(), "headers": listed, "path": path}
    asyncio.run(Guard(app, KEYS)(scope, receive, send))
    return bool(through), answers[0] if answers else {}


_STEERS, _LOOKS = f"a=b; gs_console_8088={KEYS.operator}", f"gs_console_8088={KEYS.viewer}"


@pytest.mark.parametrize("kind", ["http", "websocket"])
@pytest.mark.parametrize(
    ("headers", "passes"),
    [
        ({"host": HOST, "cookie": _STEERS}, True),
        ({"host": HOST, "cookie": _LOOKS, "origin": f"http://{HOST}"}, True),
        ({"host": "localhost:8088", "cookie": _LOOKS, "origin": "http://localhost:8088"}, True),
        ({"host": HOST}, False),
        ({"host": HOST, "cookie": "gs_console_8088=guess"}, False),
        ({"host": HOST, "cookie": "gs_console_8088="}, False),
        ({"host": HOST, "cookie": f"gs_console_9000={KEYS.operator}"}, False),
        ({"host": HOST, "cookie": _STEERS, "origin": "http://evil.example"}, False),
        ({"host": HOST, "cookie": _STEERS, "origin": "http://127.0.0.1:9999"}, False),
        ({"host": HOST, "cookie": _STEERS, "origin": "null"}, False),
        ({"host": "evil.example:8088", "cookie": _STEERS, "origin": "http://evil.example:8088"}, False),
        ({"cookie": _STEERS}, False),
    ],
)
def test_who_gets_in(*, kind: str, headers: dict[str, str], passes: bool) -> None:
    through, answer = _ask(kind, **headers)
    assert through is passes
    if not passes and kind == "http":
        assert answer["status"] == 403
    elif not passes:
        assert (answer["type"], answer["code"]) == ("websocket.close", 1008)


def test_a_key_in_the_address_becomes_a_cookie_that_scripts_and_other_sites_do_not_get() -> None:
    through, answer = _ask("http", f"token={KEYS.viewer}", host=HOST)
    headers = dict(answer["headers"])  # type: ignore[call-overload]
    assert (through, answer["status"], headers[b"location"]) == (False, 303, b"/")
    assert headers[b"set-cookie"] == f"gs_console_8088={KEYS.viewer}; Path=/; HttpOnly; SameSite=Strict".encode()
    for path, onward in (("/flat", b"/flat"), ("//evil.example", b"/"), ("/other", b"/")):
        answer = _ask("http", f"token={KEYS.viewer}", path, host=HOST)[1]
        assert dict(answer["headers"])[b"location"] == onward  # type: ignore[call-overload]
    assert _ask("http", "token=guess", host=HOST)[1]["status"] == 403
    through, answer = _ask("websocket", f"token={KEYS.operator}", host=HOST)
    assert (through, answer["type"]) == (False, "websocket.close")
    assert (KEYS.role(KEYS.operator), KEYS.role(KEYS.viewer)) == (Role.OPERATOR, Role.VIEWER)
    assert KEYS.role("\udcff") is None


def test_one_steers_at_a_time_and_taking_over_is_seen() -> None:
    helm = HelmSeat()
    look, steer = Role.VIEWER, Role.OPERATOR
    assert "viewer's key" in helm.take("c", "console c", look)
    assert helm.refusal("a", steer, Order.HOLD, {"resume": "nothing is held"}) == "take the helm first"
    assert helm.take("a", "console a", steer) == ""
    assert helm.refusal("a", steer, Order.HOLD, {"resume": "nothing is held"}) == ""
    assert helm.refusal("a", steer, Order.RESUME, {"resume": "nothing is held"}) == "nothing is held"
    assert helm.refusal("a", look, Order.KILL, {"resume": "nothing is held"}).startswith("this page may only look")
    assert helm.refusal("b", steer, Order.KILL, {"resume": "nothing is held"}) == "console a steers; take over first"
    assert helm.take("b", "console b", steer) == ""
    assert helm.news == "console b has taken over from console a"
    assert helm.refusal("a", steer, Order.KILL, {"resume": "nothing is held"}) == "console b steers; take over first"
    helm.leave("a")
    assert helm.holder == "b"
    helm.leave("b")
    assert (helm.holder, helm.news) == ("", "console b has left; nobody steers from a console")


def test_the_log_says_who_gave_an_order(tmp_path: Path) -> None:
    desk = Desk(tmp_path / "gs")
    with desk.orders:
        assert desk.ask(b'{"order": "hold", "by": "console 12ab\\n' + b"x" * 100 + b'"}\n')["ok"]
        told = [note.text for note in desk.session.take_notes() if "given by" in note.text]
        assert told == [f"order hold: given by console 12ab?{'x' * 47}"]
        desk.ask(b'{"order": "dance", "by": "me"}\n')
        assert not [note for note in desk.session.take_notes() if "given by" in note.text]


def test_what_arming_waits_for_is_told_until_it_comes(desk: Desk) -> None:
    viewers, runner = Viewers(Path("/nowhere"), desk.session.runner.plan), desk.session.runner
    assert runner.problems
    told = decode(encode(viewers.snapshot(desk.session, desk.now_ns))).words
    assert (told.phase, told.problems) == ("connect", tuple(runner.problems))
    desk.session.operator("return", desk.now_ns)
    desk.tick()
    assert runner.phase is not Phase.CONNECT
    assert decode(encode(viewers.snapshot(desk.session, desk.now_ns))).words.problems == ()


@settings(deadline=None)
@given(st.lists(st.booleans(), min_size=2, max_size=300), st.sampled_from([1, 2]))
def test_what_is_lost_on_a_link_is_counted(lost: list[bool], version: int) -> None:
    encoder, companion, loss = Encoder(7, 1, version), Encoder(7, 191), LinkLoss()
    frames = [encoder.encode("HEARTBEAT", custom_mode=number) for number in range(len(lost))]
    came = [frame for frame, gone in zip(frames, lost, strict=True) if not gone]
    loss.take(b"".join(came[:3]) + companion.encode("HEARTBEAT"))
    for frame in came[3:]:
        loss.take(frame)
    share, unheard = loss.take_shares([7, 8])
    assert np.isnan(unheard)
    if came:  # what went before the first and after the last that came is not known of
        known = lost[lost.index(False) : len(lost) - lost[::-1].index(False)]
        longest = max((len(list(run)) for gone, run in groupby(known) if gone), default=0)
        assert share == pytest.approx(sum(known) / len(known)) or longest >= 128
    assert np.isnan(loss.take_shares([7])).all()
    loss.take(encoder.encode("HEARTBEAT"))
    assert np.isnan(loss.take_shares([7, 7])).all()  # on two links: not told apart


@settings(deadline=None)
@given(st.binary(max_size=200))
def test_bytes_that_are_no_frames_are_nothing_lost_and_raise_nothing(data: bytes) -> None:
    LinkLoss().take(data)
    LinkLoss().take(b"\xfd" + data)


def test_figures_of_the_emulator_stand_in_place_of_reported_ones(desk: Desk) -> None:
    viewers = Viewers(Path("/nowhere"), desk.session.runner.plan, lambda: {"min_distance_m": 0.25})
    assert viewers.snapshot(desk.session, desk.now_ns).figure("min_distance_m") == 0.25


def test_the_figures_are_those_of_the_answer() -> None:
    from groundstation.app.flying import _values

    values = _values(Desk(Path("/nowhere")).session, None, None)
    assert set(FIGURES) <= set(values)


def test_consoles_that_are_killed_or_stall_cost_the_flight_not_a_byte(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Same seed, same bytes: also with a console that is killed in mid-air, and one that never reads."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    folder = tmp_path / "gs"
    prepare_folder(folder)
    other_id = ["vehicles.0.id=300", "vehicles.0.sysid=1"]  # the page knows it by its id, frames bear its system id
    plan = load_mission(find_config(Path("first_flight2"), "missions"), other_id)
    out = Output(as_json=True)
    alone = fly_dry(out, plan, tmp_path / "alone.tlog", (), seed=3, realtime=False)
    got: list[Snapshot] = []
    with (
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as reads,
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as stalls,
    ):
        reads.bind(str(folder / f"{os.getpid()}-1.view"))
        stalls.bind(str(folder / f"{os.getpid()}-2.view"))
        reads.setblocking(False)

        def watch(session: Session, now_ns: int, _world: World) -> None:
            if session.runner.phase is Phase.HOLD:
                reads.close()  # as SIGKILL does: its name stays, and nobody is behind it
            with suppress(OSError):
                got.append(decode(reads.recv(BYTES_MAX)))

        watched = fly_dry(out, plan, tmp_path / "watched.tlog", (), seed=3, realtime=False, console=True, watch=watch)
    assert {snapshot.words.phase for snapshot in got} >= {"connect", "arm", "takeoff", "form"}
    assert {*got[-1].lost_share} == {0.0}  # the emulator's links lose nothing
    assert "hold" not in {snapshot.words.phase for snapshot in got}
    assert (tmp_path / "watched.tlog").read_bytes() == (tmp_path / "alone.tlog").read_bytes()
    np.testing.assert_equal({**watched, "log": ""}, {**alone, "log": ""})
