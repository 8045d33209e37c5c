"""Logs of other programs, written here by pymavlink's own encoder: stamps, frames, and what is no log."""

from __future__ import annotations

import json
import operator
import struct
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as dialect

from groundstation.core.errors import UserError
from groundstation.records.replay import load_flight
from groundstation.records.tlog import read_tlog
from tests.app.commands import gs

BEGIN_S = 1_700_000_000.0
EARTH_M = 6_371_000.0
LAT_DEG, LON_DEG = 47.0, 8.0
Clock = Callable[[float], float]
"""What the recording computer's clock says at a true time."""


class Station:
    """A ground station's recorder: a .tlog as mavutil writes it, of vehicles that fly 5 m from each other.

    Args:
        path: of the log.
        clock: of the computer that records.
        sysids: the vehicles.
        kinds: what they send: "local", "global", "attitude".
    """

    def __init__(
        self,
        path: Path,
        clock: Clock = lambda t: t,
        sysids: Sequence[int] = (1, 2),
        kinds: Sequence[str] = ("global",),
        starts_anew_s: float = 1e9,
    ) -> None:
        self.path, self._clock, self._sysids, self._kinds = path, clock, sysids, kinds
        self._starts_anew_s = starts_anew_s
        self._arrived: list[tuple[float, bytes]] = []
        self._links = {sysid: dialect.MAVLink(None, srcSystem=sysid, srcComponent=1) for sysid in (*sysids, 42)}
        self._links[42].srcComponent = 190

    def put(self, sysid: int, message: Any, t_s: float) -> None:
        """Lets a message arrive."""
        self._arrived.append((t_s, message.pack(self._links[sysid])))

    def record(self, seconds: float, quiet: tuple[float, float] = (0.0, 0.0), delay: Clock = lambda t: 0.0) -> Path:
        """Records a flight to the east at 1 m/s, a vehicle every 5 m, vehicle k north of vehicle k - 1."""
        for tick in range(round(seconds * 10)):
            t = tick / 10
            if quiet[0] <= t < quiet[1]:
                continue
            for k, sysid in enumerate(self._sysids):
                self._vehicle(k, sysid, t, t + delay(t))
            if tick % 10 == 0:
                self.put(42, dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), t)
        with self.path.open("wb") as log:  # as mavutil and MAVProxy write it
            for t_s, frame in sorted(self._arrived, key=lambda item: item[0]):
                log.write(struct.pack(">Q", round((BEGIN_S + self._clock(t_s)) * 1e6)) + frame)
        return self.path

    def _vehicle(self, k: int, sysid: int, t: float, arrival: float) -> None:
        boot_ms = round((t - self._starts_anew_s if t >= self._starts_anew_s else 1000 + t) * 1000)
        east, north = t, 5.0 * k
        if round(t * 10) % 10 == 0:
            self.put(sysid, dialect.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3), arrival)
        if "global" in self._kinds:
            lat = LAT_DEG + np.degrees(north / EARTH_M)
            lon = LON_DEG + np.degrees(east / (EARTH_M * np.cos(np.radians(LAT_DEG))))
            place = round(lat * 1e7), round(lon * 1e7)
            up_mm = 450_000 + 1000 * k
            message = dialect.MAVLink_global_position_int_message(boot_ms, *place, up_mm, 0, 0, 0, 0, 0)
            self.put(sysid, message, arrival)
        if "local" in self._kinds:
            self.put(sysid, dialect.MAVLink_local_position_ned_message(boot_ms, 0, east, 0, 0, 1, 0), arrival)
        if "attitude" in self._kinds:
            self.put(sysid, dialect.MAVLink_attitude_message(boot_ms, 0, 0, 0, 0, 0, 0), arrival)


def stepped(at_s: float, by_s: float) -> Clock:
    return lambda t: t if t < at_s else t + by_s


def test_vehicles_that_tell_places_on_earth_alone_share_a_frame(tmp_path: Path) -> None:
    path = Station(tmp_path / "a.tlog", sysids=(1, 2, 7)).record(10)
    flight = load_flight(path)
    assert [track.sysid for track in flight.vehicles] == [1, 2, 7]
    assert flight.samples == 100
    # 5 m north and 1 m up of each other; the earth is no sphere, and 1e-7 degrees are a centimetre
    assert flight.min_distance_m() == pytest.approx(np.hypot(5.0, 1.0), abs=0.05)
    moved = flight.vehicles[0].pos_team_enu_m[-1] - flight.vehicles[0].pos_team_enu_m[0]
    np.testing.assert_allclose(moved, [9.9, 0.0, 0.0], atol=0.05)
    assert any("GLOBAL_POSITION_INT" in note for note in flight.notes)


