"""What one tick costs by size of the team, without sockets, beside steering agent by agent with sampled headings.

Teams hover above a grid of pads with 1 m between neighbours, as the emulator flies them; a tick is everything from the
datagrams that came in to those that go out. The peer is what the paper's authors had, as plain loops: for each agent,
50 headings round about, tried in turn against everybody who is near; that is a small part of a tick.
"""

from __future__ import annotations

import math
import statistics
import time
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from groundstation.app.emulator import world_config
from groundstation.app.opening import open_flight
from groundstation.app.output import Output
from groundstation.app.session import Session
from groundstation.core.types import FloatArray
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.reading import load_mission
from groundstation.mission.plan.vehicle_spec import SYSTEM_IDS
from groundstation.mission.runner import Phase
from sitl.world import World

_SIZES = (8, 30, 100, min(1000, SYSTEM_IDS[-1]))
_TICKS = 100
_PERIOD_NS = 20_000_000
_HEADINGS = 50
_RADIUS_M, _NEAR_M, _SPEED_M_S = 0.45, 2.0, 0.5
_MISSION = """
name: hover
rate_hz: 50
speed_limit_m_s: {speed}
avoidance: {{radius_m: {radius}, activation_m: 0.5, shape: sphere}}
takeoff: {{height_m: 0.5}}
steps: [hover: {{seconds: {seconds}}}]
land: {{at: pads}}
fence: {{min_m: [-10, -10, 0], max_m: [{far}, {far}, 30]}}
failsafe: {{ceiling_m: 25.0, set_parameters: true}}
vehicles:
{vehicles}
"""
_VEHICLE = (
    '  - {{id: {id}, link: "udpin://127.0.0.1:{port}", autopilot: px4, profile: crazyflie, '
    "pad_m: [{east}, {north}, 0]}}"
)


def run(out: Output) -> dict[str, float | int]:
    """Measures and returns the figures; medians and 90 of 100 over a hundred ticks of processor time. Some minutes."""
    values: dict[str, float | int] = {"ticks": _TICKS}
    for n in _SIZES:
        out.console.print(f"{n} vehicles: from their pads to hovering, then {_TICKS} ticks")
        taken_ms, pos_m = _ticks(_plan(n))
        peer_ms = statistics.median([_headings_ms(pos_m) for _ in range(3)])
        median_ms = statistics.median(taken_ms)
        values |= {
            f"n{n}_ms": median_ms,
            f"n{n}_p90_ms": float(np.quantile(taken_ms, 0.9)),
            f"n{n}_us_for_each": median_ms / n * 1e3,
            f"n{n}_headings_ms": peer_ms,
            f"n{n}_headings_over_tick": peer_ms / median_ms,
        }
    return values


def hover_mission(n: int, port: int, seconds: float) -> str:
    """A mission file: n vehicles hover above a grid of pads, 1 m between neighbours, all behind one port."""
    side = math.ceil(math.sqrt(n))
    rows = [_VEHICLE.format(id=k + 1, port=port, east=k % side, north=k // side) for k in range(n)]
    vehicles = "\n".join(rows)
    return _MISSION.format(speed=_SPEED_M_S, radius=_RADIUS_M, far=side + 10, seconds=seconds, vehicles=vehicles)


def _plan(n: int) -> MissionPlan:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "hover.yaml"
        path.write_text(hover_mission(n, 14_540, 60.0), encoding="utf-8")
        return load_mission(path)


def _ticks(plan: MissionPlan) -> tuple[list[float], FloatArray]:
    """Milliseconds of each tick once everybody hovers, and where everybody is, shape (n, 3)."""
    session = open_flight(ExitStack(), plan, make=Session).session
    world, fleet = World(world_config(plan, 0), 0), session.runner.fleet
    peers, links = [f"emulator:{sysid}" for sysid in fleet.ids], fleet.link.tolist()
    vehicle_of_peer = {peer: vehicle for vehicle, peer in enumerate(peers)}
    taken_ms: list[float] = []
    now_ns = 0
    while len(taken_ms) < _TICKS and not session.runner.done:
        now_ns += _PERIOD_NS
        came = [(links[vehicle], peers[vehicle], data, t_ns) for t_ns, vehicle, data in world.advance(now_ns)]
        start_s = time.process_time()
        session.deliver_all(came)
        outgoing = session.tick(now_ns)
        if session.runner.phase is Phase.HOLD:
            taken_ms.append((time.process_time() - start_s) * 1e3)
        for datagram in outgoing:
            vehicle = vehicle_of_peer.get(datagram.peer)
            if vehicle is not None:
                world.receive(vehicle, b"".join(datagram.frames), now_ns)
    if len(taken_ms) < _TICKS:
        raise AssertionError(f"{plan.size} vehicles did not come to hover: {session.runner.reason}")
    return taken_ms, fleet.pos_local_ned_m + session.runner.plan.pads_enu_m[:, [1, 0, 2]] * [1.0, 1.0, -1.0]


def _headings_ms(pos_m: FloatArray) -> float:
    """One round of the peer: for each agent the sampled heading nearest to its wish that comes too near to nobody."""
    places = [tuple(place) for place in pos_m.tolist()]
    turns = [(math.cos(2 * math.pi * k / _HEADINGS), math.sin(2 * math.pi * k / _HEADINGS)) for k in range(_HEADINGS)]
    start_s = time.process_time()
    for i, (x, y, z) in enumerate(places):
        others = []
        for j, (ox, oy, oz) in enumerate(places):
            dx, dy, dz = ox - x, oy - y, oz - z
            if j != i and dx * dx + dy * dy + dz * dz < _NEAR_M * _NEAR_M:
                others.append((dx, dy, dz))
        best, found = -2.0, None
        for east, north in turns:
            for dx, dy, dz in others:
                along = dx * east + dy * north
                if along > 0.0 and dx * dx + dy * dy + dz * dz - along * along < _RADIUS_M * _RADIUS_M:
                    break
            else:
                if east > best:
                    best, found = east, (east, north)
        del found
    return (time.process_time() - start_s) * 1e3
