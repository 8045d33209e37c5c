from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from groundstation.core.errors import UserError
from groundstation.mavlink.codec import decode
from groundstation.records.imports import import_crazyswarm, read_crazyswarm
from groundstation.records.manifest import manifest_path, read_manifest
from groundstation.records.notes import Received, Roles, Sent
from groundstation.records.replay import load_flight
from groundstation.records.tlog import read_tlog

REAL = Path(__file__).parents[3] / "shared" / "data" / "icra2019_flight"

# Three vehicles A, B, C stand still at these places; rows of the files are in the order of roles.
A, B, C = "1,2,3", "4,5,6", "7,8,9"
IDENTITY = "1,0,0,0,1,0,0,0,1"
TURNED = "0,1,0,0,0,1,1,0,0"  # role 1 is held by B, role 2 by C, role 3 by A
FILES = {
    "time_stamp.csv": "heading\n1541003533.25\n1541003533.4\n1541003533.500001\n",
    "positions.csv": f'"x1,y1,z1,..."\n{A},{B},{C}\n{B},{C},{A}\n{B},{C},{A}\n',
    "control_velocity.csv": "heading\n.1,.2,.3,0,0,0,0,0,0\n0,0,0,0,0,0,.1,.2,.3\n0,0,0,0,0,0,.1,.2,.3\n",
    "permutations.csv": f"heading\n{IDENTITY}\n{TURNED}\n{TURNED}\n",
    "stopFlag.csv": "heading\n1,0,0\n0,0,0\n0,0,0\n",
    "stopFlag_old.csv": "heading\n1,1,1\n0,0,0\n0,0,0\n",
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = tmp_path / "made_up"
    made.mkdir()
    for name, text in FILES.items():
        (made / name).write_text(text)
    return made


def test_rows_are_put_back_in_the_order_of_vehicles(folder: Path) -> None:
    flight = read_crazyswarm(folder)
    np.testing.assert_array_equal(flight.pos_team_enu_m, [[[1, 2, 3], [4, 5, 6], [7, 8, 9]]] * 3)
    np.testing.assert_array_equal(flight.role_of_vehicle, [[0, 1, 2], [2, 0, 1], [2, 0, 1]])
    np.testing.assert_array_equal(flight.control_enu_m_s[:, 0], [[0.1, 0.2, 0.3]] * 3)
    np.testing.assert_array_equal(flight.unix_us - 1_541_003_533_000_000, [250_000, 400_000, 500_001])


def test_log_holds_ned_frames_at_the_recorded_times(folder: Path, tmp_path: Path) -> None:
    log = tmp_path / "flight.tlog"
    import_crazyswarm(folder, log, {"gs": "0"})
    records = list(read_tlog(log))
    received = [record for record in records if isinstance(record, Received)]
    sent = [record for record in records if isinstance(record, Sent)]
    assert [record.t_ns for record in received] == [0] * 3 + [150_000_000] * 3 + [250_001_000] * 3
    (positions,) = decode([record.frame for record in received])
    assert positions.sysid.tolist() == [1, 2, 3] * 3
    np.testing.assert_array_equal(
        [positions.values[name][1] for name in ("x", "y", "z", "time_boot_ms")], [5.0, 4.0, -6.0, 0.0]
    )
    assert all(np.isnan(positions.values[name]).all() for name in ("vx", "vy", "vz"))
    (setpoints,) = decode([record.frame for record in sent])
    first = setpoints.values[0]
    np.testing.assert_allclose([first[name] for name in ("vx", "vy", "vz")], [0.2, 0.1, -0.3], rtol=1e-7)
    assert (first["type_mask"], first["coordinate_frame"], setpoints.sysid[0]) == (0x0DC7, 1, 255)
    assert setpoints.values["target_system"].tolist() == [1, 2, 3] * 3
    assert [record.roles for record in records if isinstance(record, Roles)] == [(0, 1, 2), (2, 0, 1)]
    assert struct.unpack(">Q", log.read_bytes()[:8]) == (1_541_003_533_250_000,)


def test_made_up_flight_reads_like_any_other(folder: Path, tmp_path: Path) -> None:
    log = tmp_path / "flight.tlog"
    formation = {"name": "line", "points": [[0, 0, 0], [3, 3, 3], [6, 6, 6]], "edges": [[1, 2], [2, 3]]}
    manifest = import_crazyswarm(folder, log, {"gs": "0"}, formation, radius_m=0.5)
    assert read_manifest(manifest_path(log)) == manifest
    flight = load_flight(log)
    assert (flight.name, len(flight.vehicles), flight.samples, flight.setpoints) == ("made_up", 3, 3, 9)
    assert flight.min_distance_m() == pytest.approx(np.sqrt(27))
    assert flight.safety_radius_m == 0.5
    assert [event.text for event in flight.events] == [
        "info: gridlock: roles 2, 3 swap",
        "info: no free direction: roles 1",
        "info: no free direction: none",
    ]
    assert flight.role_changes == 3


def test_same_files_give_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    logs = [tmp_path / "a.tlog", tmp_path / "b.tlog"]
    for log in logs:
        import_crazyswarm(folder, log, {"gs": "0"})
    assert logs[0].read_bytes() == logs[1].read_bytes()
    assert manifest_path(logs[0]).read_bytes() == manifest_path(logs[1]).read_bytes()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("positions.csv", A, "1,2,north"), r"positions\.csv: line 2, column 3: 'north' is not a finite number"),
        (("positions.csv", C, "7,8,nan"), r"positions\.csv: line 2, column 9: 'nan'"),
        (("positions.csv", f"{B},{C},{A}\n", f"{B},{C}\n"), r"positions\.csv: line 3: 6 values, expected 9"),
        (("positions.csv", f"{A},{B},{C}\n", ""), r"positions\.csv: 2 rows, time_stamp\.csv has 3"),
        (("time_stamp.csv", "1541003533.4\n", "noon\n"), r"time_stamp\.csv: line 3: 'noon' is not one time"),
        (("time_stamp.csv", "1541003533.4\n", "\n"), r"time_stamp\.csv: line 3"),
        (("time_stamp.csv", "1541003533.4\n", "1541003533.2\n"), "line 3: 1541003533.2 is not later"),
        (("time_stamp.csv", "1541003533.4\n", "9999999999\n"), "before 2100"),
        (("permutations.csv", TURNED, "1,0,0,1,0,0,0,0,1"), r"permutations\.csv: line 3: not a permutation matrix"),
        (("permutations.csv", IDENTITY, "1,0,0,0,1,0,0,0"), r"permutations\.csv: line 2: 8 values, expected 9"),
        (("stopFlag.csv", "1,0,0", "1,0,2"), r"stopFlag\.csv: line 2, column 3: 2: expected 0 or 1"),
        (("control_velocity.csv", ".1,.2,.3,0,0,0,0,0,0", ""), r"control_velocity\.csv: line 2: 0 values, expected 9"),
    ],
)
def test_bad_values_are_told_with_file_and_line(
    folder: Path, tmp_path: Path, change: tuple[str, str, str], words: str
) -> None:
    name, old, new = change
    text = FILES[name]
    assert old in text
    (folder / name).write_text(text.replace(old, new, 1))
    with pytest.raises(UserError, match=words):
        import_crazyswarm(folder, tmp_path / "flight.tlog", {})
    assert not (tmp_path / "flight.tlog").exists()


