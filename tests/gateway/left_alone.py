"""``gs fly`` as a process, its gateway, and a room with emulated Crazyflies in this one: what becomes of all of them.

Vehicles, CRTP and a motion capture that speaks VRPN are here, in real time behind sockets; the truth says where
everybody was. What reads VRPN is the package that reads real systems, in the process that ``gs fly`` starts.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import dataclass, field
from pathlib import Path
from threading import Event

import numpy as np

from groundstation.app.mocap.serving import fake_server
from groundstation.app.mocap.vrpn import VrpnServer, bodies_of
from groundstation.mission.plan.reading import load_mission
from sitl.server import Server
from tests.sitl.served import free_udp_port

_MAIN = "import sys; sys.argv[0] = 'gs'; from groundstation.app.cli import main; main()"
SECOND_NS = 1_000_000_000
_LIMIT_NS = 150 * SECOND_NS


@dataclass
class Seen:
    """What was seen of one flight, by the emulator's truth.

    Attributes:
        exit_code: of ``gs fly``.
        said: by it.
        children: processes that it had started and that lived at the deed.
        left: those of them that still live when all is over.
        down_s: from the deed to everybody being on the ground with motors off; NaN when that did not happen.
        ended_s: from the deed to the end of the last of the children.
        min_distance_m: smallest distance of two of which one is in the air.
        off_pad_m: how far from its pad each has come down, shape (n,).
        impact_m_s: fastest downward speed below 0.15 m since the deed.
    """

    exit_code: int | None = None
    said: str = ""
    children: list[int] = field(default_factory=list)
    left: list[int] = field(default_factory=list)
    down_s: float = float("nan")
    ended_s: float = float("nan")
    min_distance_m: float = float("inf")
    off_pad_m: np.ndarray = field(default_factory=lambda: np.zeros(0))
    impact_m_s: float = 0.0


def free_ports(count: int) -> int:
    """The first of so many UDP ports that are free, one behind the other."""
    while True:
        first = free_udp_port()
        try:
            for port in range(first, first + count):
                with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as probe:
                    probe.bind(("127.0.0.1", port))
        except OSError:
            continue
        return first


def children_of(pid: int) -> list[int]:
    """Processes that a process has started, on Linux."""
    found = []
    for entry in Path("/proc").iterdir():
        with suppress(OSError, ValueError, IndexError):
            if entry.name.isdecimal():
                fields = (entry / "stat").read_text(encoding="utf-8").rpartition(")")[2].split()
                if int(fields[1]) == pid:
                    found.append(int(entry.name))
    return found


def lives(pid: int) -> bool:
    """Whether a process runs; one that has ended and that nobody has asked after does not."""
    with suppress(OSError, IndexError):
        return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0] != "Z"
    return False


def fly_and(
    deed: Callable[[subprocess.Popen[bytes]], None],
    when: Callable[[Server], bool],
    mission: Path,
    folder: Path,
    *,
    changes: tuple[str, ...] = (),
    room_goes_too: bool = False,
) -> Seen:
    """Flies a mission of Crazyflies on emulated ones, does something to ``gs fly``, and waits for what follows.

    Args:
        deed: done once.
        when: asked every 10 ms whether it is time.
        mission: its vehicles' links, and the links of gateway and room, are replaced.
        folder: for logs, and what the processes keep.
        changes: of the mission.
        room_goes_too: the motion capture ends with the deed.
    """
    n = load_mission(mission, ()).size
    first, room_port = free_ports(n), free_ports(2)
    sets = [f"vehicles.{k}.link=udp://127.0.0.1:{first + k}" for k in range(n)]
    sets += [f"gateway={{link: 'udpout://127.0.0.1:{free_udp_port()}'}}", "limits.preflight_s=120"]
    sets += ["link_delay_s=0.15", "limits.pose_age_s=1"]  # a machine with other work answers late
    sets += [f"positioning.link=udpin://127.0.0.1:{room_port}", "positioning.system=vrpn"]
    sets += [f"positioning.host=127.0.0.1:{room_port + 1}", *changes]
    plan = load_mission(mission, sets)
    seen, stop, times = Seen(), Event(), dict[str, int]()
    server, room = fake_server(plan, 1, first, hz=100.0, noise_m=0.0005, faults=[])
    names = {vehicle.id: vehicle.body_name for vehicle in plan.spec.vehicles}
    words = ["fly", "--mission", str(mission), "--log", str(folder / "flight.tlog")]
    words += [word for change in sets for word in ("--set", change)]
    pads = np.array([vehicle.pad_m for vehicle in plan.spec.vehicles])
    first_row, second_row = np.triu_indices(n, 1)
    with server, closing(VrpnServer(port=room_port + 1)) as vrpn, (folder / "said.txt").open("wb") as said:
        flight = subprocess.Popen(
            [sys.executable, "-c", _MAIN, *words], cwd=folder,
            stdin=subprocess.DEVNULL, stdout=said, stderr=subprocess.STDOUT, start_new_session=True,
        )  # fmt: skip
        world, sees = server.world, room.status(lambda data: vrpn.send(*bodies_of(data, names)))

        def look(at: Server) -> None:
            truth, now_ns = world.truth, world.now_ns
            if not (room_goes_too and "deed" in times):
                sees(at)
            up = truth.airborne[first_row] | truth.airborne[second_row]
            if up.any():
                apart = np.linalg.norm(truth.pos_enu_m[first_row] - truth.pos_enu_m[second_row], axis=1)
                seen.min_distance_m = min(seen.min_distance_m, float(apart[up].min()))
            if "deed" in times:
                low = truth.airborne & (truth.pos_enu_m[:, 2] < 0.15)
                seen.impact_m_s = max(seen.impact_m_s, float((-truth.vel_enu_m_s[low, 2]).max(initial=0.0)))
            if "deed" not in times:
                if when(at):
                    seen.children = children_of(flight.pid)
                    deed(flight)
                    times["deed"] = now_ns
                elif flight.poll() is not None:
                    stop.set()
                return
            since_s = (now_ns - times["deed"]) / SECOND_NS
            if not truth.airborne.any() and np.isnan(seen.down_s):
                seen.down_s, seen.off_pad_m = since_s, np.linalg.norm((truth.pos_enu_m - pads)[:, :2], axis=1)
            if not np.isnan(seen.down_s) and flight.poll() is not None:
                if not any(map(lives, seen.children)):
                    seen.ended_s = since_s
                    stop.set()
                elif since_s - seen.down_s > 20.0:
                    stop.set()
            if since_s * SECOND_NS > _LIMIT_NS:
                stop.set()

        try:
            server.run(stop, look, 0.01)
        finally:
            seen.exit_code = flight.poll()
            seen.left = [pid for pid in seen.children if lives(pid)]
            for pid in (flight.pid, *seen.left):
                with suppress(OSError):
                    os.kill(pid, signal.SIGKILL)
            flight.wait()
    seen.said = (folder / "said.txt").read_text(encoding="utf-8", errors="replace")
    return seen


def kill(process: subprocess.Popen[bytes]) -> None:
    """SIGKILL."""
    process.send_signal(signal.SIGKILL)
