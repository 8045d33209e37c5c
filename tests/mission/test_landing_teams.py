"""Random teams, random orders to land: nobody obedient below r of anybody known, everybody down or said why not.

Teams of two to five: some stand already, some hover in layers above each other, some are lost or follow nobody; fences
from narrow to wide. Vehicles are lags (``landing_team``), guidance and landing are the real ones.
"""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pytest

from groundstation.mission.plan.plan import MissionPlan
from tests.app.flights import cube8
from tests.mission.landing_team import Flown, LandingTeam

RADIUS_M = 0.45
POINTS = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.5], [0.5, 0.5, 1.2]]
ROOM_M = [0.8, 1.2, 3.0]


@cache
def plan_of(count: int, half_m: float, folder: str) -> MissionPlan:
    """A mission of so many vehicles inside a fence of so many metres around the middle of their pads."""
    pads = [[k % 2, k // 2, 0.0] for k in range(4)]
    pads.append([0.5, 0.5, 0.0])
    vehicles = [{"id": k + 1, "link": "udpin://127.0.0.1:14540", "pad_m": pad} for k, pad in enumerate(pads[:count])]
    file = f"{folder}/team{count}.yaml"
    with open(file, "w", encoding="utf-8") as stream:
        stream.write(json.dumps({"name": f"team{count}", "points": POINTS[:count], "edges": "complete"}))
    return cube8(
        f"formation={file}",
        "gains=null",
        f"vehicles={json.dumps(vehicles)}",
        "rate_hz=20",
        "failsafe.action=hold",
        "steps=[{form: {tolerance_m: 0.1, timeout_s: 60}}]",
        f"fence.min_m=[{0.5 - half_m}, {0.5 - half_m}, 0]",
        f"fence.max_m=[{0.5 + half_m}, {0.5 + half_m}, 3.5]",
    )


def fly(seed: int, folder: str) -> Flown:
    """One random team."""
    rng = np.random.default_rng(seed)
    count, half_m = int(rng.integers(2, 6)), float(rng.choice(ROOM_M))
    plan = plan_of(count, half_m, folder)
    while True:
        spread_m = float(rng.choice([0.2, 0.6, half_m]))
        heights_m = rng.choice([0.0, 0.7, 1.3, 1.9, 2.5], count)
        middle_m = 0.5 + rng.uniform(-1.0, 1.0, 2) * (half_m - min(spread_m, half_m))
        places = np.clip(middle_m + spread_m * rng.uniform(-1.0, 1.0, (count, 2)), 0.5 - half_m, 0.5 + half_m)
        pos_enu_m = np.column_stack([places, heights_m])
        apart_m = np.linalg.norm(pos_enu_m[:, None] - pos_enu_m[None], axis=2)[~np.eye(count, dtype=bool)]
        if apart_m.min() > 0.55 and heights_m.any():
            break
    team = LandingTeam(plan, pos_enu_m, lost=rng.random(count) < 0.12, loose=rng.random(count) < 0.12)
    kind = int(rng.integers(3))
    if kind == 0:
        return team.fly({float(rng.uniform(0.0, 3.0)): []}, np.inf, 120.0)
    orders = {float(rng.uniform(0.0, 8.0)): [int(rng.integers(count))] for _ in range(kind)}
    return team.fly(orders, float(rng.choice([0.0, 2.0, 6.0, 15.0])), 120.0)


@pytest.mark.parametrize("seed", range(12))
def test_nobody_lands_on_anybody_and_everybody_comes_down_or_says_why_not(
    seed: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    flown = fly(seed, str(tmp_path_factory.getbasetemp()))
    assert flown.nearest_m >= RADIUS_M, flown
    waiting = {
        vehicle for vehicle in flown.up if any(f"vehicle {vehicle + 1}: no place" in text for text in flown.news)
    }
    assert set(flown.up) == waiting, flown