@pytest.mark.parametrize("name", list(FILES))
def test_missing_and_empty_files_are_told(folder: Path, tmp_path: Path, name: str) -> None:
    (folder / name).write_text("only a heading\n")
    with pytest.raises(UserError, match=f"{name}: no rows"):
        read_crazyswarm(folder)
    (folder / name).unlink()
    with pytest.raises(UserError, match=f"{name}: no such file"):
        read_crazyswarm(folder)
    with pytest.raises(UserError, match="no such folder"):
        read_crazyswarm(tmp_path / "nowhere")


def test_columns_that_are_no_triples_are_told(folder: Path) -> None:
    (folder / "positions.csv").write_text("heading\n1,2\n1,2\n1,2\n")
    with pytest.raises(UserError, match=r"positions\.csv: 2 columns, expected x, y, z"):
        read_crazyswarm(folder)


def test_no_log_is_left_without_its_manifest(folder: Path, tmp_path: Path) -> None:
    log = tmp_path / "flight.tlog"
    manifest_path(log).mkdir()
    with pytest.raises(UserError, match="cannot write the manifest"):
        import_crazyswarm(folder, log, {})
    assert not log.exists()


def test_formation_of_another_size_is_told(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="3 vehicles, the formation pair has 2 points"):
        import_crazyswarm(folder, tmp_path / "f.tlog", {}, {"name": "pair", "points": [[0, 0, 0], [1, 0, 0]]})


@pytest.mark.skipif(not REAL.is_dir(), reason="the recorded flight of 2018 is not beside the project")
def test_real_flight_of_2018(tmp_path: Path) -> None:
    log = tmp_path / "flight.tlog"
    import_crazyswarm(REAL, log, {})
    flight = load_flight(log)
    assert len(flight.vehicles) == 8
    assert flight.samples == 212
    assert round(flight.duration_s, 1) == 32.4
    least = flight.min_distance_m()
    assert least is not None
    assert round(least, 4) == 0.2058
    # The columns jump by up to 0.86 m when roles swap; vehicles do not jump: they flew below 0.7 m/s.
    steps_m = [np.linalg.norm(np.diff(track.pos_team_enu_m, axis=0), axis=1).max() for track in flight.vehicles]
    assert max(steps_m) < 0.1
