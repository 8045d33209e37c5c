"""Proofs about designed matrices: what they are worth, and that nothing better exists.

Works from the matrix alone, never from what a solver said about it. Anyone can repeat every figure with an
eigenvalue routine. Refuses nothing by itself; ``faults`` lists what is wrong.

Upper bound. Let D be Hermitian and zero on every edge and on the diagonal. Any admissible H lives on edges and
diagonal only, so <D, H> = 0. With E = Q* D Q = E+ - E- and t I <= Q* H Q <= s I:
t tr(E+) <= <E+, Q*HQ> = <E-, Q*HQ> <= s tr(E-), hence t <= s tr(E-) / tr(E+).
Such a D is what the multipliers of the kernel equations leave of any solution of the dual problem.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from groundstation.core.formation import Formation, Gains
from groundstation.core.types import FloatArray
from groundstation.design.problem import Block, Matrix, graph_of, hermitian_part, pattern_equations, split

ZERO_EIGENVALUE = 1e-8
"""Below this, relative to the spectral norm, an eigenvalue counts as zero."""

WEAKEST = 1e-6
"""Slowest mode, relative to the spectral norm, below which a design is refused; far above ``ZERO_EIGENVALUE``."""

EXACT_SHARE = 150
"""Agents up to which a stalled least-squares problem is solved again by decomposition."""

RESIDUAL_LIMIT = 1e-9
"""Largest kernel residual relative to the spectral norm, and largest asymmetry."""


@dataclass(frozen=True)
class BlockCertificate:
    """Figures of one block, all recomputed from the matrix.

    Attributes:
        slowest: smallest eigenvalue of -Q* A Q or less, 1/s; infinite where there is nothing to place.
        fastest: largest eigenvalue of -A or more, 1/s; 0 where there is nothing to place.
        bound: no matrix of the same spectral norm has a larger ``slowest``, 1/s.
        zeros: eigenvalues of A that are zero.
        zeros_expected: dimension of the kernel that the formation has, r.
        residual: largest entry of A N with N the kernel of the formation in units of its size, 1/s.
        dual: D of the module's docstring, exactly zero on edges and diagonal, shape (n, n).
    """

    slowest: float
    fastest: float
    bound: float
    zeros: int
    zeros_expected: int
    residual: float
    dual: Matrix


@dataclass(frozen=True)
class Certificate:
    """Figures of a whole design.

    Attributes:
        xy: horizontal block.
        z: vertical block.
    """

    xy: BlockCertificate
    z: BlockCertificate

    @property
    def lambda_max(self) -> float | None:
        """Largest nonzero eigenvalue of A: the slowest mode; None when A has none, 0 when the design failed."""
        slowest = min(self.xy.slowest, self.z.slowest)
        return None if np.isinf(slowest) else min(-slowest, 0.0) or 0.0

    @property
    def lambda_min(self) -> float | None:
        """Smallest eigenvalue of A: the fastest mode; None when A has none."""
        fastest = max(self.xy.fastest, self.z.fastest)
        return None if np.isinf(min(self.xy.slowest, self.z.slowest)) else -fastest

    @property
    def interval(self) -> tuple[float, float]:
        """The optimum of (11) lies between these two rates, 1/s."""
        return min(self.xy.slowest, self.z.slowest), min(self.xy.bound, self.z.bound)

    @property
    def gap(self) -> float:
        """Relative width of the interval; 0 means proven optimal."""
        return max(_relative_gap(self.xy), _relative_gap(self.z))

    @property
    def zero_eigenvalues(self) -> int:
        """Zero eigenvalues of the 3n x 3n matrix A; every horizontal one counts twice."""
        return 2 * self.xy.zeros + self.z.zeros

    @property
    def zeros_expected(self) -> int:
        """Dimension of the kernel of the formation: 6 in general position."""
        return 2 * self.xy.zeros_expected + self.z.zeros_expected

    @property
    def kernel_residual(self) -> float:
        """Largest entry of A N, 1/s per unit of the formation's size."""
        return max(self.xy.residual, self.z.residual)


def _relative_gap(block: BlockCertificate) -> float:
    if np.isinf(block.slowest) or block.bound <= 0.0:
        return 0.0
    return max(0.0, (block.bound - block.slowest) / block.bound)


def eigenvalues(block: Block, matrix: Matrix) -> FloatArray:
    """Eigenvalues of Q* H Q in ascending order, shape (d,)."""
    if block.free == 0:
        return np.zeros(0)
    return np.asarray(scipy.linalg.eigvalsh(block.reduce(matrix), check_finite=False))


def scale_to_norm(block: Block, matrix: Matrix, spectral_norm: float) -> Matrix:
    """Scales H so that its largest eigenvalue is ``spectral_norm``; a zero matrix stays zero."""
    if block.free == 0:
        return np.zeros_like(matrix)
    largest = float(_spectrum(block, -matrix)[0][-1])
    return matrix * (spectral_norm / largest) if largest > WEAKEST else np.zeros_like(matrix)


