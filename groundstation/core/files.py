"""The file border: YAML into plain values, and what is wrong with them in words that name file and key."""

from __future__ import annotations

import stat
from collections.abc import Hashable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar, get_args

import yaml
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from groundstation.core.choices import nearest
from groundstation.core.errors import UserError
from groundstation.core.findings import choices_of, own_words, useful, words_for

Model = TypeVar("Model", bound=BaseModel)
_BYTES_MAX = 32 << 20
_VALUES_MAX = 5_000_000  # counted with every alias written out: that is what whoever walks through them meets
_DEPTH_MAX = 100
_NUMBER_MAX = 400  # characters; the largest float has 309 digits
_NUMBER_TAGS = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")


def require_regular(path: Path, max_bytes: int, what: str) -> None:
    """Makes sure that reading the whole of a file comes to an end: devices and pipes may have none.

    Args:
        path: the file.
        max_bytes: the most that is read.
        what: it should be, for the message.

    Raises:
        UserError: it is no regular file, or longer.
        OSError: there is no such file, or it cannot be looked at.
    """
    found = path.stat()
    if not stat.S_ISREG(found.st_mode):
        raise UserError(f"{path}: is no regular file, expected {what}; name a file on a disk")
    if found.st_size > max_bytes:
        raise UserError(
            f"{path}: {found.st_size} bytes are too many for {what}, limit {max_bytes >> 20} MB; is it the right file?"
        )


class _UniqueKeyLoader(yaml.SafeLoader):
    """Safe loader that refuses a key given twice, which YAML would silently take from the last place.

    Aliases are taken, but neither those that grow beyond all bounds when they are written out nor those that hold
    themselves; and no numbers that would take Python minutes to read.
    """

    def fetch_flow_collection_start(self, TokenClass: Any) -> None:
        if self.flow_level >= _DEPTH_MAX:  # PyYAML's time grows with the cube of it
            raise yaml.scanner.ScannerError(None, None, f"nested more than {_DEPTH_MAX} deep", self.get_mark())
        super().fetch_flow_collection_start(TokenClass)

    def get_single_node(self) -> yaml.Node | None:
        node = super().get_single_node()
        if node is not None and _expanded(node, {}) > _VALUES_MAX:
            raise yaml.constructor.ConstructorError(
                None, None, f"more than {_VALUES_MAX} values when aliases are written out", node.start_mark
            )
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: set[Any] = set()
        for key_node, _ in node.value:
            if key_node.tag == "tag:yaml.org,2002:merge":  # `<<`: what is there besides comes first
                continue
            key = self.construct_object(key_node, deep=True)
            if isinstance(key, Hashable) and key in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"key {key!r} is given twice, keep one", key_node.start_mark
                )
            seen.add(key)
        return super().construct_mapping(node, deep=deep)


def _expanded(node: yaml.Node, known: dict[int, int]) -> int:
    """Number of values of a node with every alias written out; judges them on the way."""
    if isinstance(node, yaml.ScalarNode):
        if node.tag in _NUMBER_TAGS and len(node.value) > _NUMBER_MAX:
            raise yaml.constructor.ConstructorError(
                None, None, f"a number of {len(node.value)} characters, limit {_NUMBER_MAX}", node.start_mark
            )
        return 1
    if id(node) not in known:
        known[id(node)] = -1
        children = [part for pair in node.value for part in pair] if isinstance(node, yaml.MappingNode) else node.value
        known[id(node)] = 1 + sum(_expanded(child, known) for child in children)
    elif known[id(node)] < 0:
        raise yaml.constructor.ConstructorError(None, None, "an alias that holds itself", node.start_mark)
    return known[id(node)]


