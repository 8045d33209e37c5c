"""Who is near whom, for large teams: views of the near ones alone instead of all pairs.

`LocalViews` has a column for every agent that may be seen. Here it has one for each of the nearest few, and a table
says who they are; whatever works on views works on these. Found with a k-d tree, in n log n steps instead of n^2.

Gives the same neighbours as looking at all pairs; whom an agent senses to form is another matter (`views`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from groundstation.core import frames
from groundstation.core.quick import every, finite_rows
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.core.views import LocalViews


@dataclass(frozen=True)
class NearViews:
    """Views of n agents on those near to each.

    Attributes:
        views: shape (n, k): column c of row i is agent ``who[i, c]``, nobody where not visible.
        who: shape (n, k), ascending along each row, filled up with i itself.
    """

    views: LocalViews
    who: IntArray

    def spread(self, flags: BoolArray) -> BoolArray:
        """Turns flags about the near ones, shape (n, k), into flags about everybody, shape (n, n)."""
        n = len(self.who)
        out = np.zeros((n, n), dtype=np.bool_)
        rows, columns = np.nonzero(flags)
        out[rows, self.who[rows, columns]] = True
        return out


def near_views(
    pos_team_ned_m: FloatArray,
    vel_ned_m_s: FloatArray,
    quat_ned_from_frd: FloatArray,
    reach_m: float,
    others: BoolArray | None = None,
) -> NearViews:
    """Builds views of everybody nearer than a distance.

    Args:
        pos_team_ned_m: shape (n, 3); NaN rows are unknown: they see nobody and are seen by nobody.
        vel_ned_m_s: shape (n, 3).
        quat_ned_from_frd: shape (n, 4).
        reach_m: whoever is nearer is seen.
        others: further pairs that see each other, shape (n, n), row i on column j.

    Returns:
        The views, with as many columns as somebody has near ones, at least one.

    Raises:
        ValueError: the reach is not positive.
    """
    if not 0.0 < reach_m < np.inf:
        raise ValueError(f"near views: the reach is {reach_m} m, must be positive")
    n = len(pos_team_ned_m)
    known = np.asarray(np.isfinite(pos_team_ned_m).all(axis=1), dtype=np.bool_)
    index = np.flatnonzero(known)
    found = np.empty((0, 2), dtype=np.int64)
    if len(index) > 1:
        # A hair farther than asked for: the exact comparison below decides.
        tree = cKDTree(pos_team_ned_m[index])
        found = index[tree.query_pairs(reach_m * (1.0 + 1e-9), output_type="ndarray")].reshape(-1, 2)
        offset = pos_team_ned_m[found[:, 1]] - pos_team_ned_m[found[:, 0]]
        found = found[np.einsum("ij,ij->i", offset, offset) < reach_m**2]
    sees, seen = np.concatenate([found[:, 0], found[:, 1]]), np.concatenate([found[:, 1], found[:, 0]])
    if others is not None:
        more, them = np.nonzero(others & known[None, :] & known[:, None] & ~np.eye(n, dtype=np.bool_))
        sees, seen = np.concatenate([sees, more]), np.concatenate([seen, them])
    code = np.unique(sees * n + seen)
    sees, seen = code // n, code % n
    count = np.bincount(sees, minlength=n)
    column = np.arange(len(sees)) - np.repeat(np.cumsum(count) - count, count)
    width = max(int(count.max(initial=0)), 1)
    who = np.repeat(np.arange(n, dtype=np.int64)[:, None], width, axis=1)
    who[sees, column] = seen
    visible = np.zeros((n, width), dtype=np.bool_)
    visible[sees, column] = True
    views = views_of(pos_team_ned_m, vel_ned_m_s, frames.rot_ned_from_flu(quat_ned_from_frd), who, visible)
    return NearViews(views, who)


def views_of(
    pos_team_ned_m: FloatArray,
    vel_ned_m_s: FloatArray,
    rot_ned_from_flu: FloatArray,
    who: IntArray,
    visible: BoolArray,
) -> LocalViews:
    """Builds views of some agents for each.

    Args:
        pos_team_ned_m: shape (n, 3); NaN rows are unknown: they see nobody and are seen by nobody.
        vel_ned_m_s: shape (n, 3).
        rot_ned_from_flu: `frames.rot_ned_from_flu` of the attitudes, shape (n, 3, 3).
        who: whom each may see, shape (n, k).
        visible: whom of those it does see as far as their places are known, shape (n, k).
    """
    known = finite_rows(pos_team_ned_m)
    if not every(known):
        visible = visible & known[who] & known[:, None]
    state = np.stack([pos_team_ned_m, vel_ned_m_s])
    relative = state[:, who] - state[:, :, None]
    relative[:, ~visible] = np.nan
    rel_flu = frames.rotate_back(rot_ned_from_flu[:, None], relative)
    return LocalViews(
        rel_pos_flu_m=rel_flu[0],
        rel_vel_flu_m_s=rel_flu[1],
        visible=visible,
        vel_flu_m_s=frames.rotate_back(rot_ned_from_flu, vel_ned_m_s),
        up_flu=-rot_ned_from_flu[:, 2],
    )
