"""One call from a formation to certified gains.

Chooses a method per block, lets it work, and then believes only the certificate: the answer is a matrix whose
eigenvalues were recomputed, or a refusal with the reason. There is nothing in between.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace

import numpy as np
import scipy.spatial
from threadpoolctl import ThreadpoolController  # type: ignore[import-untyped]

from groundstation.core.extras import need
from groundstation.core.formation import Formation, Gains
from groundstation.design.certify import (
    RESIDUAL_LIMIT,
    WEAKEST,
    BlockCertificate,
    Certificate,
    certify_block,
    dual_on_non_edges,
    faults,
    scale_to_norm,
)
from groundstation.design.closed_form import solve_complete
from groundstation.design.diagnosis import findings
from groundstation.design.interior_point import InteriorPoint, solve_interior_point
from groundstation.design.mesh import solve_triangles
from groundstation.design.problem import (
    SPECTRAL_NORM,
    Block,
    BlockSolution,
    Matrix,
    Progress,
    Watch,
    hermitian_part,
    split,
)
from groundstation.design.sdp import solve_clarabel
from groundstation.design.shapes import notes
from groundstation.design.splitting import MOST_ITERATIONS, Splitting, solve_splitting

COINCIDENT = 1e-6
"""Distance relative to the formation's size below which two agents count as standing in one place."""

DENSE_GRAPH = 0.3
"""Share of all pairs that are edges, above which splitting converges faster than an interior point."""

FEW_ITERATIONS = 600
"""Splitting iterations where an interior point can be tried as well."""

COARSE = 0.5
"""Relative gap to which both blocks are taken before either is refined: from there on a stop finds a whole design."""

NEARLY = 1e-3
"""Certified relative gap from which a cold start of splitting is not worth its time any more."""

LARGEST_SCHUR = 14_000
"""Unknowns up to which the Schur complement of an interior point is formed: 1.6 GB."""

NEAR = 0.05
"""Distance of a pair relative to the formation's size that deserves a warning."""

Solver = Callable[[Block, float, Watch], BlockSolution]


def _solve_cvxpy(block: Block, gap: float, watch: Watch) -> BlockSolution:
    need("solvers", "method cvxpy")
    from groundstation.design.modelled import solve_cvxpy  # noqa: PLC0415 - slow to import, seldom wanted

    return solve_cvxpy(block, gap, watch)


METHODS: dict[str, Solver] = {
    "closed-form": solve_complete,
    "interior-point": solve_interior_point,
    "splitting": solve_splitting,
    "clarabel": solve_clarabel,
    "cvxpy": _solve_cvxpy,
    "triangles": solve_triangles,
}


@dataclass(frozen=True)
class DesignResult:
    """What came of a design.

    Attributes:
        formation: what was asked for.
        gains: the certified matrices, None when the design was refused.
        certificate: figures of the gains, or of the best matrix found when they were refused; None when no solver ran.
        reason: why it was refused, empty otherwise.
        method: what found the blocks, ``xy/z`` where they differ.
        finished: whether the certified gap is the one that was asked for or less, or a refusal is proven.
        notes: what the shape leaves free, and warnings, in words.
        undecided: neither gains nor a proof that there are none: time or methods ran out.
    """

    formation: Formation
    gains: Gains | None
    certificate: Certificate | None
    reason: str
    method: str
    finished: bool
    notes: tuple[str, ...] = ()
    undecided: bool = False

    @property
    def feasible(self) -> bool:
        """Whether there are gains."""
        return self.gains is not None


def default_gap(n: int) -> float:
    """Certified relative gap at which a method may stop: 1e-6 where it costs nothing, 1e-3 to n = 150, then 1e-2."""
    if n <= 16:
        return 1e-6
    return 1e-3 if n <= 150 else 1e-2


