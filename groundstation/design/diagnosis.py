"""Why a design fails or is weak, in terms of agents and edges, and the fewest edges that mend it.

Reads the graph first (components, agents with one neighbour, cut vertices and their like), then counts dimensions, and
only then looks at the modes of the best matrix. Agents are counted from 1 in every sentence. What ``mend`` proposes was
designed and certified; that fewer edges cannot do is only claimed when it was proven.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import combinations, product
from math import comb

import numpy as np
import scipy.sparse.csgraph

from groundstation.core.formation import Formation
from groundstation.core.types import BoolArray, IntArray
from groundstation.design.certify import WEAKEST, Certificate
from groundstation.design.problem import Block, Matrix, split

WEAK = 0.05
"""Slowest mode relative to the fastest below which a design is called weak."""

MENDED = 0.01
"""Slowest mode, 1/s, from which a formation counts as mended: anything slower would never be seen to form."""

MOST_PRUNED = 40
"""Added edges up to which each is tried for being superfluous."""

MOST_EXCHANGED = 12
"""Added edges up to which pairs of them are exchanged for single ones."""

LOOKS_PER_DESIGN = 12
"""Choices of edges that may be looked at for every one that may be designed."""

MOST_PAIRED = 60
"""Agents up to which every pair is tried for separating the others."""

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


def _hanging(agents: IntArray) -> str:
    return f"{names(agents)} {'hangs' if len(agents) == 1 else 'hang'}"


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
        if not found and len(block.edges) > block.size:
            found += _separating_pairs(block)
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
        hinge = f"{_hanging(parts[0])} on the rest by {names(place)} alone"
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
        sentence = f"{len(block.edges)} edges leave no freedom for {kind} gains of {block.size} agents"
        if not block.is_complex or _on_one_line(block):
            return [f"{sentence}; {block.size} are the least"]
        return [f"{sentence}; {int(np.ceil((3 * block.size - 3) / 2))} are the least in general position"]
    bare = _bare(block)
    if bare.any():
        stem = "has only edges" if int(bare.sum()) == 1 else "have only edges"
        return [f"{names(np.flatnonzero(bare))} {stem} that no {kind} gain can use: too few edges there"]
    if free.shape[1] < block.free // 4:
        return [f"too few edges: they leave {free.shape[1]} free numbers for {block.free} {kind} modes"]
    return []


def _on_one_line(block: Block) -> bool:
    """Whether all agents share one horizontal line: then edges need no rotation, and fewer of them do."""
    parts = np.stack([np.asarray(block.coordinate).real, np.asarray(block.coordinate).imag])
    values = np.linalg.svd(parts, compute_uv=False)
    return bool(values[-1] <= 1e-9 * values[0])


def _bare(block: Block) -> BoolArray:
    """Agents none of whose edges can carry a gain, shape (n,)."""
    usable = np.zeros(len(block.edges), dtype=np.bool_)
    free = block.null_space
    if free.shape[1]:
        np.logical_or.at(usable, block.unknown_edges, np.abs(free).max(axis=1) > 1e-9)
    bare = np.ones(block.size, dtype=np.bool_)
    bare[block.edges[usable].ravel()] = False
    return bare


def _separating_pairs(block: Block) -> list[str]:
    """Groups that hang on the rest by two agents and whose ties are too few to hold a shape."""
    if block.size > MOST_PAIRED or block.kernel.shape[1] == 1:
        return []
    found: list[tuple[IntArray, tuple[int, int]]] = []
    keep = np.ones(block.size, dtype=np.bool_)
    for pair in combinations(range(block.size), 2):
        keep[list(pair)] = False
        parts = _components(block.adjacency, keep)
        keep[list(pair)] = True
        # one agent with two neighbours is held by them
        found += [(part, pair) for part in parts[:-1] if len(part) > 1 and _too_few_ties(block, part)]
    said: list[str] = []
    taken: set[int] = set()
    for part, pair in sorted(found, key=lambda item: -len(item[0])):
        if taken.isdisjoint(part.tolist()):
            taken |= set(part.tolist())
            said.append(f"{_hanging(part)} on the rest by {names(pair)} alone, a separating pair, with too few edges")
    return said


def _too_few_ties(block: Block, part: IntArray) -> bool:
    """Whether the kernel equations of some agents leave one of them no edge that can carry a gain."""
    inside = np.zeros(block.size, dtype=np.bool_)
    inside[part] = True
    touching = inside[block.edges[:, 0]] | inside[block.edges[:, 1]]
    columns = np.flatnonzero(touching[block.unknown_edges])
    rows = np.flatnonzero(np.tile(inside, block.equations.shape[0] // block.size))
    local = block.equations[rows][:, columns].toarray()
    _, values, directions = np.linalg.svd(local, full_matrices=True)
    free = directions[int(np.sum(values > 1e-9 * max(float(values[0]), 1e-300))) :]
    if len(free) == 0:
        return True
    usable = block.edges[block.unknown_edges[columns[np.abs(free).max(axis=0) > 1e-9]]]
    return not set(part.tolist()) <= set(usable.ravel().tolist())


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


def mend(
    formation: Formation,
    certificate: Certificate,
    evaluate: Evaluate,
    most_designs: int = 150,
    stop: Callable[[], bool] = lambda: False,
) -> Mend | None:
    """Looks for the fewest edges that make a formation feasible, and not just barely.

    One edge, two, and so on are tried exhaustively as long as that is affordable: a look at the graph and a count of
    what the kernel equations leave free rule most choices out. Beyond that, edges are added greedily by their price in
    the dual matrices, superfluous ones taken away, pairs exchanged for single ones, and lots drawn.

    Args:
        formation: one that was proven infeasible.
        certificate: of its best matrices.
        evaluate: designs a formation.
        most_designs: designs to spend on each number of edges in the exhaustive search, and on exchanges.
        stop: asked before every design; True ends the search with what was found.

    Returns:
        The edges, or None when not even the complete graph helps, or nothing was found before the stop.
    """
    candidates = _priced(formation, certificate)
    least = max(1, fewest_conceivable(formation))
    # designs, and looks at a graph, cost more the larger the team is
    afforded = int(most_designs * min(1.0, (10.0 / formation.size) ** 2))
    count, exhausted = least, True
    while exhausted and count <= len(candidates):
        most = most_designs if count == 1 and len(candidates) <= most_designs else afforded
        if comb(len(candidates), count) > LOOKS_PER_DESIGN * most:
            break
        choices, exhausted = _conceivable(formation, combinations(candidates, count), most, stop)
        if not exhausted:
            break
        best = _best(formation, choices, evaluate, stop)
        if best is not None:
            return Mend(*best, fewest=True)
        if stop():
            return None
        count += 1
    greedy = _greedy(formation, certificate, evaluate, stop)
    if greedy is None:
        return None
    edges, slowest = _exchange(
        formation, candidates, greedy, least=count, evaluate=evaluate, most_designs=afforded, stop=stop
    )
    # whatever has fewer than `count` edges was ruled out one by one
    return Mend(edges, slowest, fewest=len(edges) <= count)


def fewest_conceivable(formation: Formation) -> int:
    """Edges that are missing at the very least, whatever the shape: agents that differ need two neighbours each.

    The count of free numbers, 2E - 3n + 4, is no proof: it holds in general position only. On a line n edges do, and
    so they do horizontally for a regular polygon.
    """
    xy, z = split(formation)
    general = any(block.kernel.shape[1] == 2 and len(places(block)) == formation.size for block in (xy, z))
    if not general or formation.size < 3:
        return 0
    degrees = xy.adjacency.sum(axis=1)
    by_agents = int(np.ceil(np.maximum(2 - degrees, 0).sum() / 2))
    # no agent can hang on a single edge, so that a tree is not enough
    return max(by_agents, formation.size - len(formation.edges))


def _conceivable(
    formation: Formation, choices: Iterable[tuple[Edge, ...]], most: int, stop: Callable[[], bool]
) -> tuple[list[tuple[Edge, ...]], bool]:
    """Choices that are not ruled out without a design, and whether all were looked at and they are few enough."""
    kept: list[tuple[Edge, ...]] = []
    for extra in choices:
        if stop() or len(kept) > most:
            return kept, False
        blocks = split(with_edges(formation, extra))
        if not any(_ruled_out(block) for block in blocks):
            kept.append(extra)
    return kept, len(kept) <= most


def _ruled_out(block: Block) -> bool:
    """Whether the graph, or the null space of the kernel equations, shows that a block has no gains."""
    if block.free == 0:
        return False
    if len(_components(block.adjacency, np.ones(block.size, dtype=np.bool_))) > 1 or _graph_reasons(block):
        return True
    return len(block.unknown_edges) <= MOST_COUNTED and bool(_bare(block).any())


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
    formation: Formation, choices: Iterable[tuple[Edge, ...]], evaluate: Evaluate, stop: Callable[[], bool]
) -> tuple[tuple[Edge, ...], float] | None:
    best: tuple[tuple[Edge, ...], float] | None = None
    for extra in choices:
        if stop():
            break
        slowest, _ = evaluate(with_edges(formation, extra))
        if slowest >= MENDED and (best is None or slowest > 1.001 * best[1]):
            best = (tuple(sorted(extra)), slowest)
    return best


def _greedy(
    formation: Formation, certificate: Certificate, evaluate: Evaluate, stop: Callable[[], bool]
) -> tuple[tuple[Edge, ...], float] | None:
    now, figures, slowest = formation, certificate, 0.0
    batch = max(1, formation.size // 20)
    while slowest < MENDED:
        candidates = _priced(now, figures)
        if not candidates:
            return (tuple(sorted(set(now.edges) - set(formation.edges))), slowest) if slowest > 0 else None
        if stop():
            return None
        now = with_edges(now, _apart(candidates, batch))
        slowest, found = evaluate(now)
        figures = found or figures
    added = [edge for edge in now.edges if edge not in set(formation.edges)]
    if len(added) > MOST_PRUNED:
        return tuple(added), slowest
    for edge in list(added):
        if stop():
            break
        without = [other for other in added if other != edge]
        value, _ = evaluate(with_edges(formation, without))
        if value >= MENDED:
            added, slowest = without, value
    return tuple(added), slowest


def _exchange(
    formation: Formation,
    candidates: list[Edge],
    start: tuple[tuple[Edge, ...], float],
    *,
    least: int,
    evaluate: Evaluate,
    most_designs: int,
    stop: Callable[[], bool],
) -> tuple[tuple[Edge, ...], float]:
    """Replaces two of the added edges by one other as long as that mends the formation as well; else draws lots."""
    edges, slowest = start
    rng = np.random.default_rng(0)
    better, left = True, 3 * most_designs
    while better and least < len(edges) <= MOST_EXCHANGED:
        # dearest candidates first, each in place of every two; then anything with one edge less
        swaps = (tuple(sorted({*edges, new} - set(out))) for new, out in product(candidates, combinations(edges, 2)))
        lots = (
            tuple(sorted(candidates[k] for k in rng.choice(len(candidates), len(edges) - 1, replace=False)))
            for _ in range(4 * most_designs)
        )
        better = False
        for source in (swaps, lots):
            for trial in source:
                if better or left == 0 or stop():
                    break
                if len(trial) >= len(edges) or any(map(_ruled_out, split(with_edges(formation, trial)))):
                    continue
                left -= 1
                value, _ = evaluate(with_edges(formation, trial))
                if value >= MENDED:
                    edges, slowest, better = trial, value, True
    return edges, slowest


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
