"""What a validator found, in plain words: key, what is allowed there, what was given.

Knows pydantic's findings by their type alone, so that neither it nor typer, which asks it too, is loaded for this.
"""

from __future__ import annotations

import re
import reprlib
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from groundstation.core.choices import nearest, unknown

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

_EXPECTED = "expected "
_BELOW = ("too_short", "too_long", "literal_error")
"""Findings that say nothing more where something below the same key is wrong; ends of words for types do neither."""
_short = reprlib.Repr()
_short.maxstring = _short.maxother = 200
_short.maxlong = 60

_ALLOWED: dict[str, Callable[[Mapping[str, object]], str]] = {
    "float_type": lambda _: "a number",
    "float_parsing": lambda _: "a number",
    "finite_number": lambda _: "a finite number",
    "int_type": lambda _: "a whole number",
    "int_parsing": lambda _: "a whole number",
    "int_parsing_size": lambda _: "a smaller whole number",
    "int_from_float": lambda _: "a whole number",
    "bool_type": lambda _: "true or false",
    "bool_parsing": lambda _: "true or false",
    "string_type": lambda _: "text",
    "string_unicode": lambda _: "text in UTF-8",
    "path_type": lambda _: "a path",
    "list_type": lambda _: "a list",
    "tuple_type": lambda _: "a list",
    "dict_type": lambda _: "keys and values",
    "mapping_type": lambda _: "keys and values",
    "model_type": lambda _: "keys and values",
    "model_attributes_type": lambda _: "keys and values",
    "none_required": lambda _: "nothing",
    "greater_than": lambda context: f"a number above {context['gt']:g}",
    "greater_than_equal": lambda context: f"a number of at least {context['ge']:.12g}",
    "less_than": lambda context: f"a number below {context['lt']:g}",
    "less_than_equal": lambda context: f"a number of at most {context['le']:.12g}",
    "string_too_short": lambda context: f"text of at least {_many(context['min_length'], 'character')}",
    "string_too_long": lambda context: f"text of at most {_many(context['max_length'], 'character')}",
    "string_pattern_mismatch": lambda _: "letters, digits, '.', '_' and '-', the first a letter or digit",
    "literal_error": lambda context: " or ".join(choices_of(str(context["expected"]))),
    "enum": lambda context: " or ".join(choices_of(str(context["expected"]))),
}
"""Type of a finding: what is allowed, as the words after "expected"."""


def no_boolean(value: object) -> object:
    """Refuses booleans, which Python would take for 0 or 1."""
    if isinstance(value, bool):
        raise ValueError("expected a number")
    return value


def shown(value: object) -> str:
    """A value for a message, shortened where it is long."""
    return _short.repr(value)


def choices_of(expected: str) -> list[str]:
    """The words among which a value had to be; pydantic tells them as one text."""
    return re.findall("'([^']*)'", expected) or [expected]


def key_of(finding: ErrorDetails, values: object) -> str:
    """The key of a finding as people write it, ``vehicles[0].pad_m``.

    Args:
        finding: of pydantic, whose place has names of types and of a union's members in it too.
        values: what was judged; only what leads through it is part of the key.
    """
    key, place, parts = "", values, finding["loc"]
    for number, part in enumerate(parts):
        if isinstance(part, int) and isinstance(place, list | tuple):
            key += f"[{part}]"
            place = place[part] if part < len(place) else None
        elif isinstance(place, Mapping) and part in place:
            key += f".{part}" if key else str(part)
            place = place[part]
        elif number == len(parts) - 1 and finding["type"] == "missing":
            key += f".{part}" if key else str(part)
    return key


def useful(findings: Sequence[ErrorDetails], values: object) -> dict[str, list[ErrorDetails]]:
    """Findings by key, without those that only follow from others.

    A list that is too short since its items were wrong is not too short; a list that is no single word was not meant
    to be one.
    """
    by_key: dict[str, list[ErrorDetails]] = {}
    for finding in findings:
        by_key.setdefault(key_of(finding, values), []).append(finding)
    for key, found in by_key.items():
        if any(other != key and other.startswith((f"{key}.", f"{key}[")) for other in by_key):
            found[:] = [item for item in found if not (item["type"] in _BELOW or item["type"].endswith("_type"))]
    return {key: found for key, found in by_key.items() if found}


def words_for(found: Sequence[ErrorDetails]) -> str:
    """What is wrong with one value: what is allowed, and what was given.

    Args:
        found: all findings at its key: one, or one of each member of a union.
    """
    given = found[0]["input"]
    allowed: dict[str, None] = {}
    for item in found:
        context = item.get("ctx") or {}
        kind = item["type"]
        if kind == "missing":
            return "is missing, give it a value"
        if kind in ("literal_error", "enum") and isinstance(given, str):
            known = choices_of(str(context["expected"]))
            if nearest(given, known) or (len(found) == 1 and len(known) > 1):
                return f"{given or shown(given)}: {unknown(given, known)}"
        if kind == "too_short":
            return f"needs at least {_many(context['min_length'], 'item')}, has {context['actual_length']}"
        if kind == "too_long":
            return f"takes at most {_many(context['max_length'], 'item')}, has {context['actual_length']}"
        words = _ALLOWED[kind](context) if kind in _ALLOWED else own_words(item)
        if kind not in _ALLOWED and not words.startswith(_EXPECTED):
            return f"{words}, got {shown(given)}"
        allowed[words.removeprefix(_EXPECTED)] = None
    return f"{_EXPECTED}{' or '.join(allowed)}, got {shown(given)}"


def own_words(finding: ErrorDetails) -> str:
    """The words of one of our own checks."""
    words = str(finding["msg"]).removeprefix("Value error, ")
    return words[:1].lower() + words[1:]


def _many(count: object, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"
