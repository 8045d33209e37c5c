"""What gain design says: degenerate shapes, diagnoses, mending edges, suggested graphs."""

from __future__ import annotations

import numpy as np
import pytest

from groundstation.app.resources import packaged_configs
from groundstation.core.errors import UserError
from groundstation.core.formation import Formation
from groundstation.core.types import FloatArray
from groundstation.design.designer import design, evaluator
from groundstation.design.diagnosis import fewest_conceivable, mend, weak_agents, with_edges
from groundstation.design.graphs import suggest
from groundstation.design.problem import Progress, Watch, split
from groundstation.design.store import load_formation

RNG = np.random.default_rng(11)
CLOUD = RNG.normal(size=(8, 3))


def complete(points: FloatArray) -> Formation:
    n = len(points)
    return Formation(
        "shape", np.asarray(points, dtype=np.float64), tuple((i, j) for i in range(n) for j in range(i + 1, n))
    )


def graph(n: int, edges: list[tuple[int, int]], points: FloatArray | None = None) -> Formation:
    return Formation("team", CLOUD[:n] if points is None else points, tuple(sorted(edges)))


LINE = np.arange(5.0)[:, None]


@pytest.mark.parametrize(
    ("points", "zeros", "words"),
    [
        (CLOUD, 6, ()),
        (CLOUD * [1, 1, 0], 5, ("at one height: the formation is held level",)),
        (LINE * [0, 0, 1], 4, ("one vertical line",)),
        (LINE * [1, 2, 0], 5, ("at one height",)),
        (LINE * [1, 2, 3], 6, ("one slanted line", "slope")),
        (CLOUD[:, :2] @ np.array([[1, 0, 1], [0, 1, -1.0]]), 6, ("one slanted plane", "slope")),
        (CLOUD * [1, 0, 1], 6, ("one upright plane",)),
        (CLOUD * [1, 1, 1e-5], 6, ("vertical extent is only", "still counts as shape")),
        (CLOUD[:2], 6, ("two agents side by side", "two agents at different heights")),
        (CLOUD[:2] * [1, 1, 0], 5, ("two agents side by side", "at one height")),
        (np.array([[0.0, 0, 0], [0, 0, 1]]), 4, ("one vertical line", "two agents at different heights")),
        (CLOUD[:3], 6, ("one slanted plane",)),
        (CLOUD[:1], 3, ("one agent",)),
    ],
)
def test_degenerate_shapes_are_designed_by_rank_and_told_in_words(
    points: FloatArray, zeros: int, words: tuple[str, ...]
) -> None:
    result = design(complete(points))
    assert result.feasible, result.reason
    assert result.certificate is not None
    assert result.certificate.zero_eigenvalues == zeros
    assert result.certificate.lambda_max == (None if zeros == 3 * len(points) else pytest.approx(-10.0))
    said = "; ".join(result.notes)
    assert all(word in said for word in words), said
    assert bool(words) == bool(result.notes), said


def test_near_agents_are_told_and_coincident_ones_refused() -> None:
    near = CLOUD.copy()
    near[3] = near[6] + [1e-3, 0, 0]
    assert any("agents 4 and 7 are only 0.001 m apart" in note for note in design(complete(near)).notes)
    near[3] = near[6]
    refused = design(complete(near))
    assert refused.gains is None
    assert "agents 4 and 7 stand in one place" in refused.reason


SQUARE = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]


