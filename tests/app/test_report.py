from __future__ import annotations

import hashlib
import re
import struct
import subprocess
import sys
from base64 import b64decode
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from groundstation.app.paper_figures import COLUMN_IN, PAPER_FIGURES
from groundstation.app.report import PICTURES, key_figures, shown_instant, to_html, write_report
from groundstation.app.report_facts import facts_of
from groundstation.core.errors import UserError
from groundstation.mavlink.codec import Encoder
from groundstation.records.imports import import_crazyswarm
from groundstation.records.manifest import DRY_RUN_EPOCH_UNIX_US, Manifest, manifest_path, write_manifest
from groundstation.records.replay import Flight, load_flight
from groundstation.records.tlog import TlogWriter
from tests.app.commands import gs

REAL = Path(__file__).parents[3] / "shared" / "data" / "icra2019_flight"
SECOND_NS = 1_000_000_000
PADS = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [2.0, 2.0, 0.0]])
GOALS = np.array([[0.5, 0.5, 0.5], [1.5, 0.5, 0.5], [0.5, 1.5, 0.5], [1.5, 1.5, 0.5]])
PHASES = {0: "takeoff", 2: "form", 6: "hold", 8: "return", 11: "land"}


def record(path: Path, *, manifest: bool = True, name: str = "square4") -> Flight:
    """Four vehicles form a square of 1 m, hold it and fly back to pads 2 m apart."""
    ground = Encoder(255, 190)
    with TlogWriter(path, DRY_RUN_EPOCH_UNIX_US) as writer:
        for tick in range(121):
            t_s = tick / 10
            t_ns = tick * SECOND_NS // 10
            if tick % 10 == 0 and tick // 10 in PHASES:
                writer.event(f"phase: {PHASES[tick // 10]}", t_ns)
            if tick == 20:
                writer.roles([3, 2, 1, 0], t_ns)
            there = np.clip(min((t_s - 2) / 4, (11 - t_s) / 3), 0, 1)
            up = np.array([0.0, 0.0, min(t_s, 12 - t_s, 0.5)])
            positions = PADS + up * (1 - there) + there * (GOALS - PADS)
            writer.tick(t_ns, tick)
            for k, (east, north, height) in enumerate(positions - PADS):
                frame = Encoder(k + 1).encode("LOCAL_POSITION_NED", x=north, y=east, z=-height)
                writer.received(0, "p", frame, t_ns)
                setpoint = ground.encode(
                    "SET_POSITION_TARGET_LOCAL_NED", target_system=k + 1, type_mask=0x0DC7, vx=0.1 * k, vz=-0.2
                )
                writer.sent(setpoint, t_ns)
        writer.operator("return <now>", 8 * SECOND_NS)
    if manifest:
        mission = {
            "name": name,
            "vehicles": [{"id": k + 1, "pad_m": pad.tolist(), "origin": "pad"} for k, pad in enumerate(PADS)],
            "formation": {
                "name": "square",
                "points": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]],
                "edges": [[1, 2], [1, 3], [2, 4], [3, 4]],
            },
            "avoidance": {"radius_m": 0.45},
            "steps": [{"form": {"tolerance_m": 0.05}}, {"hold": {"seconds": 2}}],
        }
        ended = Manifest(mission=mission, epoch_unix_us=DRY_RUN_EPOCH_UNIX_US).finished({"outcome": "completed"})
        write_manifest(manifest_path(path), ended)
    return load_flight(path)


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    return record(tmp_path_factory.mktemp("flight") / "flight.tlog")


def draw(flight: Flight, file: str) -> Any:
    (picture,) = [item for item in PICTURES if item.file == file]
    figure = Figure(figsize=picture.size_in)
    picture.draw(figure, flight)
    return figure


def texts(figure: Any) -> str:
    """All words of a figure, its legend's included."""
    items = [figure.get_suptitle(), *(text.get_text() for text in figure.texts)]
    for legend in figure.legends:
        items += [text.get_text() for text in legend.get_texts()]
    for axes in figure.axes:
        items += [axes.get_xlabel(), axes.get_ylabel(), *(text.get_text() for text in axes.texts)]
    return "\n".join(items)


