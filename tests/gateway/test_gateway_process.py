"""The gateway of a flight as a process: begun by a mission's addresses, watched, replaced when it dies."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from groundstation.app.gateway.finding import block, found, full
from groundstation.app.gateway.process import GatewayKeeper, budget_of, handover_of, words_of
from groundstation.app.session import Session
from groundstation.core.errors import UserError
from groundstation.gateway.handover import Handover, read, written
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.reading import load_mission
from groundstation.mission.runner import Runner
from tests.app.commands import gs
from tests.app.flights import mission
from tests.sitl.served import serving

_TELLS = "import sys; print('told', sys.stdin.readline().strip(), flush=True); sys.stdin.read()"
SECOND_NS = 1_000_000_000


class Children:
    """Stand-ins for the program: each tells what it is told."""

    def __init__(self) -> None:
        self.started: list[subprocess.Popen[bytes]] = []

    def __call__(self, _words: list[str]) -> subprocess.Popen[bytes]:
        child = subprocess.Popen(
            [sys.executable, "-c", _TELLS], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
        )
        assert child.stdout is not None
        os.set_blocking(child.stdout.fileno(), False)
        self.started.append(child)
        return child


def told_by(child: subprocess.Popen[bytes]) -> dict[str, dict[str, object]]:
    """Waits for what it was told."""
    assert child.stdout is not None
    os.set_blocking(child.stdout.fileno(), True)
    told: dict[str, dict[str, object]] = json.loads(child.stdout.readline().removeprefix(b"told "))
    os.set_blocking(child.stdout.fileno(), False)
    return told


def test_a_gateway_that_dies_is_replaced_at_once_by_one_that_waits_and_knows_who_flies() -> None:
    plan, children = mission("lab_pair2"), Children()
    session = Session(Runner(plan, 0), None)
    keeper = GatewayKeeper(plan, children)
    try:
        told = told_by(children.started[0])
        assert told.pop("room") == {"link": "udpin://127.0.0.1:15595", "by_place": False, "speed_m_s": 1.0, "hz": 25.0}
        assert {sysid: word["flies"] for sysid, word in told.items()} == {"1": False, "2": False}
        keeper.apply(session, SECOND_NS)
        keeper.apply(session, 7 * SECOND_NS)
        assert len(children.started) == 2  # one serves, one waits
        fleet = session.runner.fleet
        fleet.armed[1], fleet.landed_state[1] = True, 2
        os.kill(keeper.pid, signal.SIGKILL)
        children.started[0].wait()
        keeper.apply(session, 8 * SECOND_NS)
        assert keeper.pid == children.started[1].pid
        told = told_by(children.started[1])
        assert [told[sysid]["flies"] for sysid in ("1", "2")] == [False, True]
        assert told["2"]["home"] == [0.5, 0.0, 0.0]
        assert told["2"]["settings"]
        (note,) = [note.text for note in session.take_notes() if note.kind == "alarm"]
        assert "killed by signal 9" in note
        assert (
            "vehicles 2 fly: by setpoints they fall after 2 s; another one takes over, and tells them to stay" in note
        )
    finally:
        keeper.close()


def test_what_it_is_told_comes_through_and_what_is_none_is_left_out() -> None:
    told = {1: Handover(True, (1.0, 2.0, 0.0), {"GW_LOSS_S": 20.0}), 7: Handover()}
    assert read(written(told)) == told
    assert read("no json") == {}
    assert read('{"1": 3, "x": {}, "2": {"flies": 1, "home": [1, null, 3], "settings": {"GW_SETP_HZ": "x"}}}') == {
        2: Handover()
    }


def test_a_mission_names_the_gateway_that_it_wants() -> None:
    plan = mission("lab_cube8", "gateway={log_hz: 30, broadcast: true}")
    words = words_of(plan)
    assert words[:4] == ["gateway", "crazyflie", "--vehicle", "1=radio://0/80/2M/E7E7E7E701"]
    assert words[words.index("--out") + 1] == "udpin://127.0.0.1:14588"
    assert words[words.index("--log-hz") + 1] == "30"
    assert "--broadcast" in words
    assert plan.links == ("udpout://127.0.0.1:14588",)
    assert len(budget_of(plan)) == 2
    assert handover_of(plan, None)[8] == Handover(False, (0.0, 1.0, 0.0), {})


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (["vehicles.0.link=radio://0/80/3M/E7"], r"vehicles\[0\].link: radio://0/80/3M/E7: expected radio://RADIO/"),
        (["vehicles.1.link=radio://0/80/2M/E7E7E7E701"], r"is that of vehicles\[0\] too"),
        (["vehicles.0.autopilot=px4"], "a Crazyflie's own firmware is behind it, not px4"),
        (["gateway={link: 'udpin://127.0.0.1:1'}"], "gateway.link: udpin://127.0.0.1:1: expected udpout://HOST:PORT"),
    ],
)
def test_addresses_that_no_gateway_could_serve_are_refused(changes: list[str], words: str) -> None:
    with pytest.raises(UserError, match=words):
        mission("lab_pair2", *changes)


def test_a_radio_that_would_be_too_full_is_refused_with_the_keys_to_change(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    slow = [w for k in range(8) for w in ("--set", f"vehicles.{k}.link=radio://0/80/250K/E7E7E7E70{k + 1}")]
    log = ["--log", str(tmp_path / "x.tlog")]
    code, _, err = gs(["fly", "--mission", "lab_cube8", *log, *slow], monkeypatch, capsys)
    assert code == 2
    assert "radio 0: 8 vehicles" in err
    assert "(rate_hz, gateway.log_hz)" in err
    assert not (tmp_path / "x.tlog").exists()


def test_vehicles_are_found_over_udp_and_by_radio_and_their_block_loads(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    from tests.sitl.served import free_udp_port

    port = free_udp_port()
    with serving("--autopilot", "crazyflie", "--vehicles", "1", "--port", str(port)):
        code, out, _ = gs(["vehicles", f"udp://127.0.0.1:{port}"], monkeypatch, capsys)
    assert code == 0
    assert f'{{id: 1, link: "udp://127.0.0.1:{port}", autopilot: crazyflie, origin: team' in out
    code, _, err = gs(["vehicles", f"udp://127.0.0.1:{free_udp_port()}"], monkeypatch, capsys)
    assert code == 1
    assert "no Crazyflie answers" in err
    code, _, err = gs(["vehicles", "radio://", "udpin://127.0.0.1:1"], monkeypatch, capsys)
    assert code == 2

    air = {0xE7E7E7E701: ["radio://0/80/2M/E7E7E7E701"], 0xE7E7E7E7E7: ["radio://0/80/2M"]}
    uris = found(["radio://"], lambda number: air.get(number, []))
    assert uris == ["radio://0/80/2M/E7E7E7E7E7", "radio://0/80/2M/E7E7E7E701"]
    assert full("radio://0/80/2M/E7E7E7E701") == "radio://0/80/2M/E7E7E7E701"
    written_block = block(uris).split("\n", 1)[1]
    assert _loads(written_block, tmp_path) == {1, 231}
    with pytest.raises(UserError, match="expected up to ten hexadecimal digits"):
        found(["radio://0/80/2M/XY"], lambda _: [])


def _loads(vehicles: str, tmp_path: Path) -> set[int]:
    packaged = mission("lab_pair2").source
    text = (Path(__file__).parents[2] / "configs" / "missions" / "lab_pair2.yaml").read_text(encoding="utf-8")
    head = text[: text.index("vehicles:")].replace("../", f"{Path(__file__).parents[2] / 'configs'}/")
    (tmp_path / "m.yaml").write_text(f"{head}vehicles:\n{vehicles}", encoding="utf-8")
    plan: MissionPlan = load_mission(tmp_path / "m.yaml", ())
    assert packaged
    return {vehicle.id for vehicle in plan.spec.vehicles}
