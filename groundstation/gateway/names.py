"""Names of parameters that MAVLink can carry: 16 bytes, where the firmware's are longer.

A name that is too long has its group cut to what is left: ``supervisor.landedTimeout`` becomes ``su.landedTimeout``.
Refuses to give two parameters one name: the later one ends in a digit.
"""

from __future__ import annotations

from collections.abc import Iterable

_LONGEST = 16


def short_names(names: Iterable[str]) -> dict[str, str]:
    """Short name: full name, in the order of the full ones."""
    found: dict[str, str] = {}
    for full in names:
        short = _cut(full)
        number = 1
        while short in found:
            number += 1
            short = f"{_cut(full)[: _LONGEST - len(str(number))]}{number}"
        found[short] = full
    return found


def _cut(full: str) -> str:
    if len(full) <= _LONGEST:
        return full
    group, _, name = full.partition(".")
    room = max(1, _LONGEST - 1 - len(name))
    return f"{group[:room]}.{name}"[:_LONGEST]
