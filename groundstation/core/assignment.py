"""Who flies to which point: the best roles, heading and place of the formation for where the vehicles are.

Minimises the sum of squared distances over permutation, rotation about z and translation together. For given roles
the best rotation and translation are known in closed form, for a given rotation the best roles are an optimal
assignment; the two are alternated from evenly spread headings until nothing changes, and the best end is kept. Each
alternation ends in a local optimum, so the headings in between are then bounded, and halved where the bound leaves
room for something better: the answer is the best there is, to a millionth (branch and bound). Deterministic.

An optimal assignment takes 10 ms for 343 agents and 300 ms for 1,000: above ``PROVEN_MAX`` agents fewer headings are
tried, and the best end of these is the answer.

Only before a formation is formed does anybody know all positions; in flight agents act on their views alone.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from groundstation.core.formation import Formation
from groundstation.core.types import ComplexArray, FloatArray, IntArray

_MAX_ROUNDS = 50
_GAP = 1e-6
"""What a better answer that was missed may be better by, as a share of the spread of positions and points."""

_MOST_HALVED = 400
"""Intervals halved at most: where many headings are equally good, as with a ring, there is nothing more to find."""


PROVEN_MAX = 128
"""Agents up to which the answer is proven to be the best."""

_STARTS_MIN = 4


@dataclass(frozen=True)
class Assignment:
    """Roles, and where the formation would stand for them.

    Attributes:
        role_of_agent: shape (n,), agent a takes role role_of_agent[a].
        yaw_enu_rad: rotation of the formation about z, counterclockwise seen from above, in [-pi, pi].
        translation_team_enu_m: added after the rotation, shape (3,).
        cost_m2: sum of squared distances from the agents to their points.
    """

    role_of_agent: IntArray
    yaw_enu_rad: float
    translation_team_enu_m: FloatArray
    cost_m2: float

    def targets_team_enu_m(self, formation: Formation) -> FloatArray:
        """The points that the agents were assigned to, shape (n, 3), by agent."""
        return place(formation.points_enu_m[self.role_of_agent], self.yaw_enu_rad, self.translation_team_enu_m)


def place(points_enu_m: FloatArray, yaw_enu_rad: float, translation_enu_m: FloatArray) -> FloatArray:
    """Turns points about z and moves them, shape (n, 3)."""
    cos, sin = np.cos(yaw_enu_rad), np.sin(yaw_enu_rad)
    x, y, z = points_enu_m.T
    return np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=1) + translation_enu_m


def assign_roles(pos_team_enu_m: FloatArray, formation: Formation, yaw_starts: int = 36) -> Assignment:
    """Finds the best roles for interchangeable vehicles.

    Args:
        pos_team_enu_m: where the vehicles are, shape (n, 3), ENU (z up, as the formation's points).
        formation: n points.
        yaw_starts: headings tried, >= 1; of more agents than ``PROVEN_MAX`` fewer, four at least.

    Returns:
        The best assignment found; for equal costs the one found first.

    Raises:
        ValueError: another number of vehicles than roles, a non-finite position, or no start.
    """
    pos, points, pos_mean, points_mean = _centred(pos_team_enu_m, formation)
    if yaw_starts < 1:
        raise ValueError(f"assignment: {yaw_starts} headings to start from, must be at least 1")
    search = _Search(pos, points)
    large = formation.size > PROVEN_MAX
    if large:
        yaw_starts = min(yaw_starts, max(_STARTS_MIN, yaw_starts * PROVEN_MAX // formation.size))
    yaws = [2.0 * np.pi * start / yaw_starts for start in range(yaw_starts)]
    values = [search.alternate(yaw) for yaw in yaws]
    if not large:
        search.close_gaps([*yaws, 2.0 * np.pi], [*values, values[0]])
    return _assignment(search.roles, search.yaw_rad, search.cost_m2, pos_mean, points_mean)


class _Search:
    """The search for the best roles and heading of centred positions and points.

    |p - R q|^2 = |p|^2 + |q|^2 - 2 p.Rq: only the last term, the gain, depends on the choice.

    Attributes:
        roles: the best so far.
        yaw_rad: their best heading.
        cost_m2: their sum of squares.
    """

    def __init__(self, pos: FloatArray, points: FloatArray) -> None:
        self.roles: IntArray = np.arange(len(pos))
        self.yaw_rad = 0.0
        self.cost_m2 = np.inf
        self._pos, self._points = pos, points
        self._pos_xy, self._points_xy = pos[:, 0] + 1j * pos[:, 1], points[:, 0] + 1j * points[:, 1]
        self._gain_z = pos[:, 2:3] * points[:, 2]
        self._seen: set[bytes] = set()
        self._size_m2 = float(np.sum(pos**2) + np.sum(points**2))

    def alternate(self, yaw_rad: float) -> float:
        """Goes from a heading to roles, from roles to heading, until nothing changes; returns the start's gain."""
        first, roles = None, None
        for _ in range(_MAX_ROUNDS):
            gain = (np.conj(self._pos_xy)[:, None] * (np.exp(1j * yaw_rad) * self._points_xy)).real + self._gain_z
            agents, new_roles = linear_sum_assignment(gain, maximize=True)
            first = float(gain[agents, new_roles].sum()) if first is None else first
            new_roles = new_roles.astype(np.int64)
            if roles is not None and np.array_equal(new_roles, roles):
                break
            roles = new_roles
            if roles.tobytes() in self._seen:
                break
            self._seen.add(roles.tobytes())
            yaw_rad = _best_yaw(self._pos_xy, self._points_xy[roles])
            cost = _cost(self._pos, self._points[roles], yaw_rad)
            # A gain within rounding is none: keeps the answer independent of the order of equal solutions.
            if cost < self.cost_m2 - 1e-12 * (1.0 + cost):
                self.cost_m2, self.roles, self.yaw_rad = cost, roles, yaw_rad
        return first if first is not None else -np.inf

    def close_gaps(self, yaws: list[float], gains: list[float]) -> None:
        """Halves the intervals between headings until none can hold an answer that is better by the gap.

        For given roles the gain over the heading is S cos(yaw - phi) + Z. Of width 2 h, an interval whose ends reach
        at most G holds at most G + (1 / cos h - 1) min(G - Z, S), for every choice of roles.
        """
        swing = float(np.sort(np.abs(self._pos_xy)) @ np.sort(np.abs(self._points_xy)))  # the largest S there can be
        least_z = float(np.sort(self._pos[:, 2]) @ np.sort(self._points[:, 2])[::-1])

        def bound(low: float, high: float, gain: float) -> float:
            return float(gain + (1.0 / np.cos(0.5 * (high - low)) - 1.0) * min(max(gain - least_z, 0.0), swing))

        heap = [
            (-bound(low, high, max(a, b)), low, high, a, b)
            for low, high, a, b in zip(yaws[:-1], yaws[1:], gains[:-1], gains[1:], strict=True)
            if high - low < 0.5 * np.pi
        ]
        heapq.heapify(heap)
        for _ in range(_MOST_HALVED):
            if not heap or -heap[0][0] <= 0.5 * (self._size_m2 * (1.0 + _GAP) - self.cost_m2):
                return
            _, low, high, a, b = heapq.heappop(heap)
            middle = 0.5 * (low + high)
            m = self.alternate(middle)
            heapq.heappush(heap, (-bound(low, middle, max(a, m)), low, middle, a, m))
            heapq.heappush(heap, (-bound(middle, high, max(m, b)), middle, high, m, b))


def fixed_roles(pos_team_enu_m: FloatArray, formation: Formation, role_of_agent: IntArray) -> Assignment:
    """Best heading and place for roles that are given; arguments, result and errors as in `assign_roles`."""
    pos, points, pos_mean, points_mean = _centred(pos_team_enu_m, formation)
    if not np.array_equal(np.sort(role_of_agent), np.arange(formation.size)):
        raise ValueError(f"roles {role_of_agent.tolist()} are no permutation of 0..{formation.size - 1}")
    chosen = points[role_of_agent]
    yaw = _best_yaw(pos[:, 0] + 1j * pos[:, 1], chosen[:, 0] + 1j * chosen[:, 1])
    return _assignment(np.asarray(role_of_agent, dtype=np.int64), yaw, _cost(pos, chosen, yaw), pos_mean, points_mean)


def _centred(pos_team_enu_m: FloatArray, formation: Formation) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Moves both centroids to the origin, which the best translation makes coincide whatever the rest."""
    if pos_team_enu_m.shape != (formation.size, 3):
        raise ValueError(
            f"assignment: positions have shape {pos_team_enu_m.shape}, formation {formation.name} needs "
            f"({formation.size}, 3)"
        )
    if not np.isfinite(pos_team_enu_m).all():
        raise ValueError("assignment: a position is unknown; wait until every vehicle reports one")
    pos_mean, points_mean = pos_team_enu_m.mean(axis=0), formation.points_enu_m.mean(axis=0)
    return pos_team_enu_m - pos_mean, formation.points_enu_m - points_mean, pos_mean, points_mean


def _best_yaw(pos_xy: ComplexArray, chosen_xy: ComplexArray) -> float:
    """Rotation that brings chosen points nearest to positions; 0 where all rotations are equal."""
    return float(np.angle(np.sum(np.conj(chosen_xy) * pos_xy)))


def _cost(pos: FloatArray, chosen: FloatArray, yaw_rad: float) -> float:
    """Sum of squared distances after the rotation."""
    return float(np.sum((pos - place(chosen, yaw_rad, np.zeros(3))) ** 2))


def _assignment(
    roles: IntArray, yaw_rad: float, cost_m2: float, pos_mean: FloatArray, points_mean: FloatArray
) -> Assignment:
    """Puts the centroids back."""
    translation = pos_mean - place(points_mean[None], yaw_rad, np.zeros(3))[0]
    return Assignment(roles, yaw_rad, translation, cost_m2)
