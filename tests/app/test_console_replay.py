"""Replay in the console: a log at any moment, jumps, two side by side, in a real browser too."""

from __future__ import annotations

import lzma
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from playwright.sync_api import expect

from groundstation.app.console.feed import largest_error_m, smallest_distance_m
from groundstation.app.console.player import SPEEDS, Player
from groundstation.app.console.recorded import Recorded
from groundstation.app.console.snapshot import decode, encode
from groundstation.app.whatif import what_if
from groundstation.core.errors import UserError
from groundstation.records.imports import import_crazyswarm
from groundstation.records.manifest import manifest_beside
from groundstation.records.replay import Flight, load_flight
from tests.app.browser import chromium, opened
from tests.app.commands import gs
from tests.app.test_console_browser import addresses, started

LOGS = Path(__file__).parents[1] / "reference_logs"
REAL = Path(__file__).parents[3] / "shared" / "data" / "icra2019_flight"


def _unpacked(name: str, folder: Path) -> Path:
    log = folder / f"{name}.tlog"
    log.write_bytes(lzma.decompress((LOGS / f"{name}.tlog.xz").read_bytes()))
    shutil.copy(LOGS / f"{name}.manifest.json", folder)
    return log


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    return load_flight(_unpacked("lands_all", tmp_path_factory.mktemp("logs")))


@pytest.fixture(scope="module")
def recorded(flight: Flight) -> Recorded:
    return Recorded(flight)


def test_at_each_report_the_vehicle_is_where_it_was_reported(flight: Flight, recorded: Recorded) -> None:
    for row, track in enumerate(flight.vehicles):
        for at in range(0, len(track.t_ns), 37):
            if at + 1 < len(track.t_ns) and track.t_ns[at + 1] == track.t_ns[at]:
                continue  # of several in one instant the last one counts
            snapshot = recorded.at((int(track.t_ns[at]) - flight.start_ns) / 1e9)
            np.testing.assert_allclose(snapshot.pos_team_enu_m[row], track.pos_team_enu_m[at], atol=1e-6)
            assert snapshot.pose_age_s[row] == 0.0


def test_figures_phases_and_roles_are_those_of_the_log(flight: Flight, recorded: Recorded) -> None:
    nearest = next(mark for mark in recorded.marks if mark[1] == "near")
    least_m = flight.min_distance_m()
    assert least_m is not None
    assert f"{least_m:.4f} m" in nearest[2]
    snapshot = recorded.at(nearest[0])
    assert smallest_distance_m(snapshot) == pytest.approx(least_m, abs=1e-6)
    assert snapshot.figure("min_distance_m") == pytest.approx(least_m)
    assert recorded.at(nearest[0] - 1.0).figure("min_distance_m") > least_m
    assert np.nanmin(recorded.history[:, 1]) == least_m  # thinned, and yet there
    middle = len(recorded.pairs) // 2
    at_ns = np.array([round(float(recorded.pairs[middle, 0]) * 1e9) + flight.start_ns])
    np.testing.assert_allclose(recorded.pairs[middle, 1:], flight.distances_at(at_ns)[0], atol=1e-6)
    for name, begin_s, end_s in recorded.phases():
        if end_s > begin_s:
            assert recorded.at((begin_s + end_s) / 2).words.phase == name
    end = recorded.at(recorded.duration_s)
    result = flight.manifest.result if flight.manifest is not None else None
    assert result is not None
    assert end.words.outcome == result["outcome"] != recorded.at(recorded.duration_s - 0.1).words.outcome
    assert end.figure("setpoints") == flight.setpoints
    t_ns = flight.start_ns + round(recorded.duration_s / 2 * 1e9)
    assert tuple(recorded.at(recorded.duration_s / 2).role.tolist()) == flight.roles_at(t_ns)
    error_m = flight.formation_error_at(np.array([t_ns]))[0]
    assert largest_error_m(recorded.at(recorded.duration_s / 2)) == pytest.approx(error_m, nan_ok=True)


