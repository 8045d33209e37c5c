"""Rank-one unknowns for sparse graphs: one per triangle of the sensing graph.

For three mutual neighbours there is one unit vector v on their places that is orthogonal to 1 and to the coordinate, so
v v* is admissible by itself: triangles need no kernel equations. In nearest-neighbour graphs they span all but a
percent or two of the admissible matrices. What is missing runs around chordless cycles; a chord that is no edge closes
such a cycle into triangles, under the condition that its own entry sums to zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy.linalg
import scipy.sparse

from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.design.basis import LocalMatrix, RankOneBasis, outer_products, squared_products
from groundstation.design.problem import Block, Matrix

MOST_TRIANGLES = 12_000
"""Above this the selection costs more than it saves."""

LOCAL_REACH = 0.03
"""Share of a direction that a local matrix has to have to stand for it."""

MOST_PAIRS = 6
"""Pairs of neighbours around which one missing direction is looked for."""

FEW_WIDE = 8
"""Full matrices that cost less than looking for local ones."""

MOST_WIDE = 60
"""Full matrices that a basis may carry for what nothing local reaches."""

INDEPENDENT = 1e-9
"""Squared distance from the span of the others above which a triangle counts as independent of them."""


def triangle_basis(block: Block) -> RankOneBasis | None:
    """Independent triangles, with chords where needed, that span all admissible matrices.

    Args:
        block: the problem.

    Returns:
        The basis, or None when triangles and chords do not span or would not pay.
    """
    if block.kernel.shape[1] == 1:
        return None
    normal = (block.equations @ block.equations.T).toarray()
    values, directions = np.linalg.eigh(normal)
    kept = values > 1e-13 * values[-1]
    dimensions = len(block.unknown_edges) - int(kept.sum())
    corners = triangles(block)
    if not 0.8 * dimensions <= len(corners) <= MOST_TRIANGLES:
        return None
    corners, rows = triangle_vectors(block, corners)
    gram = np.zeros((len(corners), len(corners)), order="F")
    squared_products(rows, None, gram)
    factor, pivots, rank, _ = scipy.linalg.lapack.dpstrf(gram, tol=INDEPENDENT, lower=1, overwrite_a=1)
    rank = min(int(rank), dimensions)
    chosen = pivots[:rank].astype(np.int64) - 1
    missing = dimensions - rank
    if missing == 0:
        return RankOneBasis(block, rows[np.sort(chosen)].tocsr(), np.zeros((0, rank)))
    if missing > 0.1 * dimensions + 5:
        return None
    # random admissible matrices, minus their share in the triangles, span what is missing
    draws = np.random.default_rng(0).normal(size=(missing, len(block.unknown_edges)))
    inverse = directions[:, kept] / values[kept] @ directions[:, kept].T
    draws -= (block.equations.T @ (inverse @ (block.equations @ draws.T))).T
    gap = _Gap.of(block, draws, rows[chosen], np.asfortranarray(factor[:rank, :rank]))
    chords, left = _close(block, gap)
    extras = _local_extras(block, gap, left)
    if extras is None:
        return None
    added = [triangle_vectors(block, chord.corners)[1] for chord in chords]
    vectors = scipy.sparse.vstack([rows[chosen], *added]).tocsr()
    constraints = np.zeros((len(chords) * (2 if block.is_complex else 1), vectors.shape[0] + len(extras)))
    place, equation = rank, 0
    for chord, part in zip(chords, added, strict=True):
        i, j = chord.corners[0, :2]
        entry = (part[:, [i]].toarray() * part[:, [j]].conj().toarray()).ravel()
        members = slice(place, place + len(entry))
        constraints[equation, members] = entry.real
        if block.is_complex:
            constraints[equation + 1, members] = entry.imag
        place, equation = place + len(entry), equation + (2 if block.is_complex else 1)
    return RankOneBasis(block, vectors, constraints, extras)


def triangles(block: Block) -> IntArray:
    """All triangles i < j < k of the graph, shape (count, 3)."""
    found = []
    for i, j in block.edges:
        third = np.flatnonzero(block.adjacency[i] & block.adjacency[j])
        third = third[third > j]
        found.append(np.stack([np.full_like(third, i), np.full_like(third, j), third], axis=1))
    return np.concatenate(found).astype(np.int64) if found else np.zeros((0, 3), dtype=np.int64)


def triangle_vectors(block: Block, corners: IntArray) -> tuple[IntArray, scipy.sparse.csr_array]:
    """Unit vectors on three agents, orthogonal to 1 and to the coordinate.

    Args:
        block: the problem.
        corners: agents, shape (count, 3).

    Returns:
        The corners without those whose agents agree in the coordinate, and v* as rows, shape (count, n).
    """
    corners, values = _corner_values(block, corners)
    pointers = np.arange(0, 3 * len(values) + 1, 3)
    return corners, scipy.sparse.csr_array((values.ravel(), corners.ravel(), pointers), (len(values), block.size))


def _corner_values(block: Block, corners: IntArray) -> tuple[IntArray, Matrix]:
    p = block.coordinate
    a, b, c = (p[corners[:, k]] for k in range(3))
    values = np.stack([b - c, c - a, a - b], axis=1)
    norms = np.linalg.norm(values, axis=1)
    keep = norms > 1e-9 * float(np.max(np.abs(p)))
    return corners[keep], values[keep] / norms[keep, None]


@dataclass(frozen=True)
class _Gap:
    """Orthonormal admissible matrices that no combination of triangles reaches.

    Attributes:
        edges: their entries on the edges, shape (missing, m).
        diagonal: their diagonals, shape (missing, n).
    """

    edges: Matrix
    diagonal: FloatArray

    def matrix(self, block: Block, part: FloatArray) -> Matrix:
        """The combination ``part``, shape (missing,), as a full matrix, shape (n, n)."""
        full = np.diag(part @ self.diagonal).astype(block.dtype)
        i, j = block.edges[:, 0], block.edges[:, 1]
        full[i, j] = part @ self.edges
        full[j, i] = full[i, j].conj()
        return full

    @staticmethod
    def of(block: Block, draws: FloatArray, rows: scipy.sparse.csr_array, factor: FloatArray) -> _Gap:
        i, j = block.edges[:, 0], block.edges[:, 1]
        outer = outer_products(rows)
        inner = [(outer.conj() @ block.assemble(draw).ravel()).real for draw in draws]
        shares, _ = scipy.linalg.lapack.dpotrs(factor, np.array(inner).T, lower=1)
        edges, diagonal = [], []
        for draw, share in zip(draws, np.asarray(shares).T, strict=True):
            matrix = block.assemble(draw) - np.asarray(outer.T @ share).reshape(block.size, block.size)
            edges.append(matrix[i, j])
            diagonal.append(matrix.diagonal().real)
        entries, own = np.array(edges), np.array(diagonal)
        products = 2.0 * (entries @ entries.conj().T).real + own @ own.T
        lower = np.linalg.cholesky(products)
        return _Gap(
            edges=scipy.linalg.solve_triangular(lower, entries, lower=True),
            diagonal=scipy.linalg.solve_triangular(lower, own, lower=True),
        )

    def inner(self, corners: IntArray, values: Matrix, index: IntArray) -> FloatArray:
        """Inner products with triangles whose first two corners are no edge, shape (missing, count).

        Args:
            corners: agents, shape (count, 3).
            values: v* on the corners, shape (count, 3).
            index: number of the edge between two agents i < j, shape (n, n).
        """
        total = sum(self.diagonal[:, corners[:, k]] * np.abs(values[:, k]) ** 2 for k in range(3))
        third = corners[:, 2]
        for k in (0, 1):
            upward = corners[:, k] < third
            edge = index[np.minimum(corners[:, k], third), np.maximum(corners[:, k], third)]
            weights = values[:, k] * values[:, 2].conj()
            weights = np.where(upward, weights, weights.conj())
            total = total + 2.0 * (self.edges[:, edge] * weights).real
        return np.asarray(total)


@dataclass(frozen=True)
class _Chord:
    """A pair that is no edge, and triangles on it.

    Attributes:
        corners: agents; the first two columns are the pair, shape (count, 3).
    """

    corners: IntArray


def _close(block: Block, gap: _Gap) -> tuple[list[_Chord], FloatArray]:
    """Chords that together close as much of the gap as they can, greedily.

    Returns:
        The chords, and an orthonormal basis of what remains open in coordinates of the gap, shape (missing, left).
    """
    least = 3 if block.is_complex else 2
    corners, values, starts = _offers(block, least)
    missing = len(gap.diagonal)
    if len(starts) == 0:
        return [], np.eye(missing)
    index = np.zeros((block.size, block.size), dtype=np.int64)
    index[block.edges[:, 0], block.edges[:, 1]] = np.arange(len(block.edges))
    inner = gap.inner(corners, values, index)
    entry = values[:, 0] * values[:, 1].conj()
    bounds = [*starts.tolist(), len(corners)]
    pieces, owners = [], []
    for offer, (begin, end) in enumerate(pairwise(bounds)):
        piece = _entry_free(inner[:, begin:end], entry[begin:end], block.is_complex)
        if float(np.sum(piece**2)) > 1e-8:
            pieces.append(piece)
            owners.append(np.full(piece.shape[1], offer))
    chosen: list[_Chord] = []
    closed = np.zeros((missing, 0))
    if not pieces:
        return [], np.eye(missing)
    reach, owner = np.concatenate(pieces, axis=1), np.concatenate(owners)
    while closed.shape[1] < missing:
        strengths = np.bincount(owner, weights=np.sum(reach**2, axis=0))
        best = int(np.argmax(strengths))
        basis, sizes, _ = np.linalg.svd(reach[:, owner == best], full_matrices=False)
        new = basis[:, sizes > 1e-3]
        if new.shape[1] == 0:
            break
        members = slice(bounds[best], bounds[best + 1])
        still = inner[:, members] - closed @ (closed.T @ inner[:, members])
        stacked = np.concatenate([still, entry[None, members].real, entry[None, members].imag])
        _, _, order = scipy.linalg.qr(stacked, mode="economic", pivoting=True)
        chosen.append(_Chord(corners[members][np.sort(order[: new.shape[1] + least - 1])]))
        closed = np.concatenate([closed, new], axis=1)
        reach = reach - new @ (new.T @ reach)
        reach[:, owner == best] = 0.0
    full, _ = scipy.linalg.qr(closed, mode="full") if closed.shape[1] else (np.eye(missing), None)
    return chosen, np.asarray(full[:, closed.shape[1] :])


def _offers(block: Block, least: int) -> tuple[IntArray, Matrix, IntArray]:
    """All pairs that are no edge but have common neighbours: corners, v* on them, and where each pair starts."""
    adjacency = block.adjacency
    common = adjacency.astype(np.float32) @ adjacency.astype(np.float32)
    parts = []
    for i, j in np.argwhere(np.triu(~adjacency & (common >= least - 0.5), 1)):
        third = np.flatnonzero(adjacency[i] & adjacency[j])
        parts.append(np.stack([np.full_like(third, i), np.full_like(third, j), third], axis=1))
    if not parts:
        return np.zeros((0, 3), dtype=np.int64), np.zeros((0, 3)), np.zeros(0, dtype=np.int64)
    corners, values = _corner_values(block, np.concatenate(parts).astype(np.int64))
    pair = corners[:, 0] * block.size + corners[:, 1]
    _, counts = np.unique(pair, return_counts=True)
    wanted = np.repeat(counts >= least, counts)
    corners, values = corners[wanted], values[wanted]
    return corners, values, np.unique(pair[wanted], return_index=True)[1].astype(np.int64)


def _entry_free(inner: FloatArray, entry: Matrix, is_complex: bool) -> FloatArray:
    """Inner products of those combinations of triangles whose entries on the chord cancel."""
    rows = np.stack([entry.real, entry.imag]) if is_complex else entry.real[None]
    _, _, basis = np.linalg.svd(rows, full_matrices=True)
    return np.asarray(inner @ basis[len(rows) :].T)


def _local_extras(block: Block, gap: _Gap, left: FloatArray) -> tuple[LocalMatrix, ...] | None:
    """Admissible matrices on few agents that reach what is left of the gap.

    Args:
        block: the problem.
        gap: what triangles do not reach.
        left: what chords do not reach of it, orthonormal, shape (missing, left).

    Returns:
        As many matrices as directions are left: on an agent and its neighbours or on two such sets where that reaches,
        on all agents where not; None when the latter would be too many.
    """
    if left.shape[1] == 0:
        return ()
    edges = left.T @ gap.edges
    diagonal = left.T @ gap.diagonal
    around = block.adjacency | np.eye(block.size, dtype=np.bool_)
    found: list[LocalMatrix] = []
    opened = np.eye(left.shape[1])  # orthonormal basis of what is still to be reached
    for hops in (1, 2, 3):
        if opened.shape[1] <= FEW_WIDE:
            break
        regions = list(around)
        if hops > 1:
            # edges on which most is missing: with the neighbours of both ends, then with theirs as well
            weight = np.sum(np.abs(opened.T @ edges) ** 2, axis=0)
            count = (MOST_PAIRS if hops == 2 else 2) * opened.shape[1]
            regions = [around[i] | around[j] for i, j in block.edges[np.argsort(-weight, kind="stable")[:count]]]
        if hops == 3:
            regions = [around[region].any(axis=0) for region in regions]
        more, opened = _reach(block, edges, diagonal, regions, opened)
        found += more
    if opened.shape[1] > MOST_WIDE:
        return None
    everyone = np.arange(block.size, dtype=np.int64)
    return (*found, *((everyone, gap.matrix(block, left @ direction)) for direction in opened.T))


def _reach(
    block: Block, edges: Matrix, diagonal: FloatArray, regions: list[BoolArray], opened: FloatArray
) -> tuple[list[LocalMatrix], FloatArray]:
    """Picks admissible matrices on single regions, greedily, until they add nothing more.

    Args:
        block: the problem.
        edges: entries on the edges of the directions to reach, shape (left, m).
        diagonal: their diagonals, shape (left, n).
        regions: masks of agents.
        opened: orthonormal basis of what is still to be reached, shape (left, open).

    Returns:
        The matrices, and what is open after them.
    """
    parts, reaches = [], []
    for region in regions:
        agents = np.flatnonzero(region).astype(np.int64)
        part, members = _part(block, agents)
        inner = opened @ (opened.T @ _inner(part, edges[:, members], diagonal[:, agents]))
        if inner.size and float(np.sum(inner**2)) > LOCAL_REACH**2:
            parts.append((agents, part))
            reaches.append(inner)
    found: list[LocalMatrix] = []
    while reaches and opened.shape[1] > 0:
        best = int(np.argmax([float(np.sum(reach**2)) for reach in reaches]))
        basis, sizes, rows = np.linalg.svd(opened.T @ reaches[best], full_matrices=False)
        good = int(np.sum(sizes > max(LOCAL_REACH, 0.3 * sizes[0])))
        if good == 0:
            break
        agents, part = parts[best]
        found += [(agents, part.assemble(part.null_space @ row)) for row in rows[:good]]
        rest, _ = scipy.linalg.qr(basis[:, :good], mode="full")
        new = opened @ basis[:, :good]
        reaches = [reach - new @ (new.T @ reach) for reach in reaches]
        opened = opened @ rest[:, good:]
    return found, opened


def _inner(part: Block, edges: Matrix, diagonal: FloatArray) -> FloatArray:
    """Inner products of matrices, given on edges and diagonal of a part, with a basis of its admissible ones."""
    unknowns, count = part.null_space, len(part.edges)
    entries = unknowns[:count] + 1j * unknowns[count:] if part.is_complex else unknowns
    own = np.zeros((part.size, unknowns.shape[1]))
    np.add.at(own, part.edges[:, 0], -entries.real)
    np.add.at(own, part.edges[:, 1], -entries.real)
    return np.asarray(2.0 * (edges.conj() @ entries).real + diagonal @ own)


def _part(block: Block, agents: IntArray) -> tuple[Block, IntArray]:
    """The problem on some of the agents, and which edges of the whole it has."""
    number = np.full(block.size, -1)
    number[agents] = np.arange(len(agents))
    members = np.flatnonzero((number[block.edges[:, 0]] >= 0) & (number[block.edges[:, 1]] >= 0)).astype(np.int64)
    part = Block(
        name=block.name,
        coordinate=block.coordinate[agents],
        kernel=block.kernel[agents],
        edges=number[block.edges[members]],
        adjacency=block.adjacency[np.ix_(agents, agents)],
    )
    return part, members