def suitable_methods(block: Block) -> list[str]:
    """Names of the methods that suit a block, best first; the next one is tried when one fails to reach the gap."""
    n, edges = block.size, len(block.edges)
    if block.complete:
        return ["closed-form"]
    if n <= 16:
        return ["interior-point", "clarabel"]
    unknowns = len(block.unknown_edges) - (3 * n if block.is_complex else n)
    density = 2.0 * edges / (n * (n - 1))
    fits = unknowns <= LARGEST_SCHUR
    if density < DENSE_GRAPH:
        return ["interior-point", "splitting"] if fits else ["splitting"]
    return ["splitting", "interior-point"] if fits else ["splitting"]


def design(
    formation: Formation,
    *,
    method: str = "auto",
    gap: float | None = None,
    spectral_norm: float = SPECTRAL_NORM,
    watch: Watch | None = None,
) -> DesignResult:
    """Designs the gains of a formation (Section IV, Algorithm 1).

    Args:
        formation: points and sensing graph.
        method: a name of ``METHODS``, or ``auto``.
        gap: certified relative gap at which to stop; ``default_gap`` when None.
        spectral_norm: largest eigenvalue of -A, 1/s.
        watch: progress and interruption; an interrupted design keeps the best certified matrix.

    Returns:
        Certified gains, or a refusal with the reason.

    Raises:
        ValueError: unknown method, or one that does not fit (the closed form on an incomplete graph).
    """
    if method != "auto" and method not in METHODS:
        raise ValueError(f"method {method!r} is unknown, known are auto, {', '.join(METHODS)}")
    together = coincident_agents(formation)
    if together:
        return DesignResult(formation, None, None, _together(formation, *together[0]), "none", finished=True)
    if formation.size == 2 and not formation.edges:
        return DesignResult(formation, None, None, "no edge joins agent 1 to agent 2", "none", finished=True)
    watch = watch or Watch()
    wanted = default_gap(formation.size) if gap is None else gap
    with _one_thread():
        xy, z = split(formation)
        works = [_Work(block, method, wanted, spectral_norm, watch) for block in (xy, z)]
        # first a whole design, if a poor one; the slower block is what the design is worth, so it is refined first
        for work in reversed(works):
            work.sketch()
        for work in sorted(works, key=lambda work: work.slowest):
            work.refine()
        horizontal, vertical = (work.found() for work in works)
    found = (horizontal, vertical)
    names = [part.method for part in found]
    used = names[0] if names[0] == names[1] else "/".join(names)
    gains = Gains(
        xy=np.asarray(horizontal.gain, dtype=np.complex128),
        z=np.asarray(vertical.gain.real, dtype=np.float64),
    )
    certificate = Certificate(horizontal.figures, vertical.figures)
    finished = all(part.reached for part in found)
    why = "; ".join(findings(formation, (xy, z), certificate, spectral_norm))
    refused, undecided = _refusal(certificate, spectral_norm, stopped=watch.stop())
    reason = (f"{refused}: {why}" if refused and why else refused) or "; ".join(faults(formation, gains, certificate))
    said = tuple(notes(formation) + _near_misses(formation))
    kept = None if reason else gains
    return DesignResult(formation, kept, certificate, reason, used, finished, said, undecided=undecided)


@dataclass(frozen=True)
class _Found:
    """One block of A with its certificate, from one method or from the best of several."""

    method: str
    gain: Matrix
    figures: BlockCertificate
    reached: bool


