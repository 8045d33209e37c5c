"""``gs fly`` and ``gs check``: missions on vehicles, or as a dry run against the emulator."""

from __future__ import annotations

import time
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from groundstation.app.options import ForceOption, JsonOption, MissionOption, SetOption, StreamOption, check_stream
from groundstation.app.output import Output
from groundstation.core.errors import MissionFailed, PreflightRefused, UserError

FixOption = Annotated[bool, typer.Option("--fix", help="Set parameters that are not as the mission needs them.")]


def fly(
    mission: MissionOption,
    *,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Fly the emulator, in virtual time.")] = False,
    realtime: Annotated[bool, typer.Option("--realtime", help="Hold a dry run to the wall clock.")] = False,
    udp: Annotated[bool, typer.Option("--udp", help="Dry run over UDP sockets, on the wall clock.")] = False,
    seed: Annotated[int, typer.Option(help="Seed of the emulator's noise.", min=0)] = 0,
    faults: Annotated[
        Path | None, typer.Option(help="Timetable of faults (YAML) for a dry run; time 0 is the vehicles' power-up.")
    ] = None,
    take_over: Annotated[
        bool, typer.Option("--take-over", help="Bring home vehicles that a ground station left in the air.")
    ] = False,
    log: Annotated[Path | None, typer.Option(help="Log to record (.tlog); one in flights/ by default.")] = None,
    fix: FixOption = False,
    give_back: Annotated[
        bool, typer.Option("--restore", help="After the flight, set parameters back that --fix has set.")
    ] = False,
    bare: Annotated[
        bool,
        typer.Option(
            "--incomplete-avoidance",
            help="Fly vehicles although the mission's avoidance.method leaves out the damper or Algorithm 2.",
        ),
    ] = False,
    changes: SetOption = None,
    wait: Annotated[
        bool, typer.Option("--wait", help="Stay on the pads until the order start: on the page, or gs command start.")
    ] = False,
    console: Annotated[
        bool, typer.Option("--console", help="Show the flight to gs console, in another terminal; on the wall clock.")
    ] = False,
    stream: StreamOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Flies a mission: take off, form, hold, return to the pads, land.

    With --take-over: finds those of its vehicles that are in the air, holds them, brings them home and lands them.

    Keys at a terminal: h hold, r resume, b back to the pads, l land, k kill; from another one: gs command.
    Ctrl-C once: everybody stops, comes back and lands. Twice: setpoints stop, the autopilots' own failsafe acts.
    """
    from groundstation.app.console.beside import streamed
    from groundstation.app.emulator import read_faults
    from groundstation.app.flying import (
        check_method,
        fly_dry,
        fly_vehicles,
        log_path_of,
        refusal,
        tell_flight,
        with_options,
    )
    from groundstation.app.gateway.process import budget_of
    from groundstation.app.resources import find_config
    from groundstation.mission.plan.advice import advice
    from groundstation.mission.plan.reading import load_mission

    out = Output(as_json=as_json)
    if (realtime or udp) and not dry_run:
        raise UserError("--realtime and --udp go with --dry-run; a flight on vehicles is on the wall clock anyway")
    check_stream(stream)
    if (console or stream) and dry_run and not (realtime or udp):
        option = "--stream" if stream else "--console"
        raise UserError(f"{option}: a dry run in virtual time is over before anybody could look; add --realtime")
    if wait and (take_over or (dry_run and not (realtime or udp))):
        raise UserError(
            "--wait is for teams that stand on their pads, on the wall clock: without --take-over, a dry run with"
            " --realtime"
        )
    if take_over and dry_run:
        raise UserError("--take-over is for vehicles that are in the air; those of a dry run stand on their pads")
    if give_back and dry_run and not udp:
        raise UserError("--restore: a dry run in virtual time sets no parameters; leave it out")
    if faults is not None and not dry_run:
        raise UserError(f"--faults {faults}: faults are for a dry run; add --dry-run")
    plan = load_mission(find_config(mission, "missions"), with_options(changes, fix=fix, wait=wait))
    if not (dry_run or take_over or bare):
        check_method(plan)  # before anything is written
    for line in advice(plan):
        out.console.print(Text(line, style="bold yellow"))
    for line in budget_of(plan):
        out.console.print(Text(line))
    timetable = read_faults(faults, plan)
    log_path, replaced = log_path_of(plan, log, timetable, dry_run=dry_run, seed=seed, force=force)
    if replaced:
        out.console.print(Text(f"replaces {log_path}"))
    started = time.monotonic()
    shown = console or stream is not None
    with streamed(stream) as said:
        if said:
            out.console.print(Text(said))
        if dry_run and not udp:
            values = fly_dry(out, plan, log_path, timetable, seed=seed, realtime=realtime, console=shown)
        else:
            values = fly_vehicles(
                out,
                plan,
                log_path,
                timetable,
                emulated_seed=seed if dry_run else None,
                take_over=take_over,
                give_back=give_back,
                replace_log=replaced,
                bare=bare,
                console=shown,
            )
    refused, beside = values.pop("refused"), values.pop("beside")
    values["wall_s"] = round(time.monotonic() - started, 3)
    tell_flight(out, values | beside)
    out.result(values)
    if refused:
        raise PreflightRefused(refusal(str(values["reason"]), "nothing was taken over" if take_over else None))
    if values["outcome"] != "completed":
        raise MissionFailed(f"mission {plan.spec.name} aborted: {values['reason']}")


def check(
    mission: MissionOption, *, fix: FixOption = False, changes: SetOption = None, as_json: JsonOption = False
) -> None:
    """Checks a mission and its vehicles on their pads; arms nothing, and sets parameters only with --fix."""
    from groundstation.app.check_screen import rows_as_values, show_rows
    from groundstation.app.fence_giving import give_fence
    from groundstation.app.flying import dated_path, judged, period_ns, refusal, refused_frames, with_options
    from groundstation.app.gateway.process import serving
    from groundstation.app.loop import FlightClock, Interrupts, fly_real
    from groundstation.app.mocap.process import reading
    from groundstation.app.opening import open_flight
    from groundstation.app.param_keeping import BeforeKeeper, before_path, offer_back
    from groundstation.app.progress import FlightDisplay, link_troubles
    from groundstation.app.resources import find_config
    from groundstation.app.session import Session
    from groundstation.mission.plan.advice import advice
    from groundstation.mission.purpose import Purpose

    out = Output(as_json=as_json)
    plan = judged(out, find_config(mission, "missions"), with_options(changes, fix=fix))
    for line in advice(plan):
        out.console.print(Text(line, style="bold yellow"))
    fences = give_fence(out, plan, may_set=fix)
    interrupts = Interrupts()
    keeper = BeforeKeeper(before_path(dated_path(plan)))
    with ExitStack() as stack:
        purpose = Purpose.PREPARE if fix else Purpose.LOOK
        kept, rooms = stack.enter_context(reading(plan))
        keepers = stack.enter_context(serving(plan, kept))
        flight = open_flight(stack, plan, purpose, real=True, keep_times=True, make=Session)
        display = stack.enter_context(FlightDisplay(out.console, plan, flight.links))
        stack.enter_context(interrupts.listening())
        fly_real(
            flight.session,
            flight.links,
            flight.clock or FlightClock(),
            period_ns=period_ns(plan),
            watchers=(display, keeper),
            interrupts=interrupts,
            controls=(*keepers, *rooms),
        )
        troubles = link_troubles(flight.links)
    runner, gate = flight.session.runner, flight.gate
    for number, rates in enumerate(plan.rates):
        signed = "signed" if number in plan.signed_links else "not signed"
        out.console.print(f"{rates.words(plan.links[number], plan.link_of_vehicle.count(number))}, {signed}")
    rows = runner.check_rows()
    show_rows(out.console, rows)
    offer_back(out, plan, keeper)
    refused = refused_frames(plan, gate)
    if runner.outcome == "completed":  # else they are among the reasons
        for line in refused:
            out.console.print(Text(line, style="bold red"))
    out.result(
        {
            "mission": plan.spec.name,
            "ready": runner.outcome == "completed" and not fences,
            "problems": [*runner.problems, *fences],
            "signing": refused,
            "failsafe": runner.failsafe.words,
            "vehicles": rows_as_values(rows),
            **({"parameters_before": str(keeper.path)} if keeper.kept else {}),
        }
    )
    if runner.outcome != "completed":
        raise PreflightRefused(refusal("; ".join([runner.reason or "interrupted", *troubles, *refused, *fences])))
    if fences:
        raise PreflightRefused(refusal("; ".join(fences)))
