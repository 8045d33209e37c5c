"""The parts that only large teams need, checked on teams small enough for a second opinion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from groundstation.app.bench_gains import (
    BARS_S,
    Report,
    Timing,
    authors_formulation,
    complete,
    disagreement,
    draw,
    nearest,
    nearly_complete,
    random_graph,
)
from groundstation.app.resources import packaged_configs
from groundstation.core.formation import Formation
from groundstation.design import splitting
from groundstation.design.basis import Basis, DenseBasis, RankOneBasis, edge_basis
from groundstation.design.certify import certify_block, dual_on_non_edges, scale_to_norm
from groundstation.design.designer import METHODS, clean, default_gap, design, suitable_methods
from groundstation.design.interior_point import solve_interior_point
from groundstation.design.problem import Block, Watch, split, zero_solution
from groundstation.design.store import load_formation
from groundstation.design.triangles import triangle_basis, triangles


def interval(block: Block, basis: Basis) -> tuple[float, float]:
    solution = solve_interior_point(block, 1e-6, Watch(), basis)
    gain = -scale_to_norm(block, clean(block, solution.matrix), 10.0)
    figures = certify_block(block, gain, dual_on_non_edges(block, solution.dual))
    assert figures.residual < 1e-9
    return figures.slowest, figures.bound


@pytest.mark.parametrize("seed", [0, 1])
def test_triangles_edges_and_dense_bases_find_the_same_optimum(seed: int) -> None:
    for block in split(nearest(36, 9, seed)):
        dense = interval(block, DenseBasis(block))
        by_triangles = triangle_basis(block)
        assert by_triangles is not None
        assert isinstance(by_triangles, RankOneBasis)
        for other in (interval(block, by_triangles), interval(block, edge_basis(block))):
            assert other == pytest.approx(dense, rel=3e-6)


@pytest.mark.parametrize("neighbours", [6, 7, 8])
def test_chords_and_local_matrices_close_what_triangles_leave_open(neighbours: int) -> None:
    """Sparser graphs have more chordless cycles; whatever the basis, it must span everything or be refused."""
    shape = nearest(40, neighbours, 3)
    for block in split(shape):
        basis = triangle_basis(block)
        if basis is None:
            continue
        rng = np.random.default_rng(0)
        wanted = block.assemble(block.null_space @ rng.normal(size=block.null_space.shape[1]))
        # columns: what each unknown adds on edges and diagonal
        every = np.stack([basis.matrix(row).ravel() for row in np.eye(basis.count)], axis=1)
        parts = np.concatenate([every.real, every.imag]) if block.is_complex else every
        target = np.concatenate([wanted.ravel().real, wanted.ravel().imag]) if block.is_complex else wanted.ravel()
        found, *_ = np.linalg.lstsq(parts, target, rcond=None)
        assert np.abs(parts @ found - target).max() < 1e-8


def test_triangles_are_the_triangles_of_the_graph() -> None:
    shape = Formation(
        "two", np.random.default_rng(1).normal(size=(5, 3)), ((0, 1), (0, 2), (1, 2), (1, 3), (2, 3), (3, 4))
    )
    assert triangles(split(shape)[0]).tolist() == [[0, 1, 2], [1, 2, 3]]


def test_reduction_to_agents_that_miss_an_edge_keeps_the_optimum(monkeypatch: pytest.MonkeyPatch) -> None:
    shape = nearly_complete(24, 5)
    reduced = [splitting.solve_splitting(block, 1e-5, Watch()) for block in split(shape)]
    assert all(splitting.reduction(block).size <= 10 for block in split(shape))
    monkeypatch.setattr(splitting, "reduction", splitting._whole)
    for block, ours in zip(split(shape), reduced, strict=True):
        whole = splitting.solve_splitting(block, 1e-5, Watch())
        slowest = []
        for solution in (ours, whole):
            gain = -scale_to_norm(block, clean(block, solution.matrix), 10.0)
            figures = certify_block(block, gain, dual_on_non_edges(block, solution.dual))
            assert figures.bound - figures.slowest <= 2e-5 * figures.bound
            slowest.append(figures.slowest)
        assert slowest[0] == pytest.approx(slowest[1], rel=3e-5)


@pytest.mark.parametrize(
    ("shape", "method"),
    [
        (complete(150), "closed-form"),
        (nearly_complete(150, 20), "splitting"),
        (nearest(60, 12), "interior-point"),
    ],
)
def test_larger_teams_are_certified_within_the_gap_by_the_method_that_suits(shape: Formation, method: str) -> None:
    assert suitable_methods(split(shape)[0])[0] == method
    result = design(shape)
    assert result.feasible, result.reason
    assert result.finished
    assert result.certificate is not None
    assert result.method == method
    assert result.certificate.gap <= default_gap(shape.size)
    assert result.certificate.zero_eigenvalues == 6


def test_authors_formulation_agrees_with_the_split_problem() -> None:
    shape = load_formation(packaged_configs() / "formations" / "two_squares8_low.yaml")
    assert authors_formulation(shape) == pytest.approx(5.0, abs=1e-3)


def test_bench_compares_methods_on_random_graphs_and_sees_a_difference(monkeypatch: pytest.MonkeyPatch) -> None:
    shapes = [random_graph(seed) for seed in range(40)]
    assert {shape.size for shape in shapes} == set(range(4, 17))
    small = next(shape for shape in shapes if shape.size == 6 and design(shape).feasible)
    assert disagreement(small) < 1e-4
    monkeypatch.setitem(METHODS, "clarabel", lambda block, *_: zero_solution(block))
    assert disagreement(small) == np.inf


def test_bench_draws_time_over_number_of_agents(tmp_path: Path) -> None:
    timings = tuple(Timing(f"nearest12_{n}", "interior-point", n, 6 * n, n**3 / 1e6, 1e-3, 1.0) for n in (50, 100, 200))
    report = Report(
        agreement=1e-6,
        agreement_random=1e-6,
        baseline_s=0.2,
        speedup=40.0,
        timings=timings,
        within={"nearest12_100": True},
    )
    assert set(report.within) <= set(BARS_S)
    path = tmp_path / "bench.png"
    draw(path, report)
    assert path.read_bytes().startswith(b"\x89PNG")
