"""Why a design fails or is weak, in terms of agents and edges, and the fewest edges that mend it.

Reads the graph first (components, agents with one neighbour, cut vertices and their like), then counts dimensions, and
only then looks at the modes of the best matrix. Agents are counted from 1 in every sentence. What ``mend`` proposes was
designed and certified; that fewer edges cannot do is only claimed when it was proven.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import scipy.sparse.csgraph

from groundstation.core.formation import Formation
from groundstation.core.types import IntArray
from groundstation.design.certify import WEAKEST, Certificate
from groundstation.design.problem import Block, Matrix, split

WEAK = 0.05
"""Slowest mode relative to the fastest below which a design is called weak."""

MENDED = 0.01
"""Slowest mode, 1/s, from which a formation counts as mended: anything slower would never be seen to form."""

MOST_PRUNED = 40
"""Added edges up to which each is tried for being superfluous."""

MOST_COUNTED = 3000
"""Unknowns up to which the null space of the kernel equations is looked at."""

Edge = tuple[int, int]


def names(agents: Iterable[int], most: int = 8) -> str:
    """``agents 1, 3 and 4`` from indices counted from 0; long lists are cut."""
    listed = [str(int(agent) + 1) for agent in sorted(agents)]
    if len(listed) == 1:
        return f"agent {listed[0]}"
    if len(listed) > most:
        return f"agents {', '.join(listed[:most])} and {len(listed) - most} more"
    return f"agents {', '.join(listed[:-1])} and {listed[-1]}"


def findings(
    formation: Formation, blocks: tuple[Block, Block], certificate: Certificate, spectral_norm: float
) -> list[str]:
    """Reasons for which blocks fail that were proven to have no gains, most telling first.

    Args:
        formation: points and graph.
        blocks: its problems xy and z.
        certificate: figures of the best matrices found.
        spectral_norm: fastest mode that was asked for, 1/s.

    Returns:
        Sentences without a final stop; empty when nothing fails.
    """
    failing = [
        block
        for block, figures in zip(blocks, (certificate.xy, certificate.z), strict=True)
        if np.isfinite(figures.slowest) and figures.bound < WEAKEST * spectral_norm
    ]
    if not failing:
        return []
    parts = _components(blocks[0].adjacency, np.ones(formation.size, dtype=np.bool_))
    if len(parts) > 1:
        return [f"no edge joins {names(parts[0])} to {names(parts[1])}"]
    found: list[str] = []
    for block in failing:
        found += [sentence for sentence in _graph_reasons(block) if sentence not in found]
    for block in failing:
        if not found:
            found += _counting_reasons(block)
    return found or [_mode_reason(failing[0])]


def _components(adjacency: np.ndarray, keep: np.ndarray) -> list[IntArray]:
    """Connected parts among the agents to keep, smallest first."""
    agents = np.flatnonzero(keep)
    if len(agents) == 0:
        return []
    graph = scipy.sparse.csr_array(adjacency[np.ix_(agents, agents)])
    count, labels = scipy.sparse.csgraph.connected_components(graph, directed=False)
    parts = [agents[labels == label] for label in range(count)]
    return sorted((part.astype(np.int64) for part in parts), key=len)


def places(block: Block) -> list[IntArray]:
    """Agents grouped by equal coordinate: single agents in general, verticals for xy, levels for z."""
    coordinate = np.asarray(block.coordinate, dtype=np.complex128)
    grid = np.round(np.stack([coordinate.real, coordinate.imag], axis=1) / 1e-9).astype(np.int64)
    _, label = np.unique(grid, axis=0, return_inverse=True)
    label = np.asarray(label).reshape(-1)
    order = np.argsort(label, kind="stable")
    return [part.astype(np.int64) for part in np.split(order, np.flatnonzero(np.diff(label[order])) + 1)]


def _graph_reasons(block: Block) -> list[str]:
    """Agents with too few neighbours, and places on which the rest of the graph hinges."""
    found: list[str] = []
    degrees = block.adjacency.sum(axis=1)
    lonely = [int(agent) for agent in np.flatnonzero(degrees == 1)] if block.size > 2 else []
    for agent in lonely:
        neighbour = int(np.flatnonzero(block.adjacency[agent])[0])
        # straight above one another is near enough to hold the one coordinate that they share
        if abs(block.coordinate[agent] - block.coordinate[neighbour]) > 1e-9:
            found.append(f"agent {agent + 1} has one neighbour, agent {neighbour + 1}")
    if block.kernel.shape[1] == 1:
        return found
    for place in places(block):
        keep = np.ones(block.size, dtype=np.bool_)
        keep[place] = False
        parts = _components(block.adjacency, keep)
        if len(parts) < 2 or (len(place) == 1 and len(parts[0]) == 1 and int(parts[0][0]) in lonely):
            continue
        hinge = f"{names(parts[0])} hang on the rest by {names(place)} alone"
        if len(place) == 1:
            found.append(f"{hinge}, a cut vertex")
        elif block.is_complex:
            found.append(f"{hinge}, a separating set that stands one above another, and can turn and grow about it")
        else:
            found.append(f"{hinge}, a separating set on one height, and can stretch vertically about it")
    return found


def _counting_reasons(block: Block) -> list[str]:
    """Too few edges for the dimension count, or agents all of whose edges must stay without gain."""
    if len(block.unknown_edges) > MOST_COUNTED:
        return []
    free = block.null_space
    kind = "horizontal" if block.is_complex else "vertical"
    if free.shape[1] == 0:
        needed = int(np.ceil((3 * block.size - 3) / 2)) if block.is_complex else block.size
        return [
            f"{len(block.edges)} edges leave no freedom for {kind} gains of {block.size} agents in general position; "
            f"{needed} are the least"
        ]
    usable = np.zeros(len(block.edges), dtype=np.bool_)
    np.logical_or.at(usable, block.unknown_edges, np.abs(free).max(axis=1) > 1e-9)
    bare = np.ones(block.size, dtype=np.bool_)
    bare[block.edges[usable].ravel()] = False
    if bare.any():
        stem = "has only edges" if int(bare.sum()) == 1 else "have only edges"
        return [f"{names(np.flatnonzero(bare))} {stem} that no {kind} gain can use: too few edges there"]
    if free.shape[1] < block.free // 4:
        return [f"too few edges: they leave {free.shape[1]} free numbers for {block.free} {kind} modes"]
    return []


def _mode_reason(block: Block) -> str:
    kind = "horizontally" if block.is_complex else "vertically"
    return (
        f"the {len(block.edges)} edges join the wrong agents: their number would do, but no positive gains hold the "
        f"formation {kind}"
    )


def weak_agents(block: Block, gain: Matrix) -> IntArray:
    """Agents that carry most of the slowest mode, counted from 0.

    Args:
        block: the problem.
        gain: block of A, shape (n, n).

    Returns:
        The fewest agents with four fifths of the mode's energy.
    """
    _, vectors = np.linalg.eigh(block.reduce(-gain))
    energy = np.abs(block.complement @ vectors[:, 0]) ** 2
    order = np.argsort(-energy)
    count = int(np.searchsorted(np.cumsum(energy[order]), 0.8 * energy.sum())) + 1
    return np.sort(order[:count]).astype(np.int64)


@dataclass(frozen=True)
class Mend:
    """Edges to add.

    Attributes:
        edges: pairs counted from 0.
        slowest: slowest mode of the mended formation, 1/s.
        fewest: whether it was proven that fewer edges cannot make the slowest mode ``MENDED``.
    """

    edges: tuple[Edge, ...]
    slowest: float
    fewest: bool


Evaluate = Callable[[Formation], tuple[float, Certificate | None]]
"""Slowest certified mode of a formation, 1/s (0 when infeasible), and the certificate."""


def mend(formation: Formation, certificate: Certificate, evaluate: Evaluate, most_designs: int = 150) -> Mend | None:
    """Looks for the fewest edges that make a formation feasible, and not just barely.

    Single edges are tried in the order in which the dual matrices price them, then pairs; where that is too many, edges
    are added greedily by price and superfluous ones taken away again.

    Args:
        formation: an infeasible one.
        certificate: of its best matrices.
        evaluate: designs a formation.
        most_designs: designs to spend on exhaustive search.

    Returns:
        The edges, or None when not even the complete graph helps.
    """
    candidates = _priced(formation, certificate)
    least = fewest_conceivable(formation)
    if len(candidates) <= most_designs:
        best = _best(formation, [(edge,) for edge in candidates], evaluate)
        if best is not None:
            return Mend(*best, fewest=True)
        pairs = list(combinations(candidates, 2))
        if len(pairs) <= most_designs:
            best = _best(formation, pairs, evaluate)
            if best is not None:
                return Mend(*best, fewest=True)
    greedy = _greedy(formation, certificate, evaluate)
    if greedy is None:
        return None
    edges, slowest = greedy
    return Mend(edges, slowest, fewest=len(edges) <= max(least, 1))


def fewest_conceivable(formation: Formation) -> int:
    """Edges that are missing at the very least: in general position every agent needs two neighbours."""
    degrees = np.zeros(formation.size, dtype=np.int64)
    for i, j in formation.edges:
        degrees[i] += 1
        degrees[j] += 1
    by_agents = int(np.ceil(np.maximum(2 - degrees, 0).sum() / 2))
    xy, z = split(formation)
    general = len(places(xy)) == formation.size and len(places(z)) == formation.size
    by_count = int(np.ceil((3 * formation.size - 3) / 2)) - len(formation.edges)
    return max(by_agents, by_count) if general and formation.size > 3 else 0


def with_edges(formation: Formation, extra: Iterable[Edge]) -> Formation:
    """The same formation with more edges."""
    return Formation(formation.name, formation.points_enu_m, tuple(sorted({*formation.edges, *extra})))


def _priced(formation: Formation, certificate: Certificate) -> list[Edge]:
    """Pairs that are no edge, the most wanted first: those that the dual matrices of weak blocks lean on."""
    price = np.zeros((formation.size, formation.size))
    worst = min(certificate.xy.slowest, certificate.z.slowest)
    for figures in (certificate.xy, certificate.z):
        size = float(np.max(np.abs(figures.dual), initial=0.0))
        if size > 0 and figures.slowest <= 1.2 * max(worst, 0.0) + 1e-9:
            price += np.abs(figures.dual) / size
    distances = formation.distances_m
    price += 1e-6 * (1.0 - distances / max(float(distances.max()), 1e-300))
    missing = np.argwhere(np.triu(~formation.adjacency, 1))
    order = np.argsort(-price[missing[:, 0], missing[:, 1]], kind="stable")
    return [(int(i), int(j)) for i, j in missing[order]]


def _best(
    formation: Formation, choices: Iterable[tuple[Edge, ...]], evaluate: Evaluate
) -> tuple[tuple[Edge, ...], float] | None:
    best: tuple[tuple[Edge, ...], float] | None = None
    for extra in choices:
        slowest, _ = evaluate(with_edges(formation, extra))
        if slowest >= MENDED and (best is None or slowest > 1.001 * best[1]):
            best = (tuple(sorted(extra)), slowest)
    return best


def _greedy(
    formation: Formation, certificate: Certificate, evaluate: Evaluate
) -> tuple[tuple[Edge, ...], float] | None:
    now, figures, slowest = formation, certificate, 0.0
    batch = max(1, formation.size // 20)
    while slowest < MENDED:
        candidates = _priced(now, figures)
        if not candidates:
            return (tuple(sorted(set(now.edges) - set(formation.edges))), slowest) if slowest > 0 else None
        now = with_edges(now, _apart(candidates, batch))
        slowest, found = evaluate(now)
        figures = found or figures
    added = [edge for edge in now.edges if edge not in set(formation.edges)]
    if len(added) > MOST_PRUNED:
        return tuple(added), slowest
    for edge in list(added):
        without = [other for other in added if other != edge]
        value, _ = evaluate(with_edges(formation, without))
        if value >= MENDED:
            added, slowest = without, value
    return tuple(added), slowest


def _apart(candidates: list[Edge], batch: int) -> list[Edge]:
    """The first few candidates no two of which share an agent, so that one price is not paid twice."""
    chosen: list[Edge] = []
    used: set[int] = set()
    for i, j in candidates:
        if i not in used and j not in used:
            chosen.append((i, j))
            used |= {i, j}
        if len(chosen) == batch:
            break
    return chosen
