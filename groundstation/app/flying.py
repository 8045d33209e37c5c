"""What ``gs fly`` and ``gs check`` do: missions on vehicles, or as a dry run against the emulator."""

from __future__ import annotations

import itertools
import math
import os
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.table import Table
from rich.text import Text

from groundstation.app.console.viewers import shown
from groundstation.app.emulator import TruthMeter, served_world, world_config
from groundstation.app.fence_giving import give_fence
from groundstation.app.forwarding import Forward
from groundstation.app.gateway.process import serving
from groundstation.app.keyboard import Keyboard
from groundstation.app.law_watch import LawWatch
from groundstation.app.link_watch import LinkWatch
from groundstation.app.loop import Control, FlightClock, Interrupts, fly_real, fly_virtual, wall_clock_pace
from groundstation.app.mocap.emulated import emulated_team
from groundstation.app.mocap.process import reading
from groundstation.app.opening import LogPlan, open_flight
from groundstation.app.order_client import runtime_folder
from groundstation.app.order_socket import OrderSocket
from groundstation.app.output import Output
from groundstation.app.param_keeping import BeforeKeeper, Lines, before_path, offer_back
from groundstation.app.progress import FlightDisplay, link_troubles
from groundstation.app.resources import log_to_write
from groundstation.app.session import Session
from groundstation.app.signing import FlightGate
from groundstation.app.steady_file import Disk
from groundstation.app.tick_times import TIMES, TickTimes
from groundstation.core.errors import PreflightRefused, UserError
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.reading import load_mission, read_spec
from groundstation.mission.purpose import Purpose
from groundstation.mission.timing import SECOND_NS
from groundstation.mission.told import Told
from groundstation.records.manifest import (
    Manifest,
    Values,
    claim_log,
    manifest_path,
    versions,
    write_manifest,
)
from groundstation.records.tlog import TlogWriter
from sitl.faults import Fault
from sitl.world import World

_FLIGHTS = Path("flights")


def with_options(changes: list[str] | None, *, fix: bool, wait: bool = False) -> list[str]:
    """The changes of the command line; ``--fix`` and ``--wait`` are of the mission, so that a replay knows of them."""
    asked = (fix, "failsafe.set_parameters=true"), (wait, "takeoff.wait=true")
    return [*(changes or ()), *(change for is_asked, change in asked if is_asked)]


def judged(out: Output, path: Path, changes: Sequence[str]) -> MissionPlan:
    """Loads a mission to be checked: one that does not fit itself is refused, not a mistake of usage.

    Raises:
        UserError: the file cannot be read.
        PreflightRefused: gains, formation, pads, fence and r do not fit each other.
    """
    spec = read_spec(path, changes)
    try:
        return load_mission(path, changes)
    except UserError as error:
        out.result({"mission": spec.name, "ready": False, "problems": [str(error)], "failsafe": "", "vehicles": []})
        raise PreflightRefused(refusal(str(error))) from None


def refusal(reason: str, what: str | None = None) -> str:
    """Words for a refusal, one line for each vehicle, link or system that is named."""
    lines = reason.replace("; vehicle", "\n  vehicle").replace("; link ", "\n  link ").replace("; system", "\n  system")
    return f"{what or 'preflight refused, nothing was armed'}:\n  {lines}"


def refused_frames(plan: MissionPlan, gate: FlightGate | None) -> list[str]:
    """What signing left out, a line for each sender and reason, and whether its times could be kept."""
    if gate is None:
        return []
    at = zip(plan.link_of_vehicle, plan.sysids, strict=True)
    id_of = {where: vehicle.id for where, vehicle in zip(at, plan.spec.vehicles, strict=True)}
    return [*gate.words(plan.links, id_of), *([gate.problem] if gate.problem else [])]


