"""Section V and VII of the paper on designed matrices: Theorems 1 and 2, Corollary 1, Proposition 2."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from scipy.spatial.transform import Rotation

from groundstation.app.resources import packaged_configs
from groundstation.core.formation import Formation, Gains
from groundstation.core.types import FloatArray
from groundstation.design.designer import design, evaluator
from groundstation.design.matrices import aggregate, damped_modes
from groundstation.design.robustness import Perturbation, assess, monte_carlo, without_agent, without_edge
from groundstation.design.store import check_gains, load_formation, load_gains

NAMES = ("cube8", "two_squares8_low", "tetrahedron4", "pyramid6", "ring12")


def team(name: str) -> tuple[Formation, Gains]:
    formation = load_formation(packaged_configs() / "formations" / f"{name}.yaml")
    stored = load_gains(packaged_configs() / "gains" / f"{name}.npz")
    check_gains(stored, formation)
    return formation, stored.gains


def shape_error(formation: Formation, q: FloatArray) -> float:
    """Distance of positions from the formation up to its four freedoms, relative to their own size."""
    p, z = formation.points_enu_m[:, 0] + 1j * formation.points_enu_m[:, 1], formation.points_enu_m[:, 2]
    horizontal = np.stack([np.ones_like(p), p], axis=1)
    vertical = np.stack([np.ones_like(z), z], axis=1)
    found = q[:, 0] + 1j * q[:, 1]
    left = found - horizontal @ np.linalg.lstsq(horizontal, found, rcond=None)[0]
    up = q[:, 2] - vertical @ np.linalg.lstsq(vertical, q[:, 2], rcond=None)[0]
    size = max(float(np.linalg.norm(q - q.mean(axis=0))), 1e-12)
    return float(np.linalg.norm(np.concatenate([np.abs(left), up]))) / size


@pytest.mark.parametrize("name", NAMES)
def test_theorem_1_every_start_converges_to_the_formation_up_to_four_freedoms(name: str) -> None:
    formation, gains = team(name)
    matrix = aggregate(gains)
    rng = np.random.default_rng(1)
    slowest = float(-damped_modes(gains)[1].max())
    later = scipy.linalg.expm(matrix * (25.0 / slowest))
    for _ in range(20):
        q = rng.normal(scale=3.0, size=(formation.size, 3))
        assert shape_error(formation, q) > 0.05
        end = (later @ q.ravel()).reshape(-1, 3)
        assert shape_error(formation, end) < 1e-7
        assert np.abs(matrix @ end.ravel()).max() < 1e-6
        assert np.allclose(end.mean(axis=0), q.mean(axis=0)), "the centre stays: A is symmetric with zero row sums"


@pytest.mark.parametrize("name", NAMES)
def test_closed_loop_is_the_control_law_of_equation_2(name: str) -> None:
    """Aggregate matrix, blocks of (3) and the complex form of the stored gains say the same."""
    formation, gains = team(name)
    q = np.random.default_rng(2).normal(size=(formation.size, 3))
    by_matrix = (aggregate(gains) @ q.ravel()).reshape(-1, 3)
    for i in range(formation.size):
        u = np.zeros(3)
        for j in range(formation.size):
            if (min(i, j), max(i, j)) in formation.edges:
                a, b, c = gains.xy[i, j].real, gains.xy[i, j].imag, gains.z[i, j]
                u += np.array([[a, -b, 0], [b, a, 0], [0, 0, c]]) @ (q[j] - q[i])
        assert by_matrix[i] == pytest.approx(u, abs=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_theorem_2_scales_and_rotations_that_switch_never_stop_convergence(name: str) -> None:
    formation, gains = team(name)
    outcome = monte_carlo(formation, gains, np.random.default_rng(5), runs=6)
    assert outcome.converged == outcome.runs
    assert outcome.lyapunov_rises == 0


def test_beyond_ninety_degrees_the_theorem_ends() -> None:
    """The counterpart: rotations of more than 90 degrees drive the team apart, so the test above can fail."""
    _, gains = team("cube8")
    matrix = aggregate(gains)
    turned = np.kron(np.eye(8), Rotation.from_euler("z", 120, degrees=True).as_matrix())
    assert np.linalg.eigvals(turned @ matrix).real.max() > 1.0


@pytest.mark.parametrize("name", ["cube8", "pyramid6"])
def test_corollary_1_saturation_noise_and_tilted_frames(name: str) -> None:
    """(i) saturated inputs, (ii) measurements with noise, (iii) z-axes misaligned by up to 30 degrees, all at once."""
    formation, gains = team(name)
    rng = np.random.default_rng(7)
    n = formation.size
    matrix = aggregate(gains)
    tilts = [Rotation.from_euler("ZX", [rng.uniform(-3, 3), rng.uniform(-0.52, 0.52)]).as_matrix() for _ in range(n)]
    q = rng.normal(scale=2.0, size=(n, 3))
    # measurement in the tilted frame, gains as if it were level, and back: u_i = T' A T (q_j - q_i)
    rows = [scipy.linalg.block_diag(*[tilt] * n) for tilt in tilts]
    tilted = np.concatenate([tilts[i].T @ matrix[3 * i : 3 * i + 3] @ rows[i] for i in range(n)])
    noise = 1e-3
    for _ in range(8000):
        u = (tilted @ q.ravel()).reshape(n, 3) + noise * rng.normal(size=(n, 3))
        speed = np.linalg.norm(u, axis=1, keepdims=True)
        q = q + 0.01 * u * np.minimum(1.0, 0.5 / np.maximum(speed, 1e-12))
    # with every frame tilted differently the equilibrium is no longer exact in the tilt, but the motion dies down
    assert np.abs(tilted @ q.ravel()).max() < 0.02


def fixed_scale_control(formation: Formation, matrix: FloatArray, q: FloatArray) -> FloatArray:
    """Equation (14) with f = 2.5 arctan, all agents, shape (n, 3)."""
    u = (matrix @ q.ravel()).reshape(-1, 3)
    desired = formation.distances_m
    for i, j in formation.edges:
        difference = q[j] - q[i]
        pull = 2.5 * np.arctan(np.linalg.norm(difference) - desired[i, j]) * difference
        u[i] += pull
        u[j] -= pull
    return u


@pytest.mark.parametrize("name", NAMES)
def test_proposition_2_jacobian_is_negative_semidefinite_with_the_right_kernel(name: str) -> None:
    formation, gains = team(name)
    matrix, q0 = aggregate(gains), formation.points_enu_m
    n, step = formation.size, 1e-6
    jacobian = np.zeros((3 * n, 3 * n))
    for k in range(3 * n):
        shift = np.zeros(3 * n)
        shift[k] = step
        up = fixed_scale_control(formation, matrix, q0 + shift.reshape(n, 3))
        down = fixed_scale_control(formation, matrix, q0 - shift.reshape(n, 3))
        jacobian[:, k] = (up - down).ravel() / (2 * step)
    assert np.abs(fixed_scale_control(formation, matrix, q0)).max() < 1e-9
    assert np.allclose(jacobian, jacobian.T, atol=1e-6)
    values = np.linalg.eigvalsh(jacobian)
    # three translations and one rotation about z are left, both scales are held
    assert values.max() < 1e-5
    assert np.sum(values > -1e-4) == 4


@pytest.mark.parametrize("name", ["cube8", "tetrahedron4", "two_squares8_low"])
def test_proposition_2_nearby_starts_converge_to_the_distances(name: str) -> None:
    formation, gains = team(name)
    matrix = aggregate(gains)
    q = formation.points_enu_m + np.random.default_rng(4).normal(scale=0.05, size=(formation.size, 3))
    for _ in range(3000):
        q = q + 0.02 * fixed_scale_control(formation, matrix, q)
    distances = np.linalg.norm(q[:, None] - q[None], axis=2)
    assert np.abs(distances - formation.distances_m).max() < 1e-4


def test_report_tells_losses_with_the_old_gains_and_after_a_new_design() -> None:
    formation, gains = team("two_squares8_low")
    result = design(formation)
    assert result.certificate is not None
    report = assess(formation, gains, result.certificate, evaluator(gap=0.05), rng=np.random.default_rng(1), runs=2)
    assert report.slowest == pytest.approx(5.0, abs=1e-3)
    assert report.condition == pytest.approx(2.0, abs=1e-3)
    assert [loss.what for loss in report.edges][:2] == ["edge 1 to 2", "edge 1 to 4"]
    assert len(report.agents) == 8
    assert report.perturbed.converged == 2
    # a new design for what is left is as good as designing that from scratch
    rest = Formation("rest", formation.points_enu_m, formation.edges[1:])
    again = design(rest)
    assert again.certificate is not None
    assert report.edges[0].redesigned == pytest.approx(-(again.certificate.lambda_max or 0.0), rel=0.06)


def test_lost_edge_that_makes_a_mode_grow_is_told() -> None:
    """Without an edge whose gain pulls, the others may push: growth is the largest eigenvalue, computed here anew."""
    formation, gains = team("two_squares8_low")
    result = design(formation)
    assert result.certificate is not None
    report = assess(formation, gains, result.certificate, lambda _: (0.0, None), rng=np.random.default_rng(1), runs=1)
    grows = 0
    for loss, edge in zip(report.edges, formation.edges, strict=True):
        rest = without_edge(gains, *edge)
        largest = max(np.linalg.eigvals(rest.xy).real.max(), np.linalg.eigvals(rest.z).real.max())
        assert loss.growth == pytest.approx(largest if largest > 1e-6 else 0.0, abs=1e-6)
        grows += largest > 1e-3
    assert grows > 0, "no loss of this formation makes a mode grow, the test shows nothing"


def test_monte_carlo_counts_rises_where_the_theorem_does_not_hold() -> None:
    formation, gains = team("cube8")
    beyond = Perturbation(angle_max_rad=np.pi, scale_min=1.0, scale_max=1.0, dwell_s=0.02)
    assert monte_carlo(formation, gains, np.random.default_rng(5), 1, beyond).lyapunov_rises > 0


def test_losses_are_taken_out_of_both_rows_and_keep_translations() -> None:
    formation, gains = team("cube8")
    i, j = formation.edges[0]
    rest = without_edge(gains, i, j)
    assert rest.xy[i, j] == rest.z[j, i] == 0
    assert np.abs(rest.xy.sum(axis=1)).max() < 1e-12
    fewer = without_agent(gains, 3)
    assert fewer.xy.shape == (7, 7)
    assert np.abs(fewer.z.sum(axis=1)).max() < 1e-12
