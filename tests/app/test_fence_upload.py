"""The fence and the pads on the autopilots: sent by the mission protocol, read back, only to who stands disarmed."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pymap3d
import pytest

from groundstation.app.emulator import served_world, world_config
from groundstation.app.fence_talk import FENCE, RALLY, FenceTalk, corners_m
from groundstation.core.errors import UserError
from groundstation.mavlink.codec import Frame, FrameSplitter, decode
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.reading import load_mission
from sitl.world import World
from tests.app.commands import gs
from tests.app.flights import CUBE8, mission, pair, without_chatter
from tests.sitl.served import free_udp_port

TICK_NS = 100_000_000
ANCHOR = "anchor={lat_deg: 47.397742, lon_deg: 8.545594, alt_m: 488.0}"
UPLOAD = "fence={min_m: [-8, -5, 0], max_m: [8, 5, 6], upload: true, rally: true}"


def _plan(*changes: str) -> MissionPlan:
    return pair(UPLOAD, *changes, autopilots=("px4", "arducopter"))


def _world(plan: MissionPlan) -> World:
    return World(without_chatter(world_config(plan, 1)), 1)


def _talk(
    plan: MissionPlan,
    world: World,
    *,
    may_set: bool = True,
    lost: Callable[[], bool] = lambda: False,
    on_the_way: Callable[[], None] = lambda: None,
) -> FenceTalk:
    conversation, begin_ns, now_ns = FenceTalk(plan, may_set=may_set), world.now_ns, 0
    while now_ns < 40e9 and not conversation.done:
        now_ns += TICK_NS
        on_the_way()
        for sent in world.advance(begin_ns + now_ns):
            if not lost():
                link = plan.link_of_vehicle[sent.vehicle_index]
                conversation.receive(link, f"emulator:{sent.vehicle_index}", sent.data, now_ns)
        for datagram in conversation.outgoing(now_ns):
            if not lost():
                world.receive(int(datagram.peer.partition(":")[2]), b"".join(datagram.frames), begin_ns + now_ns)
    return conversation


def _held_m(world: World, vehicle: int, kind: int) -> list[tuple[float, float]]:
    """What a vehicle holds, east and north of the emulator's own origin on earth, by another formula."""
    home = world.config
    items = world.autopilots[vehicle].mission.beside[kind]
    places = []
    for item in items:
        east, north, _ = pymap3d.geodetic2enu(
            item["x"] * 1e-7, item["y"] * 1e-7, home.home_alt_m, home.home_lat_deg, home.home_lon_deg, home.home_alt_m
        )
        places.append((float(east), float(north)))
    return places


def test_the_fence_and_each_ones_own_pad_are_uploaded_and_read_back_on_both_autopilots() -> None:
    plan = _plan(ANCHOR)
    world = _world(plan)
    conversation = _talk(plan, world)
    assert conversation.troubles() == []
    assert conversation.uploaded() == [
        "vehicle 1: fence and rally point uploaded, and read back",
        "vehicle 2: fence and rally point uploaded, and read back",
    ]
    for vehicle in range(2):
        assert np.allclose(_held_m(world, vehicle, FENCE), corners_m(plan), atol=0.05)
        assert np.allclose(_held_m(world, vehicle, RALLY), [plan.pads_enu_m[vehicle, :2]], atol=0.05)
        assert len(world.autopilots[vehicle].mission.items) == 0
    wider = corners_m(plan)[2][0] - 8.0
    assert wider == pytest.approx(plan.spec.limits.fence_beyond_m + plan.margin_m + plan.spec.speed_limit_m_s)
    before = [list(pilot.mission.beside[FENCE]) for pilot in world.autopilots]
    again = _talk(plan, world, may_set=False)  # what is there already is not sent again
    assert (again.troubles(), again.uploaded()) == ([], [])
    assert [pilot.mission.beside[FENCE] for pilot in world.autopilots] == before


def test_every_reading_is_closed_by_an_answer_or_firmware_waits_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    plan, closed = _plan(ANCHOR), [0, 0]
    world = _world(plan)
    receive = world.receive

    def listen(vehicle: int, data: bytes, now_ns: int) -> None:
        (frame,) = FrameSplitter().feed(data)
        assert isinstance(frame, Frame)
        closed[vehicle] += decode([frame])[0].name == "MISSION_ACK"
        receive(vehicle, data, now_ns)

    monkeypatch.setattr(world, "receive", listen)
    assert _talk(plan, world).troubles() == []
    assert closed == [4, 4]  # fence and rally point, before and after


