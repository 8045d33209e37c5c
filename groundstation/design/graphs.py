"""Sensing graphs for points alone: which edges are worth having.

Starts from a sparse connected graph, designs it, and adds the edges that the dual matrix of the slower block pays most
for, until more edges hardly help. Every row of the resulting table is a certified design. Greedy: no claim that a graph
is the best with its number of edges.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy.sparse.csgraph
import scipy.spatial

from groundstation.core.errors import UserError
from groundstation.core.formation import Formation
from groundstation.core.types import BoolArray, FloatArray
from groundstation.design.certify import Certificate

Kind = Literal["sparse", "balanced", "robust"]
Edge = tuple[int, int]
Evaluate = Callable[[Formation], tuple[float, Certificate | None]]
"""Slowest certified mode, 1/s (0 when infeasible), and the certificate."""

TREES = 200
"""Spanning trees that are tried for one within the degree limit."""

EXCHANGES = 600
"""Designs that are tried in exchanging edges."""

SHARE: dict[Kind, float] = {"sparse": 0.1, "balanced": 0.5, "robust": 0.8}
"""Slowest mode to reach, relative to what all edges within range and degree give."""


@dataclass(frozen=True)
class Row:
    """One graph on the way.

    Attributes:
        edges: pairs counted from 0.
        slowest: certified slowest mode, 1/s; 0 when infeasible.
    """

    edges: tuple[Edge, ...]
    slowest: float


@dataclass(frozen=True)
class Suggestion:
    """A proposed graph and the trade-off that led to it.

    Attributes:
        formation: the points with the proposed edges.
        slowest: its slowest mode, 1/s.
        rows: graphs with growing numbers of edges.
        survives_edges: whether a design exists after the loss of any one edge; None when not asked for.
        before: the slowest mode with as many edges before some were exchanged.
    """

    formation: Formation
    slowest: float
    rows: tuple[Row, ...]
    survives_edges: bool | None
    before: float


def suggest(
    formation: Formation,
    kind: Kind,
    evaluate: Evaluate,
    *,
    range_m: float = np.inf,
    max_degree: int | None = None,
) -> Suggestion:
    """Proposes a sensing graph.

    Args:
        formation: its points; its edges are ignored.
        kind: ``sparse`` reaches a tenth of the slowest mode that is to be had, ``balanced`` half, ``robust`` four
            fifths and stays feasible when any one edge is lost.
        evaluate: designs a formation.
        range_m: sensing range.
        max_degree: most neighbours of an agent; None for any number.

    Returns:
        The graph with its trade-off.

    Raises:
        UserError: no graph within range and degree holds the formation, or none was found; the range is not positive.
    """
    if not range_m > 0:
        raise UserError(f"sensing range {range_m:g} m: must be more than 0 m")
    n = formation.size
    limit = n - 1 if max_degree is None else max_degree
    distances = formation.distances_m
    allowed = (distances <= range_m) & ~np.eye(n, dtype=np.bool_)
    every = _formation(formation, np.argwhere(np.triu(allowed, 1)))
    ceiling, _ = evaluate(every)
    if ceiling <= 0:
        raise UserError(
            f"{formation.name}: even all {len(every.edges)} pairs within {range_m:g} m do not hold the formation; "
            "allow a longer sensing range"
        )
    tree = _tree(distances, allowed, limit)
    if tree is None:
        raise UserError(
            f"{formation.name}: found no graph that joins all agents with at most {limit} neighbours each within "
            f"{range_m:g} m; allow more neighbours or a longer range"
        )
    now = _start(tree, distances, allowed, limit)
    rows: list[Row] = []
    target = SHARE[kind] * ceiling
    enough = False
    while not enough:
        shape = _formation(formation, np.argwhere(np.triu(now, 1)))
        slowest, figures = evaluate(shape)
        rows.append(Row(shape.edges, slowest))
        # beyond nine tenths of the ceiling the table has nothing more to show
        enough = slowest >= max(target, 0.9 * ceiling) or not _grow(now, allowed, limit, distances, figures)
    reached = [row for row in rows if row.slowest > 0]
    if not reached:
        raise UserError(
            f"{formation.name}: no graph with at most {limit} neighbours each within {range_m:g} m holds "
            "the formation; allow more neighbours or a longer range"
        )
    # a degree limit may keep the ceiling out of reach: then the share counts from the best that was seen
    target = min(target, SHARE[kind] * max(row.slowest for row in reached) / (0.9 if kind == "robust" else 1.0))
    fitting = [row for row in reached if row.slowest >= 0.97 * target] or [max(reached, key=lambda row: row.slowest)]
    chosen, survives = fitting[0], None
    if kind == "robust":
        survives = False
        for row in fitting:
            chosen = row
            survives = _survives(formation, row, evaluate)
            if survives:
                break
        if not survives:
            chosen = max(reached, key=lambda row: row.slowest)
    greedy = chosen.slowest
    if kind != "robust":
        rows.remove(chosen)
        chosen = _exchanged(formation, chosen, evaluate, allowed, limit=limit, enough=0.97 * ceiling)
        rows = sorted([*rows, chosen], key=lambda row: len(row.edges))
    final = Formation(formation.name, formation.points_enu_m, chosen.edges)
    return Suggestion(final, chosen.slowest, tuple(rows), survives, greedy)


def _formation(formation: Formation, pairs: np.ndarray) -> Formation:
    edges = tuple((int(i), int(j)) for i, j in pairs)
    return Formation(formation.name, formation.points_enu_m, edges)


def _tree(distances: FloatArray, allowed: BoolArray, limit: int) -> BoolArray | None:
    """A short spanning tree within range and degree, or None when none was found.

    Whether there is one is as hard as finding a path through all agents. Shortest trees are tried with edges made
    longer at agents that had too many of them, which finds one wherever there is some choice.
    """
    n = len(distances)
    length = np.where(allowed, distances, 0.0)
    toll = np.zeros(n)
    step = 0.1 * float(np.mean(length[allowed])) if allowed.any() else 0.0
    for _ in range(TREES):
        charged = np.where(allowed, length + toll[:, None] + toll[None, :], 0.0)
        half = scipy.sparse.csgraph.minimum_spanning_tree(charged).toarray() > 0
        tree: BoolArray = np.asarray(half | half.T)
        degrees = tree.sum(axis=1)
        if half.sum() < n - 1:
            return None
        if np.all(degrees <= limit):
            return tree
        toll += step * np.maximum(degrees - limit, 0)
    return None


def _start(tree: BoolArray, distances: FloatArray, allowed: BoolArray, limit: int) -> BoolArray:
    """Spanning tree, then nearest neighbours until everyone has three, within range and degree."""
    n = len(distances)
    now: BoolArray = tree.copy()
    for wanted in (2, 3):
        for agent in range(n):
            for other in np.argsort(distances[agent], kind="stable"):
                if now[agent].sum() >= min(wanted, limit):
                    break
                if allowed[agent, other] and not now[agent, other] and now[other].sum() < limit:
                    now[agent, other] = now[other, agent] = True
    return now


def _price(distances: FloatArray, figures: Certificate | None) -> FloatArray:
    """What each edge that is not there would be worth, shape (n, n): by the dual matrices of the slower blocks."""
    price = 1e-6 / (1.0 + distances)
    if figures is not None:
        worst = min(figures.xy.slowest, figures.z.slowest)
        for block in (figures.xy, figures.z):
            size = float(np.max(np.abs(block.dual), initial=0.0))
            if size > 0 and block.slowest <= 1.3 * max(worst, 0.0) + 1e-9:
                price = price + np.abs(block.dual) / size
    return price


def _grow(now: BoolArray, allowed: BoolArray, limit: int, distances: FloatArray, figures: Certificate | None) -> bool:
    """Adds the edges with the highest price, in place; False when no edge is left to add."""
    n = len(now)
    free = now.sum(axis=1) < limit
    open_pairs = np.triu(allowed & ~now & free[:, None] & free[None, :], 1)
    candidates = np.argwhere(open_pairs)
    if len(candidates) == 0:
        return False
    price = _price(distances, figures)
    order = np.argsort(-price[candidates[:, 0], candidates[:, 1]], kind="stable")
    left, added = max(1, n // 8), np.zeros(n, dtype=np.int64)
    for i, j in candidates[order]:
        if left == 0:
            break
        # one new edge per agent and round: prices change with every edge
        if added[i] == added[j] == 0 and now[i].sum() < limit and now[j].sum() < limit:
            now[i, j] = now[j, i] = True
            added[i] = added[j] = 1
            left -= 1
    return True


def _exchanged(
    formation: Formation, row: Row, evaluate: Evaluate, allowed: BoolArray, *, limit: int, enough: float
) -> Row:
    """Exchanges one edge for another as long as that makes the slowest mode faster; as many edges as before.

    Those that the dual matrix prices highest come first, for the longest. Ends where no exchange helps, at ``enough``,
    or after so many designs: fewer of larger teams, of which each takes longer.
    """
    n = formation.size
    left = min(EXCHANGES, EXCHANGES * 64 // n**2)
    best, figures = evaluate(_formation(formation, np.array(row.edges)))
    edges = row.edges
    better = True
    while better and left > 0 and best < enough:
        better = False
        price = _price(formation.distances_m, figures)
        now = np.zeros((n, n), dtype=np.bool_)
        for i, j in edges:
            now[i, j] = now[j, i] = True
        out = np.argwhere(np.triu(allowed & ~now, 1))
        swaps = [(price[a, b] - price[i, j], (i, j), (int(a), int(b))) for i, j in edges for a, b in out]
        for _, old, new in sorted(swaps, key=lambda swap: -swap[0]):
            degrees = now.sum(axis=1)
            degrees[list(old)] -= 1
            if left == 0 or degrees[list(new)].max() >= limit:
                continue
            left -= 1
            tried = tuple(sorted([*(edge for edge in edges if edge != old), new]))
            slowest, certificate = evaluate(_formation(formation, np.array(tried)))
            if slowest > 1.01 * best:
                edges, best, figures, better = tried, slowest, certificate, True
                break
    return Row(edges, best)


def _survives(formation: Formation, row: Row, evaluate: Evaluate) -> bool:
    for edge in row.edges:
        rest = tuple(other for other in row.edges if other != edge)
        if evaluate(Formation(formation.name, formation.points_enu_m, rest))[0] <= 0:
            return False
    return True
