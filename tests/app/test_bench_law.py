"""The races of ``gs bench law``: the rivals are what they are said to be, and all race under the same conditions."""

from __future__ import annotations

import numpy as np
import pytest

from groundstation.app import bench_law
from groundstation.app.law_bench.plant import Plant
from groundstation.app.law_bench.rivals import RIVALS, changes_needed
from groundstation.app.output import Output
from groundstation.core.errors import UserError

HORIZON_S, APART_M = 2.0, 0.5


def nearest_m(rel: np.ndarray, vel: np.ndarray) -> float:
    """How near the other comes within the horizon at that relative velocity."""
    when = float(np.clip(rel @ vel / max(float(vel @ vel), 1e-12), 0.0, HORIZON_S))
    return float(np.linalg.norm(rel - when * vel))


def test_orca_asks_for_the_smallest_change_that_keeps_apart() -> None:
    rng = np.random.default_rng(4)
    tried = 0
    for _ in range(1500):
        rel = rng.normal(0.0, 1.0, 3)
        if np.linalg.norm(rel) < 1.05 * APART_M:
            continue
        vel = rng.normal(0.0, 0.8, 3)
        change, normal = changes_needed(rel[None], vel[None], APART_M, HORIZON_S)
        near = nearest_m(rel, vel) < APART_M
        # Outward where they would come too near, inward where there is room to spare.
        assert (change[0] @ normal[0] > 0.0) == near
        assert nearest_m(rel, vel + change[0]) == pytest.approx(APART_M, abs=1e-6)
        if not near:
            continue
        tried += 1
        ways = rng.normal(size=(2000, 3))
        ways *= 0.97 * np.linalg.norm(change) / np.linalg.norm(ways, axis=1, keepdims=True)
        assert all(nearest_m(rel, vel + way) < APART_M for way in ways)
    assert tried > 30


@pytest.fixture(scope="module")
def values() -> dict[str, dict[str, bench_law.Figures]]:
    return bench_law.run(Output(as_json=True), ["tetrahedron4"], ["crazyflie"], starts=["volume"], seeds=1)


def test_everybody_forms(values: dict[str, dict[str, bench_law.Figures]]) -> None:
    (team,) = values.values()
    assert list(team) == list(RIVALS)
    assert all(figures["formed"] == figures["races"] == 1 for figures in team.values())
    assert all(team[name]["below_r"] == 0 for name in ("product", "ORCA", "Voronoi"))


def test_vehicles_whose_response_is_known_form_quicker_and_as_far_apart() -> None:
    shaped = bench_law.run(
        Output(as_json=True), ["cube8"], ["px4_quad"], starts=["volume"], rivals=["product", "not shaped"], seeds=1
    )["cube8 px4_quad volume"]
    product, plain = shaped["product"], shaped["not shaped"]
    assert product["below_r"] == plain["below_r"] == 0
    assert product["formed"] == plain["formed"] == 1
    assert product["median_s"] is not None
    assert plain["median_s"] is not None
    assert product["median_s"] < 0.7 * plain["median_s"]
    # While the last errors die out (0.04 m/s before places were smoothed), and at rest.
    assert product["held_m_s"] is not None
    assert product["rest_m_s"] is not None
    assert product["held_m_s"] < 0.03
    assert product["rest_m_s"] < 0.02


def test_the_same_race_comes_out_the_same(values: dict[str, dict[str, bench_law.Figures]]) -> None:
    again = bench_law.run(
        Output(as_json=True), ["tetrahedron4"], ["crazyflie"], starts=["volume"], rivals=["straight"], seeds=1
    )
    (team,), (other,) = values.values(), again.values()
    assert other["straight"] == team["straight"]


def test_vehicles_answer_after_the_links_delay_and_not_before() -> None:
    starts = np.array([[0.0, 0.0, 3.0], [2.0, 0.0, 3.0]])
    plant = Plant("px4_quad", starts, 0)
    first = plant.see()
    north = np.tile([0.5, 0.0, 0.0], (2, 1))
    smallest = [plant.tell(north).smallest_m for _ in range(200)]
    moved = plant.see()
    assert np.linalg.norm(first.vel_ned_m_s) < 0.1
    assert moved.vel_ned_m_s[:, 0] == pytest.approx(0.5, abs=0.12)
    assert min(smallest) == pytest.approx(2.0, abs=0.05)


def test_level_starts_are_level_and_all_are_apart() -> None:
    formation = bench_law.plan_for("grid27", "crazyflie").formation
    for level in (True, False):
        start = bench_law.random_start(np.random.default_rng(1), formation, level=level)
        offset = np.linalg.norm(start[:, None] - start, axis=2)[np.triu_indices(27, 1)]
        assert offset.min() >= 0.5
        assert (np.ptp(start[:, 2]) == 0.0) == level


def test_unknown_names_are_told() -> None:
    with pytest.raises(UserError, match="did you mean px4_quad"):
        bench_law.run(Output(as_json=True), ["cube8"], ["px4_qud"])
    with pytest.raises(UserError, match="cube9"):
        bench_law.run(Output(as_json=True), ["cube9"], ["crazyflie"])
