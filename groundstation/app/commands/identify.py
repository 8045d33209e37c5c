"""``gs identify``: how fast each vehicle follows its setpoints, out of the log of a flight."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table
from rich.text import Text

from groundstation.app.completing import logs
from groundstation.app.options import ForceOption, JsonOption
from groundstation.app.output import Output
from groundstation.core.errors import CheckFailed, MissionFailed


def identify(
    log: Annotated[Path, typer.Argument(help="Log of a flight (.tlog).", autocompletion=logs)],
    *,
    picture: Annotated[
        Path | None, typer.Option(help="Picture of the vehicle that moves most: asked for, flown, both models.")
    ] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Finds lag and delay of each vehicle's velocity loop in a log, and the lines for a mission file."""
    from groundstation.app.identifying import (
        DIRECTIONS,
        cells,
        delay_note,
        loop_values,
        loop_words,
        profile_lines,
        profiles,
        slowest,
        values,
    )
    from groundstation.app.pictures import claim_picture
    from groundstation.app.resources import find_log
    from groundstation.core.identify import STEP_S
    from groundstation.core.identify import identify as fit
    from groundstation.core.velocity_loop import VelocityLoop, identify_loop
    from groundstation.records.responses import load_motions
    from groundstation.records.tlog import read_tlog

    out = Output(as_json=as_json)
    log = find_log(log)
    if picture is not None and claim_picture(picture, force=force):
        out.console.print(Text(f"replaces {picture}"))
    motions = load_motions(log, STEP_S)
    if not motions:
        for line in read_tlog(log).survey().words():
            out.console.print(Text(line))
        raise CheckFailed(f"{log}: holds no velocity setpoints with velocities beside them; nothing can be identified")
    profile_of = profiles(log)
    table = Table(title=f"{log.name}: how setpoints are followed")
    for heading in ("vehicle", "direction", "t63", "lag", "delay", "gain", "explained"):
        table.add_column(heading)
    problems: dict[str, None] = {}
    vehicles: list[dict[str, Any]] = []
    loops: dict[int, dict[str, VelocityLoop]] = {}
    for motion in motions:
        asked, done = motion.asked_enu_m_s.T, motion.done_enu_m_s.T
        axes = {name: fit([asked[k]], [done[k]]) for k, name in enumerate(DIRECTIONS)}
        axes["horizontal"] = fit(list(asked[:2]), list(done[:2]))
        for name in ("horizontal", "up"):
            table.add_row(str(motion.id), name, *cells(axes[name]))
            if axes[name].problem:
                problems[f"vehicle {motion.id}, {name}: {axes[name].problem}"] = None
        loops[motion.id] = {
            "horizontal": identify_loop(list(asked[:2]), list(done[:2])),
            "up": identify_loop([asked[2]], [done[2]]),
        }
        vehicles.append(
            {"id": motion.id, "profile": profile_of.get(motion.id), **slowest(axes)}
            | {"axes": {name: values(found) for name, found in axes.items()}}
            | {"second_order": {name: loop_values(loop) for name, loop in loops[motion.id].items()}}
        )
    out.console.print(table)
    for problem in problems:
        out.console.print(problem)
    most = max(motions, key=lambda motion: float(motion.asked_enu_m_s.var(axis=0).sum()))
    for name, loop in loops[most.id].items():
        if words := loop_words(most.id, name, loop):
            out.console.print(words)
    note = delay_note(vehicles)
    if note:
        out.console.print(note)
    lines = profile_lines(vehicles, loops)
    if lines:
        out.console.print("for the mission file (links included: leave link_delay_s at 0):\nprofiles:")
        for line in lines:
            out.console.print(f"  {line}")
    if picture is not None:
        from groundstation.app.response_picture import draw_responses

        draw_responses(picture, most, loops[most.id])
        out.console.print(Text(f"picture of vehicle {most.id}: {picture}"))
    known = [vehicle for vehicle in vehicles if vehicle["lag_s"] is not None]
    out.result({"log": str(log), "vehicles": vehicles, "identified": len(known), "profiles": lines, "note": note})
    if not known:
        raise MissionFailed(f"{log}: no vehicle could be identified: {vehicles[0]['problem']}")
