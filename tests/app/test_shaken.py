"""PX4's simulator as it comes: velocities that are wrong for seconds, flown all the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from groundstation.app.resources import packaged_configs
from groundstation.mission.plan.reading import load_mission
from groundstation.mission.runner import Phase
from sitl.personalities import NOISES
from sitl.world import WorldConfig
from tests.app.flights import Flight


def test_a_team_with_poor_velocities_completes_its_mission_and_keeps_r() -> None:
    plan = load_mission(packaged_configs() / "missions" / "first_flight2.yaml")

    def shaken(config: WorldConfig) -> WorldConfig:
        vehicles = (replace(item, profile="px4_sih", noise=NOISES["px4_sih"]) for item in config.vehicles)
        return replace(config, vehicles=tuple(vehicles))

    flight = Flight(plan, seed=3, change=shaken)
    assert flight.runner.reason == ""
    assert Phase.HOLD in flight.phase_seen
    told = [note.text for note in flight.notes if note.kind == "alarm" and "its velocity is poor" in note.text]
    assert len(told) == 2
    assert not any("wind of" in note.text for note in flight.notes)  # the air is calm
    assert flight.world.min_distance_airborne_m > plan.spec.avoidance.radius_m
    assert np.isfinite(flight.runner.figures.time_to_form_s)
