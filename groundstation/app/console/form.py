"""A form for a mission file, made of its JSON schema: what can be given, what it means, what is there. Pure.

A key with keys of its own becomes a section, a list of such a section for each item; everything else is one line, as
YAML has it. Keys are written as messages name them, ``vehicles[0].pad_m``, so that a fault finds its field.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import yaml

from groundstation.core.errors import UserError
from groundstation.core.files import parse_yaml_value

Place: TypeAlias = tuple[str | int, ...]
"""Keys and numbers of items, from the top of the file."""
Values: TypeAlias = dict[str, object]


@dataclass(frozen=True)
class Entry:
    """One value.

    Attributes:
        place: where it stands.
        name: its key.
        words: what it means.
        given: what is there, as YAML; "" where nothing is.
        default: what holds where nothing is given, as YAML; "" where nothing does.
        choices: the only values that it may have, as YAML; empty where it is written freely.
        needed: it has to be given.
    """

    place: Place
    name: str
    words: str
    given: str
    default: str
    choices: tuple[str, ...] = ()
    needed: bool = False

    @property
    def key(self) -> str:
        """As messages name it."""
        return key_of(self.place)


@dataclass(frozen=True)
class Section:
    """What has keys of its own.

    Attributes:
        place: where it stands, empty for the whole file.
        name: its key, with the number of an item.
        words: what it means.
        parts: what is in it.
    """

    place: Place
    name: str
    words: str
    parts: tuple[Entry | Section, ...]


def key_of(place: Place) -> str:
    """A place as messages name it."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place)
    return text.removeprefix(".")


def yaml_line(value: object) -> str:
    """A value as YAML on one line."""
    text = yaml.safe_dump(value, default_flow_style=True, width=10_000, sort_keys=False, allow_unicode=True)
    return text.removesuffix("...\n").strip()


def form_of(schema: Mapping[str, object], values: Mapping[str, object], leave_out: Sequence[str] = ()) -> Section:
    """The form of a file.

    Args:
        schema: JSON schema of the whole file, as ``gs schema`` prints it.
        values: what is in it.
        leave_out: keys at the top that are edited elsewhere.
    """
    return _Maker(schema, set(leave_out)).section((), "", schema, values)


def put(values: Values, place: Place, text: str) -> None:
    """Gives a value, in place; nothing written takes it out.

    Args:
        values: the file.
        place: where; sections above it are made where they are missing.
        text: the value, as YAML.

    Raises:
        UserError: it is no YAML.
    """
    value = parse_yaml_value(text, key_of(place)) if text.strip() else None
    inner: object = values
    for part in place[:-1]:
        if isinstance(inner, dict):
            if inner.get(part) is None:
                inner[part] = {}
            inner = inner[part]
        elif isinstance(inner, list) and isinstance(part, int) and part < len(inner):
            inner = inner[part]
        else:
            raise UserError(f"{key_of(place)}: there is nothing of that name any more; open the mission again")
    last = place[-1]
    if isinstance(inner, list) and isinstance(last, int) and last < len(inner):
        inner[last] = value
    if isinstance(inner, dict):
        inner[last] = value
        if not text.strip():
            del inner[last]


class _Maker:
    """Walks a schema and what is there side by side."""

    def __init__(self, schema: Mapping[str, object], leave_out: set[str]) -> None:
        self._named, self._leave_out = _inner(schema, "$defs"), leave_out

    def section(self, place: Place, name: str, schema: Mapping[str, object], given: object) -> Section:
        """What has keys of its own."""
        values = given if isinstance(given, Mapping) else {}
        needed = schema.get("required")
        parts = []
        for key, of in _inner(schema, "properties").items():
            if place or key not in self._leave_out:
                is_needed = isinstance(needed, list) and key in needed
                parts.append(self._part((*place, key), key, of, values.get(key), needed=is_needed))
        return Section(place, name, str(schema.get("description") or ""), tuple(parts))

    def _part(self, place: Place, name: str, schema: object, given: object, *, needed: bool) -> Entry | Section:
        of = self._fitting(self._followed(schema), given)
        words = str(of.get("description") or "")
        items = self._followed(of.get("items"))
        if "properties" in of and (given is None or isinstance(given, Mapping)):
            return self.section(place, name, of, given)
        if isinstance(given, list) and ("properties" in items or "oneOf" in items):
            parts = tuple(
                self.section((*place, number), f"{name}[{number}]", self._kind(items, item), item)
                for number, item in enumerate(given)
            )
            return Section(place, name, words, parts)
        allowed = of.get("enum")
        choices = tuple(map(yaml_line, allowed)) if isinstance(allowed, list) else ()
        if of.get("type") == "boolean":
            choices = ("true", "false")
        default = of.get("default")
        return Entry(
            place,
            name,
            words,
            "" if given is None else yaml_line(given),
            "" if default is None else yaml_line(default),
            choices,
            needed,
        )

    def _fitting(self, of: dict[str, object], given: object) -> dict[str, object]:
        """Of several forms that a key may have, that of what is given: a list, or keys."""
        wanted = "items" if isinstance(given, list) else "properties" if isinstance(given, Mapping) else None
        kinds = of.get("anyOf")
        for kind in kinds if isinstance(kinds, list) else ():
            if wanted is not None and wanted in (found := self._followed(kind)):
                return found | of
        return of

    def _kind(self, items: Mapping[str, object], item: object) -> Mapping[str, object]:
        """The schema of one item, where it is one of several kinds: that whose key it has."""
        kinds = items.get("oneOf")
        for kind in kinds if isinstance(kinds, list) else ():
            of = self._followed(kind)
            if isinstance(item, Mapping) and set(_inner(of, "properties")) & set(item):
                return of
        return items

    def _followed(self, schema: object) -> dict[str, object]:
        """A schema with what it refers to."""
        if not isinstance(schema, Mapping):
            return {}
        reference = schema.get("$ref")
        if isinstance(reference, str):
            return self._followed(self._named.get(reference.rpartition("/")[2])) | dict(schema)
        return dict(schema)


def _inner(schema: Mapping[str, object], key: str) -> dict[str, object]:
    found = schema.get(key)
    return dict(found) if isinstance(found, Mapping) else {}