def test_events_and_orders_are_marks_in_order_of_time(flight: Flight, recorded: Recorded) -> None:
    times = [t_s for t_s, *_ in recorded.marks]
    assert times == sorted(times)
    phases = [(t_s, text) for t_s, kind, text in recorded.marks if kind == "phase"]
    assert phases == [(begin_s, name) for name, begin_s, _ in recorded.phases()]
    assert [text for _, kind, text in recorded.marks if kind == "order"] == [order.text for order in flight.operator]
    assert flight.operator  # so that an empty list is no success


@settings(deadline=None)
@given(st.floats(-10.0, 1_000.0))
def test_every_moment_is_a_snapshot_that_can_be_shown(recorded: Recorded, t_s: float) -> None:
    snapshot = recorded.at(t_s)
    back = decode(encode(snapshot))
    assert back.words.phase == snapshot.words.phase
    if not 0.0 <= t_s <= recorded.duration_s:
        assert np.isnan(snapshot.pos_team_enu_m).all() or recorded.at(0.0).t_s == 0.0


def test_a_log_without_a_manifest_is_shown_as_far_as_it_tells(tmp_path: Path) -> None:
    log = _unpacked("completed", tmp_path)
    (tmp_path / "completed.manifest.json").unlink()
    recorded = Recorded(load_flight(log))
    snapshot = recorded.at(recorded.duration_s / 2)
    assert np.isnan(snapshot.words.radius_m)
    assert len(snapshot.edges) == 0
    assert np.isnan(largest_error_m(snapshot))
    flown_m = np.concatenate([track.pos_team_enu_m for track in recorded.flight.vehicles])
    low, high = snapshot.fence_enu_m
    size_m = float(np.ptp(flown_m, axis=0)[:2].max())
    np.testing.assert_allclose(flown_m.min(axis=0)[:2] - low[:2], max(0.5, 0.3 * size_m))
    np.testing.assert_allclose(high - flown_m.max(axis=0), [max(0.5, 0.3 * size_m)] * 2 + [0.5])


@settings(deadline=None)
@given(st.lists(st.one_of(st.just("toggle"), st.floats(-5.0, 50.0), st.sampled_from(SPEEDS), st.integers(0, 3))))
def test_a_player_never_leaves_the_flight(deeds: list[str | float | int]) -> None:
    player, marks = Player(30.0), [(1.0, "info", "a"), (20.0, "info", "b")]
    for deed in deeds:
        if deed == "toggle":
            player.toggle()
        elif isinstance(deed, int):
            player.step(marks, onward=deed > 1)
        elif deed in SPEEDS:
            player.speed = float(deed)
        else:
            player.passed(abs(float(deed)))
        assert 0.0 <= player.t_s <= 30.0