def check_method(plan: MissionPlan) -> None:
    """Refuses to fly vehicles by less than the whole of avoidance.

    Raises:
        UserError: with what is left out, what follows, and the remedy.
    """
    method = plan.spec.avoidance.method
    if method == "both":
        return
    follows = {
        "rotation": "without the damper vehicles that lag come nearer than r",
        "damper": "without Algorithm 2 nobody turns aside, and vehicles stop in each other's way",
    }[method]
    raise UserError(
        f"{plan.source}: avoidance.method: {method} is for dry runs, allowed for vehicles is both; {follows};"
        " fly it with --dry-run, leave it out, or say --incomplete-avoidance if that is what you are about to do:"
        " nearer than r is then told only, and everybody comes back at half of r"
    )


def period_ns(plan: MissionPlan) -> int:
    """Length of a tick."""
    return round(SECOND_NS / plan.spec.rate_hz)


def log_path_of(
    plan: MissionPlan,
    wanted: Path | None,
    faults: Sequence[Fault] = (),
    *,
    dry_run: bool,
    seed: int,
    force: bool | None = None,
) -> tuple[Path, bool]:
    """Where to record, and whether a log that is there is replaced.

    Raises:
        UserError: the file exists and must be kept, or its folder cannot be made.
    """
    path = (
        log_to_write(wanted)
        if wanted
        else (_free(_FLIGHTS, f"{plan.spec.name}-seed{seed}") if dry_run else dated_path(plan))
    )
    struck = [fault.record() for fault in faults]
    same = claim_log(path, lambda there: dry_run and there.same_flight(plan.record(), seed, struck), force=force)
    return path, same


def dated_path(plan: MissionPlan) -> Path:
    """Where a flight that begins now is recorded, if nothing else is wished; not there yet."""
    return _free(_FLIGHTS, f"{plan.spec.name}-{time.strftime('%Y%m%d-%H%M%S')}")


def _free(folder: Path, name: str) -> Path:
    """A log's path of that name that is not there yet: NAME.tlog, NAME-2.tlog and so on."""
    path = folder / f"{name}.tlog"
    for number in itertools.count(2):
        if not path.exists() and not path.is_symlink():
            break
        path = folder / f"{name}-{number}.tlog"
    return path


def fly_dry(
    out: Output,
    plan: MissionPlan,
    log_path: Path | None,
    faults: Sequence[Fault],
    *,
    seed: int,
    realtime: bool,
    console: bool = False,
    watch: Callable[[Session, int, World], None] | None = None,
) -> dict[str, Any]:
    """Flies the emulator in virtual time.

    Args:
        out: shows the flight.
        plan: what to fly.
        log_path: where to record; None for nowhere.
        faults: that strike.
        seed: of the emulator's noise.
        realtime: hold it to the wall clock.
        console: show it to consoles.
        watch: somebody else's program looks on after every tick, and Ctrl-C is its own.
    """
    laws = LawWatch(plan, dry=True)
    plan = laws.plan
    world = World(replace(world_config(plan, seed), faults=tuple(faults)), seed)
    meter, links_watch = TruthMeter(world), LinkWatch(plan.size)
    struck = [fault.record() for fault in faults]
    recorded = (
        None if log_path is None else LogPlan(log_path, versions(), seed, dry_run=True, replace=True, faults=struck)
    )
    with ExitStack() as stack:
        flight = open_flight(stack, plan, log=recorded, make=Session)
        session, gate = flight.session, flight.gate
        interrupts = Interrupts()
        with ExitStack() as at_the_desk:
            if watch is None:
                at_the_desk.enter_context(interrupts.listening())
            at_the_desk.enter_context(laws.listening())
            forward = _watched_along(at_the_desk, session) if realtime else None
            # A dry run in virtual time is over before anybody could say anything.
            controls, prompt = _controls(at_the_desk, session, log_path) if realtime and log_path else ((), None)
            display = at_the_desk.enter_context(FlightDisplay(out.console, plan, prompt=prompt))
            fly_virtual(
                session,
                emulated_team(plan, world, seed),
                period_ns=period_ns(plan),
                watchers=(
                    display,
                    meter,
                    links_watch,
                    laws,
                    *shown(at_the_desk, plan, meter.figures, console=console),
                    *(() if watch is None else (lambda at, now_ns: watch(at, now_ns, world),)),
                ),
                interrupts=interrupts,
                pace=wall_clock_pace() if realtime else None,
                controls=controls,
            )
        _note(session, links_watch.words(), links_watch.now_ns)
    values = _values(session, log_path, seed) | meter.figures() | {"log_complete": _complete(flight.log)}
    values |= laws.figures()
    record = _for_the_record(session.runner, gate) | meter.further()
    _tell_refused(out, values, plan, gate)
    _tell_forward(out, forward)
    for words, style in ((laws.words(), "bold red"), (links_watch.words(), "")):
        if words:
            out.console.print(Text(words, style=style))
    _finish(out, log_path, flight.manifest, values | record)
    return values | {"beside": record}


