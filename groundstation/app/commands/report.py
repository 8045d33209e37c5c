"""``gs report``: pictures and a page out of a log."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from groundstation.app.completing import choice, logs
from groundstation.app.options import ForceOption, JsonOption
from groundstation.app.output import Output
from groundstation.core.choices import unknown
from groundstation.core.errors import UserError

_KINDS = "svg", "pdf"


def report(
    logs: Annotated[
        list[Path],
        typer.Argument(help="Log of a flight or of an import (.tlog); several are compared.", autocompletion=logs),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the pictures and the page.")],
    *,
    also: Annotated[
        list[str] | None,
        typer.Option(
            "--also",
            help="svg or pdf: every picture in that kind too, and the paper's figures; may be repeated.",
            autocompletion=choice(*_KINDS),
        ),
    ] = None,
    dpi: Annotated[int, typer.Option(help="Dots to the inch of the PNG pictures.", min=50, max=600)] = 100,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Draws trajectories, distances, formation error and setpoints of a flight; several are laid over each other."""
    from groundstation.app.comparing import compare_logs, tables, write_comparison
    from groundstation.app.replaying import useful_flight
    from groundstation.app.report import DPI, claim_report, write_report
    from groundstation.app.resources import find_log

    out = Output(as_json=as_json)
    kinds = list(dict.fromkeys(also or ()))
    for kind in kinds:
        if kind not in _KINDS:
            raise UserError(f"--also {kind}: {unknown(kind, _KINDS)}")
    logs = [find_log(log) for log in logs]
    if len(logs) > 1:
        if kinds or dpi != DPI:
            raise UserError("--also and --dpi are for one log; make a report of each")
        comparison = compare_logs(logs)
        for table in tables(comparison):
            out.console.print(table)
        with out.console.status("drawing"):
            files = write_comparison(comparison, output, logs=logs, force=force)
        for file in files:
            out.console.print(Text(f"written: {file}"))
        out.result({**comparison.values(), "files": [str(file) for file in files]})
        return
    log = logs[0]
    flight = useful_flight(out, log, "no report was written")
    replaced = claim_report(output, force=force, also=kinds)
    with out.console.status("drawing"):
        files = write_report(flight, output, also=kinds, dpi=dpi, log=log)
    for file in files:
        out.console.print(Text(f"{'replaced' if replaced else 'written'}: {file}"))
    out.result({"log": str(log), "vehicles": len(flight.vehicles), "files": [str(file) for file in files],
                "notes": list(flight.notes)})  # fmt: skip
