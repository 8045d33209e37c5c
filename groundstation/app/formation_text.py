"""A formation as the text of a formation file."""

from __future__ import annotations

import math
from collections.abc import Sequence

import yaml

from groundstation.core.formation import Formation


def formation_text(formation: Formation, *, scale: float = 1.0, about: Sequence[str] = ()) -> str:
    """Writes a formation file.

    Args:
        formation: its points are written as they are, m, ENU.
        scale: multiplies the points when the file is read.
        about: comment lines at the top.

    Returns:
        YAML; read again, it gives the same points (times ``scale``) and edges to the bit.
    """
    lines = [f"# {line}" for line in about]
    quoted = yaml.safe_dump(formation.name, default_style='"', width=math.inf).strip()
    lines += [f"name: {quoted}", f"scale: {scale!r}", "points:"]
    lines += ["  - [" + ", ".join(_number(value) for value in point) + "]" for point in formation.points_enu_m]
    if 2 * len(formation.edges) == formation.size * (formation.size - 1):
        lines.append("edges: complete")
    else:
        lines += ["edges:", *(f"  - [{i + 1}, {j + 1}]" for i, j in formation.edges)]
    return "\n".join(lines) + "\n"


def _number(value: float) -> str:
    """A number to its last bit; YAML takes 1e-05 for a word, and 1.0e-05 for a number."""
    text = repr(float(value))
    return text if "." in text else text.replace("e", ".0e")
