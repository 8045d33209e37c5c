"""Where an agent's own place is, as far as its own view tells.

The formation is laid over whom an agent sees, itself included, by the best rotation about z and translation. What
comes out is in the agent's own level axes (east, north, up by its own attitude): no position and no heading of anybody
else is known. In the formation all agents' answers agree; before, each has its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from groundstation.core.quick import mean
from groundstation.core.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class Places:
    """What m agents make of their views of a team of n.

    Attributes:
        to_own_m: from each agent to its own place, shape (m, 3); zero for an agent that sees nobody.
        from_centre_m: from the formation's centre to the agent's own place, as the formation is turned, shape (m, 3).
        wanted_m: from own place to the place of each other agent, shape (m, n, 3); of those in ``who`` and, last,
            itself, where it was given.
    """

    to_own_m: FloatArray
    from_centre_m: FloatArray
    wanted_m: FloatArray


def own_places(
    rel_level_m: FloatArray,
    visible: BoolArray,
    points_by_agent_m: FloatArray,
    viewers: slice = slice(None),
    *,
    who: IntArray | None = None,
    free_scale: bool = False,
) -> Places:
    """Lays the formation over what each agent sees.

    Args:
        rel_level_m: position of j relative to i in i's level axes, shape (m, n, 3); anything where not visible.
        visible: agent i sees agent j, shape (m, n).
        points_by_agent_m: the formation's point for the role that each agent has, shape (n, 3), z up.
        viewers: which of the n agents the m rows are.
        who: who stands in the columns of each, nobody's own, shape (m, k), where they are k and not everybody.
        free_scale: the formation may have any size, the one that fits is taken.

    Returns:
        Places in the axes of ``rel_level_m``.
    """
    own_point = points_by_agent_m[viewers]
    # Summed over the last axis, row by row: one agent alone gets what it gets among others.
    rel = np.where(visible[..., None], rel_level_m, 0.0)
    points_seen = points_by_agent_m[None] if who is None else points_by_agent_m[who]
    if who is None:
        seen = visible | np.eye(len(points_by_agent_m), dtype=np.bool_)[viewers]
    else:  # each itself behind the others
        seen = np.concatenate([visible, np.ones((len(visible), 1), dtype=np.bool_)], axis=1)
        rel = np.concatenate([rel, np.zeros((len(rel), 1, 3))], axis=1)
        points_seen = np.concatenate([points_seen, own_point[:, None]], axis=1)
    share = seen / seen.sum(axis=1, keepdims=True)
    pos_mean = (share[..., None] * rel).sum(axis=1)
    points_mean = (share[..., None] * points_seen).sum(axis=1)
    pos = rel - pos_mean[:, None]
    points = points_seen - points_mean[:, None]
    pos_xy, points_xy = pos[..., 0] + 1j * pos[..., 1], points[..., 0] + 1j * points[..., 1]
    turn = np.where(seen, np.conj(points_xy) * pos_xy, 0.0).sum(axis=1)
    size = np.abs(turn)
    turn = np.where(size > 1e-12, turn / np.where(size > 1e-12, size, 1.0), 1.0)
    scale: FloatArray = np.ones(len(turn), dtype=np.float64)
    if free_scale:
        spread = np.where(seen, (np.conj(points_xy) * points_xy).real, 0.0).sum(axis=1)
        fits: BoolArray = np.asarray((spread > 1e-12) & (size > 1e-12), dtype=np.bool_)
        scale = np.where(fits, size / np.where(fits, spread, 1.0), 1.0)
    to_own = pos_mean + scale[:, None] * _turned(turn, own_point - points_mean)
    from_centre = scale[:, None] * _turned(turn, own_point - mean(points_by_agent_m))
    wanted = scale[:, None, None] * _turned(turn[:, None], points_seen - own_point[:, None])
    alone = ~np.asarray(visible.any(axis=1), dtype=np.bool_)
    to_own[alone] = 0.0
    return Places(to_own, from_centre, wanted)


def _turned(turn: FloatArray, vector_m: FloatArray) -> FloatArray:
    """Turns vectors about z by unit complex numbers."""
    level = turn * (vector_m[..., 0] + 1j * vector_m[..., 1])
    turned = np.empty((*level.shape, 3))
    turned[..., 0], turned[..., 1], turned[..., 2] = level.real, level.imag, vector_m[..., 2]
    return turned
