"""Short flights whose logs are kept in the repository: behaviour that changes by accident shows when they are replayed.

``make refs`` flies them again, keeps the new logs and prints what has changed, in figures. Do that on purpose only, in
the commit that changes the behaviour, and say there what the difference is.
"""

from __future__ import annotations

import contextlib
import json
import lzma
import math
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TypedDict

from groundstation.app.mocap.fake import FakeConfig, RoomFault
from groundstation.app.resources import packaged_configs
from groundstation.mission import timing
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.reading import load_mission
from groundstation.mission.runner import Phase
from groundstation.records.manifest import manifest_path
from sitl.faults import load_faults
from sitl.world import Outgoing, World
from tests.app.flights import FULL_RATE, Flight, after, four, mission, pair
from tests.mavlink.sender import Sender

FOLDER = Path(__file__).parent / "reference_logs"
FIGURES = FOLDER / "figures.json"
Orders = tuple[tuple[Callable[[Flight], bool], str], ...]


class Figures(TypedDict):
    """What a flight came to, for comparing."""

    outcome: str
    reason: str
    phases: str
    ticks: int
    setpoints: int
    min_distance_m: float | None
    time_to_form_s: float | None


def says(*lines: tuple[Callable[[Flight], bool], str]) -> Callable[[Flight], bool]:
    """Says each line once, as soon as its moment has come and the ones before it were said."""
    left = list(lines)

    def look(flight: Flight) -> bool:
        if left and left[0][0](flight):
            flight.session.operator(left.pop(0)[1], flight.now_ns)
        return False

    return look


def _completed(log: Path) -> Flight:
    """Both autopilots, held by the operator for a moment on the way."""
    orders = says((after(Phase.FORM, 0.5), "hold"), (after(Phase.PAUSE, 1.0), "resume"))
    return Flight(pair("steps.1.hold.seconds=1"), log=log, interrupt_when=orders)


def _goes_on(log: Path) -> Flight:
    """Four, one of which is killed; the others go on without it."""
    orders = says((after(Phase.HOLD, 0.2), "kill 4"))
    return Flight(four(FULL_RATE, "on_lost=continue_open", "steps.1.hold.seconds=0.5"), log=log, interrupt_when=orders)


def _lands_here(log: Path) -> Flight:
    """One lands where it is while the other comes back; then everybody lands."""
    orders = says((after(Phase.HOLD), "hold"), (after(Phase.PAUSE, 0.5), "land 1"), (after(Phase.PAUSE, 1.0), "resume"))
    return Flight(pair(), log=log, interrupt_when=orders)


def _lands_all(log: Path) -> Flight:
    return Flight(pair(), log=log, interrupt_when=says((after(Phase.TAKEOFF, 5.0), "land all")))


def _broken_off(log: Path) -> Flight:
    return Flight(pair(), log=log, interrupt_when=says((after(Phase.ARM, 0.5), "return")))


def _silent(log: Path) -> Flight:
    return Flight(
        pair(), log=log, interrupt_when=says((after(Phase.FORM, 0.5), "silence"), (after(Phase.SILENT), "land all"))
    )


def _taken_over(log: Path) -> Flight:
    """Left in the air by one ground station, brought home by another one."""
    worlds: list[World] = []

    class _Died(Exception):  # noqa: N818 - the end of a process, not an error
        pass

    def die(flight: Flight) -> bool:
        if flight.runner.phase is Phase.FORM:
            worlds.append(flight.world)
            raise _Died
        return False

    plan = pair("limits.hold_s=60")
    with contextlib.suppress(_Died):
        Flight(plan, interrupt_when=die)
    return Flight(plan, world=worlds[0], take_over=True, log=log)