def test_writes_four_pictures_and_a_page_that_needs_nothing_else(flight: Flight, tmp_path: Path) -> None:
    files = write_report(flight, tmp_path / "new" / "report")
    names = ["index.html", "trajectories.png", "distances.png", "formation_error.png", "setpoints.png"]
    assert [file.name for file in files] == names
    for file in files[1:]:
        data = file.read_bytes()
        assert data.startswith(b"\x89PNG\r\n")
        width, height = struct.unpack(">II", data[16:24])
        assert width == 1200
        assert 400 <= height <= 900
    page = files[0].read_text(encoding="utf-8")
    inside = [b64decode(text) for text in re.findall(r'src="data:image/png;base64,([^"]*)"', page)]
    assert inside == [file.read_bytes() for file in files[1:]]
    page = re.sub(r'src="data:[^"]*"', "", page)
    assert "src=" not in page
    assert not re.search(r"https?:|//|<script|<link|@import|url\(", page)


def test_distances_show_every_pair_with_r_and_the_smallest(flight: Flight) -> None:
    figure = draw(flight, "distances.png")
    (axes,) = figure.axes
    curves = [line for line in axes.lines if len(line.get_xdata()) == flight.samples]
    assert len(curves) == 6
    colours = [line.get_color() for line in curves]
    assert sorted(colours.count(colour) for colour in set(colours)) == [2, 4]
    assert [line for line in axes.lines if list(line.get_ydata()) == [0.45, 0.45]]
    words = texts(figure)
    assert "r = 0.45 m" in words
    assert "smallest: 1.000 m" in words
    assert "distance in m" in words
    assert "time in s" in words
    for phase in PHASES.values():
        assert phase in words


def test_trajectories_join_the_vehicles_that_hold_neighbouring_roles(flight: Flight) -> None:
    figure = draw(flight, "trajectories.png")
    (axes,) = figure.axes
    joined = set()
    for line in axes.lines:
        ends = np.array(line.get_data_3d()).T
        if len(ends) == 2:
            joined.add(frozenset(tuple(float(x) for x in end.round(3)) for end in ends))
    expected = {frozenset(tuple(float(x) for x in GOALS[k]) for k in pair) for pair in ((3, 2), (3, 1), (2, 0), (1, 0))}
    assert joined == expected
    assert "sensing graph" in texts(figure)
    assert (axes.get_xlabel(), axes.get_ylabel(), axes.get_zlabel()) == ("east in m", "north in m", "up in m")


def test_error_is_small_in_the_hold_and_its_tolerance_is_drawn(flight: Flight) -> None:
    figure = draw(flight, "formation_error.png")
    (axes,) = figure.axes
    wanted = axes.lines[1]
    held = (wanted.get_xdata() > 6) & (wanted.get_xdata() < 8)
    assert held.sum() == 19
    assert np.max(wanted.get_ydata()[held]) < 1e-5
    assert "tolerance 0.05 m" in texts(figure)


def test_setpoints_show_each_direction_of_each_vehicle(flight: Flight) -> None:
    figure = draw(flight, "setpoints.png")
    assert [axes.get_ylabel() for axes in figure.axes] == ["east in m/s", "north in m/s", "up in m/s"]
    expected = np.array([[0, 0, 0, 0], [0, 0.1, 0.2, 0.3], [0.2] * 4])
    for axes, values in zip(figure.axes, expected, strict=True):
        curves = [line for line in axes.lines if len(line.get_xdata()) == 121]
        np.testing.assert_allclose([line.get_ydata()[5] for line in curves], values, atol=1e-7)


def test_key_figures_are_taken_at_the_end_of_the_hold(flight: Flight) -> None:
    assert shown_instant(flight) == (8 * SECOND_NS, "at the end of hold")
    figures = dict(key_figures(flight))
    assert figures["Vehicles"] == "4"
    assert figures["Smallest distance between reported positions"] == "1.0000 m"
    assert figures["Safety radius r"] == "0.4500 m"
    assert figures["Formation error at the end of hold"] == "0.0000 m"
    assert figures["Outcome"] == "completed"


def test_names_cannot_break_the_page(tmp_path: Path) -> None:
    page = to_html(record(tmp_path / "flight.tlog", name="<script>alert(1)</script> & co"))
    assert "<script" not in page
    assert "&lt;script&gt;alert(1)&lt;/script&gt; &amp; co" in page
    assert "return &lt;now&gt;" in page


def test_log_without_a_manifest_says_what_is_not_known(tmp_path: Path) -> None:
    flight = record(tmp_path / "flight.tlog", manifest=False)
    files = write_report(flight, tmp_path / "report")
    assert len(files) == 5
    figures = dict(key_figures(flight))
    assert figures["Smallest distance between reported positions"] == "unknown"
    assert figures["Safety radius r"] == "unknown"
    assert "Distances are not known" in texts(draw(flight, "distances.png"))
    assert "not known" in texts(draw(flight, "formation_error.png"))
    assert "each vehicle in its own frame" in texts(draw(flight, "trajectories.png"))
    assert "sensing graph" not in texts(draw(flight, "trajectories.png"))


