"""``gs bench gains``: every method of gain design against the clock and against each other, in one run.

The baseline is the formulation that the paper's authors used: one semidefinite program over the whole 3n x 3n matrix,
as a modelling layer states it, solved with SCS. One BLAS thread throughout, so that ratios travel.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cvxpy
import numpy as np
import scipy.linalg
import scipy.spatial
from rich.table import Table
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from groundstation.app.output import Output
from groundstation.app.picture_style import BLACK, LINE
from groundstation.app.pictures import drawn_by_gs, save_picture
from groundstation.app.resources import packaged_configs
from groundstation.core.formation import Formation
from groundstation.core.own_files import claim
from groundstation.core.types import FloatArray
from groundstation.design.designer import DesignResult, design
from groundstation.design.problem import SPECTRAL_NORM
from groundstation.design.store import load_formation

SMALL = (
    "cube8",
    "tetrahedron4",
    "pyramid5",
    "pyramid6",
    "two_squares8_low",
    "two_squares9",
    "terraces12",
    "ring12",
    "rings16",
)
BARS_S = {
    "nearest12_100": 1.5,
    "nearest12_200": 10.0,
    "nearest12_500": 120.0,
    "nearly_complete_100": 0.2,
    "nearly_complete_1000": 15.0,
    "complete_1000": 0.1,
}
"""Seconds within which each of these is to be certified within 1 %."""


RANDOM_GRAPHS = 200
"""Random graphs on which methods are compared with Clarabel."""

LARGEST_SPLIT = 10
"""Agents up to which splitting takes part in that comparison: on sparse graphs it needs its time for 1e-5."""


@dataclass(frozen=True)
class Timing:
    """One measured design.

    Attributes:
        case: family and size.
        method: what was asked for.
        n: agents.
        edges: their number.
        seconds: best of the repetitions.
        gap: certified relative gap.
        slowest: certified slowest mode, 1/s.
    """

    case: str
    method: str
    n: int
    edges: int
    seconds: float
    gap: float
    slowest: float


def cloud(n: int, seed: int = 0) -> FloatArray:
    """Agents spread evenly at random over a cube, one per cubic metre, shape (n, 3)."""
    return np.asarray(np.random.default_rng(seed).uniform(size=(n, 3)) * np.cbrt(n))


def nearest(n: int, neighbours: int = 12, seed: int = 0) -> Formation:
    """A cloud in which everyone sees its nearest neighbours, and they see back."""
    points = cloud(n, seed)
    _, near = scipy.spatial.cKDTree(points).query(points, neighbours + 1)
    pairs = {(min(i, int(j)), max(i, int(j))) for i in range(n) for j in np.asarray(near)[i, 1:]}
    return Formation(f"nearest{neighbours}_{n}", points, tuple(sorted(pairs)))


def nearly_complete(n: int, missing: int = 50, seed: int = 0) -> Formation:
    """A cloud in which everyone sees everyone, but for some pairs at random."""
    i, j = np.triu_indices(n, 1)
    lost = np.random.default_rng(seed + 1).choice(len(i), missing, replace=False)
    keep = np.ones(len(i), dtype=np.bool_)
    keep[lost] = False
    pairs = tuple(zip(i[keep].tolist(), j[keep].tolist(), strict=True))
    return Formation(f"nearly_complete_{n}", cloud(n, seed), pairs)


def complete(n: int, seed: int = 0) -> Formation:
    """A cloud in which everyone sees everyone."""
    i, j = np.triu_indices(n, 1)
    return Formation(f"complete_{n}", cloud(n, seed), tuple(zip(i.tolist(), j.tolist(), strict=True)))


def authors_formulation(formation: Formation, *, solver: str = "SCS") -> float:
    """Solves (11) over the whole 3n x 3n matrix, as published, with the spectral norm bounded by 10.

    Args:
        formation: points and graph.
        solver: name of a cvxpy solver.

    Returns:
        The objective, 1/s: the slowest mode as the solver sees it.
    """
    n = formation.size
    q = formation.points_enu_m
    turned, flat = q @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]), q * [1, 1, 0]
    kernel = np.concatenate(
        [np.stack([q.ravel(), turned.ravel(), flat.ravel()], axis=1), np.tile(np.eye(3), (n, 1))], 1
    )
    left, _, _ = scipy.linalg.svd(kernel)
    complement = left[:, 6:]
    matrix = cvxpy.Variable((3 * n, 3 * n), symmetric=True)
    constraints = [matrix @ kernel == 0, matrix >> -SPECTRAL_NORM * np.eye(3 * n)]
    neighbours = formation.adjacency
    for i, j in zip(*np.triu_indices(n, 1), strict=True):
        block = matrix[3 * i : 3 * i + 3, 3 * j : 3 * j + 3]
        if neighbours[i, j]:
            constraints += [block[0, 0] == block[1, 1], block[0, 1] == -block[1, 0]]
            constraints += [block[k, m] == 0 for k, m in ((0, 2), (1, 2), (2, 0), (2, 1))]
        else:
            constraints.append(block == 0)
    problem = cvxpy.Problem(cvxpy.Minimize(cvxpy.lambda_max(complement.T @ matrix @ complement)), constraints)
    problem.solve(solver=solver)
    return -float(problem.value)


def measure(formation: Formation, method: str, *, gap: float | None, repeats: int) -> Timing:
    """Designs a formation a few times and keeps the best time."""
    best, result = np.inf, None
    for _ in range(repeats):
        start_ns = time.perf_counter_ns()
        result = design(formation, method=method, gap=gap)
        best = min(best, (time.perf_counter_ns() - start_ns) / 1e9)
    return Timing(formation.name, method, formation.size, len(formation.edges), best, *_figures(result))


def random_graph(seed: int) -> Formation:
    """Four to sixteen agents at random, each pair an edge with a chance between 0.4 and 1."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(4, 17))
    share = rng.uniform(0.4, 1.0)
    edges = tuple((i, j) for i in range(n) for j in range(i + 1, n) if rng.random() < share)
    return Formation(f"random_{seed}", rng.normal(size=(n, 3)), edges)


