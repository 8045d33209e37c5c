"""``gs replay``: what a log says, the same flight made again, or its frames sent to another program."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.text import Text

from groundstation.app.completing import logs
from groundstation.app.options import JsonOption
from groundstation.app.output import Output
from groundstation.core.errors import MissionFailed, UserError


def replay(
    log: Annotated[Path, typer.Argument(help="Log of a flight or of an import (.tlog).", autocompletion=logs)],
    *,
    verify: Annotated[bool, typer.Option("--verify", help="Fly it again from its bytes, compare every bit.")] = False,
    to: Annotated[
        str | None, typer.Option("--to", help="Send what the vehicles told to another program: udpout://HOST:PORT.")
    ] = None,
    speed: Annotated[float, typer.Option(help="Pace of --to against the recorded one.")] = 1.0,
    laws: Annotated[
        list[Path] | None,
        typer.Option("--laws", help="Folder with the law that was flown, for --verify; may be repeated."),
    ] = None,
    changes: Annotated[
        list[str] | None,
        typer.Option("--set", help="What if: another value on the same poses, gain=0.5; setpoints are compared."),
    ] = None,
    gains: Annotated[Path | None, typer.Option("--gains", help="What if: other gains on the same poses.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Reads a log back."""
    from groundstation.app.replaying import figures_table, nothing_in, parse_target, send_log
    from groundstation.app.resources import find_log
    from groundstation.app.verify import verify_log
    from groundstation.app.whatif import what_if
    from groundstation.mission.plan.own_code import CodeSource
    from groundstation.records.replay import load_flight

    out = Output(as_json=as_json)
    target = None if to is None else parse_target(to)
    if not (math.isfinite(speed) and speed > 0):
        raise UserError(f"--speed {speed:g}: expected a number above 0, for example 2 for twice as fast")
    log = find_log(log)
    flight = load_flight(log)
    values: dict[str, Any] = {
        "vehicles": len(flight.vehicles),
        "samples": flight.samples,
        "duration_s": flight.duration_s,
        "min_distance_m": flight.min_distance_m(),
        "notes": list(flight.notes),
    }
    mismatches = 0
    if verify:
        result = verify_log(log, CodeSource(tuple(laws or ())))
        mismatches = result.mismatches
        values |= {
            "ticks": result.ticks,
            "frames_compared": result.frames,
            "setpoints": result.setpoints,
            "rounded": result.rounded,
            "mismatches": mismatches,
            "max_error_m_s": result.max_error_m_s,
            "complete": result.complete,
        }
    if changes or gains is not None:
        values |= what_if(log, changes or (), gains, CodeSource(tuple(laws or ()))).figures()
    out.console.print(figures_table(values))
    for line in (*flight.notes, *flight.contents):
        out.console.print(Text(line))
    if target is not None:
        values |= send_log(log, target, speed, out)
    if flight.contents:
        values["contents"] = list(flight.contents)
    out.result(values)
    if mismatches:
        raise MissionFailed(
            f"{log}: {mismatches} frames differ from the recorded ones, setpoints by up to "
            f"{values['max_error_m_s']:.3g} m/s; was it flown with another version? (versions in the manifest)"
        )
    useful = flight.useful or bool(values.get("frames"))
    if flight.message is not None or not values.get("complete", True):
        said = flight.message or f"{log}: ends before the flight does"
        raise MissionFailed(f"{said}; the figures are of what is there" if useful else f"{said}; {nothing_in(log)}")
    if not useful:
        raise MissionFailed(nothing_in(log))