def dual_on_non_edges(block: Block, dual: Matrix) -> Matrix:
    """Moves a dual matrix to where the graph has no edges, without changing Q* D Q.

    D - N L* - L N* has the same Q* D Q for any L, shape (n, r). The L that leaves least on edges and diagonal is a
    linear least-squares solution; what still remains there is cut off, so that the bound holds whatever was left.

    Args:
        block: the problem.
        dual: Hermitian, shape (n, n).

    Returns:
        Hermitian, exactly zero on edges and diagonal, shape (n, n).
    """
    if block.free == 0 or block.complete:
        return np.zeros(dual.shape, dtype=dual.dtype)  # not zeros_like, which would touch all of the memory
    off_pattern = block.outside
    moved = hermitian_part(dual)
    share = _kernel_share(block, moved)
    remains = float(np.linalg.norm(np.where(off_pattern, 0.0, moved - share)))
    if block.size <= EXACT_SHARE and remains > 1e-9 * float(np.linalg.norm(moved)):
        share = _exact_kernel_share(block, moved)
    moved = moved - share
    return np.asarray(np.where(off_pattern, moved, 0.0))


def _kernel_share(block: Block, dual: Matrix) -> Matrix:
    """N L* + L N* nearest to D on edges and diagonal, by conjugate gradients on the normal equations."""
    kernel = block.kernel
    pattern = (~block.outside).astype(np.float64)

    def spread(share: Matrix) -> Matrix:
        product = share @ kernel.conj().T
        return np.asarray(pattern * (product + product.conj().T))

    def gather(matrix: Matrix) -> Matrix:
        return np.asarray(2.0 * (matrix @ kernel))

    share = np.zeros_like(kernel)
    residual = gather(pattern * dual)
    direction = residual
    power = start = float(np.vdot(residual, residual).real)
    for _ in range(20 * block.size + 100):
        if power <= 1e-28 * start or start == 0.0:
            break
        image = gather(spread(direction))
        curvature = float(np.vdot(direction, image).real)
        if curvature <= 0.0:
            break
        share = share + (power / curvature) * direction
        residual = residual - (power / curvature) * image
        power, before = float(np.vdot(residual, residual).real), power
        direction = residual + (power / before) * direction
    product = share @ kernel.conj().T
    return np.asarray(product + product.conj().T)


def _exact_kernel_share(block: Block, dual: Matrix) -> Matrix:
    """The same by a singular value decomposition: for agents so near each other that conjugate gradients stall."""
    i, j = block.edges[:, 0], block.edges[:, 1]
    entries, own = np.sqrt(2.0) * dual[i, j], dual.diagonal().real
    values = np.concatenate([entries.real, entries.imag, own] if block.is_complex else [entries, own])
    prices, *_ = np.linalg.lstsq(pattern_equations(block).toarray().T, values, rcond=1e-14)
    parts = prices.reshape(block.kernel.shape[1], -1, block.size)
    share = (parts[:, 0] + 1j * parts[:, 1] if block.is_complex else parts[:, 0]).T / 2
    product = share @ block.kernel.conj().T
    return np.asarray(product + product.conj().T)


def upper_bound(block: Block, dual: Matrix) -> float:
    """Largest t that any admissible H of spectral norm 1 can have, as ``dual`` proves it.

    Args:
        block: the problem.
        dual: Hermitian and zero on edges and diagonal; anything on them is ignored: no input gives a wrong bound.

    Returns:
        Between 0 and 1; 1 when the dual proves nothing.
    """
    if block.free == 0:
        return 1.0
    off_pattern = block.outside
    values = eigenvalues(block, np.where(off_pattern, hermitian_part(dual), 0.0))
    positive, negative = float(values[values > 0].sum()), float(-values[values < 0].sum())
    # both traces carry rounding; widening the bound by as much keeps it a bound
    rounding = 1e-13 * block.size * float(np.max(np.abs(values), initial=0.0))
    if positive <= rounding:
        return 1.0
    return min(1.0, (negative + rounding) / positive)


