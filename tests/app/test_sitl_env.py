"""``gs sitl-env``: a shell runs what it prints, with programs in the simulators' places that tell their call."""

from __future__ import annotations

import math
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
import yaml

from groundstation.app.resources import packaged_configs
from tests.app.commands import gs

_STUB = """#!/bin/sh
echo "$0 $*"
env | grep '^PX4_' | sort
pwd
"""


def _stubs(folder: Path) -> dict[str, str]:
    """Programs where the simulators would be; returns the variables that name their folders."""
    px4, ardupilot = folder / "px4", folder / "ardupilot"
    for program in (px4 / "bin" / "px4", ardupilot / "build" / "sitl" / "bin" / "arducopter"):
        program.parent.mkdir(parents=True)
        program.write_text(_STUB)
        program.chmod(0o755)
    return {"PX4": str(px4), "ARDUPILOT": str(ardupilot), "PATH": "/usr/bin:/bin"}


def _metres_apart(first: tuple[float, float], second: tuple[float, float]) -> tuple[float, float]:
    """East and north of the second place against the first, by the radii of curvature of WGS 84."""
    lat = math.radians(first[0])
    e2 = 0.00669437999014
    root = math.sqrt(1.0 - e2 * math.sin(lat) ** 2)
    north = math.radians(second[0] - first[0]) * 6_378_137.0 * (1.0 - e2) / root**3
    east = math.radians(second[1] - first[1]) * 6_378_137.0 / root * math.cos(lat)
    return east, north


def test_the_script_starts_each_vehicle_with_its_own_id_port_and_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    _, script, _ = gs(["sitl-env", "mixed8.yaml"], monkeypatch, capsys)
    subprocess.run(["/bin/sh", "-c", script], cwd=tmp_path, env=_stubs(tmp_path), check=True, timeout=30)
    spec = yaml.safe_load((packaged_configs() / "missions" / "mixed8.yaml").read_text())
    places: list[tuple[float, float]] = []
    for vehicle in spec["vehicles"]:
        sysid = vehicle["id"]
        told = (tmp_path / f"mixed8-{sysid}.txt").read_text()
        assert told.rstrip().endswith(f"/mixed8-{sysid}")  # a folder of its own: parameters are kept there
        port = int(vehicle["link"].rpartition(":")[2])
        if vehicle["autopilot"] == "px4":
            assert f"bin/px4 -i {sysid - 1} -d" in told
            assert port == 14540 + sysid - 1
            assert "PX4_SIM_MODEL=sihsim_quadx" in told
            assert "PX4_PARAM_EKF2_GYR_NOISE=0.1" in told
            assert "PX4_PARAM_EKF2_ACC_NOISE=1" in told
            values = [re.search(rf"PX4_HOME_{name}=(\S+)", told) for name in ("LAT", "LON")]
            lat, lon = (float(value[1]) if value else math.nan for value in values)
            places.append((lat, lon))
        else:
            assert f"arducopter -I {(port - 5760) // 10} --sysid {sysid} --model quad" in told
            assert "--defaults" in told
            home = re.search(r"--home (\S+),(\S+),(\S+),0 ", told)
            assert home is not None
            places.append((float(home[1]), float(home[2])))
    pads = np.array([vehicle["pad_m"][:2] for vehicle in spec["vehicles"]])
    offsets = np.array([_metres_apart(places[0], place) for place in places])
    np.testing.assert_allclose(offsets, pads - pads[0], atol=0.03)  # seven decimals of a degree


def test_a_system_id_that_is_not_the_id_is_what_a_simulator_is_given(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ids = ("vehicles.0.id=300", "vehicles.0.sysid=1", "vehicles.7.id=307", "vehicles.7.sysid=8")
    code, script, _ = gs(["sitl-env", "mixed8.yaml", *(f"--set={item}" for item in ids)], monkeypatch, capsys)
    assert code == 0
    (px4,) = [line for line in script.splitlines() if "mixed8-300 " in line]
    (arducopter,) = [line for line in script.splitlines() if "mixed8-307 " in line]
    assert 'bin/px4" -i 0 ' in px4
    assert " --sysid 8 " in arducopter


def test_as_it_comes_px4_gets_no_parameters(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    code, script, _ = gs(["sitl-env", "px4_cube8.yaml", "--stock"], monkeypatch, capsys)
    assert code == 0
    assert "PX4_HOME_LAT" in script
    assert "PX4_PARAM_" not in script
    assert "mkdir -p px4_cube8-stock-1 " in script  # parameters that cured ones have kept are in folders of their own


@pytest.mark.parametrize(("missing", "words"), [("PX4", "bin/px4"), ("ARDUPILOT", "build/sitl/bin/arducopter")])
def test_a_folder_without_the_simulator_is_told_before_anything_is_started(
    missing: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    _, script, _ = gs(["sitl-env", "mixed8.yaml"], monkeypatch, capsys)
    names = _stubs(tmp_path) | {missing: str(tmp_path / "elsewhere")}
    done = subprocess.run(
        ["/bin/sh", "-c", script], cwd=tmp_path, env=names, check=False, timeout=30, capture_output=True, text=True
    )
    assert done.returncode == 1
    assert done.stderr == f"{missing}={tmp_path}/elsewhere: there is no {words} in it\n"
    assert not list(tmp_path.glob("mixed8-*"))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("cube8.yaml",), "vehicles[1].link: udpin://127.0.0.1:14540: PX4's simulator with system id 2 is instance 1"),
        (("mixed8.yaml", "--set", "vehicles.4.link=udpin://0.0.0.0:14550"), "ArduPilot's simulator waits on tcp 5760"),
        (("mixed8.yaml", "--home", "91,0,0"), "--home 91,0,0: expected LAT,LON,ALT"),
        (("mixed8.yaml", "--home", "here"), "--home here: expected LAT,LON,ALT"),
    ],
)
def test_what_the_simulators_cannot_be_is_refused(
    arguments: tuple[str, ...], words: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _, told = gs(["sitl-env", *arguments], monkeypatch, capsys)
    assert code == 2
    assert words in told
