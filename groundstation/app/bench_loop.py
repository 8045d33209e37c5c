"""What a flight over sockets costs and how punctual it is, by size of the team, with the emulator in another process.

Teams hover above a grid of pads for a while, positions and attitudes coming in and setpoints going out 50 times a
second each. Beside the ground station's processor time stands what pymavlink alone takes to read what came in.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Event

from pymavlink.dialects.v20 import ardupilotmega as dialect

from groundstation.app.bench_tick import hover_mission
from groundstation.app.emulator import world_config
from groundstation.app.killed_flight import free_port
from groundstation.app.output import Output
from groundstation.mission.plan.reading import load_mission
from groundstation.records.notes import Received
from groundstation.records.tlog import read_tlog
from sitl.server import Server

_SIZES = (8, 30, 100)
_HOVER_S = 20.0
_LOOK_S = 0.05
_GS = "from groundstation.app.cli import main; main()"
_PERCENTILES = ("tick_late_ms", "tick_work_ms", "telemetry_to_setpoint_ms")


def run(out: Output) -> dict[str, float | int | str]:
    """Measures and returns the figures; a minute and a half, on the wall clock."""
    values: dict[str, float | int | str] = {"hover_s": _HOVER_S}
    for n in _SIZES:
        out.console.print(f"{n} vehicles: pads, {_HOVER_S:g} s of hovering, pads")
        with TemporaryDirectory() as folder:
            values |= {f"n{n}_{key}": value for key, value in _fly(n, Path(folder)).items()}
    return values


def _fly(n: int, folder: Path) -> dict[str, float | int | str]:
    """Flies once."""
    port, mission, log = free_port(), folder / "hover.yaml", folder / "hover.tlog"
    mission.write_text(hover_mission(n, port, _HOVER_S), encoding="utf-8")
    stop, before = Event(), resource.getrusage(resource.RUSAGE_CHILDREN)
    call = [sys.executable, "-c", _GS, "fly", "--mission", str(mission), "--log", str(log), "--json"]
    with (
        Server(world_config(load_mission(mission), 1), 1, port=port) as server,
        subprocess.Popen(  # noqa: S603 - ourselves
            call,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        ) as process,
    ):

        def look(_server: Server) -> None:
            if process.poll() is not None:
                stop.set()

        server.run(stop, look, _LOOK_S)
        text, _ = process.communicate()
    answer = json.loads(text.splitlines()[-1])
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    used_s = used.ru_utime + used.ru_stime - before.ru_utime - before.ru_stime
    values: dict[str, float | int | str] = {
        "outcome": answer["outcome"],  # a machine that is too busy for the emulator brings everybody home
        "ticks": answer["ticks"],
        "late_share": answer["deadline_misses"] / answer["ticks"],
        "cores": used_s / answer["wall_s"],
        "pymavlink_reads_cores": _their_reading_s(log) / answer["wall_s"],
        "emulator_skipped_s": server.late_ns / 1e9,
    }
    for key in _PERCENTILES:
        values |= {f"{key}_{name}": answer[key][name] for name in ("p50", "p99", "max")}
    return values


def _their_reading_s(log: Path) -> float:
    """Processor time in which pymavlink reads all frames that came in, one after the other."""
    raws = [record.frame.raw for record in read_tlog(log) if isinstance(record, Received)]
    parser = dialect.MAVLink(None)
    start_s = time.process_time()
    for raw in raws:
        parser.parse_buffer(raw)
    return time.process_time() - start_s
