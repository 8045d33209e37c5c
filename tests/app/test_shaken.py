"""PX4's simulator as it comes: velocities that are wrong for seconds, flown all the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from groundstation.app.resources import packaged_configs
from groundstation.core.types import FloatArray
from groundstation.mission.monitors.board import Board
from groundstation.mission.monitors.findings import Findings, Sight
from groundstation.mission.plan.reading import load_mission
from groundstation.mission.runner import Phase
from sitl.personalities import NOISES
from sitl.world import WorldConfig
from tests.app.flights import Flight

AUTO_LAND = 6 << 24 | 4 << 16


def test_a_team_with_poor_velocities_completes_its_mission_and_keeps_r(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[FloatArray] = []
    look = Board.look

    def looked(board: Board, sight: Sight, *, only_the_ground: bool = False) -> Findings:
        assert np.array_equal(sight.vel_error_ned_m_s, board.speeds.known_error_ned_m_s)
        seen.append(sight.vel_error_ned_m_s)
        return look(board, sight, only_the_ground=only_the_ground)

    monkeypatch.setattr(Board, "look", looked)
    plan = load_mission(packaged_configs() / "missions" / "first_flight2.yaml")

    def shaken(config: WorldConfig) -> WorldConfig:
        vehicles = (replace(item, profile="px4_sih", noise=NOISES["px4_sih"]) for item in config.vehicles)
        return replace(config, vehicles=tuple(vehicles))

    heights_m: dict[int, float] = {}

    def low(flight: Flight) -> bool:
        """Notes how high everybody was when told to land; breaks nothing off."""
        for row in np.flatnonzero(flight.runner.fleet.custom_mode == AUTO_LAND).tolist():
            heights_m.setdefault(row, float(flight.world.truth.pos_enu_m[row, 2]))
        return False

    flight = Flight(plan, seed=3, change=shaken, interrupt_when=low)
    assert flight.runner.reason == ""
    assert max(float(np.abs(error).max()) for error in seen) > 0.1  # what is known of it, monitors reckon with
    assert Phase.HOLD in flight.phase_seen
    told = [note.text for note in flight.notes if note.kind == "alarm" and "its velocity is poor" in note.text]
    assert len(told) == 2
    assert not any("wind of" in note.text for note in flight.notes)  # the air is calm
    assert flight.world.min_distance_airborne_m > plan.spec.avoidance.radius_m
    assert np.isfinite(flight.runner.figures.time_to_form_s)
    swayed = "formed while vehicles swayed (gusts, poor velocities): the tolerance was 0.4 m, and "
    assert any(text.startswith(swayed) for text in flight.texts("info"))
    # An autopilot swings by its poor velocity on its way down: only the last metre is left to it.
    assert "velocities are poor: all are led down to 1 m, and land from there" in flight.texts("info")
    assert sorted(heights_m) == [0, 1]
    assert max(heights_m.values()) < 1.0 + 0.3 + 0.4  # and what a height may be off by
