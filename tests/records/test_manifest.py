from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from groundstation.core.errors import UserError
from groundstation.records.manifest import (
    DRY_RUN_EPOCH_UNIX_US,
    Manifest,
    manifest_beside,
    manifest_path,
    read_manifest,
    versions,
    write_manifest,
)
from sitl.faults import Fault

MANIFEST = Manifest(
    mission={"name": "cube8", "vehicles": [{"id": 1, "pad_m": [0.0, 1.0, 0.0]}], "gain": 0.2},
    epoch_unix_us=DRY_RUN_EPOCH_UNIX_US,
    versions={"gs": "0.1.0"},
    seed=3,
    dry_run=True,
    gains_npz=b"PK\x03\x04 not really",
)


def test_lies_beside_the_log() -> None:
    assert manifest_path(Path("flights/a.b.tlog")) == Path("flights/a.b.manifest.json")
    assert manifest_path(Path("odd.log")) == Path("odd.log.manifest.json")


def test_comes_back_as_written(tmp_path: Path) -> None:
    path = tmp_path / "flight.manifest.json"
    write_manifest(path, MANIFEST)
    assert read_manifest(path) == MANIFEST
    assert manifest_beside(tmp_path / "flight.tlog") == MANIFEST
    assert manifest_beside(tmp_path / "other.tlog") is None
    assert [item.name for item in tmp_path.iterdir()] == ["flight.manifest.json"]


def test_faults_that_struck_stand_in_it_and_make_another_flight(tmp_path: Path) -> None:
    struck = Fault("loss", at_s=4.0, for_s=2.0, vehicles=(1,), numbers={"probability": 0.3}, direction="up").record()
    path = tmp_path / "flight.manifest.json"
    write_manifest(path, replace(MANIFEST, faults=[struck]))
    kept = json.loads(path.read_text())["faults"]
    assert kept == [{"kind": "loss", "at_s": 4.0, "for_s": 2.0, "vehicles": [1], "direction": "up", "probability": 0.3}]
    again = read_manifest(path)
    assert again.same_flight(MANIFEST.mission, 3, [struck])
    assert not again.same_flight(MANIFEST.mission, 3)
    assert not MANIFEST.same_flight(MANIFEST.mission, 3, [struck])
    assert "faults" not in json.loads(MANIFEST.to_json())


def test_keeps_the_gains_and_their_hash() -> None:
    values = json.loads(MANIFEST.to_json())
    assert values["gains_sha256"] == hashlib.sha256(b"PK\x03\x04 not really").hexdigest()
    assert values["format"] == 1


def test_dry_run_leaves_out_what_differs_from_run_to_run() -> None:
    first = MANIFEST.finished({"outcome": "completed", "wall_s": 4.1, "log": "a.tlog"})
    second = MANIFEST.finished({"log": "b.tlog", "wall_s": 5.0, "outcome": "completed"})
    assert first.to_json() == second.to_json()
    assert first.result == {"outcome": "completed"}


def test_real_flight_keeps_its_wall_time() -> None:
    flown = Manifest(mission={}, epoch_unix_us=1).finished({"wall_s": 4.1})
    assert flown.result == {"wall_s": 4.1}


def test_values_of_numpy_and_unknown_numbers_are_plain_json() -> None:
    text = Manifest(
        mission={"points": np.eye(2), "n": np.int64(3), "inf": float("inf"), "tuple": (1.5,)}, epoch_unix_us=1
    ).to_json()
    assert json.loads(text)["mission"] == {"points": [[1.0, 0.0], [0.0, 1.0]], "n": 3, "inf": None, "tuple": [1.5]}


def test_versions_name_what_a_flight_depends_on() -> None:
    assert set(versions()) == {"gs", "python", "numpy"}
    assert versions()["numpy"] == np.__version__


def test_failed_write_leaves_the_former_manifest(tmp_path: Path) -> None:
    path = tmp_path / "flight.manifest.json"
    write_manifest(path, MANIFEST)
    (tmp_path / ".flight.manifest.json.part").mkdir()
    with pytest.raises(UserError, match="cannot write the manifest"):
        write_manifest(path, Manifest(mission={}, epoch_unix_us=0))
    assert read_manifest(path) == MANIFEST


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"format": 2}, "format is 2, this program reads up to 1"),
        ({"mission": []}, r"mission is \[\], expected dict"),
        ({"seed": True}, "seed is True, expected int or null"),
        ({"epoch_unix_us": None}, "epoch_unix_us is None, expected int"),
        ({"gains_sha256": "00"}, "not the hash of gains_npz_base64"),
        ({"gains_npz_base64": "!"}, "gains_npz_base64"),
    ],
)
def test_damaged_manifests_are_told(tmp_path: Path, change: dict[str, Any], words: str) -> None:
    path = tmp_path / "flight.manifest.json"
    path.write_text(json.dumps(json.loads(MANIFEST.to_json()) | change))
    with pytest.raises(UserError, match=words) as caught:
        read_manifest(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", "\udcff"])
def test_files_that_are_no_manifest_are_told(tmp_path: Path, text: str) -> None:
    path = tmp_path / "flight.manifest.json"
    path.write_bytes(text.encode(errors="surrogateescape"))
    with pytest.raises(UserError, match=r"flight\.manifest\.json"):
        manifest_beside(tmp_path / "flight.tlog")
