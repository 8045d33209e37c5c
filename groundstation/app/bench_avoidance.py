"""How fast avoidance is: all pairs against a search for those near, spheres against other shapes, by size of the team.

Crowded grids with 1 m between neighbours, everybody on the move; Algorithm 2 and the damper as a mission flies them.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import numpy as np

from groundstation.app.output import Output
from groundstation.core import frames
from groundstation.core.avoidance import avoid
from groundstation.core.damper import DamperParams, damp
from groundstation.core.near import near_views
from groundstation.core.regions import build_region
from groundstation.core.types import FloatArray
from groundstation.core.views import LocalViews, local_views

_SIZES = (8, 64, 500, 2000)
_SHAPES = ("sphere", "ellipsoid", "cylinder")
_PERIOD_S = 0.02


def run(out: Output) -> dict[str, float | int]:
    """Measures and returns the figures; medians over several rounds. About half a minute."""
    del out
    values: dict[str, float | int] = {}
    for n in _SIZES:
        team = _Crowd(n)
        rounds = 3 if n > 100 else 31
        everybody = _seconds(lambda crowd=team: crowd.steer(crowd.all_pairs(), "sphere"), rounds)  # type: ignore[misc]
        near = {
            shape: _seconds(lambda crowd=team, name=shape: crowd.steer(crowd.near(), name), rounds)  # type: ignore[misc]
            for shape in _SHAPES
        }
        values[f"n{n}_all_pairs_over_search"] = everybody / near["sphere"]
        values[f"n{n}_search_over_period"] = near["sphere"] / _PERIOD_S
        for shape in _SHAPES[1:]:
            values[f"n{n}_{shape}_over_sphere"] = near[shape] / near["sphere"]
        values[f"n{n}_near_most"] = team.near().team_size
    return values


class _Crowd:
    """A team on a grid, with what it wants."""

    def __init__(self, n: int) -> None:
        rng = np.random.default_rng(n)
        side = int(np.ceil(np.cbrt(n) - 1e-9))
        cells = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)[:n]
        self.pos = cells + rng.uniform(-0.2, 0.2, (n, 3))
        self.vel = rng.normal(0.0, 0.2, (n, 3))
        self.wanted = rng.normal(0.0, 0.3, (n, 3))
        roll, pitch = rng.normal(0.0, 0.1, (2, n))
        self.quat = frames.quat_ned_from_frd_of_euler(roll, pitch, rng.uniform(-np.pi, np.pi, n))
        self.params = {
            shape: DamperParams(0.45, 0.04, 0.2, 0.05, _PERIOD_S, 0.5, 4.0, build_region(shape, 0.45, 0.75, 0.6))
            for shape in _SHAPES
        }
        sphere = self.params["sphere"]
        closing_m = 2.0 * sphere.speed_limit_m_s * (1.0 / sphere.rate_1_s + sphere.horizon_s)
        self.reach_m = sphere.keep_out.reach_m(closing_m)

    def all_pairs(self) -> LocalViews:
        offset: FloatArray = self.pos[None] - self.pos[:, None]
        near = np.asarray(np.einsum("ijk,ijk->ij", offset, offset) < self.reach_m**2, dtype=np.bool_)
        return local_views(self.pos, self.vel, self.quat, near)

    def near(self) -> LocalViews:
        return near_views(self.pos, self.vel, self.quat, self.reach_m).views

    def steer(self, views: LocalViews, shape: str) -> None:
        params = self.params[shape]
        damp(views, avoid(views, self.wanted, params.keep_out).vel_flu_m_s, params)


def _seconds(act: Callable[[], object], rounds: int) -> float:
    act()
    taken = []
    for _ in range(rounds):
        start = time.perf_counter()
        act()
        taken.append(time.perf_counter() - start)
    return statistics.median(taken)
