"""What a formation's shape leaves free, in words.

The gains alone hold a formation up to a translation, a heading and two scales, one horizontal and one vertical (Theorem
1). Degenerate shapes have fewer of these, or hide more in them; this module says which. It judges no graph.
"""

from __future__ import annotations

import numpy as np

from groundstation.core.formation import Formation
from groundstation.design.problem import FLAT_TOLERANCE, split

NEARLY_FLAT = 1e-3
"""Spread relative to the size below which a coordinate is a matter of accuracy rather than of shape."""


def notes(formation: Formation) -> list[str]:
    """Says what is special about a shape.

    Args:
        formation: only its points matter.

    Returns:
        Sentences without a final stop, none for a shape in general position.
    """
    n = formation.size
    if n == 1:
        return ["one agent: there is nothing to hold"]
    xy, z = split(formation)
    vertical = xy.kernel.shape[1] == 1
    level = z.kernel.shape[1] == 1
    said: list[str] = []
    if n == 2 and not vertical:
        said.append(
            "two agents side by side are the formation in every horizontal position, up to heading and scale: the "
            "horizontal gains are zero, only a scale function holds their distance"
        )
    if n == 2 and not level:
        said.append(
            "two agents at different heights are the formation at any two heights, up to scale: the vertical gains are "
            "zero, only a scale function holds their distance"
        )
    if vertical:
        said.append(
            "all agents stand on one vertical line: they are drawn onto one line, and there is no heading and no "
            "horizontal scale to choose"
        )
    if level:
        said.append(
            "all agents are at one height: the formation is held level, and there is no vertical scale to choose"
        )
    if not vertical and not level and n > 2:
        said += _slanted(formation)
    for name, block in (("horizontal", xy), ("vertical", z)):
        spread = float(np.max(np.abs(block.coordinate)))
        if FLAT_TOLERANCE < spread < NEARLY_FLAT and block.kernel.shape[1] == 2:
            said.append(
                f"the {name} extent is only {spread:.1g} of the formation's size and still counts as shape: its scale "
                "is free, so small differences may grow; make them zero if they are not meant"
            )
    return said


def _slanted(formation: Formation) -> list[str]:
    centred = formation.points_enu_m - formation.points_enu_m.mean(axis=0)
    values = np.linalg.svd(centred, compute_uv=False)
    rank = int(np.sum(values > 1e-9 * values[0]))
    if rank == 3:
        return []
    flat = np.linalg.svd(centred[:, :2], compute_uv=False)
    upright = rank == 2 and flat[1] <= 1e-9 * values[0]
    if upright:
        return [
            "all agents are in one upright plane: width and height scale apart from each other until a scale is set"
        ]
    what = "line" if rank == 1 else "plane"
    return [
        f"all agents are on one slanted {what}: as horizontal and vertical scale are free of each other, its slope is "
        "held only by a scale function"
    ]