def _moved_and_stopped(log: Path) -> Flight:
    """The pair moves and turns as one; in its second move the operator stops it, and kills one on the way back."""
    moves = "{move: {by_m: [0.5, 0.2, 0.1], turn_deg: 5}}, {move: {by_m: [-0.5, 0, 0]}}"
    orders = says((_in_the_second_move, "return"), (after(Phase.RETURN, 1.0), "kill 2"))
    return Flight(pair(f"steps=[{{form: {{tolerance_m: 0.4}}}}, {moves}]"), log=log, interrupt_when=orders)


def _in_the_second_move(flight: Flight) -> bool:
    return sum("the middle of the team has moved" in note.text for note in flight.notes) == 1


def _led(log: Path) -> Flight:
    """The pair is led by the operator, who changes his mind once."""
    steps = "steps=[{form: {tolerance_m: 0.4}}, {lead: {seconds: 20, largest: 1.1}}]"
    orders = says(
        (after(Phase.LEAD, 0.2), "turn -5"),
        (after(Phase.LEAD, 0.4), "move 0.4 0 0.2"),
        (after(Phase.LEAD, 1.5), "stay"),
        (after(Phase.LEAD, 2.0), "scale 1.5"),
        (after(Phase.LEAD, 2.2), "next"),
    )
    return Flight(pair(steps), log=log, interrupt_when=orders)


def _under(faults: str, plan: MissionPlan, log: Path) -> Flight:
    """A flight under one of the timetables of faults that come along."""
    timetable = load_faults(packaged_configs() / "faults" / f"{faults}.yaml")
    return Flight(plan, log=log, change=lambda config: replace(config, faults=timetable))


def _deaf(log: Path) -> Flight:
    return _under("deaf", pair("limits.preflight_s=8"), log)


def _lossy(log: Path) -> Flight:
    return _under("lossy", pair("steps.1.hold.seconds=0.5"), log)


def _slow_link(log: Path) -> Flight:
    slow = ("link_delay_s=0.39", "steps.0.form.tolerance_m=0.6", "limits.pose_age_s=1", "limits.pose_lost_s=2")
    calm = "wind={mean_m_s: 2, gust_m_s: 1}"  # two kinds that are told so late may be blown together by more
    return _under("slow_link", pair(*slow, calm), log)


def _hello1(log: Path) -> Flight:
    """A mission that comes along, as it comes: one vehicle, which flies to places."""
    return Flight(load_mission(packaged_configs() / "missions" / "hello1.yaml"), log=log)


def _rough_day(log: Path) -> Flight:
    """Four under the ids that the timetable speaks of."""
    ids = (f"vehicles.{row}.id={sysid}" for row, sysid in enumerate((1, 3, 5, 7)))
    return _under("rough_day", four(*ids, "steps.1.hold.seconds=4"), log)


def _poor(log: Path) -> Flight:
    """Poor sensors, shaped setpoints, a pole beside the way and an aircraft that nobody steers, told by vehicle 1."""
    changes = (
        "compensate_s=auto", "sensing={loss: 0.2, noise_m: 0.05}", "traffic={radius_m: 1}",
        "obstacles=[{name: pole, at_m: [0, 9, 0], radius_m: 0.5, height_m: 6}]",
        "steps.1.hold.seconds=3", "fence={min_m: [-12, -12, 0], max_m: [12, 12, 8]}", "speed_limit_m_s=1",
    )  # fmt: skip
    sender, told = Sender(1), [0]

    def passes(datagram: Outgoing, flight: Flight) -> list[Outgoing]:
        if datagram.vehicle_index or flight.now_ns - told[0] < timing.SECOND_NS or flight.runner.phase is Phase.CONNECT:
            return [datagram]
        told[0] = flight.now_ns
        config = flight.world.config
        place = (config.home_lat_deg + 1.2e-4, config.home_lon_deg, config.home_alt_m + 3.0)  # 13 m north
        return [datagram._replace(data=datagram.data + sender.aircraft(place, (-0.2, 0.0, 0.0)))]

    return Flight(pair(*changes, autopilots=("px4", "px4")), log=log, tamper=passes)


