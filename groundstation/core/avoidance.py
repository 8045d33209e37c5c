"""Algorithm 2, exact: the smallest rotation of the desired velocity that leaves every safety region.

Seen from an agent, a safety region blocks a set of directions, which it tells itself (`caps` for spheres, `cones` for
upright ellipsoids and cylinders). The desired direction is turned to the nearest one outside of all of them, which is
one of finitely many candidates. Every candidate is held against every region near the agent.

The rule is the paper's: it knows directions, not dynamics. On vehicles that lag it does not keep distances above
r; `damper` does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from groundstation.core import frames
from groundstation.core.caps import Blocked, dot
from groundstation.core.quick import between, every, some
from groundstation.core.regions import SafetyRegion, rot_level_from_flu
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.core.views import LocalViews

_MOST_AT_ONCE = 1_000_000
"""Candidates times regions that are held against each other in one go."""
_FIRST = 32
"""So many candidates are held against the regions first, the nearest ones where there are more."""
_TOGETHER = 16
"""So few agents are turned together, whatever their candidates."""


@dataclass(frozen=True)
class Avoided:
    """What Algorithm 2 made of the desired velocities of m agents.

    Attributes:
        vel_flu_m_s: shape (m, 3); speeds as desired, or zero where blocked.
        blocked: wanted to move and no direction within 90 degrees is free, shape (m,). With zero output that is the
            paper's gridlock, if it lasts.
        angle_rad: rotation, shape (m,); 0 where nothing was in the way, pi/2 where blocked.
        in_the_way: agents whose region the desired direction meets, shape (m, n).
    """

    vel_flu_m_s: FloatArray
    blocked: BoolArray
    angle_rad: FloatArray
    in_the_way: BoolArray


def avoid(views: LocalViews, desired_flu_m_s: FloatArray, region: SafetyRegion) -> Avoided:
    """Turns desired velocities out of the safety regions of near agents (Algorithm 2, equation (13)).

    Ties are broken by the order of the candidates. Where the desired direction points at the very centre of a cap,
    every point of the rim is equally near: the agent goes to its right (looking along, z up), so that two agents head
    on pass each other instead of dancing.

    Args:
        views: what m agents see.
        desired_flu_m_s: shape (m, 3), body FLU of each agent.
        region: the safety region.

    Returns:
        New velocities and what happened; rows with nothing in the way come back unchanged.

    Raises:
        ValueError: shape, or a desired velocity that is not finite.
    """
    if desired_flu_m_s.shape != (views.viewers, 3) or not every(np.isfinite(desired_flu_m_s)):
        raise ValueError(f"desired velocities must be finite and of shape ({views.viewers}, 3)")
    if region.by_distance:
        return _around(region.blocked(views.rel_pos_flu_m, views.visible, views.grown_m), desired_flu_m_s)
    level = rot_level_from_flu(views.up_flu)
    rel_level_m = frames.rotate(level[:, None], views.rel_pos_flu_m)
    cones = region.blocked(rel_level_m, views.visible, views.grown_m)
    result = _around(cones, frames.rotate(level, desired_flu_m_s))
    vel_flu_m_s = np.where(
        result.angle_rad[:, None] > 0.0, frames.rotate_back(level, result.vel_flu_m_s), desired_flu_m_s
    )
    return replace(result, vel_flu_m_s=vel_flu_m_s)


def straight_on(views: LocalViews, desired_flu_m_s: FloatArray, region: SafetyRegion) -> Avoided:
    """Leaves Algorithm 2 out: velocities stay as desired, whoever is in the way.

    Args:
        views: what m agents see.
        desired_flu_m_s: shape (m, 3), body FLU of each agent.
        region: the safety region, which nobody is turned from.
    """
    still = np.zeros(views.viewers, dtype=np.bool_)
    return Avoided(desired_flu_m_s, still, np.zeros(views.viewers), np.zeros_like(views.visible))


def _around(cones: Blocked, desired_m_s: FloatArray) -> Avoided:
    """Turns velocities (m, 3) out of what is blocked, in whatever axes both are given."""
    m = len(desired_m_s)
    vel = desired_m_s.copy()
    blocked = np.zeros(m, dtype=np.bool_)
    angle = np.zeros(m)
    in_the_way = np.zeros_like(cones.active)
    if not some(cones.active):
        return Avoided(vel, blocked, angle, in_the_way)
    speed = np.sqrt(dot(vel, vel))
    moving = speed > 0.0
    direction = vel / np.where(moving, speed, 1.0)[:, None]
    in_the_way = cones.active & moving[:, None] & cones.meets(direction[:, None])[:, 0]
    rows = np.flatnonzero(in_the_way.any(axis=1))
    if rows.size:
        turned, free = _nearest_free(direction[rows], cones, rows)
        vel[rows] = np.where(free[:, None], turned * speed[rows, None], 0.0)
        blocked[rows] = ~free
        cosine = between(dot(turned, direction[rows]), 0.0, 1.0)
        angle[rows] = np.where(free, np.arccos(cosine), np.pi / 2.0)
    return Avoided(vel, blocked, angle, in_the_way)


def _nearest_free(direction: FloatArray, cones: Blocked, rows: IntArray) -> tuple[FloatArray, BoolArray]:
    """Finds the free direction nearest to each desired one, some agents at a time to bound the memory.

    Args:
        direction: unit vectors, shape (m, 3), each met by at least one region.
        cones: of all agents.
        rows: the agents that the directions belong to, shape (m,).

    Returns:
        Unit vectors (m, 3) and whether one within 90 degrees exists (m,).
    """
    width = cones.active[rows].sum(axis=1)
    # Those with as many near agents together: the number of candidates goes with the square of that.
    order = np.argsort(width, kind="stable") if len(rows) > _TOGETHER else np.arange(len(rows))
    best, free = np.empty((len(rows), 3)), np.empty(len(rows), dtype=np.bool_)
    start = 0
    while start < len(order):
        stop = start + 1 if len(rows) > _TOGETHER else len(order)
        while stop < len(order) and (stop + 1 - start) * cones.work(int(width[order[stop]])) <= _MOST_AT_ONCE:
            stop += 1
        part = order[start:stop]
        some = cones.take(*_columns(cones.active, rows[part]))
        best[part], free[part] = _best_candidate(some, direction[part])
        start = stop
    return best, free


def _best_candidate(cones: Blocked, direction: FloatArray) -> tuple[FloatArray, BoolArray]:
    """The candidate (m, 3) nearest to each direction that leads into no region, and whether there is one (m,).

    Where there are many, the nearest are tried first: mostly one of those is free.
    """
    candidates, valid = cones.candidates(direction)
    cosine = np.where(valid, dot(candidates, direction[:, None]), -np.inf)
    # Within 90 degrees means strictly: a rotation of 90 degrees makes no progress and Theorem 2 does not cover it.
    score = np.where(cosine > 1e-12, cosine, -np.inf) + cones.preference(candidates, direction)
    if score.shape[1] <= 2 * _FIRST:
        return _first_free(cones, candidates, score)
    everybody = np.arange(len(score))
    order = np.argsort(-score, axis=1, kind="stable")
    nearest = (everybody[:, None], order[:, :_FIRST])
    best, found = _first_free(cones, candidates[nearest], score[nearest])
    rows = (~found).nonzero()[0]
    if rows.size:
        others = (rows[:, None], order[rows, _FIRST:])
        some = cones.take(rows[:, None], np.arange(cones.active.shape[1])[None])
        best[rows], found[rows] = _first_free(some, candidates[others], score[others])
    return best, found


def _first_free(cones: Blocked, candidates: FloatArray, score: FloatArray) -> tuple[FloatArray, BoolArray]:
    """The free candidate (m, 3) with the highest score (m, c), and whether there is one (m,)."""
    met = (cones.meets(candidates) & cones.active[:, None]).any(axis=2)
    score = np.where(met, -np.inf, score)
    chosen = (np.arange(len(score)), np.argmax(score, axis=1))
    return candidates[chosen], np.asarray(score[chosen] > -np.inf, dtype=np.bool_)


def _columns(active: BoolArray, rows: IntArray) -> tuple[IntArray, IntArray]:
    """Index arrays of the rows asked for, with their active columns in front so that few remain."""
    here = active[rows]
    width = int(here.sum(axis=1).max())
    return rows[:, None], np.argsort(~here, axis=1, kind="stable")[:, :width]
