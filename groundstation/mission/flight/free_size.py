"""The size of a formation whose size is free: in words, and whether a move has brought it to where it was to be.

With a fixed scale distances tell. With a free one nothing but the move itself changes the size, and r comes first: so
it is compared with what was asked for when the move is over. Refuses nothing; ``formation_flight`` ends the mission.
"""

from __future__ import annotations

import math

import numpy as np

from groundstation.core.metrics import size_ratios
from groundstation.core.types import FloatArray
from groundstation.mission.plan.stages import Stage, shortest_m

Sizes = tuple[float, float]
"""Level and upright, against the formation's points; NaN where unknown or where a formation is flat."""

OFF_MAX = 0.1
"""Share by which the size that a move asked for may be missed."""


def sizes_of(pos_m: FloatArray, stage: Stage) -> Sizes:
    """How large a team stands, positions in any frame whose third axis is vertical, shape (n, 3)."""
    return size_ratios(pos_m, stage.formation.points_enu_m)


def stands_at(sizes: Sizes, stage: Stage) -> str:
    """A line for the log."""
    return f"{stage.formation.name} stands, with free scale, at {_words(sizes)} times its size"


def missed(stands: Sizes, before: Sizes, scale: float, stage: Stage, keep_out_m: float) -> str:
    """Why a team is not of the size that a move asked for; empty where it is.

    Args:
        stands: after the move.
        before: the move.
        scale: what it was to grow by.
        stage: the formation.
        keep_out_m: what vehicles keep from each other, what positions may be off included.
    """
    asked = scale * before[0], scale * before[1]
    # Both together: the move grows the formation as each agent lays it over those it sees, with one size.
    if not abs(_overall(stands, stage) / _overall(asked, stage) - 1.0) > OFF_MAX:
        return ""
    apart_m = float(np.nanmin(asked)) * shortest_m(stage.formation)
    why = "vehicles did not follow, or the fence was in the way"
    if apart_m <= keep_out_m:
        why = (
            f"that brings two of them to about {apart_m:.2f} m, and {keep_out_m:.2f} m are kept (avoidance.radius_m and"
            " what positions and gusts may take)"
        )
    return (
        f"move not finished: {stage.formation.name} stands at {_words(stands)} times its size, {_words(asked)} was"
        f" asked for; {why}"
    )


def _overall(sizes: Sizes, stage: Stage) -> float:
    """One size for both, as the root mean square of all distances has it."""
    level, upright = np.square(np.nan_to_num(sizes))
    squares = stage.formation.points_enu_m.var(axis=0)
    return float(np.sqrt((level * (squares[0] + squares[1]) + upright * squares[2]) / squares.sum()))


def _words(sizes: Sizes) -> str:
    """One number, or two where they differ; a flat formation has one."""
    level, upright = sizes
    if math.isnan(upright) or f"{level:.2f}" == f"{upright:.2f}":
        return f"{level:.2f}"
    return f"{upright:.2f}" if math.isnan(level) else f"{level:.2f} (level) and {upright:.2f} (upright)"