def test_without_an_anchor_the_fence_hangs_on_the_first_vehicle_as_the_team_does() -> None:
    plan = _plan()
    world = _world(plan)
    assert _talk(plan, world).troubles() == []
    off = np.array(_held_m(world, 1, FENCE)) - corners_m(plan)
    assert np.abs(off).max() < 2.0  # GPS
    assert np.ptp(off, axis=0).max() < 0.05  # one shape
    assert _held_m(world, 0, FENCE) == _held_m(world, 1, FENCE)


@pytest.mark.parametrize("share", [0.15, 0.3])
def test_a_poor_link_makes_it_longer_and_no_different(share: float) -> None:
    plan, rng = _plan(ANCHOR), np.random.default_rng(3)
    world = _world(plan)
    conversation = _talk(plan, world, lost=lambda: bool(rng.random() < share))
    assert conversation.troubles() == []
    assert all(np.allclose(_held_m(world, vehicle, FENCE), corners_m(plan), atol=0.05) for vehicle in range(2))


def test_who_only_looks_sends_nothing_and_says_what_is_missing() -> None:
    plan = _plan(ANCHOR)
    world = _world(plan)
    conversation = _talk(plan, world, may_set=False)
    assert conversation.troubles() == [
        f"vehicle {number}: does not hold the mission's {what}; `gs check --fix` or `gs fly` uploads it"
        for number in (1, 2)
        for what in ("fence", "rally point")
    ]
    assert all(pilot.mission.beside == {FENCE: [], RALLY: []} for pilot in world.autopilots)


def test_nothing_is_sent_to_a_vehicle_that_is_armed() -> None:
    plan = _plan(ANCHOR)
    world = _world(plan)

    def arm() -> None:
        world.autopilots[0].armed = True

    conversation = _talk(plan, world, on_the_way=arm)
    assert conversation.troubles() == [
        "vehicle 1: is armed, its fence is not uploaded", "vehicle 1: is armed, its rally point is not uploaded",
    ]  # fmt: skip
    assert world.autopilots[0].mission.beside[FENCE] == []


def test_a_vehicle_that_keeps_something_else_is_found_out_by_reading_back() -> None:
    plan = _plan(ANCHOR)
    world = _world(plan)

    def spoil() -> None:
        for item in world.autopilots[1].mission.beside[FENCE][:1]:
            item["x"] = 473_977_420 + 5_000  # 55 m

    conversation = _talk(plan, world, on_the_way=spoil)
    (told,) = conversation.troubles()
    assert told.startswith("vehicle 2: holds another fence than it was sent (4 items, ")


def test_a_vehicle_that_refuses_or_says_nothing_is_named() -> None:
    plan = _plan(ANCHOR)
    world = _world(plan)
    world.autopilots[0].mission.beside.clear()  # as a firmware that was built without fences
    conversation = _talk(plan, world)
    assert conversation.troubles() == [
        "vehicle 1: refuses its fence: an item that it does not know",
        "vehicle 1: refuses its rally point: an item that it does not know",
    ]
    nobody = FenceTalk(plan, may_set=True)
    assert nobody.troubles()[0] == "vehicle 1: was not heard; its fence is not known"


def test_a_fence_without_a_place_on_earth_and_rally_points_without_a_fence_are_refused() -> None:
    with pytest.raises(UserError, match=r"fence\.upload: true needs a place on earth, and no vehicle has one"):
        load_mission(CUBE8, ["fence.upload=true"])
    with pytest.raises(UserError, match="rally goes with upload: true"):
        load_mission(CUBE8, ["fence.rally=true"])


def test_check_says_that_it_is_missing_and_with_fix_uploads_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    port = free_udp_port()
    link = f"vehicles.0.link=udpin://127.0.0.1:{port}"
    changes = ["--set", link, "--set", "fence.upload=true", "--set", "limits.preflight_s=0.1", "--json"]
    with served_world(mission("hello1", link), 1) as world:
        code, out, _ = gs(["check", "--mission", "hello1", *changes], monkeypatch, capsys)
        problems = json.loads(out.splitlines()[-1])["problems"]
        assert code == 3
        assert any("does not hold the mission's fence" in problem for problem in problems)
        code, out, err = gs(["check", "--mission", "hello1", "--fix", *changes], monkeypatch, capsys)
        assert "vehicle 1: fence uploaded, and read back" in err
        assert len(world.autopilots[0].mission.beside[FENCE]) == 4
