"""The very first flight: one vehicle, no formation, on both autopilots; and places flown to by two."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from groundstation.app.verify import verify_log
from groundstation.mission.runner import Phase
from tests.app.commands import gs
from tests.app.flights import SECOND_NS, Flight, mission, pair, still_in


@pytest.mark.parametrize("autopilot", ["px4", "arducopter"])
def test_one_vehicle_hovers_flies_its_square_and_lands_on_its_pad(autopilot: str, tmp_path: Path) -> None:
    profile = {"px4": "px4_quad", "arducopter": "arducopter"}[autopilot]
    plan = mission("hello1", f"vehicles.0.autopilot={autopilot}", f"vehicles.0.profile={profile}")
    corners = [np.array(place) for place in ((2.0, 0.0, 3.0), (2.0, 2.0, 3.5), (0.0, 2.0, 3.5), (0.0, 0.0, 3.0))]
    nearest = [np.inf] * len(corners)

    def look(flight: Flight) -> bool:
        if flight.runner.phase is Phase.MOVE:
            at = flight.world.truth.pos_enu_m[0]
            nearest[:] = [min(d, float(np.linalg.norm(at - c))) for d, c in zip(nearest, corners, strict=True)]
        return False

    flight = Flight(plan, interrupt_when=look, log=tmp_path / "hello.tlog")
    assert (flight.runner.outcome, flight.texts("alarm")) == ("completed", [])
    assert [p for p in flight.phase_seen if p in (Phase.HOLD, Phase.MOVE, Phase.FORM)] == [Phase.HOLD, Phase.MOVE]
    assert max(nearest) < 0.9  # its GPS is off by 0.24 m, one axis, and it flies past the corners
    assert np.linalg.norm(flight.world.truth.pos_enu_m[0, :2]) < 1.0
    assert verify_log(tmp_path / "hello.tlog").mismatches == 0


def test_the_first_flight_is_one_command_with_a_report_after_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert gs(["init", "mine", "--like", "hello1"], monkeypatch, capsys)[0] == 0
    assert sorted(path.name for path in Path("mine").iterdir()) == ["README.md", "mission.schema.json", "mission.yaml"]
    steps = "steps=[{hover: {seconds: 1}}]"
    code, out, _ = gs(["fly", "--mission", "mine/mission", "--dry-run", "--json", "--set", steps], monkeypatch, capsys)
    values = json.loads(out.splitlines()[-1])
    assert (code, values["outcome"], values["vehicles"]) == (0, "completed", 1)
    assert values["min_distance_m"] is None
    assert gs(["report", values["log"], "-o", "r"], monkeypatch, capsys)[0] == 0


def test_two_fly_to_a_place_in_step_are_held_on_the_way_and_form_there() -> None:
    plan = pair(
        "steps=[{go_to: {to_m: [0, 1.5, 3.5]}}, {form: {tolerance_m: 0.4}}]",
        "wind={mean_m_s: 3, gust_m_s: 0.3}",
        autopilots=("px4", "px4"),
    )
    apart: list[float] = []
    held_ns: list[int] = []
    on_the_way = still_in(Phase.MOVE, 1.0)

    def look(flight: Flight) -> bool:
        if flight.runner.phase is Phase.MOVE:
            first, second = flight.world.truth.pos_enu_m
            apart.append(float(np.linalg.norm(first - second)))
        if not held_ns and on_the_way(flight):
            held_ns.append(flight.now_ns)
            flight.session.operator("hold", flight.now_ns)
        if held_ns and flight.runner.phase is Phase.PAUSE and flight.now_ns > held_ns[0] + 3 * SECOND_NS:
            flight.session.operator("resume", flight.now_ns)
        return False

    flight = Flight(plan, interrupt_when=look)
    assert flight.runner.outcome == "completed"
    ways = [phase for phase in flight.phase_seen if phase in (Phase.MOVE, Phase.PAUSE, Phase.FORM, Phase.RETURN)]
    assert ways == [Phase.MOVE, Phase.PAUSE, Phase.MOVE, Phase.FORM, Phase.RETURN]
    assert 4.0 < min(apart) <= max(apart) < 6.0  # 5 m apart on their pads, and by GPS
    assert flight.runner.figures.converged