def _watched_along(stack: ExitStack, session: Session) -> Forward | None:
    """Lets another ground station watch along, where the mission names one."""
    address = session.runner.plan.forward
    if address is None:
        return None
    forward = stack.enter_context(Forward(address))
    session.onward = forward.put
    session.remark("info", f"what vehicles tell is forwarded to {address.url}; nothing from there is read", 0)
    return forward


def _tell_forward(out: Output, forward: Forward | None) -> None:
    if forward is not None and forward.words():
        out.console.print(Text(forward.words()))


def _controls(stack: ExitStack, session: Session, log_path: Path) -> tuple[Sequence[Control], Callable[[], str] | None]:
    """What the operator can speak by besides Ctrl-C, and the line that tells of the keys."""
    controls: list[Control] = []
    plan, prompt = session.runner.plan, None
    ids = [vehicle.id for vehicle in plan.spec.vehicles]
    # A file's name need not be text.
    path = os.fsencode(log_path.resolve()).decode("utf-8", "replace")
    about = {
        "mission": plan.spec.name,
        "log": path,
        "pid": os.getpid(),
        "vehicles": ids,
    }
    try:
        folder = runtime_folder(os.environ, Path.home())
        controls.append(stack.enter_context(OrderSocket(folder, about)))
    except (UserError, RuntimeError) as error:  # a flight needs no second terminal
        session.remark("alarm", str(error), 0)
    descriptor = 0  # standard input, whatever stands in for it in this process
    if Keyboard.usable(descriptor):
        keyboard = stack.enter_context(Keyboard(descriptor, ids))
        controls.append(keyboard)
        prompt = keyboard.prompt
    return controls, prompt


def _complete(log: TlogWriter | None) -> bool:
    """Whether everything was recorded; known when the log is closed."""
    return log is not None and log.problem is None


def _finish(out: Output, log_path: Path | None, manifest: Manifest | None, ended: Values) -> None:
    """Writes the end of the flight into the manifest; where that fails, what is there stays, and people are told."""
    if manifest is None or log_path is None:
        return
    try:
        write_manifest(manifest_path(log_path), manifest.finished(ended))
    except UserError as error:
        out.console.print(Text(f"gs: {error}; it lacks how the flight ended", style="bold red"))


