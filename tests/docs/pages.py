"""Reference pages, drawn from the models of the files and from the command line."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from typing import Any

from pydantic import BaseModel
from typer.main import get_command

from groundstation.app.cli import COMMANDS, build
from groundstation.app.commands.schema import MODELS
from groundstation.app.reference.examples import EXAMPLES
from groundstation.app.reference.words import Words, described, inside, words_of
from groundstation.mission.phases.table import page as phases_page

_TITLES = {
    "mission": (
        "Mission file: every key",
        "A mission says what a team shall do. [How to write one](missions.md), and [the tutorial](tutorial.md).",
    ),
    "formation": (
        "Formation file: every key",
        "A formation is points and a sensing graph. `gs new formation` writes one; "
        "[gains](gains.md) tells what a graph is worth.",
    ),
    "campaign": (
        "Vary file: every key",
        "A vary file says what `gs campaign` varies. [How to fly campaigns](campaigns.md).",
    ),
}
_DRAWN = "<!-- Drawn from the program by `make docs`: change the words in {source}, then draw it again. -->"


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")


def _code(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    return f"`{text}`" if text else ""


def _bounds(part: dict[str, Any]) -> str:
    low = next(
        (
            f"{mark} {part[key]:g}"
            for key, mark in (("ge", "≥"), ("gt", ">"), ("minimum", "≥"), ("exclusiveMinimum", ">"))
            if key in part
        ),
        "",
    )
    high = next((f"≤ {part[key]:g}" for key in ("le", "maximum") if key in part), "") or next(
        (f"< {part[key]:g}" for key in ("lt", "exclusiveMaximum") if key in part), ""
    )
    return ", ".join(bound for bound in (low, high) if bound)


def _type(part: dict[str, Any], places: dict[str, str]) -> str:
    """Type of a key in words."""
    if "$ref" in part:
        name = part["$ref"].rsplit("/", 1)[-1]
        return f"[{places[name]}](#{_anchor(places[name])})"
    if "anyOf" in part or "oneOf" in part:
        kinds = [_type(item, places) for item in part.get("anyOf") or part["oneOf"] if item.get("type") != "null"]
        return " or ".join(dict.fromkeys(kinds))
    if "enum" in part or "const" in part:
        return ", ".join(f"`{value}`" for value in part.get("enum", [part.get("const")]))
    kind = part.get("type")
    if kind == "array" and "prefixItems" in part:
        return f"{len(part['prefixItems'])} numbers"
    if kind == "array":
        return f"list of {_type(part.get('items', {}), places)}" if part.get("items") else "list"
    if kind == "object":
        inner = part.get("additionalProperties")
        return f"name: {_type(inner, places)}" if isinstance(inner, dict) and inner else "name: value"
    words = {"number": "number", "integer": "whole number", "string": "text", "boolean": "`true`, `false`"}
    bounds = _bounds(part)
    return f"{words.get(str(kind), 'anything')}{' ' + bounds if bounds else ''}"


def _anchor(heading: str) -> str:
    return re.sub(r"[^\w\- ]", "", heading.replace("`", "").lower()).replace(" ", "-")


def _refs(part: Any) -> Iterator[str]:
    if isinstance(part, dict):
        if "$ref" in part:
            yield part["$ref"].rsplit("/", 1)[-1]
        for value in part.values():
            yield from _refs(value)
    elif isinstance(part, list):
        for value in part:
            yield from _refs(value)


def _places(schema: dict[str, Any], top: str) -> dict[str, str]:
    """Model: the heading of its section, in the order in which a reader comes by them."""
    found = {top: "Top of the file"}
    todo: list[tuple[str, dict[str, Any], str]] = [(top, schema, "")]
    while todo:
        _, part, where = todo.pop(0)
        for key, values in inside(part)["properties"].items():
            kinds = values.get("anyOf", [values])
            also_listed = any(kind.get("type") == "array" for kind in kinds)
            for kind in kinds:
                listed = "[]" if kind.get("type") == "array" else ".NAME" if "additionalProperties" in kind else ""
                for name in _refs(kind):
                    if name not in found:
                        step = next(iter(schema["$defs"][name]["properties"]))
                        below = f".{step}" if inside(schema["$defs"][name]) is not schema["$defs"][name] else ""
                        place = f"{where}{key}{listed}{below}"
                        found[name] = place if listed or not also_listed else f"{place} (short form)"
                        todo.append((name, schema["$defs"][name], f"{place}."))
    return found


def _default(key: str, values: dict[str, Any], required: list[str], said: Words) -> str:
    if key in required:
        return "**needed**"
    if said.default is not None:
        return said.default
    default = values.get("default")
    return "" if default is None or default in ({}, []) else "as below" if isinstance(default, dict) else _code(default)


def file_page(file: str) -> str:
    """The reference page of a file.

    Args:
        file: a key of ``MODELS``.
    """
    model: type[BaseModel] = MODELS[file]()
    schema = described(file, model)
    places = _places(schema, model.__name__)
    title, about = _TITLES[file]
    lines = [f"# {title}", "", _DRAWN.format(source=f"groundstation/app/reference/{file}.yaml"), "", about, ""]
    lines += [
        "Unknown keys are errors that name the nearest one. Positions are ENU, in metres. "
        f"An editor shows the same with `gs schema {file} > {file}.schema.json`.",
    ]
    for name, place in places.items():
        part = schema if name == model.__name__ else schema["$defs"][name]
        body, said = inside(part), words_of(file)[name]
        heading = place if name == model.__name__ else f"`{place}`"
        lines += ["", f"## {heading}", ""]
        about_model = body.get("description", "") if name != model.__name__ else ""
        if about_model:
            lines += [about_model.split("\n\n")[0].replace("\n", " ").replace("``", "`"), ""]
        lines += ["| key | type | unit | default | example | meaning |", "| --- | --- | --- | --- | --- | --- |"]
        for key, values in body["properties"].items():
            words = said[key]
            cells = (
                f"`{key}`",
                _type(values, places),
                words.unit,
                _default(key, values, body.get("required", []), words),
                _code(words.example),
                words.text,
            )
            lines.append("| " + " | ".join(map(_cell, cells)) + " |")
    return "\n".join(lines) + "\n"


def click_commands() -> dict[str, Any]:
    """Every command as the command line knows it: name, click command."""
    return {name: get_command(build(name)).commands[name] for name in COMMANDS}  # type: ignore[attr-defined]


def _kind(parameter: Any) -> str:
    """Type of an option or argument in words, with its bounds."""
    if getattr(parameter, "is_flag", False):
        return ""
    annotation = parameter.type_descriptor.annotation
    if isinstance(annotation, type) and issubclass(annotation, Enum):
        return ", ".join(f"`{item.value}`" for item in annotation)
    kind = {Path: "path", int: "whole number", float: "number", str: "text"}.get(annotation, "text")
    bounds = (
        f"≥ {parameter.min:g}" if parameter.min is not None else "",
        f"≤ {parameter.max:g}" if parameter.max is not None else "",
    )
    more = "may be repeated" if parameter.multiple or parameter.nargs == -1 else ""
    return ", ".join(filter(None, (" ".join(filter(None, (kind, bounds[0]))), bounds[1], more)))


def _option(parameter: Any) -> tuple[str, str, str, str]:
    """Names, type, default and meaning of an option or argument."""
    names = ", ".join(f"`{name}`" for name in (*parameter.opts, *parameter.secondary_opts))
    if parameter.param_type_name == "argument":
        names = f"`{parameter.metavar or parameter.name.upper()}`"
    if parameter.required:
        default = "**needed**"
    else:
        known = parameter.default not in (None, (), math.inf) and parameter.default is not False
        default = f"`{parameter.default}`" if known else ""
    return names, _kind(parameter), default, parameter.help or ""


def commands_page() -> str:
    """The reference page of the command line."""
    lines = ["# Commands: every option", "", _DRAWN.format(source="groundstation/app/commands/"), ""]
    lines += [
        "Every command takes `--help`. Those with `--json` print one JSON object on the last line of stdout, and all",
        "else on stderr. Exit codes: 0 done; 1 the mission or the check failed, vehicles left safe; 2 wrong usage or",
        "configuration; 3 preflight refused, nothing was armed.",
        "",
        "| command | what it does |",
        "| --- | --- |",
    ]
    found = click_commands()
    lines += [f"| [`gs {name}`](#gs-{name}) | {_cell(COMMANDS[name][1])} |" for name in found]
    for name, command in found.items():
        lines += ["", f"## gs {name}", ""]
        about = " ".join((command.help or "").replace("\b", "").split("\n\n")[0].split())
        lines += [about.replace("``", "`"), "", "```", *EXAMPLES[name], "```", ""]
        lines += ["| | type | default | meaning |", "| --- | --- | --- | --- |"]
        for parameter in command.params:
            if parameter.name not in ("help", "install_completion", "show_completion"):
                lines.append("| " + " | ".join(map(_cell, _option(parameter))) + " |")
    return "\n".join(lines) + "\n"


PAGES = {
    "docs/phases.md": phases_page,
    "docs/reference-mission.md": lambda: file_page("mission"),
    "docs/reference-formation.md": lambda: file_page("formation"),
    "docs/reference-campaign.md": lambda: file_page("campaign"),
    "docs/reference-commands.md": commands_page,
}
"""Pages that are drawn from the program: path in the repository, what draws it."""
