"""Each answer is a certified matrix or a refusal with the right reason, whatever comes in.

`make test` runs a sample; all thousand inputs with: GS_RANDOM_TEAMS=1000 pytest tests/design/test_never_wrong.py
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse.csgraph
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from groundstation.core.formation import Formation
from groundstation.core.types import BoolArray, FloatArray
from groundstation.design.certify import certify, faults
from groundstation.design.designer import DesignResult, design
from groundstation.design.matrices import aggregate
from groundstation.design.problem import split
from groundstation.design.store import check_gains, load_gains, save_gains
from tests.design.random_teams import random_team

COUNT = int(os.environ.get("GS_RANDOM_TEAMS", "240"))
BATCH = 40


def kernel_of(points: FloatArray) -> FloatArray:
    """N of Section IV: translations, horizontal scale and turn, vertical scale; columns in units of the size."""
    n = len(points)
    centred = points - points.mean(axis=0)
    centred = centred / np.abs(centred).max()
    columns = np.zeros((n, 3, 6))
    columns[:, [0, 1, 2], [0, 1, 2]] = 1.0
    columns[:, 0, 3], columns[:, 1, 3] = centred[:, 0], centred[:, 1]
    columns[:, 0, 4], columns[:, 1, 4] = -centred[:, 1], centred[:, 0]
    columns[:, 2, 5] = centred[:, 2]
    return columns.reshape(3 * n, 6)


def check_matrix(formation: Formation, result: DesignResult) -> None:
    """Theorem 1, spelled out on the 3n x 3n matrix with nothing of the package but the layout of (7)."""
    assert result.gains is not None
    matrix = aggregate(result.gains)
    assert np.array_equal(matrix, matrix.T)
    n = formation.size
    blocks = matrix.reshape(n, 3, n, 3).transpose(0, 2, 1, 3)
    for i in range(n):
        for j in range(n):
            a, b, c = blocks[i, j, 0, 0], blocks[i, j, 1, 0], blocks[i, j, 2, 2]
            assert np.array_equal(blocks[i, j], [[a, -b, 0], [b, a, 0], [0, 0, c]])
            assert i == j or (min(i, j), max(i, j)) in formation.edges or not blocks[i, j].any()
    kernel = kernel_of(formation.points_enu_m)
    assert np.abs(matrix @ kernel).max() < 1e-7
    lengths = np.linalg.norm(kernel, axis=0)
    # the kernel's directions, each to its own length: a spread of 1e-9 is a direction as good as any other
    rank = np.linalg.matrix_rank(kernel[:, lengths > 1e-10] / lengths[lengths > 1e-10], tol=1e-6)
    values = np.linalg.eigvalsh(matrix)
    assert values.max() < 1e-7
    assert np.sum(values > -5e-6) == rank, "an eigenvalue is missing, or one too many is zero"
    if rank < 3 * n:
        assert values.min() == pytest.approx(-10.0, abs=1e-6)


def connected(adjacency: BoolArray) -> bool:
    return bool(scipy.sparse.csgraph.connected_components(adjacency, directed=False)[0] == 1)


def check_refusal(formation: Formation, result: DesignResult) -> None:
    """The reason is true, and where a solver can say so, there really is no design."""
    reason, adjacency = result.reason, formation.adjacency
    points = formation.points_enu_m
    if "stand in one place" in reason or "under the limit" in reason:
        distances = np.where(np.eye(formation.size, dtype=bool), np.inf, formation.distances_m)
        assert distances.min() <= 2e-6 * np.abs(points - points.mean(axis=0)).max()
        return
    assert ("no edge joins" in reason) == (not connected(adjacency))
    if result.certificate is None:
        return
    # the dual matrix proves it: no better matrix than next to nothing
    assert min(result.certificate.xy.bound, result.certificate.z.bound) < 1e-5
    for agent, neighbours in enumerate(adjacency.sum(axis=1), start=1):
        if f"agent {agent} has one neighbour" in reason:
            assert neighbours == 1
    if "a cut vertex" in reason:
        centre = int(reason.split(" alone, a cut vertex")[0].rsplit("agent ", 1)[1]) - 1
        keep = np.arange(formation.size) != centre
        assert not connected(adjacency[np.ix_(keep, keep)])
    if formation.size <= 9:
        reference = design(formation, method="clarabel")
        assert reference.gains is None


@pytest.mark.parametrize("batch", range((COUNT + BATCH - 1) // BATCH))
def test_random_inputs_are_certified_or_refused_for_the_right_reason(batch: int) -> None:
    certified = 0
    for seed in range(batch * BATCH, min((batch + 1) * BATCH, COUNT)):
        formation = random_team(seed)
        result = design(formation)
        assert not result.undecided, f"{formation.name}: {result.reason}"
        if result.feasible:
            check_matrix(formation, result)
            certified += 1
        else:
            assert result.reason, formation.name
            check_refusal(formation, result)
    assert 0 < certified < BATCH, "the sample exercised only one kind of answer"


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize=True)
@given(
    n=st.integers(2, 10),
    seed=st.integers(0, 2**32 - 1),
    share=st.floats(0.4, 1.0),
)
def test_all_methods_agree_with_clarabel_on_random_graphs(n: int, seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    pairs = [(i, j) for i in range(n) for j in range(i + 1, n)]
    edges = tuple(pair for pair in pairs if rng.random() < share)
    formation = Formation("random", rng.normal(size=(n, 3)), edges)
    reference = design(formation, method="clarabel")
    for method in ("auto", "interior-point", "splitting"):
        result = design(formation, method=method, gap=1e-5)
        assert result.feasible == reference.feasible, (result.reason, reference.reason)
        if result.certificate is None or reference.certificate is None:
            continue
        for ours, theirs in (
            (result.certificate.xy, reference.certificate.xy),
            (result.certificate.z, reference.certificate.z),
        ):
            if np.isfinite(theirs.slowest):
                assert max(ours.slowest, 0.0) == pytest.approx(max(theirs.slowest, 0.0), abs=1e-4)
                # each proves what the other reaches
                assert ours.bound >= theirs.slowest - 1e-7
                assert theirs.bound >= ours.slowest - 1e-7


@pytest.mark.parametrize("seed", range(20))
def test_what_is_stored_is_sound_and_what_is_not_cannot_be_stored(seed: int, tmp_path: Path) -> None:
    formation = random_team(seed, largest=10)
    result = design(formation)
    path = tmp_path / "team.npz"
    if result.gains is None or result.certificate is None:
        return
    save_gains(path, formation, result.gains, result.certificate, result.method)
    again = check_gains(load_gains(path), formation)
    assert again.interval == pytest.approx(result.certificate.interval, rel=1e-12)
    assert not faults(formation, result.gains, again)


@pytest.mark.parametrize("seed", range(12))
def test_bound_holds_for_any_dual_matrix(seed: int) -> None:
    """A bound may be poor, but never wrong: random dual matrices never undercut the optimum."""
    rng = np.random.default_rng(seed)
    formation = random_team(seed + 500, largest=9)
    result = design(formation)
    if result.gains is None or result.certificate is None:
        return
    n = formation.size
    draw = rng.normal(size=(n, n)) + 1j * rng.normal(size=(n, n))
    for scale in (1e-6, 1.0):
        disturbed = result.certificate.xy.dual + scale * draw
        figures = certify(formation, result.gains, disturbed, result.certificate.z.dual)
        assert figures.xy.bound >= result.certificate.xy.slowest - 1e-9


@given(angle=st.floats(-3.0, 3.0), scale=st.floats(0.01, 100.0), seed=st.integers(0, 1000))
@settings(max_examples=25, deadline=None, derandomize=True)
def test_optimum_does_not_depend_on_heading_place_scale_and_numbering(angle: float, scale: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 7
    points = rng.normal(size=(n, 3))
    edges = [(i, j) for i in range(n) for j in range(i + 1, n) if rng.random() < 0.85]
    cos, sin = np.cos(angle), np.sin(angle)
    moved = scale * points @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]) + rng.normal(size=3)
    order = rng.permutation(n)
    place = np.argsort(order)
    renamed = tuple(sorted((min(place[i], place[j]), max(place[i], place[j])) for i, j in edges))
    one = design(Formation("one", points, tuple(edges)))
    other = design(Formation("other", moved[order], tuple((int(i), int(j)) for i, j in renamed)))
    assert one.feasible == other.feasible
    if one.certificate is not None and other.certificate is not None and one.feasible:
        assert one.certificate.interval == pytest.approx(other.certificate.interval, rel=1e-5)


def test_kernel_dimension_follows_the_numerical_rank() -> None:
    rng = np.random.default_rng(3)
    general = rng.normal(size=(6, 3))
    level, upright = general * [1, 1, 0], np.outer(np.arange(6.0), [0, 0, 1])
    for points, xy_rank, z_rank in ((general, 2, 2), (level, 2, 1), (upright, 1, 2), (level + 1e4, 2, 1)):
        xy, z = split(Formation("shape", points, ()))
        assert (xy.kernel.shape[1], z.kernel.shape[1]) == (xy_rank, z_rank)