def fly_vehicles(
    out: Output,
    plan: MissionPlan,
    log_path: Path,
    faults: Sequence[Fault],
    *,
    emulated_seed: int | None,
    take_over: bool,
    give_back: bool = False,
    replace_log: bool = False,
    bare: bool = False,
    console: bool = False,
) -> dict[str, Any]:
    """Flies over sockets: real vehicles, or the emulator at the other end of the same sockets.

    Args:
        out: shows the flight.
        plan: what to fly.
        log_path: where to record.
        faults: that strike, of the emulator.
        emulated_seed: of the emulator's noise; None for vehicles.
        take_over: bring home vehicles that are in the air.
        give_back: parameters that preflight has set are set back after the flight.
        replace_log: a log that is there is replaced.
        bare: whoever flies knows that the mission leaves out the damper or Algorithm 2.
        console: show it to consoles.

    Raises:
        UserError: the mission leaves those out, and vehicles would fly it without that word.
        PreflightRefused: the vehicles do not take the mission's fence.
    """
    if emulated_seed is None and not take_over and not bare:
        check_method(plan)
    keeper = BeforeKeeper(before_path(log_path))
    with ExitStack() as stack:
        meter, emulated = None, emulated_seed is not None
        if emulated_seed is not None:
            meter = TruthMeter(stack.enter_context(served_world(plan, emulated_seed, faults)))
        refused = [] if take_over else give_fence(out, plan, may_set=True)
        if refused:
            why_not = PreflightRefused(refusal("; ".join(refused)))
            why_not.answered = False
            raise why_not
        disk, laws, times, links_watch = Disk(), LawWatch(plan), TickTimes(), LinkWatch(plan.size)
        plan = laws.plan
        struck = [fault.record() for fault in faults]
        recorded = LogPlan(
            log_path, versions(), emulated_seed, replace=replace_log, through=disk.through, faults=struck
        )
        purpose = Purpose.TAKE_OVER if take_over else Purpose.FLY
        kept, rooms = stack.enter_context(reading(plan))
        keepers = stack.enter_context(serving(plan, kept))
        flight = open_flight(stack, plan, purpose, real=True, keep_times=not emulated, log=recorded, make=Session)
        session, gate, links = flight.session, flight.gate, flight.links
        if flight.unlogged:
            out.console.print(Text(f"gs: {flight.unlogged}; flying without a log", style="bold red"))
        interrupts = Interrupts()
        with ExitStack() as at_the_desk:
            at_the_desk.enter_context(interrupts.listening())
            at_the_desk.enter_context(laws.listening())
            forward = _watched_along(at_the_desk, session)
            controls, prompt = _controls(at_the_desk, session, log_path)
            display = at_the_desk.enter_context(FlightDisplay(out.console, plan, links, prompt))
            fly_real(
                session,
                links,
                flight.clock or FlightClock(),
                period_ns=period_ns(plan),
                watchers=(
                    display,
                    disk,
                    laws,
                    keeper,
                    links_watch,
                    *(() if meter is None else (meter,)),
                    *shown(at_the_desk, plan, meter.figures if meter else dict, times, console=console),
                ),
                interrupts=interrupts,
                controls=(*controls, *keepers, *rooms),
                times=times,
            )
        for words in (times.words(), links_watch.words()):
            _note(session, words, links_watch.now_ns)
        if links_watch.words():
            out.console.print(Text(links_watch.words()))
        values = _values(session, log_path, emulated_seed) | times.figures()
        values["reason"] = "; ".join([str(values["reason"]), *link_troubles(links)]) if values["reason"] else ""
        _tell_refused(out, values, plan, gate)
        _tell_forward(out, forward)
        record = _for_the_record(session.runner, gate)
        for url, link in zip(plan.all_links, links, strict=True):
            record["counts"][f"errors of {url}"] = link.errors
        if meter is not None:
            values |= meter.figures()
            record |= meter.further()
        back = Lines(links, flight.clock, gate) if give_back and flight.clock is not None else None
        for line in offer_back(out, plan, keeper, back):
            out.console.print(Text(line, style="bold red"))
    values["log_complete"] = _complete(flight.log)
    _finish(out, log_path, flight.manifest, values | record)
    if keeper.kept:
        values["parameters_before"] = str(keeper.path)
    return values | {"beside": record}


def _values(session: Session, log_path: Path | None, seed: int | None) -> dict[str, Any]:
    """The figures of a flight, as the command line promises them; distances as the vehicles reported them.

    The caller adds ``log_complete`` when the log is closed.
    """
    runner = session.runner
    figures, spec = runner.figures, runner.plan.spec
    reason = runner.reason or ("" if runner.outcome else "interrupted by the operator")
    if session.unlogged:
        reason = f"{session.unlogged}; nobody takes off without a log, make room or give another place with --log"
    return {
        "mission": spec.name,
        "outcome": "completed" if runner.outcome == "completed" else "aborted",
        "reason": reason,
        "refused": runner.outcome == "refused" or bool(session.unlogged and not session.armed_unlogged),
        "vehicles": runner.plan.size,
        "converged": figures.converged,
        "time_to_form_s": figures.time_to_form_s,
        "formation_error_m": figures.formation_error_m,
        "min_distance_m": figures.min_distance_m,
        "min_clearance": figures.min_clearance,
        "safety_radius_m": spec.avoidance.radius_m,
        "gridlocks": figures.gridlocks,
        "role_swaps": figures.role_swaps,
        "wind_mean_m_s": figures.wind_mean_m_s,
        "wind_gust_m_s": figures.wind_gust_m_s,
        "setpoints": runner.setpoints_sent,
        "ticks": figures.ticks,
        "deadline_misses": figures.deadline_misses,
        **dict.fromkeys(TIMES),
        "duration_s": figures.flight_time_s,
        "wall_s": None,
        "log": None if log_path is None else str(log_path),
        "seed": seed,
    }


