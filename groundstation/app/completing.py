"""How words on the command line go on, for shells: names that come along, files of the right kind, orders, choices.

A shell waits for the answer at every press of a key: nothing is loaded for it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import typer

from groundstation.app.packaged import packaged_configs, packaged_names

Completer = Callable[[str], list[str]]
ORDERS = "hold", "resume", "return", "land", "kill", "silence", "move", "turn", "scale", "stay", "next", "start", "fix"
"""What can be ordered, as ``mission.operator`` has it."""
SHAPES = "ring", "line", "v", "grid", "cube", "sphere"
"""Shapes that a formation can be made of, as ``design.common_shapes`` has them."""
GRAPHS = "sparse", "balanced", "robust"
"""Graphs that can be proposed, as ``design.graphs`` has them."""
_NAME_VEHICLES = "land", "kill"
_FLIGHTS = Path("flights")
_ENTRIES_MAX = 500


def choice(*words: str) -> Completer:
    """One of these words."""

    def complete(incomplete: str) -> list[str]:
        return [word for word in words if word.startswith(incomplete)]

    return complete


def packaged(folder: str, *suffixes: str) -> Completer:
    """A file of one's own, or the name of one that comes along.

    Args:
        folder: ``missions``, ``formations`` or ``campaigns``.
        suffixes: of files of one's own; those of YAML where none is given.
    """

    def complete(incomplete: str) -> list[str]:
        names = [] if "/" in incomplete else [name for name in packaged_names(folder) if name.startswith(incomplete)]
        return names + files(incomplete, suffixes or (".yaml", ".yml"))

    return complete


def logs(incomplete: str) -> list[str]:
    """A log: a .tlog file, or the name of one in ``flights``."""
    named = [] if "/" in incomplete else [Path(item).stem for item in files(f"{_FLIGHTS}/{incomplete}", (".tlog",))]
    return sorted({*named, *files(incomplete, (".tlog",))})


def settings(incomplete: str) -> list[str]:
    """Keys of the mission that ``--set`` changes, ``limits.pose_age_s=``; a key that holds others ends in a point."""
    if "=" in incomplete:
        return []
    import json  # noqa: PLC0415 - only here

    try:
        schema = json.loads((packaged_configs() / "schemas" / "mission.schema.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return []
    *path, begun = incomplete.split(".")
    keys = _under(schema, "properties")
    for key in path:
        keys = _keys_of(schema, keys.get(key))
    return [
        ".".join((*path, key)) + ("." if _keys_of(schema, value) else "=")
        for key, value in keys.items()
        if key.startswith(begun)
    ]


def _keys_of(schema: dict[str, object], value: object) -> dict[str, object]:
    """Keys of what a key of the schema holds; of several that it may hold those of the first that has some."""
    several = _under({"several": value}, "several").get("anyOf")
    for one in (value, *(several if isinstance(several, list) else ())):
        named = isinstance(one, dict) and one.get("$ref")
        if isinstance(named, str):
            return _under(_under(_under(schema, "$defs"), named.rpartition("/")[2]), "properties")
    return {}


def _under(values: dict[str, object], key: str) -> dict[str, object]:
    """What stands under a key, where that is a mapping."""
    found = values.get(key)
    return found if isinstance(found, dict) else {}


def shape_of(context: typer.Context, incomplete: str) -> list[str]:
    """What ``gs new formation`` can be made of; nothing after ``gs new law``."""
    if context.params.get("what") == "law":
        return []
    return choice(*SHAPES)(incomplete) + files(incomplete, (".csv", ".skyc"))


def order_words(context: typer.Context, incomplete: str) -> list[str]:
    """The words of an order."""
    before = [word for word in context.params.get("words") or () if word != incomplete]
    if not before:
        return choice(*ORDERS)(incomplete)
    return choice("all")(incomplete) if before[0] in _NAME_VEHICLES and len(before) == 1 else []


def files(incomplete: str, suffixes: Sequence[str]) -> list[str]:
    """Files with these suffixes and folders that begin so; of a single folder what is in it, so that it goes on."""
    while True:
        head, slash, tail = incomplete.rpartition("/")
        found = []
        try:
            entries = sorted(Path(f"{head}{slash}" or ".").expanduser().iterdir())[:_ENTRIES_MAX]
            for item in entries:
                if item.name.startswith(tail) and (tail.startswith(".") or not item.name.startswith(".")):
                    if item.is_dir():
                        found.append(f"{head}{slash}{item.name}/")
                    elif item.suffix in suffixes:
                        found.append(f"{head}{slash}{item.name}")
        except (OSError, ValueError, RuntimeError):
            return []
        if len(found) != 1 or not found[0].endswith("/") or len(found[0]) <= len(incomplete):
            return found
        incomplete = found[0]
