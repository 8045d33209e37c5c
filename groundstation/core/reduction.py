"""A formation with members missing: the gains of those that are left.

Leaving the neighbours that are gone out of the sum moves the equilibrium: a square with a corner missing does not
stand. Instead the missing agent is kept in the mathematics as if it followed the law perfectly, at rest with respect
to its neighbours: with A split into those that are left (r) and those that are gone (g), the gains become
A_rr - A_rg A_gg^-1 A_gr, the Schur complement. It inherits what matters: zero row sums, the desired formation in the
kernel, and eigenvalues <= 0, so that Theorem 1 holds for the team that is left. Neighbours of a missing agent become
neighbours of each other. Refuses teams of fewer than two.
"""

from __future__ import annotations

import numpy as np

from groundstation.core.control import Task, task_for_roles
from groundstation.core.formation import Formation, Gains
from groundstation.core.types import BoolArray, ComplexArray, IntArray

_RELATIVE_ZERO = 1e-5  # eigenvalues below, relative to the largest, are zeros that the design rounded


def without_roles(formation: Formation, gains: Gains, gone: BoolArray) -> tuple[Formation, Gains, IntArray]:
    """Formation and gains of the roles that are left.

    Args:
        formation: all n roles.
        gains: of all n roles.
        gone: roles that nobody has, shape (n,).

    Returns:
        Formation and gains of the m roles that are left, and which these are, shape (m,).

    Raises:
        ValueError: fewer than two are left.
    """
    left = np.flatnonzero(~gone)
    if len(left) < 2:
        raise ValueError(f"formation {formation.name}: {len(left)} of {formation.size} roles are left, minimum is 2")
    xy, z = _schur(gains.xy, gone), _schur(gains.z.astype(np.complex128), gone)
    joined = formation.adjacency.copy()
    for role in np.flatnonzero(gone):
        around = np.flatnonzero(joined[role])
        joined[np.ix_(around, around)] = True
    np.fill_diagonal(joined, False)
    joined = joined[np.ix_(left, left)]
    edges = tuple((int(i), int(j)) for i, j in zip(*np.nonzero(np.triu(joined)), strict=True))
    smaller = Formation(formation.name, formation.points_enu_m[left], edges)
    return smaller, Gains(xy=xy, z=np.asarray(z.real, dtype=np.float64)), left


def _schur(full: ComplexArray, gone: BoolArray) -> ComplexArray:
    """A_rr - A_rg A_gg^-1 A_gr."""
    left = ~gone
    # Where those that are left have one height, A_gg of the heights is singular: the pseudo-inverse is right there too.
    inverse = np.linalg.pinv(full[np.ix_(gone, gone)], rcond=_RELATIVE_ZERO, hermitian=True)
    return np.asarray(
        full[np.ix_(left, left)] - full[np.ix_(left, gone)] @ inverse @ full[np.ix_(gone, left)], dtype=np.complex128
    )


def task_for_those_left(
    formation: Formation, gains: Gains, role_of_agent: IntArray, gone: BoolArray
) -> tuple[Task, Formation, Gains]:
    """Hands every agent that is left the rows of the reduced gains; those that are gone have no neighbours.

    Args:
        formation: all n roles.
        gains: of all n roles.
        role_of_agent: shape (n,), a permutation; the roles of those that are gone stay open.
        gone: agents that do not fly the formation, shape (n,).

    Returns:
        The task of all n agents, and the formation and gains of the roles that are left.

    Raises:
        ValueError: as ``without_roles``.
    """
    n = formation.size
    open_roles = np.zeros(n, dtype=np.bool_)
    open_roles[role_of_agent[gone]] = True
    smaller, reduced, left = without_roles(formation, gains, open_roles)
    xy, z = np.zeros((n, n), dtype=np.complex128), np.zeros((n, n))
    xy[np.ix_(left, left)], z[np.ix_(left, left)] = reduced.xy, reduced.z
    edges = tuple((int(left[i]), int(left[j])) for i, j in smaller.edges)
    whole = Formation(formation.name, formation.points_enu_m, edges)
    return task_for_roles(whole, Gains(xy=xy, z=z), role_of_agent), smaller, reduced
