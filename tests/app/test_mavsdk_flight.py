"""The same mission over MAVSDK: two emulated vehicles in real time, from ``gs fly`` to a verified log."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from groundstation.app.verify import verify_log
from tests.app.commands import gs
from tests.sitl.served import free_udp_port


def test_a_mission_flies_over_mavsdk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    url = f"mavsdk://udpin://127.0.0.1:{free_udp_port()}"
    log = tmp_path / "flight.tlog"
    changes = [
        "positioning=mocap", "formation_scale=1.3", "takeoff.height_m=0.5", "steps.1.hold.seconds=0.5",
        "steps.0.form.tolerance_m=0.05", "avoidance.radius_m=0.5", "avoidance.activation_m=0.6",
        "limits.preflight_s=20", "scale.gain=2.5", "wind={}",
    ]  # fmt: skip
    for number, x in enumerate((-0.5, 0.5)):
        vehicle = f"vehicles.{number}"
        changes += [f"{vehicle}.link={url}", f"{vehicle}.profile=crazyflie", f"{vehicle}.origin=pad"]
        changes += [f"{vehicle}.pad_m=[{x}, 0, 0]"]
    arguments = ["fly", "--mission", "first_flight2.yaml", "--dry-run", "--udp", "--json", "--log", str(log)]
    arguments += [word for change in changes for word in ("--set", change)]
    code, out, _ = gs(arguments, monkeypatch, capfd)
    assert code == 0
    output = out.splitlines()
    assert len(output) == 1  # MAVSDK's own messages do not get between
    answer = json.loads(output[0])
    assert (answer["outcome"], answer["reason"]) == ("completed", "")
    assert answer["formation_error_m"] < 0.1
    assert answer["min_distance_m"] >= 0.5
    assert verify_log(log).mismatches == 0
