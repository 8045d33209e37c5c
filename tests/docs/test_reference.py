"""Every key and option of the code is in the reference, with words, and nothing else is."""

from __future__ import annotations

import copy
import json
import re
import shlex
from pathlib import Path
from typing import Annotated, Any

import pytest
from pydantic import BaseModel, TypeAdapter

from groundstation.app.cli import COMMANDS
from groundstation.app.commands.schema import MODELS
from groundstation.app.completing import ORDERS
from groundstation.app.packaged import packaged_names
from groundstation.app.reference.examples import EXAMPLES
from groundstation.app.reference.words import FILES, described, inside, words_of
from groundstation.core.extras import EXTRAS
from tests.docs.pages import PAGES, click_commands

_ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("page", PAGES)
def test_a_page_that_is_drawn_is_as_the_program_draws_it(page: str) -> None:
    assert (_ROOT / page).read_text(encoding="utf-8") == PAGES[page](), f"{page} is out of date: make docs"


def _parts(file: str) -> dict[str, dict[str, Any]]:
    """Model: its part of the schema."""
    model = MODELS[file]()
    schema = model.model_json_schema()
    return {model.__name__: schema, **schema.get("$defs", {})}


def test_there_are_words_for_every_file_that_has_a_schema() -> None:
    assert set(FILES) == set(MODELS)


@pytest.mark.parametrize("file", FILES)
def test_every_key_has_words_and_no_words_are_of_a_key_that_is_gone(file: str) -> None:
    keys = {name: set(inside(part)["properties"]) for name, part in _parts(file).items()}
    assert {name: set(said) for name, said in words_of(file).items()} == keys
    for name, said in words_of(file).items():
        assert all(words.text.endswith((".", ").")) and len(words.text) > 5 for words in said.values()), name


def _models(model: type[BaseModel]) -> dict[str, type[BaseModel]]:
    """Every model that a file is made of, by name."""
    found: dict[str, type[BaseModel]] = {}
    todo: list[Any] = [model]
    while todo:
        item = todo.pop()
        if isinstance(item, type) and issubclass(item, BaseModel):
            if item.__name__ not in found:
                found[item.__name__] = item
                todo += [field.annotation for field in item.model_fields.values()]
                named = [mark for field in item.model_fields.values() for mark in field.metadata]
                todo += [getattr(mark, "json_schema_input_type", None) for mark in named]  # short forms
        else:
            todo += getattr(item, "__args__", ())
            todo += [getattr(item, "__value__", None)] if hasattr(item, "__value__") else []
    return found


@pytest.mark.parametrize("file", FILES)
def test_every_example_is_a_value_that_the_key_may_have(file: str) -> None:
    models = _models(MODELS[file]())
    checked = 0
    for name, said in words_of(file).items():
        for key, words in said.items():
            field = models[name].model_fields[key]
            annotated: Any = field.annotation
            if field.metadata:
                annotated = Annotated[(field.annotation, *field.metadata)]
            TypeAdapter(annotated).validate_python(copy.deepcopy(words.example))
            checked += 1
    assert checked >= len(words_of(file))


def test_units_are_those_that_names_end_in() -> None:
    said = {key: words for file in FILES for keys in words_of(file).values() for key, words in keys.items()}
    assert said["speed_limit_m_s"].unit == "m/s"
    assert said["acceleration_limit_m_s2"].unit == "m/s²"
    assert said["keep_place_1_s"].unit == "1/s"
    assert said["timeout_s"].unit == "s"
    assert said["battery_min_v"].unit == "V"


def test_editors_are_told_the_same() -> None:
    schema = described("mission", MODELS["mission"]())
    assert schema["properties"]["rate_hz"]["description"].endswith("Unit: Hz.")
    assert "](" not in json.dumps(schema)
    form = inside(schema["$defs"]["FormStep"])["properties"]
    assert form["tolerance_m"]["examples"] == [0.05]


def test_every_option_is_in_the_reference() -> None:
    text = (_ROOT / "docs/reference-commands.md").read_text(encoding="utf-8")
    sections = dict(zip(*[iter(re.split(r"^## gs (\S+)$", text, flags=re.MULTILINE)[1:])] * 2, strict=True))
    found = click_commands()
    assert set(sections) == set(found)
    for name, command in found.items():
        listed = set(
            re.findall(r"`(--?[a-z][a-z-]*)`", "".join(re.findall(r"^\| (`-.*?) \|", sections[name], re.MULTILINE)))
        )
        known = {option for item in command.params for option in (*item.opts, *item.secondary_opts) if option[0] == "-"}
        assert listed == known - {"--help", "--install-completion", "--show-completion"}
        assert all(item.help for item in command.params), name


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_an_example_that_it_takes(name: str) -> None:
    command = click_commands()[name]
    assert EXAMPLES[name]
    for line in EXAMPLES[name]:
        program, called, *words = shlex.split(line)
        assert (program, called) == ("gs", name)
        command.make_context(name, words)  # raises on an option or a value that it does not take
    assert set(EXAMPLES) == set(COMMANDS)


def test_every_command_mission_order_and_extra_is_where_a_reader_looks_for_it() -> None:
    readme, missions, operating = (
        (_ROOT / page).read_text(encoding="utf-8") for page in ("README.md", "docs/missions.md", "docs/operating.md")
    )
    assert [name for name in COMMANDS if f"`gs {name}" not in readme and f"gs {name} " not in readme] == []
    extras = re.findall(r"^\| `pip install '\.\[(\w+)\]'` \|", readme, re.MULTILINE)
    assert sorted(extras) == sorted([*EXTRAS, "all"])
    come_along = packaged_names("missions")
    assert len(come_along) > 5
    assert [name for name in come_along if f"`{name}`" not in readme] == []
    assert [name for name in come_along if f"| `{name}.yaml` |" not in missions] == []
    assert [name for name in ORDERS if not re.search(rf"`{name}\b|gs command {name}\b", operating)] == []
