"""The formation control law, equations (2), (3) and (14), on local views.

Each agent multiplies the relative positions of its neighbours with its own row of gains, in its own tilted body
frame, and sums. Nothing here knows where the team is. Refuses gains whose diagonal would be needed (the law uses
differences only) and unknown scale functions.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np

from groundstation.core.formation import Formation, Gains
from groundstation.core.types import BoolArray, ComplexArray, FloatArray, IntArray
from groundstation.core.views import LocalViews

if TYPE_CHECKING:
    import scipy.sparse

ScaleKind = Literal["arctan", "tanh", "free"]


LEAST_RATE_1_S = 1e-6
"""Below this the law moves nobody in the time of a flight: gains that are zero, as those of two agents are that stand
neither level nor one above the other, and a free or an all but free scale."""


_STIFFNESS = 0.6
"""k lambda (tau + delay) of an automatic control gain."""
_TILT_SHARE, _GRAVITY_M_S2 = 0.6, 9.81
SCALE_GAIN_M = 2.5
"""Gain of f times the length of an edge as the authors flew it, m/s: 2.5 1/s on edges of about 1 m (Section VIII)."""


@dataclass(frozen=True)
class ScaleFunction:
    """The map f of equation (14), which holds the formation's size.

    Attributes:
        kind: ``arctan`` or ``tanh`` of the distance error in metres; ``free`` leaves f out, which is equation (2).
        gain: factor 1/k before it, > 0, 1/s. The authors flew arctan with 2.5.
    """

    kind: ScaleKind = "arctan"
    gain: float = 2.5

    def __post_init__(self) -> None:
        """Refuses functions that would not be of the form that Section VII asks for."""
        if self.kind not in ("arctan", "tanh", "free"):
            raise ValueError(f"scale function: kind {self.kind!r} is none of arctan, tanh, free")
        if self.kind != "free" and not 0.0 < self.gain < np.inf:
            raise ValueError(f"scale function: gain is {self.gain}, must be positive and finite")

    def __call__(self, error_m: FloatArray) -> FloatArray:
        """Returns f of d_ij - d*_ij, any shape, in 1/s."""
        if self.kind == "free":
            return np.zeros_like(error_m)
        shape = np.arctan(error_m) if self.kind == "arctan" else np.tanh(error_m)
        return np.asarray(self.gain * shape, dtype=np.float64)


@dataclass(frozen=True)
class Task:
    """What m agents were given before the mission: their rows of gains and of desired distances.

    Attributes:
        gains_xy: a_ij + i b_ij, shape (m, n), 1/s; the diagonal is never used.
        gains_z: c_ij, shape (m, n), 1/s.
        neighbours: j is a neighbour of i in the sensing graph, shape (m, n).
        distances_m: desired distances d*_ij, shape (m, n).
        rise_m: desired heights of j above i, z*_j - z*_i, shape (m, n); used by the upright term alone.
    """

    gains_xy: ComplexArray
    gains_z: FloatArray
    neighbours: BoolArray
    distances_m: FloatArray
    rise_m: FloatArray

    def __post_init__(self) -> None:
        """Refuses rows that do not belong together."""
        shapes = {getattr(self, field.name).shape for field in fields(self)}
        if len(shapes) != 1 or self.neighbours.ndim != 2:
            raise ValueError(f"task: gains, neighbours and distances have shapes {sorted(shapes)}, expected one (m, n)")

    @cached_property
    def near(self) -> tuple[Task, IntArray]:
        """The same of a whole team with columns for neighbours alone, shape (n, k), and who they are, shape (n, k).

        Ascending along each row, filled up with the agent itself, which is no neighbour.
        """
        rows, columns = self.neighbours.nonzero()
        count = np.bincount(rows, minlength=len(self.neighbours))
        place = np.arange(len(rows)) - np.repeat(np.cumsum(count) - count, count)
        everybody = np.arange(len(count))[:, None]
        who = np.repeat(everybody, max(int(count.max(initial=0)), 1), axis=1)
        who[rows, place] = columns
        return Task(
            gains_xy=self.gains_xy[everybody, who],
            gains_z=self.gains_z[everybody, who],
            neighbours=self.neighbours[everybody, who] & (who != everybody),
            distances_m=self.distances_m[everybody, who],
            rise_m=self.rise_m[everybody, who],
        ), who

    def agent(self, index: int) -> Task:
        """Cuts out the rows of one agent: the same thing with m = 1."""
        rows = slice(index, index + 1)
        return Task(
            gains_xy=self.gains_xy[rows],
            gains_z=self.gains_z[rows],
            neighbours=self.neighbours[rows],
            distances_m=self.distances_m[rows],
            rise_m=self.rise_m[rows],
        )


def check_roles(role_of_agent: IntArray, n: int) -> None:
    """Refuses anything but a permutation of the n roles.

    Raises:
        ValueError: a role is missing, given twice or out of range.
    """
    if role_of_agent.shape != (n,) or not np.array_equal(np.sort(role_of_agent), np.arange(n)):
        raise ValueError(f"roles {role_of_agent.tolist()} are no permutation of 0..{n - 1}")


def gains_for_roles(gains: Gains, role_of_agent: IntArray) -> Gains:
    """Reorders gains from roles to agents: entry (i, j) becomes that of the roles of agents i and j.

    Raises:
        ValueError: the roles are no permutation.
    """
    check_roles(role_of_agent, len(gains.z))
    pick = np.ix_(role_of_agent, role_of_agent)
    return Gains(xy=gains.xy[pick], z=gains.z[pick])


def task_for_roles(formation: Formation, gains: Gains, role_of_agent: IntArray) -> Task:
    """Hands every agent the rows that belong to its role; a swap of roles is a new task, never new gains.

    Args:
        formation: n points and the sensing graph, by role.
        gains: blocks of shape (n, n), by role.
        role_of_agent: shape (n,), a permutation.

    Returns:
        The task of all n agents, by agent.

    Raises:
        ValueError: sizes that differ, or roles that are no permutation.
    """
    if len(gains.z) != formation.size:
        raise ValueError(f"gains are for {len(gains.z)} agents, formation {formation.name} has {formation.size}")
    by_agent = gains_for_roles(gains, role_of_agent)
    pick = np.ix_(role_of_agent, role_of_agent)
    height = formation.points_enu_m[role_of_agent, 2]
    return Task(
        gains_xy=by_agent.xy,
        gains_z=by_agent.z,
        neighbours=formation.adjacency[pick],
        distances_m=formation.distances_m[pick],
        rise_m=height[None, :] - height[:, None],
    )


def formation_control(
    views: LocalViews,
    task: Task,
    scale: ScaleFunction,
    control_gain: float = 1.0,
    *,
    lead_s: float = 0.0,
    upright_1_s: float = 0.0,
) -> FloatArray:
    """Computes the desired velocities, equation (14), or (2) with a free scale.

    u_i = k sum over neighbours j of (A_ij + f(d_ij - d*_ij)) q_ij, q_ij the relative position in i's own frame. With
    p = x + iy the block A_ij of equation (3) is a multiplication by a_ij + i b_ij and one by c_ij.

    A neighbour that is not visible is left out of the sum: the agent goes on with the rest. That is the graph with
    one edge fewer, seen from one side: the team still moves, but the formation is no guaranteed equilibrium until the
    neighbour is back. `missing_neighbours` tells, and the mission decides.

    Args:
        views: what m agents see.
        task: their rows of gains and distances, shape (m, n).
        scale: f.
        control_gain: k > 0, multiplies everything (Theorem 2 allows it, lag demands it).
        lead_s: 0 for the paper's law. Above 0, q_ij is replaced by q_ij + lead_s * q_ij': for a vehicle whose
            velocity follows with a first-order lag of lead_s that is where it would come to rest, and it obeys (1)
            exactly, so that k need not pay for the lag (docs/avoidance-why.md). An unknown velocity counts as rest.
        upright_1_s: 0 for the paper's law. Above 0, upright_1_s times (z_ij - z*_ij) is added to the vertical sum. It
            vanishes in the formation and pulls towards it, right side up. Without it a team that starts level stays
            level until noise tips it, and half of the time it then forms upside down, which has all distances
            right. It fixes the vertical scale: leave it out with a free scale.

    Returns:
        Shape (m, 3), body FLU of each agent, m/s, not yet limited.

    Raises:
        ValueError: shapes that differ, or a gain that is not positive.
    """
    if task.neighbours.shape != views.visible.shape:
        raise ValueError(f"task is for {task.neighbours.shape}, views are {views.visible.shape}")
    if not 0.0 < control_gain < np.inf:
        raise ValueError(f"control gain is {control_gain}, must be positive and finite")
    used = task.neighbours & views.visible
    rel = np.where(used[..., None], views.rel_pos_flu_m, 0.0)
    if lead_s > 0.0:
        rel = rel + lead_s * np.where(used[..., None] & np.isfinite(views.rel_vel_flu_m_s), views.rel_vel_flu_m_s, 0.0)
    x, y, z = rel[..., 0], rel[..., 1], rel[..., 2]
    pull = scale(np.sqrt(x * x + y * y + z * z) - task.distances_m)
    along = task.gains_xy.real + pull
    across = task.gains_xy.imag
    vel = np.empty((views.viewers, 3))
    np.add.reduce(along * x - across * y, axis=1, out=vel[:, 0])
    np.add.reduce(across * x + along * y, axis=1, out=vel[:, 1])
    upward = (task.gains_z + pull) * z
    if upright_1_s > 0.0:
        upward = upward + np.where(used, upright_1_s * (z - task.rise_m), 0.0)
    np.add.reduce(upward, axis=1, out=vel[:, 2])
    vel *= control_gain
    return vel


def missing_neighbours(views: LocalViews, task: Task) -> BoolArray:
    """Edges of the sensing graph whose far end is not visible, shape (m, n)."""
    return task.neighbours & ~views.visible


def saturate(vel_m_s: FloatArray, speed_max_m_s: float) -> FloatArray:
    """Shortens velocities to the speed limit, keeping their direction (Corollary 1 (i)); shape (..., 3), any frame.

    Raises:
        ValueError: a limit that is not positive and finite.
    """
    if not 0.0 < speed_max_m_s < np.inf:
        raise ValueError(f"speed limit is {speed_max_m_s} m/s, must be positive and finite")
    x, y, z = vel_m_s[..., 0], vel_m_s[..., 1], vel_m_s[..., 2]
    speed = np.sqrt(x * x + y * y + z * z)
    return vel_m_s * (speed_max_m_s / np.maximum(speed, speed_max_m_s))[..., None]


_DENSE_MAX = 128
"""Agents up to which all eigenvalues are worked out where the largest is wanted; of more, that one alone (Lanczos)."""


def _largest(matrix: scipy.sparse.csr_array[np.float64] | scipy.sparse.csr_array[np.complex128]) -> float:
    """Largest magnitude of an eigenvalue of a Hermitian matrix; the same call gives the same bits."""
    import scipy.sparse.linalg  # noqa: PLC0415 - takes a while to load, and small teams do without

    first = np.random.default_rng(0).normal(size=matrix.shape[0])
    found = scipy.sparse.linalg.eigsh(matrix, 1, v0=first, return_eigenvectors=False)
    return float(np.abs(found[0]))


def largest_rate_1_s(gains: Gains) -> float:
    """The fastest mode of the gains: the largest magnitude of an eigenvalue of A, 1/s (10 as designed)."""
    if len(gains.z) > _DENSE_MAX:
        import scipy.sparse  # noqa: PLC0415 - as above

        return max(_largest(scipy.sparse.csr_array(gains.xy)), _largest(scipy.sparse.csr_array(gains.z)))
    return float(max(np.abs(np.linalg.eigvalsh(gains.xy)).max(), np.abs(np.linalg.eigvalsh(gains.z)).max()))


def stiffest_rate_1_s(formation: Formation, gains: Gains, scale: ScaleFunction, upright_1_s: float = 0.0) -> float:
    """The fastest mode of the closed loop (14) around the formation, f and the upright term included, 1/s.

    Around q* the map f adds -f'(0) d*_ij n n^T per edge, n its direction: 15 for the cube (10 without f), 29 for
    rings16, 157 for a complete graph of 27. Arguments as in `formation_control`, by role.
    """
    n, points, edges = formation.size, formation.points_enu_m, formation.edges
    if n > _DENSE_MAX:
        return _largest(_closed_loop(formation, gains, scale, upright_1_s))
    matrix = np.zeros((3, n, 3, n))  # axis, agent, axis, agent
    matrix[0, :, 0], matrix[1, :, 1], matrix[2, :, 2] = gains.xy.real, gains.xy.real, gains.z
    matrix[0, :, 1], matrix[1, :, 0] = -gains.xy.imag, gains.xy.imag
    slope = 0.0 if scale.kind == "free" else scale.gain
    for i, j in edges:
        away = points[j] - points[i]
        block = slope * np.outer(away, away) / np.sqrt(float(away @ away))
        block[2, 2] += upright_1_s
        for a, b in ((i, j), (j, i)):
            matrix[:, a, :, b] += block
            matrix[:, a, :, a] -= block
    return float(np.abs(np.linalg.eigvalsh(matrix.reshape(3 * n, 3 * n))).max())


def _closed_loop(
    formation: Formation, gains: Gains, scale: ScaleFunction, upright_1_s: float
) -> scipy.sparse.csr_array[np.float64]:
    """The matrix of `stiffest_rate_1_s` by its entries, shape (3 n, 3 n), for a large team."""
    import scipy.sparse  # noqa: PLC0415 - as above

    n, points = formation.size, formation.points_enu_m
    first, second = np.array(formation.edges, dtype=np.int64).reshape(-1, 2).T
    away = points[second] - points[first]
    slope = 0.0 if scale.kind == "free" else scale.gain
    blocks = slope * away[:, :, None] * away[:, None, :] / np.linalg.norm(away, axis=1)[:, None, None]
    blocks[:, 2, 2] += upright_1_s
    rows: list[IntArray] = []
    columns: list[IntArray] = []
    values: list[FloatArray] = []

    def add(axis: int, row: IntArray, other: int, column: IntArray, value: FloatArray) -> None:
        rows.append(axis * n + row)
        columns.append(other * n + column)
        values.append(value)

    for axis in range(3):
        for other in range(3):
            value = blocks[:, axis, other]
            for a, b in ((first, second), (second, first)):
                add(axis, a, other, b, value)
                add(axis, a, other, a, -value)
    row, column = gains.xy.nonzero()
    xy = gains.xy[row, column]
    for axis, other, value in ((0, 0, xy.real), (1, 1, xy.real), (0, 1, -xy.imag), (1, 0, xy.imag)):
        add(axis, row, other, column, value)
    row, column = gains.z.nonzero()
    add(2, row, 2, column, gains.z[row, column])
    where = np.concatenate(rows), np.concatenate(columns)
    return scipy.sparse.coo_array((np.concatenate(values), where), shape=(3 * n, 3 * n)).tocsr()


def rate_for_auto_gain_1_s(formation: Formation, gains: Gains, scale: ScaleFunction, upright_1_s: float = 0.0) -> float:
    """The rate that `auto_control_gain` is to be given: that of the gains, or half of the stiffest mode's if more.

    The rule k lambda_max (tau + delay) = 0.6 was found on the cube, whose f is mild. In graphs with many edges f adds
    up and sets the pace; half of its rate keeps k lambda (tau + delay) at 1.2, a damping of about a half.
    """
    return max(largest_rate_1_s(gains), 0.5 * stiffest_rate_1_s(formation, gains, scale, upright_1_s))


def fitting_scale_gain(formation: Formation, gains: Gains, kind: ScaleKind, upright_1_s: float = 0.0) -> float:
    """The gain of f that suits the size of a formation and the number of its edges, 1/s.

    f pulls the harder the longer an edge is: what the authors flew, 2.5 on edges of 1 m, is 0.3 on edges of 8 m. Over
    many edges f adds up; it is made no stronger than that it doubles the rate of the fastest mode, for beyond that k
    has to pay for it (`rate_for_auto_gain_1_s`).

    Args:
        formation: points and graph, by role.
        gains: by role.
        kind: of f; any gain does for a free scale.
        upright_1_s: as in `formation_control`.
    """
    edges = formation.edges
    points = formation.points_enu_m
    mean_m = sum(float(np.linalg.norm(points[j] - points[i])) for i, j in edges) / max(len(edges), 1)
    by_size = SCALE_GAIN_M / mean_m if mean_m > 0.0 else SCALE_GAIN_M
    if kind == "free":
        return by_size
    without = stiffest_rate_1_s(formation, gains, ScaleFunction("free"), upright_1_s)
    most = 2.0 * max(largest_rate_1_s(gains), without)
    with_f = stiffest_rate_1_s(formation, gains, ScaleFunction(kind, by_size), upright_1_s)
    # The rate of the fastest mode is convex in f's gain: on the straight line between two gains it is never larger.
    return by_size if with_f <= most else by_size * (most - without) / (with_f - without)


def most_for_tilted_views(formation: Formation, gains: Gains, tau_s: float) -> float:
    """The control gain up to which views that tilt with the vehicle do not make it swing.

    Who accelerates by v' leans by v' / g, and sees a neighbour z above it by z v' / g to the side. With A_ij on it the
    law asks for k |sum_j A_ij z_ij| v' / g more, and a lag makes v' = (u - v) / tau of that: a loop of gain
    k |sum_j A_ij z_ij| / (g tau), which delays make swing from 1 on; 0.6 is allowed. At 1.5 the tip of tetrahedron4
    swung by 0.25 m/s without end.

    Args:
        formation: points and graph, by role.
        gains: by role.
        tau_s: lag of the slowest vehicle's velocity loop; without any nobody leans.
    """
    rise_m = formation.points_enu_m[None, :, 2] - formation.points_enu_m[:, None, 2]
    largest_m_s = float(np.abs((np.where(formation.adjacency, gains.xy, 0.0) * rise_m).sum(axis=1)).max())
    return np.inf if tau_s == 0.0 or largest_m_s == 0.0 else _TILT_SHARE * _GRAVITY_M_S2 * tau_s / largest_m_s


def auto_control_gain(lambda_max_1_s: float, tau_s: float, delay_s: float, lead_s: float = 0.0) -> float:
    """The control gain that a lagging vehicle can bear: k lambda_max (tau + delay) = 0.6, at most 1.

    The mode of rate lambda then closes as tau s'' + s' + k lambda s = 0, whose damping 1 / (2 sqrt(k lambda tau)) is
    0.65 or more. With k lambda (tau + delay) = 10 every run oscillated, with 0.5 and 0.6 every run formed.

    Args:
        lambda_max_1_s: `rate_for_auto_gain_1_s`, > 0; for sparse graphs the largest eigenvalue of the gains.
        tau_s: lag of the slowest vehicle's velocity loop, >= 0.
        delay_s: from measurement to effect, the tick of the controller with it, >= 0.
        lead_s: the part of the lag that `formation_control` makes up for.

    Returns:
        k in (0, 1].

    Raises:
        ValueError: a rate below ``LEAST_RATE_1_S``, or a negative time.
    """
    if not lambda_max_1_s >= LEAST_RATE_1_S:
        raise ValueError(
            f"nothing pulls the agents to their places: the fastest mode of gains and scale has {lambda_max_1_s:.2g}"
            f" 1/s, minimum is {LEAST_RATE_1_S:g} 1/s"
        )
    if not (tau_s >= 0.0 and delay_s >= 0.0 and lead_s >= 0.0):
        raise ValueError(f"lag {tau_s} s, delay {delay_s} s and lead {lead_s} s must be numbers, none negative")
    # A quarter of what is made up for is not trusted: the lag is never known exactly, nor is it of first order.
    uncompensated_s = max(tau_s - 0.75 * lead_s, 0.0) + delay_s
    return 1.0 if uncompensated_s == 0.0 else min(1.0, _STIFFNESS / (lambda_max_1_s * uncompensated_s))
