"""Random teams for the property tests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from hypothesis import strategies as st

from groundstation.core import control, frames
from groundstation.core.types import BoolArray, FloatArray
from groundstation.core.views import LocalViews, local_views


@dataclass(frozen=True)
class Team:
    """Poses and tasks of a random team; attitudes tilted by up to 30 degrees."""

    pos_ned_m: FloatArray
    vel_ned_m_s: FloatArray
    quat: FloatArray
    sensed: BoolArray
    task: control.Task

    @property
    def size(self) -> int:
        return len(self.pos_ned_m)

    @property
    def views(self) -> LocalViews:
        return local_views(self.pos_ned_m, self.vel_ned_m_s, self.quat, self.sensed)


def random_team(seed: int, n: int, spread_m: float = 2.0, *, tilted: bool = True, all_seen: bool = False) -> Team:
    rng = np.random.default_rng(seed)
    tilt = np.radians(30.0) if tilted else 0.0
    roll, pitch = rng.uniform(-tilt, tilt, (2, n)) / np.sqrt(2.0)
    neighbours = np.triu(rng.random((n, n)) < 0.6, 1)
    neighbours = neighbours | neighbours.T
    a = np.triu(rng.normal(0.0, 3.0, (n, n)) + 1j * rng.normal(0.0, 3.0, (n, n)), 1)
    c = np.triu(rng.normal(0.0, 3.0, (n, n)), 1)
    task = control.Task(
        gains_xy=np.where(neighbours, a + np.conj(a.T), 0.0),
        gains_z=np.where(neighbours, c + c.T, 0.0),
        neighbours=neighbours,
        distances_m=np.abs(rng.normal(1.0, 0.3, (n, n))),
        rise_m=rng.normal(0.0, 0.5, (n, n)),
    )
    return Team(
        pos_ned_m=rng.uniform(-spread_m / 2, spread_m / 2, (n, 3)),
        vel_ned_m_s=rng.normal(0.0, 0.4, (n, 3)),
        quat=frames.quat_ned_from_frd_of_euler(roll, pitch, rng.uniform(-np.pi, np.pi, n)),
        sensed=np.ones((n, n), dtype=np.bool_) if all_seen else rng.random((n, n)) < 0.8,
        task=task,
    )


teams = st.builds(random_team, st.integers(0, 2**32 - 1), st.integers(2, 12), st.sampled_from([1.0, 2.0, 5.0]))
level_teams = st.builds(
    lambda seed, n, spread: random_team(seed, n, spread, tilted=False, all_seen=True),
    st.integers(0, 2**32 - 1),
    st.integers(2, 12),
    st.sampled_from([1.0, 2.0, 5.0]),
)