def test_log_without_positions_still_gives_a_report(tmp_path: Path) -> None:
    path = tmp_path / "flight.tlog"
    with TlogWriter(path, DRY_RUN_EPOCH_UNIX_US) as writer:
        writer.tick(0, 0)
    flight = load_flight(path)
    assert len(write_report(flight, tmp_path / "report")) == 5
    assert "no positions" in texts(draw(flight, "trajectories.png"))
    assert "no velocity setpoints" in texts(draw(flight, "setpoints.png"))


def test_folder_that_cannot_be_written_is_told(flight: Flight, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("a file")
    with pytest.raises(UserError, match=r"cannot write the report.*-o"):
        write_report(flight, tmp_path / "taken")


def test_matplotlib_is_loaded_only_to_draw() -> None:
    code = "import sys, groundstation.app.report; sys.exit('matplotlib' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.skipif(not REAL.is_dir(), reason="the recorded flight of 2018 is not beside the project")
def test_real_flight_of_2018(tmp_path: Path) -> None:
    import_crazyswarm(REAL, tmp_path / "flight.tlog", {})
    flight = load_flight(tmp_path / "flight.tlog")
    (axes,) = draw(flight, "distances.png").axes
    assert sum(len(line.get_xdata()) == 212 for line in axes.lines) == 28
    assert "smallest: 0.206 m" in texts(draw(flight, "distances.png"))
    assert len(write_report(flight, tmp_path / "report")) == 5


def test_the_page_has_phases_links_settings_and_hashes(flight: Flight, tmp_path: Path) -> None:
    record(tmp_path / "flight.tlog")
    facts = facts_of(flight, tmp_path / "flight.tlog")
    assert [row[0] for row in facts.phases[1:]] == [phase.name for phase in flight.phases]
    assert [row[0] for row in facts.links[1:]] == [str(track.sysid) for track in flight.vehicles]
    assert {row[2] for row in facts.links[1:]} == {"0.00 %"}
    assert "radius_m: 0.45" in facts.settings
    told = {row[0]: row[1] for row in facts.hashes}
    assert told["flight.tlog"] == hashlib.sha256((tmp_path / "flight.tlog").read_bytes()).hexdigest()
    page = to_html(flight, facts)
    for word in ("<h2>Phases</h2>", "<h2>Links</h2>", "<h2>Settings</h2>", told["flight.tlog"]):
        assert word in page


def test_what_is_not_known_is_said_in_the_papers_figures_too(flight: Flight) -> None:
    nothing = replace(flight, phases=())
    for item in PAPER_FIGURES:
        figure = Figure(figsize=item.size_in)
        item.draw(figure, nothing)
        assert figure.texts, item.stem


def test_pictures_come_in_kinds_for_papers_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    record(tmp_path / "flight.tlog")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("groundstation.app.report.PICTURES", PICTURES[1:2])
    words = ["report", "flight.tlog", "-o", "out", "--also", "svg", "--also", "pdf", "--dpi", "50"]
    assert gs(words, monkeypatch, capsys)[0] == 0
    stem = PICTURES[1].file.removesuffix(".png")
    assert (tmp_path / f"out/{stem}.svg").read_bytes().startswith(b"<?xml")
    assert (tmp_path / f"out/{stem}.pdf").read_bytes().startswith(b"%PDF")
    fifth = (tmp_path / "out/paper_fig5.pdf").read_bytes()
    assert b"/CIDFontType2" in fifth  # fonts are embedded, and no Type 3, which journals refuse
    assert b"/Type3" not in fifth
    assert f"/MediaBox [ 0 0 {COLUMN_IN * 72:g} ".encode() in fifth
    assert {path.name for path in (tmp_path / "out").glob("paper_*")} == {
        f"{item.stem}.{kind}" for item in PAPER_FIGURES for kind in ("svg", "pdf")
    }
    width = struct.unpack(">I", (tmp_path / f"out/{stem}.png").read_bytes()[16:20])[0]
    assert width == round(PICTURES[1].size_in[0] * 50)
    (tmp_path / "other").mkdir()
    (tmp_path / f"other/{stem}.svg").write_text("mine")
    words[3] = "other"
    code, _, err = gs(words, monkeypatch, capsys)
    assert (code, f"{stem}.svg" in err) == (2, True)
    assert (tmp_path / f"other/{stem}.svg").read_text() == "mine"
    code, _, err = gs([*words[:5], "gif"], monkeypatch, capsys)
    assert (code, "--also gif: unknown; known are svg, pdf" in err) == (2, True)