class _Work:
    """One block on its way: its methods in turn, until the certificate says that the gap is reached."""

    def __init__(self, block: Block, method: str, gap: float, spectral_norm: float, watch: Watch) -> None:
        self._block, self._gap, self._spectral_norm = block, gap, spectral_norm
        self._names = suitable_methods(block) if method == "auto" else [method]
        self._stop, self._told = watch.stop, watch.report
        self._watch = Watch(stop=watch.stop, report=self._report)
        self._run: InteriorPoint | Splitting | None = None
        self._best: _Found | None = None
        self.slowest, self._bound = -1.0, 1.0

    def _report(self, now: Progress) -> None:
        """Passes on the best interval so far, whichever method found its ends."""
        self.slowest, self._bound = max(self.slowest, now.slowest), min(self._bound, now.bound)
        self._told(replace(now, slowest=self.slowest, bound=self._bound))

    def _start(self, name: str) -> InteriorPoint | Splitting | None:
        if name == "interior-point":
            return InteriorPoint(self._block)
        if name == "splitting":
            return Splitting(self._block, FEW_ITERATIONS if len(self._names) > 1 else MOST_ITERATIONS)
        return None

    def sketch(self) -> None:
        """Takes the first method to a coarse gap, if it can be left and taken up again."""
        if self._block.free > 0:
            self._run = self._start(self._names[0])
            if self._run is not None:
                self._run.advance(max(COARSE, self._gap), self._watch)

    def refine(self) -> None:
        """Takes the methods, one after the other, to the gap; keeps the best matrix and the best bound."""
        block = self._block
        if block.free == 0:
            return
        # the certificate loses a little of the last digits that a method sees
        aim = max(self._gap / 2, self._gap - 1e-4)
        for name in self._names:
            run = self._run or self._start(name)
            self._run = None
            solution = run.advance(aim, self._watch) if run is not None else METHODS[name](block, aim, self._watch)
            found = _judge(block, name, solution, self._gap, self._spectral_norm)
            best = self._best
            best = found if best is None else _better(best, found, self._gap, self._spectral_norm)
            self._best = best
            if best.reached or self._stop() or (name == "interior-point" and block.size > 16 and _nearly(best)):
                return

    def found(self) -> _Found:
        """The block's answer."""
        if self._best is not None:
            return self._best
        zero = np.zeros((self._block.size, self._block.size), dtype=self._block.dtype)
        return _Found("closed-form", zero, certify_block(self._block, zero, zero), reached=True)


def _nearly(found: _Found) -> bool:
    return found.figures.slowest > 0 and found.figures.bound - found.figures.slowest <= NEARLY * found.figures.bound


def _judge(block: Block, name: str, solution: BlockSolution, gap: float, spectral_norm: float) -> _Found:
    if name == "closed-form":
        gain = np.multiply(solution.matrix, -spectral_norm, out=solution.matrix)  # nobody else holds it
    else:
        gain = -scale_to_norm(block, clean(block, solution.matrix), spectral_norm)
    dual = dual_on_non_edges(block, solution.dual)
    figures = certify_block(block, gain, dual, spectral_norm)
    if figures.residual > RESIDUAL_LIMIT * max(figures.fastest, 1.0):
        # cleaning moved it off the kernel: it was no admissible matrix, and zero always is one
        gain = np.zeros_like(gain)
        figures = certify_block(block, gain, dual, spectral_norm)
    return _Found(name, gain, figures, _reached(figures, gap, spectral_norm))


def _reached(figures: BlockCertificate, gap: float, spectral_norm: float) -> bool:
    """Whether the certified interval is narrow enough, or proves that there is nothing to be found."""
    if figures.bound < WEAKEST * spectral_norm:
        return True
    return figures.slowest >= WEAKEST * spectral_norm and figures.bound - figures.slowest <= gap * figures.bound


def _better(one: _Found, other: _Found, gap: float, spectral_norm: float) -> _Found:
    keep, spare = (one, other) if one.figures.slowest >= other.figures.slowest else (other, one)
    figures = keep.figures
    if spare.figures.bound < figures.bound:
        figures = replace(figures, bound=max(figures.slowest, spare.figures.bound), dual=spare.figures.dual)
    return _Found(keep.method, keep.gain, figures, _reached(figures, gap, spectral_norm))


def clean(block: Block, matrix: Matrix) -> Matrix:
    """Removes rounding: exactly Hermitian, exactly zero off the graph, diagonal the negative row sums."""
    tidy = np.where(block.adjacency, hermitian_part(matrix), 0.0)
    tidy[np.diag_indices(block.size)] = -tidy.sum(axis=1).real
    return np.asarray(tidy)


