"""What a designed matrix withstands (Section V): losses of edges and agents, and perturbed controls.

Figures, not promises: losses are told twice, with the gains as they are and after a new design; the perturbations of
Theorem 2 are sampled, each sample integrated exactly between switches. All randomness comes from a generator that is
passed in.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from scipy.spatial.transform import Rotation

from groundstation.core.formation import Formation, Gains
from groundstation.core.types import FloatArray
from groundstation.design.certify import Certificate
from groundstation.design.matrices import aggregate, damped_modes

MOST_STEPS = 5000
"""Switches after which a run counts as not converged."""

Evaluate = Callable[[Formation], tuple[float, Certificate | None]]
"""Slowest certified mode, 1/s (0 when infeasible), and the certificate."""


@dataclass(frozen=True)
class Loss:
    """What happens when an edge or an agent is lost.

    Attributes:
        what: ``edge 1 to 2`` or ``agent 3``.
        growth: largest real part of an eigenvalue under the unchanged gains, 1/s; 0 or less means that nothing grows.
        drift: speed at which the unchanged gains pull the formation itself apart, 1/s of its size.
        redesigned: slowest mode of a new design for what is left, 1/s; 0 when there is none.
    """

    what: str
    growth: float
    drift: float
    redesigned: float


@dataclass(frozen=True)
class MonteCarlo:
    """Outcome of random perturbations after Theorem 2.

    Attributes:
        runs: number of runs.
        converged: runs in which what is not formation shrank to a thousandth.
        lyapunov_rises: steps in which V = -q'Aq grew, over all runs; the theorem allows none.
        slowest_time_s: longest time until a run had converged.
    """

    runs: int
    converged: int
    lyapunov_rises: int
    slowest_time_s: float


@dataclass(frozen=True)
class Robustness:
    """The report.

    Attributes:
        slowest: slowest mode, 1/s.
        fastest: fastest mode, 1/s.
        edges: loss of every edge.
        agents: loss of every agent.
        perturbed: Monte-Carlo of Theorem 2.
    """

    slowest: float
    fastest: float
    edges: tuple[Loss, ...]
    agents: tuple[Loss, ...]
    perturbed: MonteCarlo

    @property
    def condition(self) -> float:
        """Ratio of fastest to slowest mode."""
        return self.fastest / self.slowest if self.slowest > 0 else float("inf")


def assess(
    formation: Formation,
    gains: Gains,
    certificate: Certificate,
    evaluate: Evaluate,
    *,
    rng: np.random.Generator,
    runs: int = 20,
) -> Robustness:
    """Puts the whole report together.

    Args:
        formation: points and graph.
        gains: its certified gains.
        certificate: their figures.
        evaluate: designs what is left after a loss.
        rng: source of the perturbations.
        runs: of the Monte-Carlo.

    Returns:
        The report.
    """
    return Robustness(
        slowest=-(certificate.lambda_max or 0.0),
        fastest=-(certificate.lambda_min or 0.0),
        edges=tuple(_edge_loss(formation, gains, edge, evaluate) for edge in formation.edges),
        agents=tuple(_agent_loss(formation, gains, agent, evaluate) for agent in range(formation.size)),
        perturbed=monte_carlo(formation, gains, rng, runs),
    )


def without_edge(gains: Gains, i: int, j: int) -> Gains:
    """Gains after agents i and j, counted from 0, stopped seeing each other."""
    xy, z = gains.xy.copy(), gains.z.copy()
    for matrix in (xy, z):
        matrix[i, i] += matrix[i, j]
        matrix[j, j] += matrix[j, i]
        matrix[i, j] = matrix[j, i] = 0.0
    return Gains(xy=xy, z=z)


def without_agent(gains: Gains, agent: int) -> Gains:
    """Gains of the others after an agent, counted from 0, disappeared."""
    rest = gains
    for other in range(len(gains.z)):
        if other != agent and (gains.xy[agent, other] != 0 or gains.z[agent, other] != 0):
            rest = without_edge(rest, agent, other)
    keep = np.arange(len(gains.z)) != agent
    return Gains(xy=rest.xy[np.ix_(keep, keep)], z=rest.z[np.ix_(keep, keep)])


def _effect(formation: Formation, gains: Gains) -> tuple[float, float]:
    """Growth and drift of a formation under gains that were not designed for it."""
    matrix = aggregate(gains)
    centred = formation.points_enu_m - formation.points_enu_m.mean(axis=0)
    size_m = max(float(np.max(np.linalg.norm(centred, axis=1))), 1e-300)
    drift = float(np.max(np.linalg.norm((matrix @ centred.ravel()).reshape(-1, 3), axis=1))) / size_m
    growth = float(np.max(np.linalg.eigvals(matrix).real))
    return (growth if growth > 1e-6 else 0.0), drift


def _edge_loss(formation: Formation, gains: Gains, edge: tuple[int, int], evaluate: Evaluate) -> Loss:
    growth, drift = _effect(formation, without_edge(gains, *edge))
    rest = tuple(other for other in formation.edges if other != edge)
    slowest, _ = evaluate(Formation(formation.name, formation.points_enu_m, rest))
    return Loss(f"edge {edge[0] + 1} to {edge[1] + 1}", growth, drift, slowest)


def _agent_loss(formation: Formation, gains: Gains, agent: int, evaluate: Evaluate) -> Loss:
    what = f"agent {agent + 1}"
    if formation.size == 1:
        return Loss(what, 0.0, 0.0, 0.0)
    keep = np.arange(formation.size) != agent
    number = np.cumsum(keep) - 1
    edges = tuple((int(number[i]), int(number[j])) for i, j in formation.edges if agent not in (i, j))
    rest = Formation(formation.name, formation.points_enu_m[keep], edges)
    growth, drift = _effect(rest, without_agent(gains, agent))
    slowest, _ = evaluate(rest)
    return Loss(what, growth, drift, slowest)


@dataclass(frozen=True)
class Perturbation:
    """Range of the perturbations of Theorem 2.

    Attributes:
        angle_max_rad: largest rotation of a control vector, below pi / 2.
        scale_min: smallest c_i.
        scale_max: largest c_i.
        dwell_s: time between two switches.
    """

    angle_max_rad: float = float(np.deg2rad(85.0))
    scale_min: float = 0.1
    scale_max: float = 10.0
    dwell_s: float = 0.2

    def draw(self, matrix: FloatArray, rng: np.random.Generator) -> FloatArray:
        """P A of (17) for one draw of scales (logarithmic) and rotations, shape (3n, 3n)."""
        n = len(matrix) // 3
        axes = rng.normal(size=(n, 3))
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        angles = rng.uniform(-self.angle_max_rad, self.angle_max_rad, size=n)
        scales = np.exp(rng.uniform(np.log(self.scale_min), np.log(self.scale_max), size=n))
        turned = Rotation.from_rotvec(axes * angles[:, None]).as_matrix() * scales[:, None, None]
        return np.asarray(np.einsum("nij,njk->nik", turned, matrix.reshape(n, 3, 3 * n)).reshape(3 * n, 3 * n))


def monte_carlo(
    formation: Formation,
    gains: Gains,
    rng: np.random.Generator,
    runs: int,
    perturbation: Perturbation | None = None,
) -> MonteCarlo:
    """Integrates q' = P A q with P = diag(c_i R_i) that switches at random (Theorem 2, Remark 3).

    Args:
        formation: for the size of the random starts.
        gains: certified gains.
        rng: source of starts, axes, angles and scales.
        runs: number of runs.
        perturbation: its range.

    Returns:
        The outcome.
    """
    kind = perturbation or Perturbation()
    matrix = aggregate(gains)
    n = formation.size
    basis, rates = damped_modes(gains)
    size_m = max(float(np.max(np.abs(formation.points_enu_m))), 1.0)
    converged, rises, longest = 0, 0, 0.0
    for _ in range(runs):
        q = rng.normal(scale=size_m, size=3 * n)
        start = float(np.linalg.norm(basis.T @ q)) if len(rates) else 0.0
        energy, step = float(-q @ matrix @ q), 0
        away = start
        while away > 1e-3 * start and step < MOST_STEPS:
            q = scipy.linalg.expm(kind.draw(matrix, rng) * kind.dwell_s) @ q
            now = float(-q @ matrix @ q)
            rises += now > energy + 1e-12 * abs(energy) + 1e-18 * size_m**2
            energy, step = now, step + 1
            away = float(np.linalg.norm(basis.T @ q))
        converged += away <= 1e-3 * start
        longest = max(longest, step * kind.dwell_s)
    return MonteCarlo(runs, converged, int(rises), longest)
