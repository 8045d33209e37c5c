"""Exports, read by other people's readers: the figures of the log, under the names that docs/exports.md gives."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq  # type: ignore[import-untyped]
import pytest
from mcap.reader import make_reader

from groundstation.core.errors import UserError
from groundstation.mavlink.codec import Encoder
from groundstation.records.imports import import_crazyswarm
from groundstation.records.manifest import DRY_RUN_EPOCH_UNIX_US
from groundstation.records.replay import Flight, load_flight
from groundstation.records.tlog import TlogWriter
from groundstation.records.wide import wide
from tests.app.commands import gs
from tests.app.test_report import REAL, record

DOCS = Path(__file__).parents[2] / "docs" / "exports.md"
Patch = pytest.MonkeyPatch
Captured = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("flight") / "flight.tlog"
    record(path)
    return path


@pytest.fixture(scope="module")
def flight(log: Path) -> Flight:
    return load_flight(log)


def _export(words: list[str], monkeypatch: Patch, capsys: Captured) -> dict[str, Any]:
    code, out, err = gs(["export", *words, "--json"], monkeypatch, capsys)
    assert code == 0, err
    answer: dict[str, Any] = json.loads(out.splitlines()[-1])
    return answer


def _csv(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_csv_has_every_figure_of_the_log(
    log: Path, flight: Flight, tmp_path: Path, monkeypatch: Patch, capsys: Captured
) -> None:
    answer = _export([str(log), "--to", "csv", "-o", str(tmp_path / "f.csv")], monkeypatch, capsys)
    rows = _csv(tmp_path / "f.csv")
    assert (answer["rows"], answer["columns"]) == (len(rows), len(rows[0]) - 1) == (241, len(rows[0]) - 1)
    t_ns = np.array([round(float(row["t_s"]) * 1e9) for row in rows]) + flight.start_ns
    read = np.array([[float(row[f"v3_{axis}_enu_m"]) for axis in "xyz"] for row in rows])
    assert np.array_equal(read, flight.positions_at(t_ns)[:, 2])
    pair = np.array([float(row["distance_2_4_m"]) for row in rows])
    assert np.array_equal(pair, flight.distances_at(t_ns)[:, 4])
    assert {row["v3_setpoint_vx_enu_m_s"] for row in rows} == {"0.0"}
    assert {round(float(row["v3_setpoint_vy_enu_m_s"]), 6) for row in rows} == {0.2}
    assert {row["v1_role"] for row in rows if float(row["t_s"]) > 2.0} == {"4.0"}
    assert [(row["phase"], row["t_s"]) for row in rows if row["event"].startswith("phase: ")] == [
        (phase.name, repr((phase.start_ns - flight.start_ns) / 1e9)) for phase in flight.phases
    ]


@pytest.mark.parametrize("rate_hz", [0.0, 0.3, 7.0, 100.0])
def test_the_smallest_distance_is_there_at_every_rate(flight: Flight, rate_hz: float) -> None:
    table = wide(flight, rate_hz)
    least = np.asarray(table["min_distance_m"], dtype=np.float64)
    assert np.nanmin(least) == flight.min_distance_m()
    row = int(np.nanargmin(least))
    assert re.fullmatch(r"[1-4]-[1-4]", table["min_distance_pair"][row])


def test_parquet_is_the_same_table_with_units_and_events(
    log: Path, flight: Flight, tmp_path: Path, monkeypatch: Patch, capsys: Captured
) -> None:
    _export([str(log), "--to", "parquet", "-o", str(tmp_path / "f.parquet"), "--rate", "0"], monkeypatch, capsys)
    table = pq.read_table(tmp_path / "f.parquet")
    assert table.num_rows == len(flight.instants_ns())
    assert table.schema.field("v1_setpoint_vz_enu_m_s").metadata == {b"unit": b"m/s"}
    assert table.schema.field("distance_1_2_m").metadata == {b"unit": b"m"}
    assert table.schema.field("phase").metadata is None
    assert json.loads(table.schema.metadata[b"result"]) == {"outcome": "completed"}
    assert [text for _, text in json.loads(table.schema.metadata[b"events"])] == [item.text for item in flight.events]
    error = table["formation_error_m"].to_numpy()
    assert np.allclose(error, flight.formation_error_at(flight.instants_ns()), equal_nan=True)
    assert min(table["min_distance_m"].to_pylist()) == flight.min_distance_m()


def test_mcap_is_read_by_its_own_reader_and_tells_each_report_at_its_time(
    log: Path, flight: Flight, tmp_path: Path, monkeypatch: Patch, capsys: Captured
) -> None:
    answer = _export([str(log), "--to", "mcap", "-o", str(tmp_path / "f.mcap")], monkeypatch, capsys)
    poses, topics, times = [], set(), []
    with (tmp_path / "f.mcap").open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            content = json.loads(message.data)
            assert set(content) <= set(json.loads(schema.data)["properties"]) or schema.name == "gs.Distances"
            topics.add((channel.topic, schema.name))
            times.append(message.log_time)
            if channel.topic == "/vehicles/2/pose":
                poses.append((message.log_time, content["frame_id"], *content["pose"]["position"].values()))
    assert (len(times), len(topics)) == (answer["messages"], answer["topics"])
    track = flight.vehicles[1]
    assert [item[0] - DRY_RUN_EPOCH_UNIX_US * 1_000 for item in poses] == (track.t_ns - flight.start_ns).tolist()
    assert np.array_equal(np.array([item[2:] for item in poses]), track.pos_team_enu_m)
    assert {item[1] for item in poses} == {"team"}
    assert {("/tf", "foxglove.FrameTransform"), ("/events", "foxglove.Log"), ("/team", "gs.Team")} <= topics


def test_attitudes_are_turned_as_each_reader_expects_them(tmp_path: Path, monkeypatch: Patch, capsys: Captured) -> None:
    """One faces north with its right side down, one east and level; of who sends both, quaternions count."""
    log = tmp_path / "two.tlog"
    with TlogWriter(log, DRY_RUN_EPOCH_UNIX_US) as writer:
        for tick in range(10):
            for sysid in (1, 2):
                own = Encoder(sysid)
                placed = own.encode("LOCAL_POSITION_NED", time_boot_ms=100 * tick, x=1.0, y=2.0 * sysid, z=-3.0)
                leant = own.encode("ATTITUDE", time_boot_ms=100 * tick, roll=0.1, yaw=0.0 if sysid == 1 else 1.0)
                frames = [placed, leant]
                if sysid == 2:
                    half = np.sqrt(0.5)
                    frames.append(own.encode("ATTITUDE_QUATERNION", time_boot_ms=100 * tick, q1=half, q4=half))
                for frame in frames:
                    writer.received(0, "p", frame, 100_000_000 * tick)
    _export([str(log), "--to", "csv", "-o", str(tmp_path / "f.csv")], monkeypatch, capsys)
    row = _csv(tmp_path / "f.csv")[-1]
    told = [float(row[f"v{sysid}_{angle}_ned_deg"]) for sysid in (1, 2) for angle in ("roll", "pitch", "yaw")]
    assert np.allclose(told, [np.degrees(0.1), 0.0, 0.0, 0.0, 0.0, 90.0], atol=1e-4)
    _export([str(log), "--to", "mcap", "-o", str(tmp_path / "f.mcap")], monkeypatch, capsys)
    with (tmp_path / "f.mcap").open("rb") as file:
        turned = {
            channel.topic: json.loads(message.data)["pose"]["orientation"]
            for _, channel, message in make_reader(file).iter_messages()
            if channel.topic.endswith("/pose")
        }
    facing_east = turned["/vehicles/2/pose"]
    assert np.allclose([abs(facing_east["w"]), facing_east["x"], facing_east["y"], facing_east["z"]], [1, 0, 0, 0])
    # North is a quarter turn to the left of east; then a roll about the own x axis, right side down in both frames.
    quarter, roll = np.array([1, 0, 0, 1]) * np.sqrt(0.5), np.array([np.cos(0.05), np.sin(0.05), 0, 0])
    expected = np.array([quarter[0] * roll[0], quarter[0] * roll[1], quarter[3] * roll[1], quarter[3] * roll[0]])
    north = np.array([turned["/vehicles/1/pose"][axis] for axis in "wxyz"])
    assert np.allclose(north * np.sign(north[0]), expected, atol=1e-6)


def test_a_log_without_a_mission_is_exported_in_the_vehicles_own_frames(
    tmp_path: Path, monkeypatch: Patch, capsys: Captured
) -> None:
    record(tmp_path / "plain.tlog", manifest=False)
    _export([str(tmp_path / "plain.tlog"), "--to", "csv", "-o", str(tmp_path / "f.csv")], monkeypatch, capsys)
    rows = _csv(tmp_path / "f.csv")
    assert "v1_x_own_enu_m" in rows[0]
    assert {row["distance_1_2_m"] for row in rows} == {row["min_distance_m"] for row in rows} == {""}


def test_what_cannot_be_exported_is_told(log: Path, tmp_path: Path, monkeypatch: Patch, capsys: Captured) -> None:
    code, _, err = gs(["export", str(log), "--to", "parket", "-o", "x"], monkeypatch, capsys)
    assert (code, "parquet" in err, "Traceback" in err) == (2, True, False)
    code, _, err = gs(["export", str(log), "--to", "csv", "-o", str(tmp_path / "no" / "x")], monkeypatch, capsys)
    assert (code, "name another file with -o" in err) == (2, True)
    with pytest.raises(UserError, match=r"--rate nan: nan rows for 12 s, limit 5000000; give a lower rate"):
        wide(load_flight(log), float("nan"))
    with pytest.raises(UserError, match=r"--rate 1e\+09: 12000000001 rows for 12 s, limit 5000000; give a lower rate"):
        wide(load_flight(log), 1e9)


@pytest.mark.parametrize("to", ["csv", "parquet", "mcap"])
def test_only_an_export_is_replaced(log: Path, to: str, tmp_path: Path, monkeypatch: Patch, capsys: Captured) -> None:
    words = [str(log), "--to", to, "-o", str(tmp_path / "f")]
    _export(words, monkeypatch, capsys)
    first = (tmp_path / "f").read_bytes()
    _export(words, monkeypatch, capsys)
    assert (tmp_path / "f").read_bytes() == first
    (tmp_path / "f").write_bytes(b"t_s,mine\n1,2\n")
    code, _, err = gs(["export", *words], monkeypatch, capsys)
    assert (code, "replace it with --force" in " ".join(err.split())) == (2, True)
    _export([*words, "--force"], monkeypatch, capsys)
    assert (tmp_path / "f").read_bytes() == first


@pytest.mark.parametrize("to", ["csv", "parquet", "mcap"])
def test_an_export_of_a_large_team_knows_its_own_file(
    to: str, tmp_path: Path, monkeypatch: Patch, capsys: Captured
) -> None:
    """Thirty vehicles have 435 distances: the heads of columns alone are 20 kB."""
    log = tmp_path / "thirty.tlog"
    with TlogWriter(log, DRY_RUN_EPOCH_UNIX_US) as writer:
        for sysid in range(1, 31):
            placed = Encoder(sysid).encode("GLOBAL_POSITION_INT", lat=470_000_000, lon=80_000_000 + 200 * sysid, alt=1)
            writer.received(0, "p", placed, 1_000_000 * sysid)
    words = [str(log), "--to", to, "-o", str(tmp_path / "f")]
    first = _export(words, monkeypatch, capsys)
    if to != "mcap":
        assert first["columns"] > 435
    assert _export(words, monkeypatch, capsys) == first


def test_every_column_and_topic_is_in_the_documentation(flight: Flight) -> None:
    words = DOCS.read_text(encoding="utf-8")
    for name in wide(flight, 1.0):
        general = re.sub(r"^v\d+_", "vN_", re.sub(r"^distance_\d+_\d+", "distance_A_B", name))
        general = re.sub(r"_v?[xyz]_", lambda axis: axis[0].replace("y", "x").replace("z", "x"), general)
        assert f"`{general}`" in words, general


@pytest.mark.skipif(not REAL.is_dir(), reason="the recorded flight of 2018 is not beside the project")
def test_the_real_flight_of_2018_shows_where_it_was_nearest(
    tmp_path: Path, monkeypatch: Patch, capsys: Captured
) -> None:
    log = tmp_path / "flight.tlog"
    import_crazyswarm(REAL, log, {})
    _export([str(log), "--to", "parquet", "-o", str(tmp_path / "f.parquet")], monkeypatch, capsys)
    table = pq.read_table(tmp_path / "f.parquet")
    least = table["min_distance_m"].to_numpy()
    row = int(np.nanargmin(least))
    assert round(float(least[row]), 4) == 0.2058
    a, b = table["min_distance_pair"][row].as_py().split("-")
    beside = table[f"distance_{a}_{b}_m"].to_numpy()[max(0, row - 1) : row + 1]
    assert beside.min() == pytest.approx(0.2058, abs=0.02)


def test_rerun_reads_what_the_log_has(
    log: Path, flight: Flight, tmp_path: Path, monkeypatch: Patch, capsys: Captured
) -> None:
    chunk = pytest.importorskip("rerun.chunk", reason="rerun-sdk is not here: requirements-rerun.lock brings it")
    path = tmp_path / "f.rrd"
    answer = _export([str(log), "--to", "rrd", "-o", str(path)], monkeypatch, capsys)
    told: dict[str, list[Any]] = {}
    for part in chunk.RrdReader(path).stream():
        told.setdefault(part.entity_path, []).append(part.to_record_batch())
    assert answer["entities"] == len([name for name in told if not name.startswith("/__")]) - 1  # the axes' own
    for track in flight.vehicles:
        places = [
            row
            for batch in told[f"/team/v{track.sysid}"]
            if "Transform3D:translation" in batch.schema.names
            for row in batch.column("Transform3D:translation").to_pylist()
        ]
        np.testing.assert_allclose(np.array(places)[:, 0], track.pos_team_enu_m, atol=1e-6)
    least = [row[0] for batch in told["/figures/min_distance_m"] for row in batch.column("Scalars:scalars").to_pylist()]
    assert min(least) == pytest.approx(flight.min_distance_m())
    code, out, err = gs(["export", str(log), "--to", "rrd", "-o", str(path)], monkeypatch, capsys)
    assert (code, "replaced" in out + err) == (0, True)  # it knows its own file
