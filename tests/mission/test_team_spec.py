"""Many vehicles alike in a few words."""

from __future__ import annotations

from pathlib import Path

import pytest

from groundstation.core.errors import UserError
from groundstation.mission.plan.reading import read_spec
from groundstation.mission.plan.vehicle_spec import VehicleSpec, system_ids
from tests.app.flights import CUBE8

_LINKS = [f"udpin://127.0.0.1:{14540 + k}" for k in range(4)]


def _vehicles(tmp_path: Path, short: str) -> tuple[VehicleSpec, ...]:
    """Those of a mission file that says it in short."""
    whole = CUBE8.read_text(encoding="utf-8")
    path = tmp_path / "mission.yaml"
    path.write_text(f"{whole[: whole.index('vehicles:')]}vehicles: {short}\n", encoding="utf-8")
    return read_spec(path).vehicles


def test_a_thousand_vehicles_in_one_line(tmp_path: Path) -> None:
    pads = "{columns: 40, spacing_m: 0.8, middle_m: [1, 2, 0]}"
    given = f"count: 1000, pads: {pads}, links: {_LINKS}, autopilot: arducopter"
    vehicles = _vehicles(tmp_path, "{" + given + "}")
    assert [vehicle.id for vehicle in vehicles] == list(range(1, 1001))
    assert [vehicle.link for vehicle in vehicles] == [link for link in _LINKS for _ in range(250)]
    assert system_ids(vehicles) == tuple(range(1, 251)) * 4
    assert {vehicle.autopilot for vehicle in vehicles} == {"arducopter"}
    assert (vehicles[0].pad_m, vehicles[-1].pad_m) == ((-14.6, -7.6, 0.0), (16.6, 11.6, 0.0))


def test_a_small_team_keeps_its_ids_as_system_ids(tmp_path: Path) -> None:
    given = f"count: 5, pads: {{columns: 2, spacing_m: 1}}, links: {_LINKS[:2]}, per_link: 3"
    vehicles = _vehicles(tmp_path, "{" + given + "}")
    assert system_ids(vehicles) == (1, 2, 3, 4, 5)
    assert [vehicle.link for vehicle in vehicles] == [_LINKS[0]] * 3 + [_LINKS[1]] * 2
    assert [vehicle.pad_m for vehicle in vehicles] == [
        (-0.5, -1, 0), (0.5, -1, 0), (-0.5, 0, 0), (0.5, 0, 0), (-0.5, 1, 0),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("short", "words"),
    [
        ("{count: 300, pads: {columns: 9, spacing_m: 1}, links: [a]}",
         "count is 300, 1 links of 250 vehicles take 250"),
        ("{count: 9, pads: {columns: 0, spacing_m: 1}, links: [a]}",
         "vehicles: pads.columns: expected a number of at least 1, got 0"),
        ("{count: 9, pads: {columns: 3, spacing: 1}, links: [a]}",
         "pads.spacing: unknown key, did you mean spacing_m?"),
        ("{count: 9, links: [a]}", "pads: is missing"),
        ("{}", "count: is missing"),
    ],
)  # fmt: skip
def test_what_is_wrong_in_it_is_told_by_its_key(tmp_path: Path, short: str, words: str) -> None:
    with pytest.raises(UserError) as refused:
        _vehicles(tmp_path, short)
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)
