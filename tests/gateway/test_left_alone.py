"""A flight that is killed: its gateway tells vehicles where they are and brings them home; no process lives on."""

from __future__ import annotations

import signal
import sys
from pathlib import Path

import pytest

from groundstation.app.resources import packaged_configs
from sitl.server import Server
from tests.gateway.left_alone import fly_and, kill

pytest.importorskip("cflib", reason="cflib is not installed")
pytest.importorskip("motioncapture", reason="motioncapture is not installed")

MISSION = packaged_configs() / "missions" / "lab_pair2.yaml"


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="processes are looked up in /proc")
def test_a_killed_flight_leaves_vehicles_that_come_home_and_no_process(tmp_path: Path) -> None:
    def flies(server: Server) -> bool:
        return bool((server.world.truth.pos_enu_m[:, 2] > 0.45).all())

    seen = fly_and(kill, flies, MISSION, tmp_path, changes=("failsafe.hold_s=10", "steps.1.hold.seconds=30"))
    assert seen.exit_code == -signal.SIGKILL, seen.said
    assert len(seen.children) >= 2  # its gateway, and what reads the motion capture
    assert seen.down_s > 10.0, seen.said  # they held first, as preflight had set them
    assert seen.off_pad_m.max() < 0.1  # by an estimate that nobody corrects it would be more than ten metres
    assert seen.min_distance_m > 0.45
    assert seen.left == []