def is_file(path: Path) -> bool:
    """Whether there is such a file; not for names that are too long, or hold what no name can hold."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def exists(path: Path) -> bool:
    """Whether anything has this name; not for names that are too long, or hold what no name can hold."""
    try:
        return path.exists() or path.is_symlink()
    except (OSError, ValueError):
        return False


def read_text(path: Path, bytes_max: int, encoding: str = "utf-8") -> str:
    """Reads a text file that people bring along.

    Args:
        path: the file.
        bytes_max: as long as it may be, whole MB; no more is read.
        encoding: UTF-8, with ``utf-8-sig`` the mark that spreadsheets put in front is passed over.

    Raises:
        UserError: no such file, not readable, too long, or no text.
    """
    try:
        with path.open("rb") as file:
            content = file.read(bytes_max + 1)
        if len(content) > bytes_max:
            raise UserError(f"{path}: is longer than {bytes_max >> 20} MB, the limit for such files")
        return content.decode(encoding)
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise UserError(f"{path}: is not a text file in UTF-8") from None


def read_yaml(path: Path) -> dict[str, Any]:
    """Reads a YAML file whose top level is a mapping.

    Raises:
        UserError: no such file, not readable, not YAML, or not a mapping.
    """
    return parse_yaml(read_text(path, _BYTES_MAX), str(path))


def parse_yaml(text: str, source: str) -> dict[str, Any]:
    """Reads YAML text whose top level is a mapping; ``source`` names it in messages.

    Raises:
        UserError: not YAML, or not a mapping.
    """
    values = parse_yaml_value(text, source)
    if not isinstance(values, dict) or not all(isinstance(key, str) for key in values):
        raise UserError(f"{source}: expected keys and values at the top level, for example `name: ...`")
    return values


def parse_yaml_value(text: str, source: str) -> Any:
    """Reads YAML text that holds anything; ``source`` names it in messages.

    Raises:
        UserError: not YAML, or too much of it.
    """
    try:
        return yaml.load(text, Loader=_UniqueKeyLoader)  # noqa: S506 - a SafeLoader
    except RecursionError:
        raise UserError(f"{source}: is not valid YAML: nested too deeply") from None
    except (yaml.YAMLError, ValueError, OverflowError, TypeError, AttributeError, LookupError) as error:
        # The last ones are PyYAML's own, for example on `!!binary` of a list or a date without a day.
        mark = getattr(error, "problem_mark", None)
        place = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
        problem = getattr(error, "problem", None) or str(error)
        raise UserError(f"{source}: {place}is not valid YAML: {problem}") from None


def validate(model: type[Model], values: dict[str, Any], source: str) -> Model:
    """Checks plain values against a model.

    Raises:
        UserError: each wrong key with its value and what is allowed, one per line.
    """
    try:
        return model.model_validate(values)
    except ValidationError as error:
        lines = (f"{source}: {words}" for words in _faults(model, values, error).values())
        raise UserError("\n".join(lines)) from None


def faults(model: type[BaseModel], values: Mapping[str, object]) -> dict[str, str]:
    """What is wrong with plain values, by key, each in words that begin with it; empty where they fit the model."""
    try:
        model.model_validate(values)
    except ValidationError as error:
        return _faults(model, values, error)
    return {}


def _faults(model: type[BaseModel], values: Mapping[str, object], error: ValidationError) -> dict[str, str]:
    return {key: _describe(model, key, found) for key, found in useful(error.errors(), values).items()}


def _keys_beside(model: type[BaseModel], place: Sequence[str | int]) -> set[str]:
    """Keys that are known where a key stands; ``place`` as pydantic tells it, the key last."""
    models: list[type[BaseModel]] = [model]
    for part in place[:-1]:
        inner = [item.model_fields[part].annotation for item in models if part in item.model_fields]
        models = [found for annotation in inner for found in _models_in(annotation)] or models
    return {name for item in models for name in item.model_fields}


def _models_in(annotation: object) -> list[type[BaseModel]]:
    """Models that an annotation names, in unions and lists too."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [found for part in get_args(annotation) for found in _models_in(part)]


def _describe(model: type[BaseModel], key: str, found: Sequence[ErrorDetails]) -> str:
    item = found[0]
    if item["type"] == "union_tag_invalid":  # one of several kinds, named by its only key
        name, known = str(item["ctx"]["tag"]), set(choices_of(item["ctx"]["expected_tags"]))
        return f"{key}.{name}: {_unknown(name, known)}"
    if item["type"] == "extra_forbidden":
        return f"{key}: {_unknown(str(item['loc'][-1]), _keys_beside(model, item['loc']))}"
    if not key and item["type"] == "value_error":  # of the whole file: the words name the key
        return own_words(item)
    return f"{key or 'file'}: {words_for(found)}"


def _unknown(name: str, known: set[str]) -> str:
    """Says that nobody knows a key, and which one may have been meant."""
    # Units stand at the end of our keys: who leaves them out gets the whole key.
    whole = next((other for other in sorted(known) if other.startswith(f"{name}_")), "")
    near = whole or nearest(name, sorted(known))
    return f"unknown key, did you mean {near}?" if near else "unknown key, remove it or correct its spelling"