def test_one_vehicle_is_read_by_its_local_positions(tmp_path: Path) -> None:
    flight = load_flight(Station(tmp_path / "a.tlog", sysids=(1,), kinds=("global", "local")).record(10))
    assert not flight.vehicles[0].in_team_frame
    np.testing.assert_allclose(flight.vehicles[0].pos_team_enu_m[-1], [9.9, 0, 0], atol=1e-6)


@pytest.mark.parametrize("by_s", [3600.0, 2.0, -2.0, -3600.0, 0.8, 1.7e9 - 1e5])
@pytest.mark.parametrize("sysids", [(1,), (1, 2, 3)])
def test_a_clock_that_is_set_while_it_records_alters_no_figure(
    by_s: float, sysids: Sequence[int], tmp_path: Path
) -> None:
    straight = load_flight(Station(tmp_path / "a.tlog", sysids=sysids).record(60))
    flight = load_flight(Station(tmp_path / "b.tlog", stepped(30.05, by_s), sysids).record(60))
    assert flight.duration_s == pytest.approx(straight.duration_s, abs=0.15)
    assert flight.min_distance_m() == pytest.approx(straight.min_distance_m(), abs=0.02)
    for ours, theirs in zip(flight.vehicles, straight.vehicles, strict=True):
        np.testing.assert_allclose(ours.t_ns, theirs.t_ns, atol=0.15e9)
    (note,) = (note for note in flight.notes if "the clock that" in note)
    assert f"was set by {by_s:+.1f}"[:-1] in note
    assert "after 30.0 s" in note or "after 29.9 s" in note or "after 30.1 s" in note
    assert not any("the clock that" in note for note in straight.notes)


@pytest.mark.parametrize(
    ("clock", "by_stamps"),
    [(lambda _t: 0.0, "0.00"), (lambda t: t / 1000.0, "0.02"), (lambda t: 0.3 * t, "5.97")],
    ids=["stands", "milliseconds", "a quick simulator"],
)
@pytest.mark.parametrize("sysids", [(1,), (1, 2)])
def test_stamps_that_hardly_go_on_are_told_by_the_vehicles_times(
    sysids: Sequence[int], clock: Clock, by_stamps: str, tmp_path: Path
) -> None:
    (note,) = read_tlog(Station(tmp_path / "a.tlog", clock, sysids=sysids).record(20)).notes
    assert note.startswith(f"the vehicles' own times go on by 19.9 s, the time stamps by {by_stamps} s: the clock ")
    for rate in (0.8, 1.0, 1.3):
        assert not read_tlog(Station(tmp_path / "b.tlog", partial(operator.mul, rate)).record(20)).notes


def test_messages_that_tell_of_a_little_earlier_in_turns_make_no_slow_clock(tmp_path: Path) -> None:
    station = Station(tmp_path / "a.tlog", sysids=(1,))
    for tick in range(200):  # between the positions, each of 0.2 s before
        message = dialect.MAVLink_attitude_message(round(1000 * (1000 + tick / 10 - 0.2)), 0, 0, 0, 0, 0, 0)
        station.put(1, message, tick / 10 + 0.05)
    assert not read_tlog(station.record(20)).notes


def test_two_steps_are_both_put_right(tmp_path: Path) -> None:
    clock = lambda t: t + (3600.0 if 10.05 <= t < 40.05 else 0.0)  # noqa: E731 - set, and set back
    flight = load_flight(Station(tmp_path / "a.tlog", clock).record(60))
    assert flight.duration_s == pytest.approx(59.9, abs=0.15)
    assert sum("the clock that" in note for note in flight.notes) == 2


NO_STEPS: dict[str, dict[str, Any]] = {
    "a pause": {"quiet": (20, 50)},
    "a link that stalls and delivers everything at once": {"delay": lambda t: max(0.0, 33.0 - t) if t >= 30 else 0.0},
    "a link that gets later and later, and catches up": {"delay": lambda t: (t - 20) / 10 if 20 <= t < 45 else 0.0},
    "a link that is late for twenty seconds": {"delay": lambda t: 1.5 if 20 <= t < 40 else 0.0},
}


@pytest.mark.parametrize("what", NO_STEPS)
@pytest.mark.parametrize("sysids", [(1,), (1, 2)])
def test_what_is_no_step_is_taken_for_none(what: str, sysids: Sequence[int], tmp_path: Path) -> None:
    flight = load_flight(Station(tmp_path / "a.tlog", sysids=sysids).record(60, **NO_STEPS[what]))
    assert flight.duration_s == pytest.approx(59.9, abs=0.01)
    assert not any("the clock that" in note for note in flight.notes)
    assert flight.message is None


