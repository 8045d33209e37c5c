"""What gain design says: degenerate shapes, diagnoses, mending edges, suggested graphs."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from groundstation.app.resources import packaged_configs
from groundstation.core.errors import UserError
from groundstation.core.formation import Formation
from groundstation.core.types import FloatArray
from groundstation.design import designer, diagnosis, graphs
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
    near[3] = near[6] + [1e-8, 0, 0]
    refused = design(complete(near))
    assert refused.gains is None
    assert "agents 4 and 7 are 1e-08 m apart, under the limit of" in refused.reason
    assert "stand in one place" not in refused.reason


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


def test_group_that_hangs_by_two_agents_is_named() -> None:
    team = [(i, j) for i in range(6) for j in range(i + 1, 6)]
    refused = design(graph(8, [*team, (0, 6), (6, 7), (1, 7)]))
    assert refused.gains is None
    assert "agents 7 and 8 hang on the rest by agents 1 and 2 alone, a separating pair" in refused.reason
    # one agent with two neighbours is held by them, and so are two with one edge more
    assert design(graph(7, [*team, (0, 6), (1, 6)])).feasible
    held = design(graph(8, [*team, (0, 6), (6, 7), (1, 7), (1, 6)]))
    assert "separating pair" not in held.reason


def test_line_needs_fewer_edges_than_general_position_and_fewest_is_true() -> None:
    """Two pieces of a path on one line: the count for general position would claim three, two do."""
    line = Formation("line", np.arange(10.0)[:, None] * [1.0, 0.5, 0.3], tuple((i, i + 1) for i in range(9) if i != 4))
    result = design(line)
    assert result.certificate is not None
    found = mend(line, result.certificate, evaluator(gap=0.2))
    assert found is not None
    assert (len(found.edges), found.fewest) == (2, True)
    assert fewest_conceivable(line) == 2


def test_regular_polygon_is_held_horizontally_by_its_sides() -> None:
    """Why the count of free numbers is no proof: n edges where general position needs (3n - 3) / 2."""
    turn = np.arange(7) * 2 * np.pi / 7
    ring = Formation(
        "ring",
        np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1),
        tuple(sorted([(0, 6), *((i, i + 1) for i in range(6))])),
    )
    assert design(ring).feasible
    assert fewest_conceivable(ring) == 0


def test_greedy_mend_makes_no_claim_that_was_not_proven() -> None:
    ring = graph(8, [(0, 7), *((i, i + 1) for i in range(7))])
    result = design(ring)
    assert result.certificate is not None
    found = mend(ring, result.certificate, evaluator(gap=0.2), most_designs=5)
    assert found is not None
    assert len(found.edges) > 3
    assert not found.fewest
    assert design(with_edges(ring, found.edges)).feasible


def test_exchange_finds_fewer_edges_than_pruning() -> None:
    """Any one of a few edges mends this pair of teams; what pruning left is replaced by less."""
    ring = graph(8, [(0, 7), *((i, i + 1) for i in range(7))])
    candidates = [(i, j) for i in range(8) for j in range(i + 1, 8) if (i, j) not in ring.edges]
    wanted = {(0, 2), (1, 4), (3, 6)}

    def evaluate(formation: Formation) -> tuple[float, None]:
        return (1.0 if wanted <= set(formation.edges) else 0.0), None

    start = (((0, 2), (0, 4), (1, 4), (2, 7)), 1.0)
    found, slowest = diagnosis._exchange(
        ring, candidates, start, least=1, evaluate=evaluate, most_designs=150, stop=lambda: False
    )
    assert (set(found), slowest) == (wanted, 1.0)


def test_stop_ends_the_search_for_mending_edges() -> None:
    ring = graph(8, [(0, 7), *((i, i + 1) for i in range(7))])
    result = design(ring)
    assert result.certificate is not None
    assert mend(ring, result.certificate, evaluator(gap=0.2), stop=lambda: True) is None


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
    found = mend(formation, result.certificate, evaluator(gap=0.2), most_designs=20)
    assert found is not None
    assert design(with_edges(formation, found.edges)).feasible
    in_general_position = int(np.ceil((3 * n - 3) / 2)) - len(edges)
    assert fewest_conceivable(formation) <= len(found.edges) <= max(in_general_position, 3) + 2
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
    points = Formation("cloud", np.random.default_rng(4).uniform(size=(8, 3)) * 3, ())
    found = {
        kind: suggest(points, kind, evaluator(gap=0.05), range_m=2.8, max_degree=5)
        for kind in ("sparse", "balanced", "robust")
    }
    for suggestion in found.values():
        shape = suggestion.formation
        assert shape.adjacency.sum(axis=1).max() <= 5
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


def test_edges_are_exchanged_for_better_ones_within_range_and_degree() -> None:
    points = Formation("cloud", np.random.default_rng(2).uniform(-2, 2, (8, 3)), ())
    found = suggest(points, "sparse", evaluator(gap=0.05), range_m=4.5, max_degree=5)
    shape = found.formation
    assert found.slowest > 1.5 * found.before > 0.0
    assert shape.adjacency.sum(axis=1).max() <= 5
    assert max(shape.distances_m[i, j] for i, j in shape.edges) <= 4.5
    assert [row.edges for row in found.rows if len(row.edges) == len(shape.edges)] == [shape.edges]
    result = design(shape)
    assert result.certificate is not None
    assert -(result.certificate.lambda_max or 0.0) >= found.slowest - 1e-6


def hub() -> Formation:
    """Seven agents about one, farther from each other than from it: the shortest tree is a star."""
    around = np.array([[1, 0, 0], [-1, 0.1, 0], [0, 1, 0.1], [0.1, -1, 0], [0, 0.1, 1], [0.1, 0, -1], [0.9, 0.9, 0.9]])
    return Formation("hub", np.vstack([[0.0, 0.0, 0.0], around]), ())


def test_degree_limit_holds_where_the_shortest_tree_breaks_it() -> None:
    found = suggest(hub(), "sparse", evaluator(gap=0.05), max_degree=4)
    assert all(max(np.bincount(np.ravel(row.edges))) <= 4 for row in found.rows)
    with pytest.raises(UserError, match="at most 1 neighbours each"):
        suggest(hub(), "sparse", evaluator(gap=0.05), max_degree=1)


def test_robust_without_a_survivor_is_the_one_with_the_best_slowest_mode(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(graphs, "_survives", lambda *_: False)

    def evaluate(formation: Formation) -> tuple[float, None]:
        return (10.0 if len(formation.edges) == 28 else 8.8 - 0.01 * len(formation.edges)), None

    found = suggest(hub(), "robust", evaluate, max_degree=5)
    assert found.survives_edges is False
    assert len(found.rows) > 1
    assert found.slowest == max(row.slowest for row in found.rows)


def test_robust_says_so_when_a_lost_edge_cannot_be_spared() -> None:
    """Three agents need all their three edges."""
    found = suggest(Formation("three", CLOUD[:3], ()), "robust", evaluator(gap=0.05))
    assert found.survives_edges is False
    five = suggest(Formation("five", CLOUD[:5], ()), "robust", evaluator(gap=0.05))
    assert five.survives_edges is True


def test_range_that_is_too_short_is_refused_with_a_remedy() -> None:
    points = Formation("cloud", np.arange(12.0).reshape(4, 3), ())
    with pytest.raises(UserError, match="allow a longer sensing range"):
        suggest(points, "sparse", evaluator(), range_m=1.0)
    with pytest.raises(UserError, match="must be more than 0 m"):
        suggest(points, "sparse", evaluator(), range_m=-1.0)


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


def test_time_that_runs_out_leaves_a_sound_graph_undecided() -> None:
    formation = complete(np.random.default_rng(8).normal(size=(30, 3)))
    formation = Formation("sparse", formation.points_enu_m, formation.edges[::4])
    for looks in range(12):
        left = iter([False] * looks)
        cut = design(formation, watch=Watch(stop=lambda left=left: next(left, True)))  # type: ignore[misc]
        if cut.gains is None:
            assert cut.undecided
            assert cut.reason.startswith("undecided: time ran out before a matrix could be certified")
            assert "no gains on this graph" not in cut.reason
    # a refusal with a proof is none of that
    assert not design(graph(4, [(0, 1), (0, 2), (1, 2), (2, 3)])).undecided


def test_whole_design_comes_before_a_fine_one() -> None:
    """Both blocks are taken to a coarse gap first; from then on a stop finds gains, and the slower block is refined."""
    formation = complete(np.random.default_rng(8).normal(size=(30, 3)))
    formation = Formation("sparse", formation.points_enu_m, formation.edges[::4])
    seen: list[Progress] = []
    design(formation, gap=1e-4, watch=Watch(report=seen.append))
    order = [now.block for now in seen]
    turns = [block for k, block in enumerate(order) if k == 0 or order[k - 1] != block]
    assert turns[:2] == ["z", "xy"]
    first = [now for now in seen[: order.index("xy")] if now.block == "z"]
    assert first[-1].bound - first[-1].slowest > 1e-3 * first[-1].bound, "z is not polished while xy has nothing"
    # what is reported is the best so far, over all methods
    for block in ("xy", "z"):
        own = [now for now in seen if now.block == block]
        assert all(b.slowest >= a.slowest and b.bound <= a.bound for a, b in pairwise(own))


@pytest.mark.parametrize("gap", [1e-2, 1e-4, 1e-6])
def test_finished_means_that_the_certified_gap_is_reached(gap: float) -> None:
    for seed in range(4):
        rng = np.random.default_rng(seed)
        shape = complete(rng.normal(size=(20, 3)))
        edges = tuple(edge for edge in shape.edges if rng.random() < (0.4, 0.5, 0.7, 0.9)[seed])
        result = design(Formation("random", shape.points_enu_m, edges), gap=gap)
        assert result.certificate is not None
        assert result.feasible
        assert result.finished
        assert result.certificate.gap <= gap


def test_gap_beyond_the_one_asked_for_is_not_reached() -> None:
    result = design(graph(4, SQUARE))
    assert result.certificate is not None
    figures = replace(result.certificate.xy, bound=10.0)
    assert designer._reached(replace(figures, slowest=9.9), 0.01, 10.0)
    assert not designer._reached(replace(figures, slowest=9.85), 0.01, 10.0)


def test_unknown_methods_and_wrong_ones_are_errors() -> None:
    formation = graph(4, SQUARE[:-1])
    with pytest.raises(ValueError, match="known are auto"):
        design(formation, method="magic")
    with pytest.raises(ValueError, match="complete graph"):
        design(formation, method="closed-form")
