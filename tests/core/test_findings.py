"""No key of any file answers a wrong value in the words of a library: key, value and what is allowed are told."""

from __future__ import annotations

import copy
import re
import types
from collections.abc import Iterator
from typing import Any, get_args

import pytest
from pydantic import BaseModel

from groundstation.app.campaign.vary import VarySpec
from groundstation.app.resources import packaged_configs
from groundstation.core.errors import UserError
from groundstation.core.files import read_yaml, validate
from groundstation.design.store import FormationFile
from groundstation.mission.plan.schema import MissionSpec, StepSpec

_WRONG: tuple[Any, ...] = (
    "fast",
    "",
    1.5,
    -1e30,
    float("nan"),
    True,
    None,
    [],
    ["a"],
    [[["a"]]],
    {},
    {"a": 1},
    10**400,
)
_RAW = re.compile(
    r"input should|valid (number|string|integer|dict|list|boolean|tuple)|unable to parse|value error|type=|pydantic|"
    r"instance of|\b(float|int|str|bool|dict|tuple)\b|tagged-union|validation|literal\[|constrained|Spec\b",
    re.IGNORECASE,
)
_FILES: dict[type[BaseModel], tuple[str, dict[str, Any]]] = {
    MissionSpec: ("missions/cube8.yaml", {}),
    FormationFile: ("formations/cube8.yaml", {}),
    VarySpec: ("campaigns/faults.yaml", {}),
}


def _models(annotation: Any) -> list[tuple[type[BaseModel], str]]:
    """Models in an annotation, and how a value of them stands there: alone, in a list or under a name."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [(annotation, "")]
    found = [item for part in get_args(annotation) for item in _models(part)]
    origin = getattr(annotation, "__origin__", None)
    if isinstance(annotation, types.GenericAlias) and origin in (list, tuple, dict):
        return [(model, "list" if origin in (list, tuple) else "dict") for model, _ in found]
    return found


def _places(model: type[BaseModel], seen: tuple[type[BaseModel], ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Ways to every key of a model and of the models below it."""
    for key, field in model.model_fields.items():
        yield (key,)
        for inner, how in _models(field.annotation):
            if inner in seen:
                continue
            below: tuple[Any, ...] = (key, 0) if how == "list" else (key, "one") if how == "dict" else (key,)
            if issubclass(inner, StepSpec):
                below = (*below, inner.kind)
            for place in _places(inner, (*seen, model)):
                yield (*below, *place)


def _with(values: dict[str, Any], place: tuple[Any, ...], value: Any) -> dict[str, Any]:
    """A copy with one value set; what is missing on the way is made, a step of another kind replaced."""
    root = copy.deepcopy(values)
    at: Any = root
    for part, after in zip(place, (*place[1:], None), strict=True):
        if after is None:
            at[part] = value
        elif isinstance(part, int):
            at = at[part]
        else:
            wanted = list if isinstance(after, int) else dict
            if not isinstance(at.get(part), wanted) or (wanted is list and not at[part]):
                if part in at and len(at) == 1 and at is not root:
                    at.clear()
                at[part] = [{}] if wanted is list else {}
            at = at[part]
            if wanted is list and len(place) > place.index(part) + 2:
                kind = place[place.index(part) + 2]
                if part == "steps" and kind not in at[0]:
                    at[0] = {}
    return root


@pytest.mark.parametrize("model", _FILES, ids=lambda model: model.__name__)
def test_every_key_answers_every_wrong_value_in_plain_words(model: type[BaseModel]) -> None:
    path, _ = _FILES[model]
    values = read_yaml(packaged_configs() / path)
    validate(model, values, "file")
    places = sorted(set(_places(model)), key=str)
    assert len(places) > 5
    refused = 0
    for place in places:
        for wrong in _WRONG:
            told = _told(model, _with(values, place, wrong))
            refused += bool(told)
            for line in told.splitlines():
                assert not _RAW.search(line.partition(", got ")[0]), f"{place} = {wrong!r}: {line}"
                assert re.match(r"file: [a-z][\w.\[\]]*: .", line), f"{place} = {wrong!r}: {line}"
            assert not told or place[0] in told, f"{place} = {wrong!r}: {told}"
    assert refused > 4 * len(places)


def _told(model: type[BaseModel], values: dict[str, Any]) -> str:
    try:
        validate(model, values, "file")
    except UserError as error:
        return str(error)
    return ""


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"rate_hz": "fast"}, "rate_hz: expected a number, got 'fast'"),
        ({"forward": ["x"]}, "forward: expected text, got ['x']"),
        ({"gain": "atuo"}, "gain: atuo: unknown, did you mean auto? known are auto"),
        ({"gain": 20}, "gain: expected auto or a number of at most 10, got 20"),
        ({"role_swaps": "perhaps"}, "role_swaps: expected auto or true or false, got 'perhaps'"),
        ({"law": 3}, "law: expected keys and values, got 3"),
        ({"vehicles": []}, "vehicles: needs at least 1 item, has 0"),
        ({"fence": 1}, "fence: expected keys and values, got 1"),
    ],
)
def test_words(change: dict[str, Any], words: str) -> None:
    with pytest.raises(UserError) as told:
        validate(MissionSpec, read_yaml(packaged_configs() / "missions/cube8.yaml") | change, "file")
    assert str(told.value) == f"file: {words}"


def test_a_list_whose_items_are_wrong_is_not_too_short() -> None:
    with pytest.raises(UserError) as told:
        validate(MissionSpec, read_yaml(packaged_configs() / "missions/cube8.yaml") | {"steps": ["hold"]}, "file")
    (line,) = str(told.value).splitlines()
    assert line.startswith("file: steps[0]: a step has exactly one key")
