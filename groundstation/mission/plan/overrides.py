"""Changes a single value of a mission file before it is judged: ``--set key.path=value``.

Adds keys, since a value may be left out of a file; never adds to a list. What the value means is not looked at here.
"""

from __future__ import annotations

from typing import Any

from groundstation.core.errors import UserError
from groundstation.core.files import parse_yaml_value


def override_value(values: dict[str, Any], override: str) -> None:
    """Sets one value in place, and the keys above it that are missing.

    Args:
        values: a mission file as plain values.
        override: ``key.path=value``, the value in YAML, list items by number from 0.

    Raises:
        UserError: it is not of this form, its value is no YAML, or its path leads past the end of a list or below a
            single value.
    """
    path, separator, text = override.partition("=")
    if not separator or not path:
        raise UserError(f"--set {override}: expected key.path=value, for example speed_limit_m_s=0.3")
    try:
        value = parse_yaml_value(text, path)
    except UserError:
        raise UserError(f"--set {override}: the value is not valid YAML") from None
    *parents, last = path.split(".")
    place: Any = values
    for number, key in enumerate([*parents, last]):
        where = ".".join([*parents, last][: number + 1])
        step: str | int = key
        if isinstance(place, list):
            if not (key.isascii() and key.isdigit() and len(key) < 10) or int(key) >= len(place):
                raise UserError(f"--set {override}: {where}: expected a number from 0 to {len(place) - 1}")
            step = int(key)
        elif not isinstance(place, dict):
            raise UserError(f"--set {override}: {where}: there are no keys below a single value")
        if number == len(parents):
            place[step] = value
        elif isinstance(place, dict):
            place = place.setdefault(step, {})
        else:
            place = place[int(step)]
