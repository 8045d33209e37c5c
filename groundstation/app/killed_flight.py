"""Flies ``gs fly`` as a process of its own against an emulator, does something to it, and looks at what becomes of it.

The emulator runs here, in real time behind UDP sockets, with the autopilots' failsafes as preflight sets them; its
truth says how near the vehicles came to each other. Vehicles that are still up after a while are taken over by another
``gs fly``. Judges nothing: whoever calls compares figures with limits.
"""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import IO, Any

import numpy as np

from groundstation.app.emulator import world_config
from groundstation.app.verify import verify_log
from groundstation.core.errors import UserError
from groundstation.mission.plan.reading import load_mission
from groundstation.mission.timing import SECOND_NS
from groundstation.records.replay import load_flight
from sitl.server import Server
from sitl.world import World

_LOOK_S = 0.01
_SETTLED_NS = 3 * SECOND_NS // 2  # after the deed: an arming that is under way shows by then
_LIMIT_NS = 200 * SECOND_NS
_EXIT_NS = 30 * SECOND_NS


@dataclass(frozen=True)
class KilledFlight:
    """What became of one flight.

    Attributes:
        phase: last phase in the log.
        after_s: from the emulator hearing the ground station for the first time to the deed.
        modes: modes that the vehicles in the air were in when the take-over began, each once; empty without one.
        down_s: from the deed to everybody being disarmed on the ground; NaN when that did not happen.
        before_m: smallest true distance of two vehicles of which at least one is in the air, until the deed.
        min_distance_m: the same of the whole flight.
        exit_code: of the process; negative for a signal, None when it had to be ended.
        take_over_code: exit code of the one that took over; None where there was none, or it had to be ended.
        log_message: what of the log could not be read, "" when all of it is whole.
        log_lost_s: from the last record to the deed, NaN when the process was not killed.
        setpoints: in the log.
        mismatches: setpoints and other frames that a replay of the log does not find again.
        output: what the processes printed.
        late_s: time that the emulator skipped because the machine was too slow.
    """

    phase: str
    after_s: float
    modes: tuple[str, ...]
    down_s: float
    before_m: float
    min_distance_m: float
    exit_code: int | None
    take_over_code: int | None
    log_message: str
    log_lost_s: float
    setpoints: int
    mismatches: int
    output: str
    late_s: float


class Watched:
    """An emulated team, the ground station that flies it, and the smallest true distance so far.

    Attributes:
        world: the emulator's.
        process: ``gs fly``.
        min_distance_m: as ``KilledFlight`` has it.
        log: the flight's.
    """

    def __init__(self, world: World, process: subprocess.Popen[bytes], log: Path) -> None:
        self.world, self.process, self.log = world, process, log
        self.min_distance_m = float("inf")
        self._heard_ns: int | None = None
        self._pairs = np.triu_indices(world.n, 1)

    @property
    def flying_s(self) -> float:
        """Since the emulator first heard the ground station, negative before."""
        return -1.0 if self._heard_ns is None else (self.world.now_ns - self._heard_ns) / SECOND_NS

    @property
    def down(self) -> bool:
        """Whether everybody is disarmed and on the ground."""
        truth = self.world.truth
        return not truth.armed.any() and not truth.airborne.any()

    def look(self) -> None:
        """Measures."""
        if self._heard_ns is None:
            self._heard_ns = self.world.autopilots[0].gcs_heard_ns
        truth, (first, second) = self.world.truth, self._pairs
        up = truth.airborne[first] | truth.airborne[second]
        if up.any():
            apart_m = np.linalg.norm(truth.pos_enu_m[first] - truth.pos_enu_m[second], axis=1)
            self.min_distance_m = min(self.min_distance_m, float(apart_m[up].min()))


def kill(watched: Watched) -> None:
    """SIGKILL."""
    watched.process.send_signal(signal.SIGKILL)