def _room(log: Path) -> Flight:
    """Two Crazyflies behind the gateway, whose places come from motion capture; one is covered for a moment."""
    two = (
        "formation=../formations/pair2.yaml", "formation_scale=1.2", "gains=../gains/pair2.npz",
        "vehicles=[{id: 1, link: 'udpin://127.0.0.1:14540', autopilot: crazyflie, origin: team, pad_m: [0, 0, 0]},"
        " {id: 2, link: 'udpin://127.0.0.1:14540', autopilot: crazyflie, origin: team, pad_m: [1, 0, 0]}]",
        "steps.1.hold.seconds=1",
    )  # fmt: skip
    room = FakeConfig(hz=50.0, faults=(RoomFault("occlude", 12.0, 12.3, (1,)),))
    return Flight(mission("lab_cube8", *two), log=log, room=room)


FLIGHTS: dict[str, Callable[[Path], Flight]] = {
    "completed": _completed,
    "goes_on": _goes_on,
    "lands_here": _lands_here,
    "lands_all": _lands_all,
    "broken_off": _broken_off,
    "silent": _silent,
    "taken_over": _taken_over,
    "moved_and_stopped": _moved_and_stopped,
    "led": _led,
    "deaf": _deaf,
    "lossy": _lossy,
    "slow_link": _slow_link,
    "rough_day": _rough_day,
    "hello1": _hello1,
    "poor": _poor,
    "room": _room,
}


def figures_of(flight: Flight) -> Figures:
    """What a flight came to."""
    runner = flight.runner

    def known(value: float, digits: int) -> float | None:
        return round(value, digits) if math.isfinite(value) else None

    return Figures(
        outcome=str(runner.outcome),
        reason=runner.reason,
        phases=" ".join(phase.value for phase in flight.phase_seen),
        ticks=runner.figures.ticks,
        setpoints=runner.setpoints_sent,
        min_distance_m=known(flight.world.min_distance_airborne_m, 4),
        time_to_form_s=known(runner.figures.time_to_form_s, 3),
    )


def known_figures() -> dict[str, Figures]:
    """Figures of the logs that are kept."""
    kept: dict[str, Figures] = json.loads(FIGURES.read_text(encoding="utf-8")) if FIGURES.is_file() else {}
    return kept


def unpack(name: str, folder: Path) -> Path:
    """Puts a log that is kept, with its manifest, into a folder; returns its path."""
    log = folder / f"{name}.tlog"
    log.write_bytes(lzma.decompress((FOLDER / f"{name}.tlog.xz").read_bytes()))
    manifest_path(log).write_bytes((FOLDER / manifest_path(log).name).read_bytes())
    return log


def renew() -> int:
    """Flies all of them again and keeps the logs; returns how many differ from what was kept."""
    FOLDER.mkdir(exist_ok=True)
    before, after_all, differ = known_figures(), dict[str, Figures](), 0
    for name, fly in FLIGHTS.items():
        with tempfile.TemporaryDirectory() as folder:
            log = Path(folder) / f"{name}.tlog"
            after_all[name] = figures_of(fly(log))
            packed = lzma.compress(log.read_bytes(), preset=9 | lzma.PRESET_EXTREME)
            target = FOLDER / f"{name}.tlog.xz"
            same = target.is_file() and target.read_bytes() == packed
            if not same:  # a manifest of an earlier version stays, and has to be read
                target.write_bytes(packed)
                (FOLDER / manifest_path(log).name).write_bytes(manifest_path(log).read_bytes())
        differ += not same
        sys.stdout.write(f"{name}: {'the same to the byte' if same else 'differs'}, {len(packed)} bytes\n")
        was = before.get(name)
        for key, value in after_all[name].items():
            old = dict(was)[key] if was is not None else None
            if old != value:
                sys.stdout.write(f"    {key}: {old} -> {value}\n")
    FIGURES.write_text(json.dumps(after_all, indent=2) + "\n", encoding="utf-8")
    return differ


if __name__ == "__main__":
    renew()