def disagreement(formation: Formation) -> float:
    """Largest difference from Clarabel of the slowest mode of a block, 1/s; infinite where just one of them refuses.

    Args:
        formation: a small one.

    Returns:
        Over interior-point and auto, and splitting up to ``LARGEST_SPLIT`` agents.
    """
    reference = design(formation, method="clarabel", gap=1e-6)
    worst = 0.0
    methods = ("interior-point", "auto", "splitting") if formation.size <= LARGEST_SPLIT else ("interior-point", "auto")
    for method in methods:
        found = design(formation, method=method, gap=1e-5)
        if found.feasible != reference.feasible:
            return np.inf
        if found.certificate is None or reference.certificate is None:
            continue
        for ours, theirs in (
            (found.certificate.xy.slowest, reference.certificate.xy.slowest),
            (found.certificate.z.slowest, reference.certificate.z.slowest),
        ):
            if np.isfinite(theirs):
                worst = max(worst, abs(max(ours, 0.0) - max(theirs, 0.0)))
    return worst


def _figures(result: DesignResult | None) -> tuple[float, float]:
    if result is None or result.certificate is None or not result.feasible:
        return float("nan"), 0.0
    return result.certificate.gap, -(result.certificate.lambda_max or 0.0)


@dataclass(frozen=True)
class Report:
    """All measures of one run.

    Attributes:
        agreement: largest difference of a method from Clarabel on the small formations, 1/s.
        agreement_random: the same on random graphs; infinite where one found gains and another refused.
        baseline_s: the authors' formulation on two_squares8_low.
        speedup: how many times faster the chosen method is there.
        timings: every measured design.
        within: per bar, whether it was kept.
    """

    agreement: float
    agreement_random: float
    baseline_s: float
    speedup: float
    timings: tuple[Timing, ...]
    within: dict[str, bool]


def run(out: Output) -> dict[str, object]:
    """Runs the whole benchmark, prints its table and draws ``bench-gains.png``; takes some minutes.

    Args:
        out: where to print.

    Returns:
        The measures; the largest sparse graph has 500 agents.
    """
    picture = Path("bench-gains.png")
    claim(picture, "the picture", "another folder to begin in", ours=lambda: drawn_by_gs(picture), force=None)
    with threadpool_limits(limits=1):
        report = measure_all(largest=500, tell=lambda what: out.console.print(what, style="dim"))
    table = Table("case", "method", "edges", "seconds", "gap", "slowest, 1/s", "bar")
    for timing in report.timings:
        bar = ""
        if timing.case in BARS_S:
            bar = f"{BARS_S[timing.case]:g} s {'kept' if report.within[timing.case] else 'MISSED'}"
        figures = [str(timing.edges), f"{timing.seconds:.4f}", f"{timing.gap:.2g}", f"{timing.slowest:.4f}"]
        table.add_row(timing.case, timing.method, *figures, bar)
    out.console.print(table)
    draw(picture, report)
    out.console.print(f"written: {picture}", markup=False)
    return {
        "largest_difference_from_clarabel": report.agreement,
        "random_graphs": RANDOM_GRAPHS,
        "largest_difference_from_clarabel_on_random_graphs": report.agreement_random,
        "baseline_s": report.baseline_s,
        "times_faster_than_baseline": report.speedup,
        "bars_kept": sum(report.within.values()),
        "bars": len(report.within),
        "within": report.within,
        "timings": [vars(timing) for timing in report.timings],
    }


