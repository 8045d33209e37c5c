"""Names that people choose from, and the words for one that is not among them."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def nearest(name: str, known: Iterable[str]) -> str:
    """Which of the known names may have been meant; "" where none is like it."""
    listed = list(known)
    small = {item.lower(): item for item in listed}
    near = difflib.get_close_matches(name.lower(), small, n=1)
    return small[near[0]] if near else ""


def unknown(name: str, known: Iterable[str]) -> str:
    """Says that nobody knows a name, which one may have been meant, and which there are."""
    listed = list(known)
    near = nearest(name, listed)
    meant = f", did you mean {near}?" if near else ";"
    return f"unknown{meant} known are {', '.join(listed)}"