@pytest.mark.parametrize(
    ("formation", "words"),
    [
        (graph(4, [(0, 1), (2, 3)]), "no edge joins agents 1 and 2 to agents 3 and 4"),
        (graph(2, []), "no edge joins agent 1 to agent 2"),
        (graph(4, [(0, 1), (0, 2), (1, 2), (2, 3)]), "agent 4 has one neighbour, agent 3"),
        (
            graph(7, [*SQUARE, (3, 4), (3, 5), (3, 6), (4, 5), (4, 6), (5, 6)]),
            "agents 1, 2 and 3 hang on the rest by agent 4 alone, a cut vertex",
        ),
        (graph(6, [(0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (0, 5)]), "6 edges leave no freedom for horizontal gains"),
        (
            # two tetrahedra that share a vertical pair
            Formation(
                "hinge",
                np.array([[0, 0, 0.0], [0, 0, 1], [1, 0.2, 0.3], [0.4, 1, 0.8], [-1, 0.1, 0.2], [-0.3, -1, 0.9]]),
                tuple(sorted([(0, 1), *[(i, j) for i in (0, 1) for j in (2, 3, 4, 5)], (2, 3), (4, 5)])),
            ),
            "a separating set that stands one above another",
        ),
    ],
)
def test_diagnosis_names_agents_and_edges(formation: Formation, words: str) -> None:
    result = design(formation)
    assert result.gains is None
    assert words in result.reason


def test_published_graphs_that_join_diagonals_need_one_edge_more() -> None:
    for name in ("twisted_cube8", "parallelepiped8"):
        formation = load_formation(packaged_configs() / "formations" / f"{name}.yaml")
        result = design(formation)
        assert "the 12 edges join the wrong agents" in result.reason
        assert result.certificate is not None
        found = mend(formation, result.certificate, evaluator(gap=0.2))
        assert found is not None
        assert found.fewest
        assert len(found.edges) == 1
        assert design(with_edges(formation, found.edges)).feasible


@pytest.mark.parametrize("kind", ["path", "star", "cycle"])
def test_mending_edges_are_few_and_enough(kind: str) -> None:
    n = 7
    edges = {
        "path": [(i, i + 1) for i in range(n - 1)],
        "star": [(0, i) for i in range(1, n)],
        "cycle": [*[(i, i + 1) for i in range(n - 1)], (0, n - 1)],
    }[kind]
    formation = graph(n, edges)
    result = design(formation)
    assert result.certificate is not None
    found = mend(formation, result.certificate, evaluator(gap=0.2))
    assert found is not None
    assert design(with_edges(formation, found.edges)).feasible
    assert fewest_conceivable(formation) <= len(found.edges) <= fewest_conceivable(formation) + 2
    # none of them is superfluous
    for edge in found.edges:
        rest = [other for other in found.edges if other != edge]
        assert found.fewest or not design(with_edges(formation, rest)).feasible


def test_slowest_mode_points_at_the_weak_agent() -> None:
    formation = load_formation(packaged_configs() / "formations" / "pyramid6.yaml")
    result = design(formation)
    assert result.gains is not None
    agents = weak_agents(split(formation)[0], result.gains.xy)
    assert 1 <= len(agents) < formation.size


def test_suggested_graphs_keep_range_and_degree_and_grow_with_the_wish() -> None:
    points = Formation("cloud", np.random.default_rng(4).uniform(size=(10, 3)) * 3, ())
    found = {
        kind: suggest(points, kind, evaluator(gap=0.05), range_m=2.8, max_degree=7)
        for kind in ("sparse", "balanced", "robust")
    }
    for suggestion in found.values():
        shape = suggestion.formation
        assert shape.adjacency.sum(axis=1).max() <= 7
        assert max(shape.distances_m[i, j] for i, j in shape.edges) <= 2.8
        result = design(shape)
        assert result.feasible, result.reason
        assert result.certificate is not None
        assert -(result.certificate.lambda_max or 0.0) >= suggestion.slowest - 1e-6
        assert [len(row.edges) for row in suggestion.rows] == sorted({len(row.edges) for row in suggestion.rows})
    sizes = [len(found[kind].formation.edges) for kind in ("sparse", "balanced", "robust")]
    assert sizes == sorted(sizes)
    assert found["sparse"].survives_edges is None
    robust = found["robust"]
    assert robust.survives_edges is not None
    if robust.survives_edges:
        for edge in robust.formation.edges:
            rest = tuple(other for other in robust.formation.edges if other != edge)
            assert design(Formation("rest", robust.formation.points_enu_m, rest)).feasible


def test_range_that_is_too_short_is_refused_with_a_remedy() -> None:
    points = Formation("cloud", np.arange(12.0).reshape(4, 3), ())
    with pytest.raises(UserError, match="allow a longer sensing range"):
        suggest(points, "sparse", evaluator(), range_m=1.0)


def test_interrupted_design_keeps_the_best_certified_matrix() -> None:
    formation = complete(np.random.default_rng(8).normal(size=(30, 3)))
    formation = Formation("sparse", formation.points_enu_m, formation.edges[::4])
    full = design(formation, gap=1e-4)
    assert full.certificate is not None
    seen: list[Progress] = []
    cut = design(
        formation,
        gap=1e-9,
        watch=Watch(stop=lambda: any(now.block == "xy" and now.slowest > 0 for now in seen), report=seen.append),
    )
    assert cut.certificate is not None
    assert not cut.finished
    assert 0 < cut.certificate.xy.slowest <= full.certificate.xy.bound
    assert cut.certificate.xy.bound >= full.certificate.xy.slowest
    # intervals only ever close in
    horizontal = [now for now in seen if now.block == "xy"]
    assert all(now.slowest <= now.bound + 1e-9 for now in horizontal)


def test_unknown_methods_and_wrong_ones_are_errors() -> None:
    formation = graph(4, SQUARE[:-1])
    with pytest.raises(ValueError, match="known are auto"):
        design(formation, method="magic")
    with pytest.raises(ValueError, match="complete graph"):
        design(formation, method="closed-form")
