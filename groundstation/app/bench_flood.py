"""What a flood on loopback does to a flight that waits for its vehicles: ticks, and whether known senders are heard.

Another process sends hostile datagrams as fast as it can, up to 50,000 a second, to the port on which eight vehicles
speak, a second after they began. Bounded in time. Beside it stands the same without a flood.
"""

from __future__ import annotations

import itertools
import multiprocessing
import socket
import time
from contextlib import ExitStack, closing
from multiprocessing.sharedctypes import Synchronized
from multiprocessing.synchronize import Event
from pathlib import Path

import numpy as np

from groundstation.app.bench_hostile import hostile_units
from groundstation.app.loop import FlightClock, Interrupts, fly_real
from groundstation.app.opening import open_flight
from groundstation.app.output import Output
from groundstation.app.resources import find_config
from groundstation.app.session import Session
from groundstation.links.opening import open_link
from groundstation.mavlink.codec import Encoder
from groundstation.mavlink.gate import Gate
from groundstation.mavlink.station import Outgoing
from groundstation.mission.plan.reading import load_mission
from groundstation.mission.runner import Runner
from groundstation.records.tlog import TlogWriter

_SECONDS = 5
_RATE_HZ = 50_000
_SIZE = 1_400
_VEHICLE_HZ = 50
_BEFORE_S = 1.0  # until then the vehicles are heard alone


class _Watched(Session):
    """Keeps when it ticked and how often vehicles were heard."""

    def __init__(self, runner: Runner, log: TlogWriter | None, gate: Gate | None) -> None:
        super().__init__(runner, log, gate)
        self.ticks_ns: list[int] = []
        self.heard = self.strangers = 0

    def tick(self, now_ns: int) -> list[Outgoing]:
        """Steps the runner."""
        self.ticks_ns.append(now_ns)
        return super().tick(now_ns)

    def deliver(self, link: int, peer: str, data: bytes, t_rx_ns: int) -> None:
        """Takes a datagram."""
        if len(data) < _SIZE:
            self.heard += 1
        else:
            self.strangers += 1
        super().deliver(link, peer, data, t_rx_ns)


def run(out: Output) -> dict[str, float | int | str]:
    """Measures and returns the figures. About a quarter of a minute."""
    del out
    values: dict[str, float | int | str] = {"seconds": _SECONDS, "vehicles_hz": _VEHICLE_HZ}
    for name, units in (("quiet", []), ("flood", list(hostile_units().values()))):
        values |= {f"{name}_{key}": value for key, value in _fly(units).items()}
    return values


def _fly(units: list[bytes]) -> dict[str, float | int]:
    plan = load_mission(find_config(Path("cube8.yaml"), "missions"), [f"limits.preflight_s={_SECONDS}"])
    session = open_flight(ExitStack(), plan, make=_Watched).session
    period_ns = round(1e9 / plan.spec.rate_hz)
    context = multiprocessing.get_context("spawn")
    stop = context.Event()
    with closing(open_link("udpin://127.0.0.1:0")) as link:
        where = link.socket.getsockname()  # type: ignore[attr-defined]
        counted = context.Value("q", 0)
        sender = context.Process(target=_send, args=(where, len(plan.spec.vehicles), units, stop, counted))
        sender.start()
        try:
            while not link.receive():  # the other process takes a moment to begin
                time.sleep(0.01)
            fly_real(session, [link], FlightClock(), period_ns=period_ns, watchers=(), interrupts=Interrupts())
        finally:
            stop.set()
            sender.join()
    gaps = np.array([after - before for before, after in itertools.pairwise(session.ticks_ns)]) / period_ns
    flooded = counted.value
    return {
        "datagrams_per_s": flooded / _SECONDS,
        "strangers_taken_per_s": session.strangers / _SECONDS,
        "ticks_made_of_due": len(session.ticks_ns) * period_ns / (session.ticks_ns[-1] or 1),
        "gap_over_period_p99": float(np.quantile(gaps, 0.99)),
        "gap_over_period_worst": float(gaps.max()),
        "vehicles_heard_of_spoken": session.heard / (_SECONDS * _VEHICLE_HZ * len(plan.spec.vehicles)),
    }


def _send(where: tuple[str, int], vehicles: int, units: list[bytes], stop: Event, counted: Synchronized[int]) -> None:
    """Speaks for the vehicles, and floods in between."""
    bad = [(unit * (_SIZE // len(unit) + 1))[:_SIZE] for unit in units]
    spoken = flooded = 0
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(vehicles + 1)]
    encoders = [Encoder(sysid) for sysid in range(1, vehicles + 1)]
    start_s = time.monotonic()
    while not stop.is_set():
        elapsed_s = time.monotonic() - start_s
        while spoken < vehicles * (1 + int(elapsed_s * _VEHICLE_HZ)):
            vehicle = spoken % vehicles
            raw = encoders[vehicle].encode("HEARTBEAT", type=2, autopilot=12, system_status=3, mavlink_version=3)
            sockets[vehicle].sendto(raw, where)
            spoken += 1
        if bad and flooded < (elapsed_s - _BEFORE_S) * _RATE_HZ:
            for _ in range(50):
                sockets[-1].sendto(bad[flooded % len(bad)], where)
                flooded += 1
        else:
            time.sleep(0.001)
    counted.value = flooded
    for item in sockets:
        item.close()
