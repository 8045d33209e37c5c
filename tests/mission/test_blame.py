"""What is said of vehicles that fly on when the mission has ended."""

from __future__ import annotations

import numpy as np

from groundstation.app.resources import packaged_configs
from groundstation.mavlink.vehicle import LANDED_IN_AIR, Fleet
from groundstation.mission.plan.reading import load_mission
from groundstation.mission.reasons.blame import still_flying

LOITER = 4 << 16 | 3 << 24


def test_many_in_the_same_mode_are_told_in_one_line_and_a_few_one_by_one() -> None:
    plan = load_mission(packaged_configs() / "missions" / "cube8.yaml")
    fleet = Fleet([vehicle.id for vehicle in plan.spec.vehicles], plan.link_of_vehicle)
    fleet.custom_mode[:] = LOITER
    fleet.landed_state[:] = LANDED_IN_AIR
    fleet.heartbeat_ns[:] = fleet.heard_ns[:] = 1_000_000_000
    (line,) = still_flying(fleet, plan, np.ones(8, dtype=np.bool_), 1_500_000_000)
    assert line.startswith("vehicles 1, 2, 3, 4, 5, 6, 7, 8 are still in the air, in AUTO.LOITER; ")
    fleet.landed_state[7] = 0
    few = np.arange(8) >= 6
    lines = list(still_flying(fleet, plan, few, 1_500_000_000))
    assert [line.split(";")[0] for line in lines] == [
        "vehicle 7 is still in the air, in AUTO.LOITER",
        "vehicle 8 may still be in the air, in AUTO.LOITER when last told",
    ]
    fleet.landed_state[:] = 0
    (line,) = still_flying(fleet, plan, np.ones(8, dtype=np.bool_), 1_500_000_000)
    assert "8 may still be in the air, in AUTO.LOITER when last told; " in line
