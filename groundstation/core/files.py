"""The file border: YAML into plain values, and what is wrong with them in words that name file and key."""

from __future__ import annotations

from collections.abc import Hashable
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from groundstation.core.errors import UserError

Model = TypeVar("Model", bound=BaseModel)


class _UniqueKeyLoader(yaml.SafeLoader):
    """Safe loader that refuses a key given twice, which YAML would silently take from the last place."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: set[Any] = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if isinstance(key, Hashable) and key in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"key {key!r} is given twice, keep one", key_node.start_mark
                )
            seen.add(key)
        return super().construct_mapping(node, deep=deep)


def read_yaml(path: Path) -> dict[str, Any]:
    """Reads a YAML file whose top level is a mapping.

    Raises:
        UserError: no such file, not readable, not YAML, or not a mapping.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise UserError(f"{path}: is not a text file in UTF-8") from None
    return parse_yaml(text, str(path))


def parse_yaml(text: str, source: str) -> dict[str, Any]:
    """Reads YAML text whose top level is a mapping; ``source`` names it in messages.

    Raises:
        UserError: not YAML, or not a mapping.
    """
    try:
        values = yaml.load(text, Loader=_UniqueKeyLoader)  # noqa: S506 - a SafeLoader
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        place = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
        problem = getattr(error, "problem", None) or str(error)
        raise UserError(f"{source}: {place}is not valid YAML: {problem}") from None
    if not isinstance(values, dict) or not all(isinstance(key, str) for key in values):
        raise UserError(f"{source}: expected keys and values at the top level, for example `name: ...`")
    return values


def validate(model: type[Model], values: dict[str, Any], source: str) -> Model:
    """Checks plain values against a model.

    Raises:
        UserError: each wrong key with its value and what is allowed, one per line.
    """
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise UserError("\n".join(_describe(source, item) for item in error.errors())) from None


def _describe(source: str, item: Any) -> str:
    key = ""
    for part in item["loc"]:
        if isinstance(part, int):
            key += f"[{part}]"
        elif part not in {"float", "constrained-float"} and not str(part).startswith(("literal[", "function-")):
            key += f".{part}" if key else str(part)
    if item["type"] == "extra_forbidden":
        return f"{source}: {key}: unknown key, remove it or correct its spelling"
    if item["type"] == "missing":
        return f"{source}: {key}: is missing, give it a value"
    message = item["msg"].removeprefix("Value error, ")
    message = message[:1].lower() + message[1:]
    return f"{source}: {key or 'file'}: {message}, got {item['input']!r}"
