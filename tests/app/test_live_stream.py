"""A flight streamed to Foxglove: what is told, and read by a client that shares no code with the server."""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from groundstation.app.console import beside
from groundstation.app.console.beside import streamed
from groundstation.app.console.feed import largest_error_m, smallest_distance_m
from groundstation.app.console.live import live_messages
from groundstation.app.console.snapshot import AIRBORNE, Snapshot
from groundstation.app.console.viewers import Viewers
from groundstation.app.foxglove_messages import SCHEMAS
from groundstation.app.mcap_file import messages
from groundstation.core.errors import UserError
from groundstation.core.frames import rot_ned_from_flu
from groundstation.records.replay import load_flight
from groundstation.records.wide import wide
from tests.app.commands import gs
from tests.app.test_console_browser import started
from tests.app.test_console_replay import _unpacked
from tests.app.test_order_socket import Desk

_TIMEOUT_S = 120.0
_DATA = struct.Struct("<BIQ")  # of the protocol: 1, the subscription, nanoseconds


@pytest.fixture
def flying() -> Snapshot:
    """Two in the air and one of whom nothing is known."""
    desk = Desk(Path("/nowhere"))
    here = Viewers(Path("/nowhere"), desk.session.runner.plan).snapshot(desk.session, desk.now_ns)
    pos_m = np.array([[0.0, 0.0, 1.0], [3.0, 4.0, 1.0]])
    quats = np.array([[1.0, 0.0, 0.0, 0.0], [np.nan] * 4])
    return replace(
        here, t_s=12.5, pos_team_enu_m=pos_m, quat_ned_from_frd=quats, state=np.full(2, AIRBORNE),
        setpoint_enu_m_s=np.array([[0.1, 0.2, 0.3], [np.nan] * 3]),
    )  # fmt: skip


def test_what_is_told_is_what_the_page_shows_by_the_topics_of_a_file(flying: Snapshot) -> None:
    told = {item.topic: item for item in live_messages(flying, [(12.4, "alarm", "too near")]) if item.topic != "/tf"}
    assert {item.t_ns for topic, item in told.items() if topic != "/events"} == {12_500_000_000}
    assert told["/vehicles/2/pose"].content["pose"]["position"] == {"x": 3.0, "y": 4.0, "z": 1.0}  # type: ignore[index]
    turned = told["/vehicles/1/pose"].content["pose"]["orientation"]  # type: ignore[index]
    w, x, y, z = (turned[axis] for axis in "wxyz")
    forward = [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]
    north = rot_ned_from_flu(flying.quat_ned_from_frd[:1])[0] @ [1.0, 0.0, 0.0]
    np.testing.assert_allclose(forward, [north[1], north[0], -north[2]], atol=1e-9)
    assert told["/vehicles/1/setpoint"].content == {"x_enu_m_s": 0.1, "y_enu_m_s": 0.2, "z_enu_m_s": 0.3}
    assert "/vehicles/2/setpoint" not in told
    team = told["/team"].content
    assert (team["min_distance_m"], team["min_distance_pair"]) == (smallest_distance_m(flying), "1-2")
    assert team["formation_error_m"] == largest_error_m(flying)
    assert told["/team/distances"].content == {"distance_1_2_m": 5.0}
    assert (told["/events"].content["message"], told["/events"].content["level"]) == ("alarm: too near", 3)
    assert told["/flight"].content["name"] == "first_flight2"
    for item in live_messages(flying, []):
        assert set(item.content) <= set(SCHEMAS[item.schema]) or item.schema == "gs.Distances"
        json.dumps(item.content, allow_nan=False)


def test_live_and_recorded_have_the_same_topics(flying: Snapshot, tmp_path: Path) -> None:
    flight = load_flight(_unpacked("completed", tmp_path))
    of_file = {(item.topic, item.schema) for item in messages(flight, wide(flight, 1.0))}
    live = {(item.topic, item.schema) for item in live_messages(flying, [(1.0, "info", "a")])}
    assert live <= of_file
    assert {topic for topic, _ in of_file - live if "velocity" not in topic} == {"/vehicles/2/setpoint"}


