"""Several flights side by side: figures of each, deviations of every two, pictures, a page with a report of each."""

from __future__ import annotations

import hashlib
import json
import math
import re
from base64 import b64encode
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import groundstation as gs_api
from groundstation.app.comparing import compare_logs
from groundstation.core.errors import UserError
from groundstation.records.comparison import deviation, labels, summary
from groundstation.records.replay import Flight
from tests.app.commands import gs
from tests.app.test_report import GOALS, PADS, record


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two recordings of the same flight."""
    made = tmp_path_factory.mktemp("flights")
    record(made / "one.tlog", name="one")
    (made / "more").mkdir()
    record(made / "more" / "one.tlog", name="two")
    return made


def _moved(flight: Flight, by_m: float, vehicle: int, later_s: float = 0.0) -> Flight:
    """The same flight with one vehicle elsewhere, and everything later."""
    shift = round(later_s * 1e9)
    tracks = [
        replace(
            track,
            t_ns=track.t_ns + shift,
            pos_team_enu_m=track.pos_team_enu_m + (by_m if number == vehicle else 0.0) * np.array([0.0, 0.6, 0.8]),
        )
        for number, track in enumerate(flight.vehicles)
    ]
    phases = [replace(p, start_ns=p.start_ns + shift, stop_ns=p.stop_ns + shift) for p in flight.phases]
    return replace(
        flight,
        vehicles=tuple(tracks),
        phases=tuple(phases),
        start_ns=flight.start_ns + shift,
        stop_ns=flight.stop_ns + shift,
    )


def test_figures_of_a_flight_are_those_of_what_was_flown(folder: Path) -> None:
    flight = gs_api.read_log(folder / "one.tlog").flight
    figures = summary(flight, "one")
    assert (figures.label, figures.outcome, figures.vehicles) == ("one", "completed", 4)
    ways = [np.linalg.norm(goal - pad) for goal, pad in zip(GOALS, PADS + np.array([0.0, 0.0, 0.5]), strict=True)]
    assert figures.way_m == pytest.approx(1.0 + 2.0 * float(np.mean(ways)), rel=0.05)  # up, there, back and down
    speeds = np.hypot(0.1 * np.arange(4), 0.2)
    assert figures.effort_m == pytest.approx(12.0 * speeds.mean())
    assert figures.effort_m2_s == pytest.approx(12.0 * (speeds**2).mean())
    assert figures.flight_s == pytest.approx(12.0)
    assert math.isnan(figures.time_to_form_s)
    assert figures.hold_error_m < 0.01
    assert figures.min_distance_m == pytest.approx(1.0)


def test_a_flight_deviates_from_itself_by_nothing_and_from_another_by_what_it_is_off(folder: Path) -> None:
    flight = gs_api.read_log(folder / "one.tlog").flight
    same = deviation(flight, flight, ("a", "b"))
    assert (same.rms_m, same.max_m, same.distance_max_m, same.vehicles) == (0.0, 0.0, 0.0, 4)
    other = deviation(flight, _moved(flight, 0.5, 2, later_s=3.0), ("a", "b"))
    assert other.max_m == pytest.approx(0.5)
    assert other.rms_m == pytest.approx(0.25)  # one of four
    assert other.vehicle == flight.vehicles[2].sysid
    assert 0.2 < other.distance_max_m <= 0.5
    assert other.seconds == pytest.approx(10.0, abs=0.1)  # from the form step on


def test_what_cannot_be_known_is_not_made_up(folder: Path) -> None:
    flight = gs_api.read_log(folder / "one.tlog").flight
    lost = replace(flight, vehicles=tuple(replace(track, in_team_frame=False) for track in flight.vehicles))
    found = deviation(flight, lost, ("a", "b"))
    assert (found.vehicle, found.seconds) == (0, 0.0)
    assert math.isnan(found.rms_m)
    assert math.isnan(found.distance_max_m)
    nobody = deviation(flight, replace(flight, vehicles=()), ("a", "b"))
    assert (nobody.vehicles, nobody.vehicle) == (0, 0)
    assert labels([flight] * 3, ["x", "y", "x"]) == ["1 x", "y", "3 x"]


def test_compare_prints_tables_and_json_and_draws_into_a_folder(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    logs = [str(folder / "one.tlog"), str(folder / "more" / "one.tlog")]
    code, out, err = gs(["compare", *logs, "-o", str(tmp_path / "c"), "--json"], monkeypatch, capsys)
    values = json.loads(out.splitlines()[-1])
    assert code == 0
    assert [row["label"] for row in values["logs"]] == ["1 one", "2 one"]
    assert values["logs"][0]["time_to_form_s"] is None
    assert values["deviations"][0]["max_m"] == 0.0
    assert "places apart, rms, m" in err
    page = (tmp_path / "c" / "index.html").read_text()
    drawn = sorted(b64encode(path.read_bytes()).decode() for path in (tmp_path / "c").glob("*.png"))
    assert sorted(re.findall(r'src="data:image/png;base64,([^"]*)"', page)) == drawn  # the page needs no other file
    assert page.count("src=") == len(drawn) == 4
    assert not re.search(r"https?:|//|<script|<link|@import|url\(", re.sub(r"base64,[^\"]*", "", page))
    assert gs(["compare", *logs, "-o", str(tmp_path / "c")], monkeypatch, capsys)[0] == 0  # its own is replaced
    (tmp_path / "c" / "index.html").write_text("<!doctype html><title>my thesis</title>")
    code, _, err = gs(["compare", *logs, "-o", str(tmp_path / "c")], monkeypatch, capsys)
    assert (code, "is not what this command would make again" in " ".join(err.split())) == (2, True)
    assert (tmp_path / "c" / "index.html").read_text() == "<!doctype html><title>my thesis</title>"


def test_a_report_of_several_logs_is_one_page_with_a_report_of_each_below(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    logs = [str(folder / "one.tlog"), str(folder / "more" / "one.tlog")]
    code, out, _ = gs(["report", *logs, "-o", str(tmp_path / "r"), "--json"], monkeypatch, capsys)
    assert code == 0
    files = [Path(file) for file in json.loads(out.splitlines()[-1])["files"]]
    assert all(file.is_file() for file in files)
    page = files[0].read_text()
    for link in re.findall(r'href="([^"]*)"', page):
        assert (tmp_path / "r" / link).is_file()
    assert page.count("href=") == 2
    for log, number in zip(logs, "12", strict=True):
        below = (tmp_path / "r" / number / "index.html").read_text()
        assert hashlib.sha256(Path(log).read_bytes()).hexdigest() in below
        assert "<h2>Links</h2>" in below


def test_mistakes_are_told(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="1 logs: can compare 2 to 50"):
        compare_logs([folder / "one.tlog"])
    with pytest.raises(UserError, match=r"nowhere\.tlog"):
        compare_logs([folder / "one.tlog", tmp_path / "nowhere.tlog"])


def test_from_python_too(folder: Path) -> None:
    found: Any = gs_api.compare([folder / "one.tlog", folder / "more" / "one.tlog"])
    assert found.deviations[0].rms_m == 0.0