def test_a_vehicle_that_starts_anew_sets_no_clock(tmp_path: Path) -> None:
    flight = load_flight(Station(tmp_path / "c.tlog", starts_anew_s=30.0).record(60))
    assert flight.duration_s == pytest.approx(59.9, abs=0.01)
    assert not any("the clock that" in note for note in flight.notes)


def test_stamps_that_run_back_without_any_vehicle_time_end_the_reading(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = Station(tmp_path / "a.tlog", stepped(30.05, -3600.0), kinds=()).record(60)
    flight = load_flight(path)
    assert flight.duration_s == pytest.approx(30.0, abs=0.1)
    assert "run back by 3599" in " ".join(flight.notes)
    assert "run back" in str(flight.message)
    ahead = load_flight(Station(tmp_path / "b.tlog", stepped(30.05, 3600.0), kinds=()).record(60))
    assert "a pause, or the clock that stamped the log was set" in " ".join(ahead.notes)
    assert gs(["replay", str(path)], monkeypatch, capsys)[0] == 1


@pytest.mark.parametrize("command", ["replay", "report", "identify"])
def test_a_log_with_nothing_of_use_says_what_is_in_it_and_fails(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = Station(tmp_path / "a.tlog", kinds=("attitude",)).record(10)
    more = ["-o", str(tmp_path / "report")] if command == "report" else []
    code, out, err = gs([command, str(path), *more, "--json"], monkeypatch, capsys)
    assert code == 1
    assert "system 1, component 1 (quadrotor, ardupilotmega): ATTITUDE 100, HEARTBEAT 10" in err
    assert "system 42, component 190 (ground station): HEARTBEAT 10" in err
    assert not (tmp_path / "report").exists()
    if command == "replay":
        (first, *_) = json.loads(out.splitlines()[-1])["contents"]
        assert "ATTITUDE 100" in first


def test_a_companions_positions_count_in_no_foreign_log(tmp_path: Path) -> None:
    station = Station(tmp_path / "a.tlog")
    station._links[1].srcComponent = 1
    companion = dialect.MAVLink(None, srcSystem=1, srcComponent=197)
    station._links[3] = companion
    for tick in range(100):
        beside = dialect.MAVLink_global_position_int_message(
            1_000_000 + 100 * tick, round(LAT_DEG * 1e7) + 440, round(LON_DEG * 1e7), 451_000, 0, 0, 0, 0, 0
        )
        station.put(3, beside, tick / 10)
    flight = load_flight(station.record(10))
    assert flight.samples == 100
    assert flight.min_distance_m() == pytest.approx(np.hypot(5.0, 1.0), abs=0.05)


def raw_mavlink(path: Path) -> None:
    """What mavutil writes with ``logfile_raw``, MAVProxy's .tlog.raw: frames alone."""
    link = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    path.write_bytes(b"".join(dialect.MAVLink_attitude_message(k, 0, 0, 0, 0, 0, 0).pack(link) for k in range(500)))


OTHER_KINDS: dict[str, tuple[Callable[[Path], object], str]] = {
    "raw MAVLink": (raw_mavlink, "is MAVLink without time stamps"),
    "a ULog": (lambda path: path.write_bytes(b"ULog\x01\x12\x35\x01" + bytes(range(256)) * 40), "is a ULog"),
    "DataFlash": (lambda path: path.write_bytes(b"\xa3\x95\x80\x80" + bytes(range(256)) * 40), "is a DataFlash log"),
    "packed": (lambda path: path.write_bytes(b"\xfd7zXZ\x00" + bytes(range(256)) * 40), "packed with xz"),
}


@pytest.mark.parametrize("kind", OTHER_KINDS)
@pytest.mark.parametrize("command", ["replay", "report", "identify"])
def test_files_of_other_kinds_are_told_and_not_read(
    kind: str, command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write, words = OTHER_KINDS[kind]
    path = tmp_path / "a.tlog"
    write(path)
    with pytest.raises(UserError, match=words):
        read_tlog(path)
    more = ["-o", str(tmp_path / "report")] if command == "report" else []
    code, _, err = gs([command, str(path), *more], monkeypatch, capsys)
    assert code == 2
    assert words in " ".join(err.split())


def test_pymavlink_reads_these_logs_as_we_do(tmp_path: Path) -> None:
    """The logs made here are logs to mavutil too: as many messages, from the same senders."""
    path = Station(tmp_path / "a.tlog").record(10)
    log = mavutil.mavlink_connection(str(path), dialect="ardupilotmega")
    theirs: dict[tuple[int, int], int] = {}
    while (message := log.recv_msg()) is not None:
        sender = message.get_srcSystem(), message.get_srcComponent()
        theirs[sender] = theirs.get(sender, 0) + 1
    log.close()
    assert {address: item.counts.total() for address, item in read_tlog(path).survey().senders.items()} == theirs