class Client:
    """Speaks the protocol by its specification, over a WebSocket of another library."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket = socket
        self.schemas: dict[str, Mapping[str, object]] = {}
        self._topics: dict[int, str] = {}
        self.about = self._json("serverInfo")

    def _json(self, op: str) -> Mapping[str, object]:
        while True:
            data = self._socket.recv(_TIMEOUT_S)
            if isinstance(data, str) and (told := json.loads(data))["op"] == op:
                return dict(told)

    def subscribe(self, *topics: str) -> None:
        """Asks for topics, and waits until the server has read that: it answers frames in their order."""
        while not set(topics) <= set(self.schemas):
            for channel in self._json("advertise")["channels"]:  # type: ignore[attr-defined]
                self.schemas[channel["topic"]] = json.loads(channel["schema"])
                self._topics[channel["id"]] = channel["topic"]
        wanted = [{"id": at, "channelId": at} for at, topic in self._topics.items() if topic in topics]
        self._socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
        self._socket.ping().wait(_TIMEOUT_S)

    def message(self) -> tuple[str, int, dict[str, object]]:
        """Topic, time and content of the next one."""
        while True:
            data = self._socket.recv(_TIMEOUT_S)
            if isinstance(data, bytes) and data[0] == 1:
                _, subscription, t_ns = _DATA.unpack_from(data)
                return self._topics[subscription], t_ns, json.loads(data[_DATA.size :])


def test_a_client_of_the_protocol_follows_a_flight(tmp_path_factory: pytest.TempPathFactory, flying: Snapshot) -> None:
    pytest.importorskip("foxglove", reason="foxglove-sdk is not here: make install brings it")
    folder = tmp_path_factory.mktemp("s")
    desk = Desk(Path("/nowhere"))
    words = f"console --stream foxglove --port 0 --flight {os.getpid()}"
    with started(words, folder) as process, Viewers(folder / "gs", desk.session.runner.plan) as viewers:
        assert process.stdout is not None
        address = process.stdout.readline().split()[-1]
        second = [0]

        def told(snapshot: Snapshot) -> None:
            viewers.snapshot = lambda *_: snapshot  # type: ignore[method-assign]
            second[0] += 1
            viewers(desk.session, second[0] * 1_000_000_000)

        told(flying)
        with connect(address, subprotocols=[Subprotocol("foxglove.sdk.v1")]) as socket:
            client = Client(socket)
            assert client.about["capabilities"] == []  # it takes nothing from anybody
            client.subscribe("/vehicles/2/pose", "/team")
            assert client.schemas["/team"]["title"] == "gs.Team"
            told(replace(flying, t_s=13.5, pos_team_enu_m=flying.pos_team_enu_m * [2.0, 2.0, 1.0]))
            got = {topic: (t_ns, content) for topic, t_ns, content in (client.message(), client.message())}
            assert got["/vehicles/2/pose"][1]["pose"]["position"] == {"x": 6.0, "y": 8.0, "z": 1.0}  # type: ignore[index]
            assert got["/team"][1]["min_distance_m"] == 10.0
            before_ns = got["/team"][0]
            words_at_end = replace(flying.words, phase="done", outcome="completed")
            told(replace(flying, t_s=14.0, words=words_at_end))
            got = {topic: (t_ns, content) for topic, t_ns, content in (client.message(), client.message())}
            assert got["/team"][1]["phase"] == "done"
            assert got["/team"][0] - before_ns == 500_000_000  # the flight's own pace
            assert process.communicate()[0].endswith("the flight is over: completed\n")
    assert process.returncode == 0


def test_a_flight_begins_its_stream_beside_it_and_says_why_it_cannot(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("foxglove", reason="foxglove-sdk is not here: make install brings it")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("s")))
    monkeypatch.setattr(beside, "PORT", 0)
    monkeypatch.setattr(beside, "_END_S", 0.0)  # nothing flies here
    with streamed("foxglove") as said:
        port = int(said.rpartition(":")[2])
        with connect(f"ws://127.0.0.1:{port}", subprotocols=[Subprotocol("foxglove.sdk.v1")]) as socket:
            assert Client(socket).about["name"] == "gs"
        monkeypatch.setattr(beside, "PORT", port)
        with pytest.raises(UserError, match=r"Address already in use.*gs console --stream foxglove --port"):
            streamed("foxglove").__enter__()
    with streamed(None) as said:
        assert said == ""


def test_the_flight_itself_loads_nothing_of_foxglove() -> None:
    code = (
        "import sys; sys.modules['foxglove'] = None;"
        "import groundstation.app.console.beside, groundstation.app.flying, groundstation.app.commands.fly"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["fly", "--mission", "hello1", "--dry-run", "--stream", "foxglove"], "--stream: a dry run in virtual time"),
        (["fly", "--mission", "hello1", "--dry-run", "--realtime", "--stream", "rerun"], "gs export LOG --to rrd"),
        (["console", "--stream", "foxglov"], "foxglove"),
        (["console", "--stream", "foxglove", "--edit", "cube8"], "leave out --log, --edit and --tiles"),
        (["console", "--stream", "foxglove", "--host", "10.0.0.1"], "ssh -L 8765:127.0.0.1:8765"),
    ],
)
def test_what_cannot_be_streamed_is_told(
    words: list[str], told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, err = gs(words, monkeypatch, capsys)
    assert (code, told in err, "Traceback" in out + err) == (2, True, False)
