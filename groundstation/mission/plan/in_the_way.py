"""Whether the obstacles of a mission leave it room: its pads, its formations wherever they may stand, and its ways.

Where the team will be is expected as moves are judged (``stages``): above the middle of its pads, turned any way, until
a step flies to a place. In flight every move is judged again by where the team is, and the damper has the last word.
"""

from __future__ import annotations

import math

import numpy as np

from groundstation.core.errors import UserError
from groundstation.core.types import FloatArray
from groundstation.mission.plan.plan import MissionPlan

_BEARINGS = 36
_STEP_SHARE, _MOST_STEPS = 0.25, 200
_BY_ROUNDING_M = 1e-6


def check_obstacles(plan: MissionPlan) -> None:
    """Refuses a mission that an obstacle is in the way of.

    Raises:
        UserError: with the key, the distance, the obstacle and the remedy.
    """
    spec, obstacles = plan.spec, plan.obstacles
    names = [given.name for given in spec.obstacles]
    for number, name in enumerate(names):
        if name in names[:number]:
            raise UserError(
                f"{plan.source}: obstacles[{number}].name: {name} is the name of obstacles[{names.index(name)}] too;"
                " give each its own"
            )
    if not len(obstacles):
        return
    top_m = spec.takeoff.height_m + 0.5 * spec.takeoff.stagger_m
    up_m = np.linspace(0.0, top_m, _steps(plan, top_m))[:, None] * [0.0, 0.0, 1.0]
    for number, pad_m in enumerate(plan.pads_enu_m):
        _check(plan, pad_m + up_m, f"vehicles[{number}].pad_m: takeoff and landing", "move the pad")
    _check_steps(plan)


def _check_steps(plan: MissionPlan) -> None:
    """The same of the steps, one after the other."""
    spec = plan.spec
    centre_m = plan.pads_enu_m.mean(axis=0) + np.array([0.0, 0.0, spec.takeoff.height_m])
    from_centre_m, size = plan.pads_enu_m - plan.pads_enu_m.mean(axis=0), 1.0
    for number, step in enumerate(spec.steps):
        points_m = plan.stages[plan.stage_of_step[number]].formation.points_enu_m
        points_m = points_m - points_m.mean(axis=0)
        key = f"steps[{number}].{step.kind}: the team"
        if step.form is not None:
            size, from_centre_m = 1.0, _turned(points_m)
            centre_m[2] = max(centre_m[2], plan.min_altitude_m - float(points_m[:, 2].min()))
            _check(
                plan,
                centre_m + from_centre_m,
                f"{key}, expected above its pads and turned any way,",
                "form it elsewhere",
            )
        elif step.move is not None:
            move = plan.moves[number]
            way_m = float(np.linalg.norm(move.by_enu_m)) + abs(move.scale - 1.0) * float(np.abs(points_m).max())
            for share in np.linspace(0.0, 1.0, _steps(plan, way_m)):
                from_centre_m = size * move.scale**share * _turned(points_m)
                _check(plan, centre_m + share * move.by_enu_m + from_centre_m, key, "move it elsewhere")
            centre_m, size = centre_m + move.by_enu_m, size * move.scale
        elif not step.formed:
            for place_m in plan.places_enu_m[number]:
                for share in np.linspace(0.0, 1.0, _steps(plan, float(np.linalg.norm(place_m - centre_m)))):
                    at_m = centre_m + share * (place_m - centre_m)
                    _check(plan, at_m + from_centre_m, f"{key} on its straight way", "fly round it by waypoints")
                centre_m = place_m.copy()


def _steps(plan: MissionPlan, way_m: float) -> int:
    """So many points of a way are looked at: r is not stepped over."""
    return min(2 + math.ceil(way_m / (_STEP_SHARE * plan.spec.avoidance.radius_m)), _MOST_STEPS)


def _turned(points_m: FloatArray) -> FloatArray:
    """Points about the middle, shape (n, 3), turned about the vertical in all ways, shape (m, 3)."""
    turns = np.exp(2j * np.pi * np.arange(_BEARINGS) / _BEARINGS)
    level = ((points_m[:, 0] + 1j * points_m[:, 1])[:, None] * turns).ravel()
    return np.stack([level.real, level.imag, np.repeat(points_m[:, 2], _BEARINGS)], axis=1)


def _check(plan: MissionPlan, places_m: FloatArray, what: str, remedy: str) -> None:
    distance_m, name, _ = plan.obstacles.nearest(places_m)
    if distance_m < plan.obstacles.keep_m - _BY_ROUNDING_M:
        where = f"{distance_m:.2f} m from" if distance_m > 0.0 else "into"
        raise UserError(
            f"{plan.source}: {what} would come {where} obstacle {name}, minimum is {plan.obstacles.keep_m:.2f} m"
            f" (avoidance.radius_m and what positions and gusts may take); {remedy}, or correct obstacles"
        )