def fly_and(
    deed: Callable[[Watched], None],
    when: Callable[[Watched], bool],
    mission: Path,
    folder: Path,
    *,
    seed: int = 1,
    changes: Sequence[str] = (),
    then: Callable[[Watched], None] | None = None,
    take_over_s: float = 5.0,
) -> KilledFlight:
    """Flies a mission in a process of its own and does something to it.

    Args:
        deed: done once.
        when: asked every 10 ms whether it is time.
        mission: file; its links are replaced.
        folder: for the logs and the output.
        seed: of the emulator.
        changes: of the mission, as ``--set`` takes them.
        then: called every 10 ms after the deed.
        take_over_s: from the end of the process to the take-over of those that are still up.

    Raises:
        UserError: the mission is wrong.
    """
    port = free_port()
    plan = load_mission(mission, changes)
    sets = [*(f"vehicles.{number}.link=udpin://127.0.0.1:{port}" for number in range(plan.size)), *changes]
    log = folder / "flight.tlog"
    stop = Event()
    times: dict[str, int] = {}
    modes: tuple[str, ...] = ()
    before_m = float("inf")
    successors: list[subprocess.Popen[bytes]] = []
    with (
        Server(world_config(plan, seed), seed, port=port) as server,
        (folder / "output.txt").open("wb") as output,
        ExitStack() as stack,
    ):
        world = server.world
        process = stack.enter_context(_start(mission, log, sets, output, piped=deed is close_stdout))
        stack.callback(_end, process)
        watched = Watched(world, process, log)
        began_ns = world.now_ns

        def look(_server: Server) -> None:
            nonlocal modes, before_m
            watched.look()
            now_ns = world.now_ns
            if "deed" not in times and watched.flying_s >= 0.0 and when(watched):
                deed(watched)
                times["deed"], times["late"] = now_ns, server.late_ns
                before_m = watched.min_distance_m
            if "deed" in times and then is not None:
                then(watched)
            if process.poll() is not None:
                ended_ns = times.setdefault("ended", now_ns)
                if watched.down and now_ns - ended_ns >= _SETTLED_NS:
                    down_ns = times.setdefault("down", now_ns)
                    # Whoever took over wants to hear that they are disarmed.
                    late = now_ns - down_ns >= _EXIT_NS
                    if late or all(successor.poll() is not None for successor in successors):
                        stop.set()
                elif not watched.down and not successors and now_ns - ended_ns >= take_over_s * SECOND_NS:
                    pilots = zip(world.autopilots, world.truth.airborne, strict=True)
                    modes = tuple(sorted({pilot.mode_name() for pilot, airborne in pilots if airborne}))
                    successor = _start(mission, folder / "take_over.tlog", sets, output, take_over=True)
                    successors.append(stack.enter_context(successor))
                    stack.callback(_end, successor)
            if now_ns - began_ns >= _LIMIT_NS:
                stop.set()

        server.run(stop, look, _LOOK_S)
        take_over_code = None
        for successor in successors:
            take_over_code = successor.poll()
        exit_code = process.poll()
    deed_ns = times.get("deed", world.now_ns)
    killed_unix_us = world.config.unix_start_us + (deed_ns - world.config.start_ns + times.get("late", 0)) // 1000
    return KilledFlight(
        after_s=watched.flying_s - (world.now_ns - deed_ns) / SECOND_NS,
        modes=modes,
        down_s=(times["down"] - deed_ns) / SECOND_NS if "down" in times else float("nan"),
        before_m=before_m,
        min_distance_m=watched.min_distance_m,
        exit_code=exit_code,
        take_over_code=take_over_code,
        output=(folder / "output.txt").read_text(errors="replace"),
        late_s=server.late_ns / SECOND_NS,
        **_read(log, killed_unix_us if exit_code == -signal.SIGKILL else None),
    )


def _start(
    mission: Path,
    log: Path,
    sets: Sequence[str],
    output: IO[bytes],
    *,
    piped: bool = False,
    take_over: bool = False,
) -> subprocess.Popen[bytes]:
    """Starts ``gs fly`` away from this terminal."""
    arguments = ["fly", "--mission", str(mission), "--log", str(log), "--json"]
    arguments += [word for change in sets for word in ("--set", change)] + ["--take-over"] * take_over
    return subprocess.Popen(  # noqa: S603 - ourselves
        [sys.executable, "-c", "from groundstation.app.cli import main; main()", *arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE if piped else output,
        stderr=output,
        start_new_session=True,
    )


def _end(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        process.kill()


def close_stdout(watched: Watched) -> None:
    """Closes the reading end of the process's standard output."""
    if watched.process.stdout is not None:
        watched.process.stdout.close()


def _read(log: Path, killed_unix_us: int | None) -> dict[str, Any]:
    """Reads the log back as any user would."""
    values: dict[str, Any] = {
        "phase": "none", "log_message": "", "log_lost_s": float("nan"), "setpoints": 0, "mismatches": 0,
    }  # fmt: skip
    try:
        flight = load_flight(log)
        values["phase"] = flight.phases[-1].name if flight.phases else "none"
        values["log_message"] = flight.message or ""
        values["setpoints"] = flight.setpoints
        if killed_unix_us is not None and flight.manifest is not None:
            values["log_lost_s"] = (killed_unix_us - flight.manifest.epoch_unix_us) / 1e6 - flight.stop_ns / SECOND_NS
        if flight.setpoints:
            values["mismatches"] = verify_log(log).mismatches
    except (UserError, OSError) as error:
        values["log_message"] = f"not readable: {error}"
    return values


def free_port() -> int:
    """A UDP port of this machine that nobody listens on."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
