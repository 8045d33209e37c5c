"""The mission desk without a browser: a form made of the schema, faults at their fields, a draft changed and saved."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from groundstation.app.console.draft import Draft
from groundstation.app.console.form import Entry, Section, form_of, put
from groundstation.app.packaged import packaged_configs, packaged_names
from groundstation.app.schema_files import schema_text
from groundstation.core.errors import UserError
from groundstation.core.files import read_yaml
from groundstation.design.designer import design, evaluator
from groundstation.design.graphs import suggest
from groundstation.mission.plan.reading import load_mission
from groundstation.mission.plan.schema import MissionSpec

SCHEMA = json.loads(schema_text("mission"))
MISSIONS = packaged_configs() / "missions"


def entries(section: Section) -> Iterator[Entry]:
    for part in section.parts:
        if isinstance(part, Section):
            yield from entries(part)
        else:
            yield part


@pytest.mark.parametrize("name", packaged_names("missions"))
def test_every_value_of_a_mission_has_its_field_and_gives_it_back(name: str) -> None:
    values = read_yaml(MISSIONS / f"{name}.yaml")
    form = list(entries(form_of(SCHEMA, values)))
    assert {entry.place[0] for entry in form} | {"obstacles"} >= set(MissionSpec.model_fields)
    again = json.loads(json.dumps(values))
    for entry in form:
        if entry.given:
            put(again, entry.place, entry.given)
    assert again == values
    given = {entry.key: entry.given for entry in form}
    assert given["vehicles[0].pad_m"].startswith("[")
    assert all(entry.words for entry in form)


@pytest.fixture
def draft() -> Draft:
    return Draft(MISSIONS / "cube8.yaml")


def test_what_is_wrong_is_told_by_the_key_of_its_field(draft: Draft) -> None:
    for place, text in (
        (("speed_limit_m_s",), "fast"),
        (("steps", 0, "form", "tolerance_m"), "-1"),
        (("vehicles", 2, "id"), "70000"),
        (("wind", "mean_m_s"), "99"),
    ):
        draft.put(place, text)
    faults = draft.faults()
    assert set(faults) == {"speed_limit_m_s", "steps[0].form.tolerance_m", "vehicles[2].id", "wind.mean_m_s"}
    assert faults["speed_limit_m_s"] == "speed_limit_m_s: expected a number, got 'fast'"
    keys = {entry.key for entry in entries(form_of(SCHEMA, draft.values))}
    assert set(faults) <= keys
    with pytest.raises(UserError, match="speed_limit_m_s: expected a number"):
        draft.save(Path("/nowhere"), replace=True)
    with pytest.raises(UserError, match=r"gain: .* not valid YAML"):
        draft.put(("gain",), "[1, ")
    with pytest.raises(UserError, match="open the mission again"):
        draft.put(("vehicles", 99, "id"), "1")
    draft.put(("wind", "mean_m_s"), "")  # nothing written takes it out
    assert draft.values["wind"] == {}


def test_gains_belong_to_a_shape_and_are_designed_anew(draft: Draft, tmp_path: Path) -> None:
    assert draft.has_gains
    there = draft.points[4]
    draft.move(4, [0.0, 0.0, 1.4])
    assert not draft.has_gains
    draft.move(4, there)
    assert draft.has_gains
    draft.move(4, [0.0, 0.0, 1.4])
    assert "no gains exist" in draft.judged()
    for other in (2, 3, 4):
        draft.toggle(1, 4 + other)
    draft.toggle(5, 2)
    with pytest.raises(UserError, match="edge 1 to 9: expected two different agents from 1 to 8"):
        draft.toggle(1, 9)
    draft.propose(draft.formation())
    draft.keep_gains(design(draft.formation()))
    assert (draft.has_gains, draft.judged()) == (True, "")
    draft.put(("avoidance", "radius_m"), "0.9")
    assert "activation_m" in draft.judged()
    draft.put(("avoidance", "radius_m"), "0.45")
    path = draft.save(tmp_path, replace=False)
    with pytest.raises(UserError, match=r"cube8\.yaml, .*is there already"):
        draft.save(tmp_path, replace=False)
    draft.save(tmp_path, replace=True)
    plan = load_mission(path)
    assert plan.formation.points_enu_m[4].tolist() == [0.0, 0.0, 1.4]
    assert (1, 4) in plan.formation.edges
    assert (tmp_path / "mission.schema.json").is_file()
    again = Draft(path)  # what was saved is opened again as it was
    assert (again.points, again.edges, again.has_gains) == (draft.points, draft.edges, True)


def test_vehicles_in_the_short_form_have_their_fields(draft: Draft) -> None:
    draft.values["vehicles"] = {"count": 8, "pads": {"spacing_m": 1.0}, "links": ["udpin://127.0.0.1:14540"]}
    keys = {entry.key: entry.given for entry in entries(form_of(SCHEMA, draft.values))}
    assert (keys["vehicles.count"], keys["vehicles.pads.spacing_m"], draft.vehicles) == ("8", "1.0", 8)


def test_points_come_and_go_with_their_edges(draft: Draft) -> None:
    assert (len(draft.points), draft.vehicles) == (8, 8)
    before = [(tuple(draft.points[i - 1]), tuple(draft.points[j - 1])) for i, j in draft.edges]
    gone = tuple(draft.points[2])
    draft.remove(2)
    assert not draft.has_gains
    after = [(tuple(draft.points[i - 1]), tuple(draft.points[j - 1])) for i, j in draft.edges]
    assert after == [edge for edge in before if gone not in edge]
    assert "7" in draft.judged()  # of eight vehicles
    assert "8" in draft.judged()
    draft.add([0.5, 0.25, 2.0])
    assert draft.points[-1] == [0.5, 0.25, 2.0]
    assert all(8 not in edge for edge in draft.edges)
    draft.propose(suggest(draft.formation(), "balanced", evaluator()).formation)
    assert draft.judged() == ""
    one = Draft(MISSIONS / "first_flight2.yaml")
    one.remove(0)
    with pytest.raises(UserError, match="the only one"):
        one.remove(0)


@pytest.mark.parametrize("name", ["sequence8", "hello1"])
def test_steps_with_shapes_of_their_own_go_along(name: str, tmp_path: Path) -> None:
    draft = Draft(MISSIONS / f"{name}.yaml")
    assert draft.judged() == ""
    assert load_mission(draft.save(tmp_path, replace=False)).spec.name == name