def certify_block(block: Block, gain: Matrix, dual: Matrix, spectral_norm: float = 0.0) -> BlockCertificate:
    """Recomputes every figure of one block.

    Args:
        block: the problem that the matrix is said to solve.
        gain: negative semidefinite block of A (not of -A), shape (n, n), 1/s.
        dual: D, shape (n, n).
        spectral_norm: what the bound counts for when the matrix itself is smaller, 1/s.

    Returns:
        The figures, good or bad; ``faults`` judges them.
    """
    if block.free == 0:
        stray = float(np.max(np.abs(gain), initial=0.0))
        zeros = block.size if stray == 0.0 else 0
        return BlockCertificate(np.inf, 0.0, np.inf, zeros, block.size, stray, dual)
    directions = np.stack([np.ones(block.size, dtype=gain.dtype), block.coordinate.astype(gain.dtype)], axis=1)
    residual = float(np.max(np.abs(gain @ directions)))
    inside, slack = _spectrum(block, gain)
    slowest, fastest = float(inside[0] - slack), float(inside[-1] + slack)
    norm = max(fastest, -slowest)
    rounding = 1e-9 * max(norm, spectral_norm)
    # -A = Q (Q* -A Q) Q* + what touches the kernel; the latter moves no eigenvalue by more than twice its norm
    touching = 2.0 * float(np.linalg.norm(gain @ block.kernel))
    if touching <= ZERO_EIGENVALUE * norm / 2:
        zeros = block.kernel.shape[1] + int(np.sum(np.abs(inside) <= ZERO_EIGENVALUE * norm))
    else:
        everywhere = scipy.linalg.eigvalsh(hermitian_part(gain), check_finite=False)
        zeros = int(np.sum(np.abs(everywhere) <= ZERO_EIGENVALUE * max(float(np.max(np.abs(everywhere))), 1e-300)))
    bound = max(norm, spectral_norm) * (1.0 if block.complete else upper_bound(block, dual))
    return BlockCertificate(
        slowest=slowest,
        fastest=fastest,
        bound=max(slowest, bound) if slowest <= bound + rounding else bound,
        zeros=zeros,
        zeros_expected=block.kernel.shape[1],
        residual=residual,
        dual=dual,
    )


def _spectrum(block: Block, gain: Matrix) -> tuple[FloatArray, float]:
    """Eigenvalues of -Q* A Q, shape (d,), and by how much they may be off.

    A matrix that is a multiple of the projector I - N N* up to a small difference has its eigenvalues within the norm
    of that difference (Weyl): no decomposition is needed.
    """
    if block.complete:
        level = -float(np.trace(gain).real) / block.free
        # gain + level (I - N N*), put together in one piece of memory
        difference: Matrix = np.matmul(block.kernel * -level, block.kernel.conj().T).astype(gain.dtype, copy=False)
        difference += gain
        difference[np.diag_indices(block.size)] += level
        away = float(np.linalg.norm(difference))
        if away <= 1e-11 * abs(level):
            return np.full(block.free, level), away
    return eigenvalues(block, -gain), 0.0


def certify(formation: Formation, gains: Gains, dual_xy: Matrix, dual_z: Matrix) -> Certificate:
    """Recomputes the whole certificate of a formation's gains; see ``certify_block``."""
    xy, z = split(formation)
    return Certificate(certify_block(xy, gains.xy, dual_xy), certify_block(z, gains.z, dual_z))


def faults(formation: Formation, gains: Gains, certificate: Certificate) -> list[str]:
    """Everything that keeps a matrix from being a design for a formation (Theorem 1, equation (3)).

    Args:
        formation: points and graph.
        gains: the matrices.
        certificate: figures of ``certify`` for exactly these gains.

    Returns:
        One sentence per fault, empty when the matrix is sound.
    """
    found: list[str] = []
    n = formation.size
    if gains.xy.shape != (n, n):
        return [f"gains are for {gains.xy.shape[0]} agents, the formation has {n}"]
    if not (np.all(np.isfinite(gains.xy)) and np.all(np.isfinite(gains.z))):
        return ["gains contain a number that is not finite"]
    edges, adjacency = graph_of(formation)
    complete = 2 * len(edges) == n * (n - 1)
    allowed = adjacency | np.eye(n, dtype=np.bool_)
    for name, gain, figures in (("xy", gains.xy, certificate.xy), ("z", gains.z, certificate.z)):
        limit = RESIDUAL_LIMIT * max(figures.fastest, 1.0)
        mirrored = gain.conj().T
        asymmetry = 0.0 if np.array_equal(gain, mirrored) else float(np.max(np.abs(gain - mirrored)))
        if asymmetry > limit:
            found.append(f"{name}: not symmetric, entries differ by {asymmetry:.3g} (limit {limit:.3g})")
        stray = np.argwhere((gain != 0) & ~allowed) if not complete else np.zeros((0, 2), dtype=np.int64)
        if len(stray):
            i, j = stray[0] + 1
            found.append(f"{name}: agents {i} and {j} have a gain but no edge")
        rows = float(np.max(np.abs(gain.sum(axis=1))))
        if rows > limit:
            found.append(f"{name}: row sums reach {rows:.3g}, so equation (3) does not hold (limit {limit:.3g})")
        if figures.residual > limit:
            found.append(f"{name}: kernel residual {figures.residual:.3g} (limit {limit:.3g})")
        if figures.zeros != figures.zeros_expected:
            found.append(f"{name}: {figures.zeros} zero eigenvalues, the formation has {figures.zeros_expected}")
        if figures.slowest > figures.bound:
            found.append(f"{name}: slowest mode {figures.slowest:.6g} 1/s above its bound {figures.bound:.6g} 1/s")
        if np.isfinite(figures.slowest) and figures.slowest < WEAKEST * figures.fastest:
            positive = figures.slowest < -ZERO_EIGENVALUE * figures.fastest
            kind = "a positive eigenvalue" if positive else "a mode that is not damped"
            found.append(f"{name}: {kind}: {-figures.slowest:.3g} 1/s off the kernel")
    return found
