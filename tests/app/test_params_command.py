"""Parameters are kept, compared and given back; nothing is set in the air; what --fix changes is kept beforehand."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.app.emulator import served_world, world_config
from groundstation.app.param_keeping import BeforeKeeper, before_path
from groundstation.app.param_talk import ParamTalk
from groundstation.app.session import Session
from groundstation.core.errors import UserError
from groundstation.mavlink.codec import Encoder
from groundstation.mavlink.params import bits_of_value, value_of_bits
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.purpose import Purpose
from groundstation.mission.runner import Runner
from groundstation.records.param_file import Param, Team, read_params, write_params
from sitl.world import World, WorldConfig
from tests.app.commands import gs
from tests.app.flights import mission, pair, without_chatter
from tests.sitl.served import free_udp_port

TICK_NS = 100_000_000


def _world(plan: MissionPlan, change: Callable[[WorldConfig], WorldConfig] | None = None) -> World:
    config = without_chatter(world_config(plan, 1))
    return World(config if change is None else change(config), 1)


def _talk(
    plan: MissionPlan,
    world: World,
    conversation: ParamTalk,
    seconds: float = 20.0,
    lost: Callable[[], bool] = lambda: False,
) -> float:
    """Lets a talk go on with the emulator; returns how long it took, s."""
    begin_ns = world.now_ns
    now_ns = 0
    while now_ns < seconds * 1e9 and not conversation.done:
        now_ns += TICK_NS
        for sent in world.advance(begin_ns + now_ns):
            if not lost():
                link = plan.link_of_vehicle[sent.vehicle_index]
                conversation.receive(link, f"emulator:{sent.vehicle_index}", sent.data, now_ns)
        for datagram in conversation.outgoing(now_ns):
            if not lost():
                world.receive(int(datagram.peer.partition(":")[2]), b"".join(datagram.frames), begin_ns + now_ns)
    return now_ns / 1e9


def _both() -> MissionPlan:
    return pair(autopilots=("px4", "arducopter"))


def _truth(world: World) -> Team:
    """What the emulator holds, as it holds it."""
    held: Team = {}
    for pilot in world.autopilots:
        rows = [pilot.params.at(position) for position in range(len(pilot.params))]
        held[pilot.sysid] = {
            name: Param(float(np.float32(value)) if kind == 9 else value, kind) for name, value, kind in rows
        }
    return held


@pytest.mark.parametrize("share", [0.0, 0.2])
def test_all_parameters_are_read_from_both_autopilots_also_over_a_poor_link(share: float, tmp_path: Path) -> None:
    plan = _both()
    world, rng = _world(plan), np.random.default_rng(2)
    conversation = ParamTalk(plan)
    took_s = _talk(plan, world, conversation, 60.0, lambda: bool(rng.random() < share))
    assert conversation.done
    assert conversation.troubles() == []
    assert took_s < (6.0 if share == 0.0 else 60.0)
    truth, told = _truth(world), conversation.team()
    for sysid, params in truth.items():
        assert set(told[sysid]) == set(params)
        assert all(told[sysid][name].same(param) for name, param in params.items())
    write_params(tmp_path / "all.params", told, "of a test")
    again = read_params(tmp_path / "all.params")
    assert {sysid: set(of) for sysid, of in again.items()} == {sysid: set(of) for sysid, of in told.items()}
    assert all(again[sysid][name].same(param) for sysid, of in told.items() for name, param in of.items())


def test_what_was_kept_is_given_back_to_the_bit_and_nothing_else_is_touched() -> None:
    plan = _both()
    world = _world(plan)
    wanted: Team = {
        1: {"COM_DL_LOSS_T": Param(17, 6), "RTL_RETURN_ALT": Param(12.3, 9), "NO_SUCH_ONE": Param(1, 6)},
        2: {"RTL_ALT": Param(1234, 9), "FENCE_RADIUS": Param(float(np.float32(0.1)), 9)},
    }
    before = _truth(world)
    conversation = ParamTalk(plan, wanted=wanted)
    _talk(plan, world, conversation)
    assert conversation.done
    after = _truth(world)
    assert after[1]["COM_DL_LOSS_T"].value == 17
    assert after[1]["RTL_RETURN_ALT"].value == np.float32(12.3)
    assert after[2]["FENCE_RADIUS"].value == np.float32(0.1)
    changed = {
        (sysid, name) for sysid in after for name in after[sysid] if not after[sysid][name].same(before[sysid][name])
    }
    assert changed <= {(sysid, name) for sysid, params in wanted.items() for name in params}
    assert {(sysid, name) for sysid, of in conversation.changed().items() for name in of} == changed
    assert conversation.troubles() == ["vehicle 1: does not know NO_SUCH_ONE"]


def test_nothing_is_set_in_a_vehicle_that_is_armed_or_not_heard() -> None:
    plan = _both()
    world = _world(plan)
    world.autopilots[0].armed = True
    before = _truth(world)
    conversation = ParamTalk(plan, wanted={1: {"COM_DL_LOSS_T": Param(17, 6)}, 2: {"RTL_ALT": Param(1, 9)}})
    while world.now_ns < 5_000_000_000:  # vehicle 2's words do not arrive
        for sent in world.advance(world.now_ns + TICK_NS):
            if sent.vehicle_index == 0:
                conversation.receive(plan.link_of_vehicle[0], "emulator:0", sent.data, world.now_ns)
        for datagram in conversation.outgoing(world.now_ns):
            world.receive(0, b"".join(datagram.frames), world.now_ns)
        world.autopilots[0].armed = True
    assert _truth(world) == before
    armed, silent = conversation.troubles()
    assert armed == "vehicle 1: is armed, nothing is set; disarm it"
    assert silent.startswith("vehicle 2: was not heard")


def test_what_preflight_sets_is_kept_as_it_was_and_can_be_given_back(tmp_path: Path) -> None:
    plan = mission("hello1", "failsafe.set_parameters=true")

    def stock(config: WorldConfig) -> WorldConfig:
        """Parameters as the firmware comes."""
        return replace(config, vehicles=tuple(replace(vehicle, params=()) for vehicle in config.vehicles))

    world = _world(plan, stock)
    before = _truth(world)
    session = Session(Runner(plan, 0, Purpose.PREPARE), None)
    keeper = BeforeKeeper(before_path(tmp_path / "flights" / "a.tlog"))
    assert keeper.path == tmp_path / "flights" / "a.before.params"
    now_ns = 0
    while not session.runner.done:
        now_ns += 50_000_000
        for sent in world.advance(now_ns):
            session.deliver(0, "emulator:0", sent.data, sent.t_ns)
        for datagram in session.tick(now_ns):
            world.receive(0, b"".join(datagram.frames), now_ns)
        keeper(session, now_ns)
        assert now_ns < 100e9
    assert session.runner.outcome == "completed"
    set_now = {name for name, param in _truth(world)[1].items() if not param.same(before[1][name])}
    assert len(set_now) >= 3
    kept = read_params(keeper.path)
    assert set(kept[1]) == set_now
    assert all(param.same(before[1][name]) for name, param in kept[1].items())
    conversation = ParamTalk(plan, wanted=kept)
    _talk(plan, world, conversation)
    assert conversation.troubles() == []
    assert _truth(world) == before


def test_save_diff_and_restore_over_sockets(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    port = free_udp_port()
    change = f"vehicles.0.link=udpin://127.0.0.1:{port}"
    common = ["--mission", "hello1", "--set", change, "--file", "a.params", "--json"]
    with served_world(mission("hello1", change), 1) as world:
        code, out, _ = gs(["params", "save", *common], monkeypatch, capsys)
        kept = read_params(Path("a.params"))
        assert (code, json.loads(out.splitlines()[-1])["vehicles"]) == (0, {"1": len(kept[1])})
        kept[1]["COM_DL_LOSS_T"] = Param(kept[1]["COM_DL_LOSS_T"].value + 3, 6)
        few: Team = {1: {name: kept[1][name] for name in ("COM_DL_LOSS_T", "RTL_RETURN_ALT")}}
        write_params(Path("a.params"), few, "changed")
        Path("a.params").rename("hello1.params")  # what was saved under the mission's name is what diff takes by itself
        by_itself = [item for item in common if item not in ("--file", "a.params")]
        code, out, err = gs(["params", "diff", *by_itself], monkeypatch, capsys)
        assert "compared with hello1.params, saved 20" in " ".join(err.split())
        Path("hello1.params").rename("a.params")
        differ = json.loads(out.splitlines()[-1])["differences"]
        assert (code, [row["parameter"] for row in differ]) == (1, ["COM_DL_LOSS_T"])
        assert "1 parameter differs; gs params restore --file hello1.params gives back" in " ".join(err.split())
        assert gs(["params", "restore", *common], monkeypatch, capsys)[0] == 0
        held = world.autopilots[0].params
        assert held.at(held.position("COM_DL_LOSS_T") or 0)[1] == kept[1]["COM_DL_LOSS_T"].value


def test_who_speaks_first_under_a_vehicles_id_stays_and_nobody_else_is_heard() -> None:
    plan = mission("hello1")
    (sysid,) = (item.id for item in plan.spec.vehicles)
    vehicle, stranger = ("127.0.0.1:14541", "10.0.0.9:14550")
    encoder = Encoder(sysid)

    def heartbeat(*, armed: bool) -> bytes:
        return encoder.encode("HEARTBEAT", type=2, autopilot=12, base_mode=128 if armed else 0, mavlink_version=3)

    def value(number: float) -> bytes:
        return encoder.encode("PARAM_VALUE", param_id="A", param_value=number, param_type=9, param_count=1)

    talk = ParamTalk(plan)
    for peer, data in (
        (stranger, value(7.0)),  # before anybody has said who he is
        (vehicle, heartbeat(armed=True)),
        (stranger, heartbeat(armed=False)),
        (stranger, value(8.0)),
    ):
        talk.receive(0, peer, data, 0)
    (item,) = talk._vehicles
    assert (item.peer, item.armed, talk.team()) == (vehicle, True, {})
    assert {sent.peer for sent in talk.outgoing(0)} == {vehicle}
    talk.receive(0, vehicle, value(9.0), 0)
    assert [param.value for param in talk.team()[sysid].values()] == [9.0]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["restore", "--mission", "hello1"], "--file: is missing"),
        (
            ["diff", "--mission", "hello1"],
            "hello1.params: nothing was saved here under this name; begin with gs params",
        ),
        (["tune", "--mission", "hello1"], "known are save, diff, restore"),
        (["diff", "--mission", "hello1", "--file", "nowhere"], "nowhere: cannot be read"),
        (["diff", "--mission", "cube8", "--file", "other"], "is of vehicles 77, the mission has 1, 2"),
    ],
)
def test_wrong_usage_is_told(
    arguments: list[str],
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    write_params(Path("other"), {77: {"A": Param(1, 6)}}, "x")
    code, _, err = gs(["params", *arguments], monkeypatch, capsys)
    assert (code, words in " ".join(err.split())) == (2, True)


@settings(max_examples=200, deadline=None)
@given(bits=st.integers(0, 2**32 - 1), kind=st.sampled_from([1, 2, 3, 4, 5, 6, 9]), bytewise=st.booleans())
def test_every_value_that_a_vehicle_can_tell_comes_back_from_a_file_as_it_was(
    bits: int, kind: int, bytewise: bool
) -> None:
    value = value_of_bits(bits, kind, bytewise=bytewise)
    if not np.isfinite(value):
        return
    again = float(Param(value, kind).text())
    assert Param(again, kind).same(Param(value, kind))
    if kind == 9 or bytewise:
        told = bits_of_value(again, kind, bytewise=bytewise)
        assert value_of_bits(told, kind, bytewise=bytewise) == value


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "holds no parameter"),
        ("1 1 A 1", "line 1: has 4 columns, expected 5"),
        ("1 1 A 1 6\n0 1 A 1 6", "line 2: vehicle 0, component 1: must be 1 to 9999 and 0 to 255"),
        ("1 1 A x 6", "could not convert string to float"),
        ("1 1 A nan 9", "A: value nan of type 9: no number"),
        ("1 1 A 1 77", "no MAV_PARAM_TYPE"),
        ("1 1 A 300 1", "300 does not fit a parameter of type 1"),
        ("1 1 A_NAME_THAT_IS_TOO_LONG 1 6", "no name that MAVLink carries"),
        ("1 100 A 1 6", "holds no parameter"),
    ],
)
def test_a_file_that_is_none_of_parameters_is_refused_with_its_line(text: str, words: str, tmp_path: Path) -> None:
    file = tmp_path / "a.params"
    file.write_text(text)
    with pytest.raises(UserError) as refused:
        read_params(file)
    assert str(refused.value).startswith(f"{file}: ")
    assert words in str(refused.value)


def test_a_foreign_file_is_not_written_over(tmp_path: Path) -> None:
    file: Any = tmp_path / "a.params"
    file.write_text("mine")
    with pytest.raises(UserError, match="is not what this command would make again"):
        write_params(file, {1: {"A": Param(1, 6)}}, "x", force=False)
    assert file.read_text() == "mine"
    write_params(file, {1: {"A": Param(1, 6)}}, "x", force=True)
    write_params(file, {1: {"A": Param(2, 6)}}, "x", force=False)  # its own
    assert read_params(file) == {1: {"A": Param(2.0, 6)}}
