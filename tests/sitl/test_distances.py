"""Smallest distances of large teams, against all pairs at every step."""

from __future__ import annotations

import numpy as np

from sitl.distances import ALL_PAIRS_MAX, Distances


def test_the_smallest_distance_of_a_large_team_is_that_of_all_pairs_at_all_steps() -> None:
    rng = np.random.default_rng(1)
    n = ALL_PAIRS_MAX + 2
    pos = rng.uniform(0.0, 12.0, (3, n))
    vel = rng.normal(0.0, 0.5, (3, n))
    large = Distances(n)
    assert large.smallest_m() == np.inf
    expected, at = np.inf, (0, 0)
    for step in range(200):
        pos = pos + 0.01 * vel
        airborne = rng.random(n) < (0.0 if step < 5 else 0.5 if step < 100 else 0.9)
        if step > 120:
            airborne[:] = True  # nothing but motion decides then whether it is looked at all
        large.note(pos, airborne)
        apart = np.linalg.norm(pos[:, :, None] - pos[:, None], axis=0)
        apart[~(airborne[:, None] | airborne[None])] = np.inf
        np.fill_diagonal(apart, np.inf)
        if apart.min() < expected:
            expected = float(apart.min())
            at = divmod(int(apart.argmin()), n)
        assert large.smallest_m() == expected if np.isinf(expected) else abs(large.smallest_m() - expected) < 1e-12
    pairs = large.of_pairs_m()
    assert abs(pairs[at] - expected) < 1e-12
    assert pairs.min() == pairs[at] == pairs.T[at]
    large.reset()
    assert np.isinf(large.of_pairs_m()).all()