def test_a_player_plays_at_its_speed_pauses_at_the_end_and_steps_through_marks() -> None:
    player, marks = Player(30.0), [(1.0, "info", "a"), (20.0, "info", "b")]
    player.passed(5.0)
    assert player.t_s == 0.0  # it pauses
    player.speed = 2.0
    player.toggle()
    player.passed(5.0)
    assert player.t_s == 10.0
    assert player.step(marks, onward=True) == marks[1]
    assert player.step(marks, onward=True) is None
    assert player.t_s == 20.0
    assert player.step(marks, onward=False) == marks[0]
    player.passed(100.0)
    assert (player.t_s, player.playing) == (30.0, False)
    player.toggle()
    assert (player.t_s, player.playing) == (0.0, True)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--log", "nowhere"], "nowhere"),
        (["--log", "a", "--log", "b", "--log", "c"], "two go side by side"),
        (["--log", "a", "--flight", "cube8"], "leave one of them out"),
    ],
)
def test_what_cannot_be_replayed_is_told(
    words: list[str], told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, err = gs(["console", *words], monkeypatch, capsys)
    assert code == 2
    assert told in err
    assert "Traceback" not in out + err


@pytest.mark.skipif(not REAL.is_dir(), reason="the recorded flight of 2018 is not beside the project")
def test_the_real_flight_of_2018_shows_its_smallest_distance_where_it_happened(tmp_path: Path) -> None:
    log = tmp_path / "real.tlog"
    import_crazyswarm(REAL, log, {})
    recorded = Recorded(load_flight(log))
    at_s, _, text = next(mark for mark in recorded.marks if mark[1] == "near")
    assert text == "smallest distance of the flight: 0.2058 m, vehicles 5 and 6"
    assert round(smallest_distance_m(recorded.at(at_s)), 4) == 0.2058
    positions = np.loadtxt(REAL / "positions.csv", delimiter=",", skiprows=1).reshape(-1, 8, 3)
    # The authors' own file, read without our code; its columns are roles, which vehicles swap.
    apart_m = np.linalg.norm(positions[:, :, None] - positions[:, None], axis=-1) + 9.0 * np.eye(8)
    least_m = apart_m.min(axis=(1, 2))
    stamps = np.loadtxt(REAL / "time_stamp.csv", skiprows=1)
    assert round(least_m.min(), 4) == 0.2058
    assert at_s == pytest.approx(stamps[least_m.argmin()] - stamps[0], abs=1e-3)


def test_what_other_gains_would_have_said_to_the_same_poses(tmp_path: Path) -> None:
    log = _unpacked("completed", tmp_path)
    manifest = manifest_beside(log)
    assert manifest is not None
    assert manifest.gains_npz is not None
    same = tmp_path / "same.npz"
    same.write_bytes(manifest.gains_npz)
    assert what_if(log, [], same).figures()["whatif_max_m_s"] == 0.0
    other = what_if(log, ["gain=0.2"])
    assert other.note == ""
    # What was said is what the log has, wherever it was sent; setpoints of the first one, a PX4, were shaped besides.
    track = load_flight(log).vehicles[1]
    flying = np.all(np.isfinite(other.was_enu_m_s[:, 1]), axis=1)
    rows = np.searchsorted(other.t_ns, track.setpoint_t_ns, side="right") - 1
    sent = flying[rows]
    np.testing.assert_allclose(other.was_enu_m_s[rows[sent], 1], track.setpoint_vel_enu_m_s[sent], atol=1e-6)
    assert 0.0 < float(np.nanmax(other.apart_m_s)) < 1.0
    for change in ("vehicles.0.id=3", "rate_hz=10"):
        with pytest.raises(UserError, match="are the log's own"):
            what_if(log, [change])
    with pytest.raises(UserError, match=r"[Nn]o such file"):
        what_if(log, [], tmp_path / "none.npz")


def test_two_logs_side_by_side_in_a_browser(tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("r")
    logs = [_unpacked(name, folder) for name in ("lands_all", "completed")]
    shown = [Recorded(load_flight(log)) for log in logs]
    least = next(mark for mark in shown[0].marks if mark[1] == "near")
    words = " ".join(f"--log {log}" for log in logs)
    with chromium() as browser, started(f"console --port 0 {words}", folder) as console:
        tab = opened(browser, addresses(console)["replay"], scheme="dark")
        tab.press("smallest distance")
        ids = [item.id for one in shown for item in one.flight.vehicles]  # both flew by GPS: two maps
        expect(tab.page.locator(".leaflet-tooltip")).to_have_text([str(number) for number in ids])
        expect(tab.page.get_by_test_id("map").first).to_have_css("background-color", "rgb(32, 36, 42)")
        tab.shows("distance_now_m", least[2].split(": ")[1].split(",")[0])
        tab.shows("age", f"{least[0]:.2f} s")
        tab.shows("other-phase", shown[1].at(least[0]).words.phase)
        tab.page.get_by_test_id("what-if").click()
        tab.page.get_by_test_id("changes").fill("gain=0.2")
        tab.press("compare setpoints")
        expect(tab.page.get_by_test_id("what-if-said")).to_contain_text("largest difference 0.")
        tab.press("next event (.)")
        after = next(mark for mark in shown[0].marks if mark[0] > least[0] + 1e-6)
        tab.shows("age", f"{after[0]:.2f} s")
        tab.page.get_by_test_id("slider").click(position={"x": 1, "y": 10})  # scrubbed to its begin
        tab.shows("setpoints", str(int(shown[0].at(0.0).figure("setpoints"))))
        tab.press("play (space)")
        tab.page.get_by_role("combobox").first.click()
        tab.page.get_by_role("option", name="16 times").click()
        tab.shows("phase", shown[0].at(shown[0].duration_s).words.outcome)  # to the end
        tab.shows("age", f"{shown[0].duration_s:.2f} s")
        assert tab.wrong == []
