"""``gs export``: a log for other programs."""

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

_KINDS = "parquet", "csv", "mcap", "rrd", "tlog"


def export(
    log: Annotated[Path, typer.Argument(help="Log of a flight or of an import (.tlog).", autocompletion=logs)],
    to: Annotated[str, typer.Option("--to", help="parquet, csv, mcap, rrd or tlog.", autocompletion=choice(*_KINDS))],
    output: Annotated[Path, typer.Option("-o", "--output", help="The file to write.")],
    *,
    rate: Annotated[
        float, typer.Option("--rate", help="Rows in a second; 0: one whenever a vehicle told its position.", min=0.0)
    ] = 20.0,
    link: Annotated[
        int, typer.Option("--link", help="With --to tlog: whose frames, as the mission counts its links.", min=0)
    ] = 0,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Writes positions, attitudes, setpoints, distances, phases and events of a flight for other programs."""
    from groundstation.app.exporting import MADE_BY, claim_export, export
    from groundstation.app.link_log import write_link
    from groundstation.app.replaying import useful_flight
    from groundstation.app.resources import find_log

    out = Output(as_json=as_json)
    if to not in _KINDS:
        raise UserError(f"--to {to}: {unknown(to, _KINDS)}")
    replaced = claim_export(to, output, force=force)
    log = find_log(log)
    notes: list[str] = []
    with out.console.status("writing"):
        if to == "tlog":
            told = write_link(log, link, output, MADE_BY)
        else:
            flight = useful_flight(out, log, "nothing was exported")
            notes = list(flight.notes)
            told = export(flight, to, output, rate)
    words = ", ".join(f"{value} {key}" for key, value in told.items())
    out.console.print(Text(f"{'replaced' if replaced else 'written'}: {output}, {words}"))
    out.result({"log": str(log), "file": str(output), "to": to, **told, "notes": notes})
