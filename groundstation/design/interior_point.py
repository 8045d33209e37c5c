"""Primal-dual interior point for the split gain design problem, with Nesterov-Todd directions.

Maximise t over y with S1 = Q* H(y) Q - t I and S2 = I - Q* H(y) Q positive semidefinite. Its dual: minimise tr X2 with
tr X1 = 1 and X1 - X2 orthogonal to every admissible H. y = 0, t = -1, X1 = X2 = I/d is feasible and central, so every
iterate is feasible and tr X2 - t is the true gap throughout. Predictor and corrector after Mehrotra.

The work is in the Schur complement; ``basis`` provides it, either from dense matrices (small teams) or entry by entry
from rank-one matrices that each touch two or three agents (sparse graphs). Nothing here is random or timed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from groundstation.core.types import FloatArray
from groundstation.design.basis import Basis, DenseBasis, dense_pays, edge_basis
from groundstation.design.problem import Block, BlockSolution, Matrix, Progress, Watch, zero_solution
from groundstation.design.triangles import triangle_basis

MOST_ITERATIONS = 60
BOLD_STEP, CAREFUL_STEP = 0.98, 0.95
"""Share of the way to the boundary: for dense bases, and for large problems, where bold steps cost iterations."""
NOTHING = 1e-8
"""Gap, and bound on t, at which nothing is left to be found."""


@dataclass
class _Iterate:
    """Values of one iteration; index 0 belongs to S1 and X1, index 1 to S2 and X2, each (d, d)."""

    y: FloatArray
    t: float
    slack: Matrix
    dual: Matrix

    @property
    def bound(self) -> float:
        return float(np.trace(self.dual[1]).real / np.trace(self.dual[0]).real)


@dataclass(frozen=True)
class _Scaling:
    """Nesterov-Todd scaling: G* S G = G^-1 X G^-* = diag(sigma), for both cones at once."""

    g: Matrix
    inverse: Matrix
    sigma: FloatArray

    @staticmethod
    def of(slack: Matrix, dual: Matrix) -> _Scaling:
        lower = np.linalg.cholesky(slack)
        values, vectors = np.linalg.eigh(_adjoint(lower) @ dual @ lower)
        if not np.all(values > 0):
            raise np.linalg.LinAlgError("dual iterate is not positive definite")
        sigma = np.sqrt(values)
        root = np.sqrt(sigma)[:, None, :]
        solve = scipy.linalg.lapack.ztrtrs if np.iscomplexobj(lower) else scipy.linalg.lapack.dtrtrs
        scaled = vectors * root
        g = np.empty_like(scaled)
        for place in range(2):
            g[place], info = solve(lower[place], scaled[place], lower=1, trans=2)
            if info != 0:
                raise np.linalg.LinAlgError("slack is not positive definite")
        return _Scaling(g=g, inverse=_adjoint(lower @ (vectors / root)), sigma=sigma)

    def step_lengths(self, ds: Matrix, dx: Matrix, share: float) -> tuple[float, float]:
        """Largest steps for which diag(sigma) plus ds, and plus dx, stay positive definite."""
        root = 1.0 / np.sqrt(self.sigma)
        weights = root[:, :, None] * root[:, None, :]
        lowest = np.linalg.eigvalsh(np.concatenate([weights * ds, weights * dx]))[:, 0].tolist()
        lengths = [1.0 if value > -share else -share / value for value in lowest]
        return min(lengths[:2]), min(lengths[2:])


def _adjoint(stack: Matrix) -> Matrix:
    return np.asarray(np.swapaxes(stack.conj(), -1, -2))


def choose_basis(block: Block) -> Basis:
    """Dense basis for small teams, triangles where they span, edges otherwise."""
    if dense_pays(block):
        return DenseBasis(block)
    return triangle_basis(block) or edge_basis(block)


class InteriorPoint:
    """One block under way: it can be taken to a coarse gap, left, and taken on from there."""

    def __init__(self, block: Block, basis: Basis | None = None) -> None:
        """Starts at y = 0.

        Args:
            block: the problem.
            basis: unknowns; chosen by size, at the first step, when None.
        """
        self._block, self._basis = block, basis
        self._now: _Iterate | None = None
        self._iteration, self._stuck = 0, False

    def advance(self, gap: float, watch: Watch) -> BlockSolution:
        """Goes on to a relative gap.

        Args:
            gap: relative distance of t from its bound at which to stop.
            watch: progress and interruption.

        Returns:
            The last feasible iterate; unfinished when interrupted or when rounding ended the progress first.
        """
        block = self._block
        if block.free == 0 or len(block.edges) == 0:
            return zero_solution(block)
        if self._now is None and watch.stop():
            return zero_solution(block, finished=False)
        if self._basis is None:
            self._basis = choose_basis(block)
        basis = self._basis
        if basis.count == 0:
            return zero_solution(block)
        d = block.free
        unit = np.eye(d, dtype=block.dtype)
        if self._now is None:
            self._now = _Iterate(np.zeros(basis.count), -1.0, np.stack([unit, unit]), np.stack([unit, unit]) / d)
        now = self._now
        share = BOLD_STEP if isinstance(basis, DenseBasis) else CAREFUL_STEP
        finished = _near_enough(now, gap)
        while self._iteration < MOST_ITERATIONS and not (finished or self._stuck or watch.stop()):
            self._iteration += 1
            try:
                _step(now, basis, unit, share)
            except np.linalg.LinAlgError:
                self._stuck = True
                break
            finished = _near_enough(now, gap)
            watch.report(Progress(block.name, "interior-point", self._iteration, now.t, now.bound))
        return BlockSolution(
            matrix=basis.matrix(now.y),
            dual=block.expand(now.dual[0] - now.dual[1]),
            iterations=self._iteration,
            finished=finished,
        )


def _near_enough(now: _Iterate, gap: float) -> bool:
    left = now.bound - now.t
    return left <= gap * max(now.bound, 0.0) or left <= NOTHING * 0.1 or now.bound <= NOTHING


def solve_interior_point(block: Block, gap: float, watch: Watch, basis: Basis | None = None) -> BlockSolution:
    """Solves one block to a relative gap in one go; see ``InteriorPoint``."""
    return InteriorPoint(block, basis).advance(gap, watch)


def _step(now: _Iterate, basis: Basis, unit: Matrix, share: float) -> None:
    """One predictor-corrector step, in place; raises LinAlgError where rounding makes a factorisation fail."""
    d = len(unit)
    scaling = _Scaling.of(now.slack, now.dual)
    g, sigma = scaling.g, scaling.sigma
    solve = basis.factor(g)
    w1 = g[0] @ g[0].conj().T
    pull = basis.inner(w1 @ w1)
    drift = basis.drift(now.y)
    # M dy - pull dt = rhs and pull dy - weight dt = right, the latter for tr X1 = 1
    weight = float(np.linalg.norm(w1) ** 2)
    response = solve(pull, np.zeros_like(drift))
    slope = float(pull @ response) - weight

    def direction(target: Matrix) -> tuple[FloatArray, float, Matrix, Matrix]:
        """Direction with scaled dX + dS = target: dy, dt, and dS, dX scaled."""
        aimed = now.dual + g @ target @ _adjoint(g)
        base = solve(basis.inner(aimed[0] - aimed[1]), -drift)
        dt = (float(np.trace(aimed[0]).real) - 1.0 - float(pull @ base)) / slope
        dy = base + response * dt
        change = basis.reduced(dy)
        ds = _adjoint(g) @ np.stack([change - dt * unit, -change]) @ g
        return dy, dt, ds, target - ds

    diagonal = sigma[:, :, None] * unit
    _, _, ds, dx = direction(-diagonal)
    step_s, step_x = scaling.step_lengths(ds, dx, share)
    inner = float(np.sum(sigma**2))
    ahead = float(np.vdot(diagonal + step_x * dx, diagonal + step_s * ds).real)
    centring = max(min((max(ahead, 0.0) / inner) ** 3, 1.0), 1e-6)
    second = dx @ ds
    second = (second + _adjoint(second)) / 2
    mu = inner / (2 * d)
    target = 2.0 * ((centring * mu - sigma**2)[:, :, None] * unit - second)
    dy, dt, ds, dx = direction(target / (sigma[:, :, None] + sigma[:, None, :]))
    step_s, step_x = scaling.step_lengths(ds, dx, share)
    now.y = now.y + step_s * dy
    now.t = now.t + step_s * dt
    reduced = basis.reduced(now.y)
    now.slack = np.stack([reduced - now.t * unit, unit - reduced])
    moved = now.dual + step_x * (g @ dx @ _adjoint(g))
    now.dual = (moved + _adjoint(moved)) / 2
