"""Flies ``gs fly`` as a process of its own against an emulator, does something to it, and looks at what becomes of it.

The emulator runs here, in real time behind UDP sockets, with the autopilots' failsafes as preflight sets them; its truth
says how near the vehicles came to each other. Judges nothing: whoever calls compares figures with limits.
"""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Event

import numpy as np

from groundstation.app.emulator import world_config
from groundstation.app.verify import verify_log
from groundstation.core.errors import UserError
from groundstation.mission.failsafe import failsafe_parameters
from groundstation.mission.plan import MissionPlan, load_mission
from groundstation.records.replay import load_flight
from sitl.server import Server
from sitl.world import World

_SECOND_NS = 1_000_000_000
_LOOK_S = 0.01
_SETTLED_NS = 3 * _SECOND_NS // 2  # after the deed: an arming that is under way shows by then
_LIMIT_NS = 150 * _SECOND_NS
_EXIT_S = 30.0


@dataclass(frozen=True)
class KilledFlight:
    """What became of one flight.

    Attributes:
        phase: last phase in the log.
        after_s: from the emulator hearing the ground station for the first time to the deed.
        down_s: from the deed to everybody being disarmed on the ground; NaN when that did not happen.
        min_distance_m: smallest true distance of two vehicles of which at least one is in the air, whole flight.
        exit_code: of the process; negative for a signal, None when it had to be ended.
        log_message: what of the log could not be read, "" when all of it is whole.
        log_lost_s: from the last record to the deed, NaN when the flight went on.
        setpoints: in the log.
        mismatches: setpoints and other frames that a replay of the log does not find again.
        output: what the process printed.
    """

    phase: str
    after_s: float
    down_s: float
    min_distance_m: float
    exit_code: int | None
    log_message: str
    log_lost_s: float
    setpoints: int
    mismatches: int
    output: str


class Watched:
    """An emulated team, the ground station that flies it, and the smallest true distance so far.

    Attributes:
        world: the emulator's.
        process: ``gs fly``.
        min_distance_m: as ``KilledFlight`` has it.
        flying_s: since the emulator first heard the ground station, negative before.
        log: the flight's.
    """

    def __init__(self, world: World, process: subprocess.Popen[bytes], log: Path) -> None:
        self.world, self.process, self.log = world, process, log
        self.min_distance_m = float("inf")
        self._heard_ns: int | None = None
        self._pairs = np.triu_indices(world.n, 1)

    @property
    def flying_s(self) -> float:
        """Since the emulator first heard the ground station."""
        return -1.0 if self._heard_ns is None else (self.world.now_ns - self._heard_ns) / _SECOND_NS

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
    failsafes: bool = True,
    then: Callable[[Watched], None] | None = None,
) -> KilledFlight:
    """Flies a mission in a process of its own and does something to it.

    Args:
        deed: done once.
        when: asked every 10 ms whether it is time.
        mission: file; its links are replaced.
        folder: for the log and the output.
        seed: of the emulator.
        changes: of the mission, as ``--set`` takes them.
        failsafes: whether the autopilots are set as ``mission.failsafe`` says; else as they come.
        then: called every 10 ms after the deed.

    Raises:
        UserError: the mission is wrong.
    """
    port = _free_port()
    plan = load_mission(mission, changes)
    links = [f"vehicles.{number}.link=udpin://127.0.0.1:{port}" for number in range(plan.size)]
    log = folder / "flight.tlog"
    arguments = ["fly", "--mission", str(mission), "--log", str(log), "--json"]
    arguments += [word for change in [*links, *changes] for word in ("--set", change)]
    stop = Event()
    done_ns: list[int] = []
    down_ns: list[int] = []
    with (
        Server(world_config(plan, seed), seed, port=port) as server,
        (folder / "output.txt").open("wb") as output,
        subprocess.Popen(  # noqa: S603 - ourselves
            [sys.executable, "-c", "from groundstation.app.cli import main; main()", *arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE if deed is close_stdout else output,
            stderr=output,
            start_new_session=True,
        ) as process,
    ):
        if failsafes:
            set_failsafes(server.world, plan)
        watched = Watched(server.world, process, log)
        began_ns = server.world.now_ns

        def look(_server: Server) -> None:
            watched.look()
            now_ns = server.world.now_ns
            if not done_ns and watched.flying_s >= 0.0 and when(watched):
                deed(watched)
                done_ns.append(now_ns)
            if done_ns and then is not None:
                then(watched)
            ended = process.poll() is not None
            if (ended and (not done_ns or now_ns - done_ns[0] >= _SETTLED_NS)) and not server.world.truth.armed.any():
                down_ns.append(now_ns)
                stop.set()
            if now_ns - began_ns >= _LIMIT_NS:
                stop.set()

        server.run(stop, look, _LOOK_S)
        exit_code = process.poll()
        if exit_code is None:
            process.kill()
    deed_ns = done_ns[0] if done_ns else server.world.now_ns
    deed_s = watched.flying_s - (server.world.now_ns - deed_ns) / _SECOND_NS
    return _read(
        log,
        after_s=deed_s,
        down_s=(down_ns[0] - deed_ns) / _SECOND_NS if down_ns else float("nan"),
        min_distance_m=watched.min_distance_m,
        exit_code=exit_code,
        lost_from=deed_ns if exit_code == -signal.SIGKILL else None,
        world=server.world,
        output=(folder / "output.txt").read_text(errors="replace"),
    )


def set_failsafes(world: World, plan: MissionPlan) -> None:
    """Sets the emulated autopilots as preflight would."""
    for vehicle, pilot in enumerate(world.autopilots):
        for name, value in failsafe_parameters(plan, vehicle).items():
            if name in pilot.params:
                pilot.params.set_value(name, value)


def close_stdout(watched: Watched) -> None:
    """Closes the reading end of the process's standard output."""
    if watched.process.stdout is not None:
        watched.process.stdout.close()


def _read(
    log: Path,
    *,
    after_s: float,
    down_s: float,
    min_distance_m: float,
    exit_code: int | None,
    lost_from: int | None,
    world: World,
    output: str,
) -> KilledFlight:
    """Reads the log back as any user would."""
    phase, message, lost_s, setpoints, mismatches = "none", "", float("nan"), 0, 0
    try:
        flight = load_flight(log)
        phase = flight.phases[-1].name if flight.phases else "none"
        message = flight.message or ""
        setpoints = flight.setpoints
        if lost_from is not None and flight.manifest is not None:
            unix_us = world.config.unix_start_us + (lost_from - world.config.start_ns) // 1000
            lost_s = (unix_us - flight.manifest.epoch_unix_us) / 1e6 - flight.stop_ns / _SECOND_NS
        if setpoints:
            mismatches = verify_log(log).mismatches
    except (UserError, OSError) as error:
        message = f"not readable: {error}"
    return KilledFlight(
        phase, after_s, down_s, min_distance_m, exit_code, message, lost_s, setpoints, mismatches, output
    )


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