def coincident_agents(formation: Formation) -> list[tuple[int, int]]:
    """Pairs of agents, from 0, that stand in one place: nothing in (11) sees that."""
    if formation.size < 2:
        return []
    points = formation.points_enu_m - formation.points_enu_m.mean(axis=0)
    tree = scipy.spatial.cKDTree(points)
    pairs = tree.query_pairs(COINCIDENT * float(np.max(np.abs(points))))
    return sorted((int(i), int(j)) for i, j in pairs)


def _together(formation: Formation, i: int, j: int) -> str:
    """Why two agents, from 0, are too near each other to be told apart."""
    points = formation.points_enu_m
    limit_m = COINCIDENT * float(np.max(np.abs(points - points.mean(axis=0))))
    apart_m = float(np.linalg.norm(points[i] - points[j]))
    pair, remedy = f"agents {i + 1} and {j + 1}", "move one of them, gains cannot tell them apart"
    if apart_m == 0.0:
        return f"{pair} stand in one place; {remedy}"
    return (
        f"{pair} are {apart_m:.3g} m apart, under the limit of {limit_m:.3g} m, "
        f"{COINCIDENT:g} of the formation's size; {remedy}"
    )


def _near_misses(formation: Formation) -> list[str]:
    """Warning about a pair that is much nearer than the formation is large: (11) does not see distances either."""
    if formation.size < 3:
        return []
    points = formation.points_enu_m - formation.points_enu_m.mean(axis=0)
    found = scipy.spatial.cKDTree(points).query(points, 2)
    distances, neighbours = np.asarray(found[0])[:, 1], np.asarray(found[1])[:, 1]
    nearest = int(np.argmin(distances))
    apart_m = float(distances[nearest])
    if apart_m >= NEAR * float(np.max(np.abs(points))):
        return []
    i, j = sorted((nearest + 1, int(neighbours[nearest]) + 1))
    return [f"agents {i} and {j} are only {apart_m:.3g} m apart: gains do not keep agents from each other"]


def _refusal(certificate: Certificate, spectral_norm: float, *, stopped: bool) -> tuple[str, bool]:
    """Why blocks have no gains, empty when all have; and whether that is just not known."""
    proven, unknown = [], []
    for label, figures in (("horizontally", certificate.xy), ("vertically", certificate.z)):
        if figures.slowest >= WEAKEST * spectral_norm:
            continue
        if figures.bound < WEAKEST * spectral_norm:
            proven.append(f"{label}, no gains on this graph hold the formation")
        else:
            unknown.append(f"{label} the slowest mode lies between 0 and {figures.bound:.3g} 1/s")
    if proven or not unknown:
        return "; ".join(proven), False
    what = "time ran out" if stopped else "the methods gave up"
    remedy = "allow more time" if stopped else "try another method"
    return f"undecided: {what} before a matrix could be certified; {' and '.join(unknown)}; {remedy}", True


_controller: list[ThreadpoolController] = []


def _one_thread() -> AbstractContextManager[object]:
    """Keeps BLAS on one thread: two on a busy machine were up to 40 times slower."""
    if not _controller:
        _controller.append(ThreadpoolController())
    limited: AbstractContextManager[object] = _controller[0].limit(limits=1, user_api="blas")
    return limited


def evaluator(
    gap: float = 0.02, spectral_norm: float = SPECTRAL_NORM
) -> Callable[[Formation], tuple[float, Certificate | None]]:
    """A quick look at other formations: slowest certified mode, 1/s, 0 where the design is refused."""

    def evaluate(formation: Formation) -> tuple[float, Certificate | None]:
        result = design(formation, gap=gap, spectral_norm=spectral_norm)
        if result.certificate is None or not result.feasible:
            return 0.0, result.certificate
        return -(result.certificate.lambda_max or 0.0), result.certificate

    return evaluate