def _note(session: Session, text: str, now_ns: int) -> None:
    """Keeps in the log how the flight was, where there is something to tell."""
    if text:
        session.remark("info", text, now_ns)


def _for_the_record(runner: Told, gate: FlightGate | None) -> dict[str, Any]:
    """What the manifest keeps beside the figures: events that were only counted, and where local frames begin."""
    refused = gate.totals() if gate is not None else {}
    return {
        "counts": dict(runner.fleet.counts) | refused,
        "local_origins_enu_m": runner.local_origins_enu_m,
        "move_error_m": runner.figures.move_error_m,
        "hold_speed_m_s": math.nan,  # only an emulator knows it
        "detours": runner.figures.detours,
    }


def _tell_refused(out: Output, values: dict[str, Any], plan: MissionPlan, gate: FlightGate | None) -> None:
    """Tells what signing left out; where the flight came to nothing that may be why."""
    lines = refused_frames(plan, gate)
    if values["refused"]:
        values["reason"] = "; ".join([str(values["reason"]), *lines])
        return
    for line in lines:
        out.console.print(Text(line, style="bold red"))


def tell_flight(out: Output, values: Values) -> None:
    """Prints the figures of a flight."""
    table = Table(show_header=False, title=f"mission {values['mission']}: {values['outcome']}")
    for label, value in (
        ("formed after", _figure(values["time_to_form_s"], "s")),
        ("largest distance error while holding", _figure(values["formation_error_m"], "m")),
        ("largest distance error while moving", _figure(values["move_error_m"], "m", missing="")),
        ("speed of the liveliest vehicle at the end of a hold", _figure(values["hold_speed_m_s"], "m/s", missing="")),
        ("smallest distance in the air", _figure(values["min_distance_m"], "m")),
        ("smallest clearance, 1 = at the safety region", _figure(values["min_clearance"], "")),
        ("safety radius r", _figure(values["safety_radius_m"], "m")),
        ("gridlocks, swaps of roles, detours", _gridlocks(values)),
        ("wind at its strongest, as felt", _wind(values)),
        ("ticks begin late by", _times(values["tick_late_ms"])),
        ("setpoints are out after the last telemetry by", _times(values["telemetry_to_setpoint_ms"])),
        ("flight time", _figure(values["duration_s"], "s")),
        ("setpoints sent", str(values["setpoints"])),
        ("log", values["log"]),
    ):
        if value:
            table.add_row(label, value)
    out.console.print(table)
    if not values["log_complete"]:
        out.console.print(Text("the log is not complete: the flight was not recorded to its end", style="bold red"))


def _gridlocks(values: Values) -> str:
    counts = [values[name] for name in ("gridlocks", "role_swaps", "detours")]
    return ", ".join(str(count) for count in counts) if any(counts) else ""


def _wind(values: Values) -> str:
    mean_m_s, gust_m_s = values["wind_mean_m_s"], values["wind_gust_m_s"]
    return f"mean {mean_m_s:.1f} m/s, gusts {gust_m_s:.1f} m/s" if math.isfinite(mean_m_s) else ""


def _times(times_ms: Values | None) -> str:
    if times_ms is None:
        return ""  # virtual time is never late
    return f"{times_ms['p50']:.3g} ms, 99 of 100 by {times_ms['p99']:.3g} ms at most, worst {times_ms['max']:.3g} ms"


def _figure(value: float, unit: str, missing: str = "-") -> str:
    return f"{value:.3f} {unit}" if math.isfinite(value) else missing