def measure_all(*, largest: int, tell: Callable[[str], None]) -> Report:
    """Measures everything.

    Args:
        largest: sparse graphs up to this many agents; 500 takes minutes.
        tell: told what is being measured.

    Returns:
        The report.
    """
    formations = packaged_configs() / "formations"
    agreement = 0.0
    timings: list[Timing] = []
    for name in SMALL:
        tell(f"all methods on {name}")
        shape = load_formation(formations / f"{name}.yaml")
        reference = measure(shape, "clarabel", gap=1e-6, repeats=1)
        for method in ("interior-point", "splitting", "auto"):
            found = measure(shape, method, gap=1e-5, repeats=1)
            agreement = max(agreement, abs(found.slowest - reference.slowest))
    tell(f"methods against Clarabel on {RANDOM_GRAPHS} random graphs")
    agreement_random = max(disagreement(random_graph(seed)) for seed in range(RANDOM_GRAPHS))
    tell("two_squares8_low against the authors' formulation")
    shape = load_formation(formations / "two_squares8_low.yaml")
    baseline_s = np.inf
    for _ in range(4):  # the first call pays for imports and caches
        start_ns = time.perf_counter_ns()
        authors_formulation(shape)
        baseline_s = min(baseline_s, (time.perf_counter_ns() - start_ns) / 1e9)
    ours = measure(shape, "auto", gap=None, repeats=20)
    timings.append(ours)
    cases = [(nearest(n), "interior-point") for n in (16, 24, 50, 100, 200, 300, 500) if n <= largest]
    cases += [(nearest(n), "splitting") for n in (16, 24, 50) if n <= largest]
    cases += [(nearest(n, 6), "clarabel") for n in (8, 12, 16)]
    cases += [(nearly_complete(n, min(50, n)), "splitting") for n in (16, 24, 50, 100, 200, 500, 1000)]
    cases += [(complete(n), "closed-form") for n in (8, 16, 50, 100, 200, 500, 1000)]
    for formation, method in cases:
        tell(f"{method} on {formation.name}")
        repeats = 3 if formation.size <= 100 or method == "closed-form" else 1
        timings.append(measure(formation, method, gap=1e-2, repeats=repeats))
    within = {
        timing.case: timing.seconds <= BARS_S[timing.case] and timing.gap <= 1e-2
        for timing in timings
        if timing.case in BARS_S
    }
    return Report(agreement, agreement_random, baseline_s, baseline_s / ours.seconds, tuple(timings), within)


def draw(path: Path, report: Report) -> None:
    """Draws time over number of agents for each method and family."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - slow to load, and only wanted with a picture

    figure = Figure(figsize=(8, 5.5), layout="constrained")
    plane = figure.add_subplot()
    families: dict[str, list[Timing]] = {}
    for timing in report.timings:
        family = timing.case.rsplit("_", 1)[0].replace("_", " ")
        if timing.method != "auto":
            families.setdefault(f"{timing.method}, {family}", []).append(timing)
    for marker, (label, rows) in zip("osD^vP", families.items(), strict=False):
        plane.loglog([row.n for row in rows], [row.seconds for row in rows], marker=marker, label=label)
    plane.loglog([8], [report.baseline_s], marker="x", linestyle="", color=BLACK, label="authors' formulation, SCS")
    plane.set_xlabel("agents")
    plane.set_ylabel("time to a certified gap of 1 %, s")
    plane.grid(visible=True, which="major", color=LINE, linewidth=0.6)
    plane.spines[["top", "right"]].set_visible(False)
    plane.legend(frameon=False)
    save_picture(figure, path, 140)
