"""Readers of logs count what the flight counted, and nothing else."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink import mavutil

from groundstation.core.identify import STEP_S
from groundstation.mavlink.codec import Encoder
from groundstation.mission.runner import Phase
from groundstation.records.manifest import Manifest, manifest_path, write_manifest
from groundstation.records.replay import load_flight
from groundstation.records.responses import load_motions
from groundstation.records.tlog import TlogWriter
from tests.app.flights import Flight, pair

EPOCH_US = 1_577_836_800_000_000
TICK_NS = 100_000_000
TEAM = {
    "vehicles": [
        {"id": 1, "origin": "team", "link": "udpin://0.0.0.0:14540"},
        {"id": 2, "origin": "team", "link": "udpin://0.0.0.0:14541"},
    ]
}


class Log:
    """A log of two vehicles 1 m apart, 1 going north at 1 m/s, with whatever else is put into it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._writer = TlogWriter(path, EPOCH_US)
        self._ground = Encoder(255, 190)
        self._vehicles = {sysid: Encoder(sysid) for sysid in (1, 2)}

    def fly(self, intrude: Any = lambda *_: None, starts_anew: int = 50) -> Path:
        for tick in range(50):
            t_ns = tick * TICK_NS
            if tick == 5:
                self._writer.event("phase: arm", t_ns)
            for sysid, east in ((1, 0.0), (2, 1.0)):
                speed = math.sin(tick / 8)
                boot_ms = 100 * (tick - starts_anew) if tick >= starts_anew and sysid == 1 else 10_000 + 100 * tick
                values = {"time_boot_ms": boot_ms, "y": east, "vx": speed}
                frame = self._vehicles[sysid].encode("LOCAL_POSITION_NED", **values)
                self._writer.received(sysid - 1, f"10.0.0.{sysid}:9", frame, t_ns)
                setpoint = {"target_system": sysid, "type_mask": 0x0DC7, "vx": math.sin((tick + 1) / 8)}
                self._writer.sent(self._ground.encode("SET_POSITION_TARGET_LOCAL_NED", **setpoint), t_ns)
            intrude(self._writer, tick, t_ns)
        self._writer.close()
        write_manifest(manifest_path(self.path), Manifest(mission=TEAM, epoch_unix_us=EPOCH_US))
        return self.path


def near(sysid: int, compid: int, tick: int, boot_ms: int | None = None, **more: float) -> bytes:
    """A position 0.1 m from vehicle 2, that goes south."""
    values = {"time_boot_ms": 10_050 + 100 * tick if boot_ms is None else boot_ms, "y": 0.9, "vx": -1.0, **more}
    return Encoder(sysid, compid).encode("LOCAL_POSITION_NED", **values)


INTRUDERS = {
    "a companion computer": lambda log, tick, t: log.received(0, "10.0.0.1:9", near(1, 197, tick), t),
    "the same component of another system on that link": lambda log, tick, t: log.received(
        1, "10.0.0.1:9", near(1, 1, tick), t
    ),
    "a second sender under the vehicle's id": lambda log, tick, t: log.received(0, "10.0.0.66:9", near(1, 1, tick), t),
    "old positions": lambda log, tick, t: log.received(0, "10.0.0.1:9", near(1, 1, tick, 9_500 + 100 * tick), t),
    "a position without a velocity": lambda log, tick, t: log.received(
        0, "10.0.0.1:9", near(1, 1, tick, vz=math.nan), t
    ),
    "a system that is not in the mission": lambda log, tick, t: log.received(0, "10.0.0.1:9", near(3, 1, tick), t),
}


@pytest.mark.parametrize("what", INTRUDERS)
def test_positions_that_the_flight_refused_alter_no_figure(what: str, tmp_path: Path) -> None:
    clean = load_flight(Log(tmp_path / "clean.tlog").fly())
    path = Log(tmp_path / "flight.tlog").fly(INTRUDERS[what])
    flight = load_flight(path)
    assert flight.min_distance_m() == clean.min_distance_m() == 1.0
    assert [len(track.t_ns) for track in flight.vehicles] == [50, 50]
    for ours, theirs in zip(load_motions(path, STEP_S), load_motions(clean_path(tmp_path), STEP_S), strict=True):
        np.testing.assert_array_equal(ours.done_enu_m_s, theirs.done_enu_m_s)


def clean_path(folder: Path) -> Path:
    return folder / "clean.tlog"


def test_a_vehicle_that_starts_anew_after_arming_has_no_place_from_then_on(tmp_path: Path) -> None:
    flight = load_flight(Log(tmp_path / "flight.tlog").fly(starts_anew=30))
    assert flight.min_distance_m() == 1.0
    assert flight.vehicles[0].t_ns[-1] == 29 * TICK_NS
    assert flight.vehicles[1].t_ns[-1] == 49 * TICK_NS


def test_a_companion_computer_in_a_flight_alters_neither_distance_nor_lag(tmp_path: Path) -> None:
    """The figures of a whole dry run, once as it was and once with the companion's frames taken out by pymavlink."""
    path = tmp_path / "flight.tlog"
    companion = Encoder(1, 197)

    def intrude(flight: Flight) -> tuple[str, bytes] | None:
        if flight.runner.phase is Phase.CONNECT:
            return None
        position, speed = flight.runner.fleet.pos_local_ned_m[1], math.sin(flight.now_ns / 1e9)
        values = dict(zip(("x", "y", "z"), position.tolist(), strict=True))
        frame = companion.encode("LOCAL_POSITION_NED", time_boot_ms=flight.now_ns // 1_000_000, vx=speed, **values)
        return "emulator:1", frame

    flight = Flight(pair(), log=path, intrude=intrude)
    assert flight.runner.outcome == "completed"
    log = mavutil.mavlink_connection(str(path), dialect="ardupilotmega")
    clean, dropped = bytearray(), 0
    while (message := log.recv_msg()) is not None:
        if (message.get_srcSystem(), message.get_srcComponent()) == (1, 197):
            dropped += 1
            continue
        clean += round(message._timestamp * 1e6).to_bytes(8, "big") + bytes(message.get_msgbuf())
    log.close()
    other = tmp_path / "clean.tlog"
    other.write_bytes(clean)
    manifest_path(other).write_bytes(manifest_path(path).read_bytes())
    assert dropped > 300
    with_it, without = load_flight(path), load_flight(other)
    assert with_it.min_distance_m() == without.min_distance_m()
    assert with_it.samples == without.samples
    for ours, theirs in zip(load_motions(path, STEP_S), load_motions(other, STEP_S), strict=True):
        np.testing.assert_array_equal(ours.done_enu_m_s, theirs.done_enu_m_s)
