"""``gs import``: flights that other programs recorded become logs of this one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table
from rich.text import Text

from groundstation.app.completing import choice, packaged
from groundstation.app.options import ForceOption, JsonOption
from groundstation.app.output import Output
from groundstation.core.choices import unknown
from groundstation.core.errors import UserError

_SOURCES = ("crazyswarm",)
"""Programs whose records can be read."""


def import_(
    source: Annotated[
        str,
        typer.Argument(
            help=f"Program that recorded the flight: {', '.join(_SOURCES)}.", autocompletion=choice(*_SOURCES)
        ),
    ],
    folder: Annotated[Path, typer.Argument(help="Folder with its files.")],
    *,
    output: Annotated[Path, typer.Option("-o", "--output", help="Log to write (.tlog).")],
    formation: Annotated[
        Path | None,
        typer.Option(
            help="Formation that was flown, where its files do not say; for the report.",
            autocompletion=packaged("formations"),
        ),
    ] = None,
    radius_m: Annotated[
        float | None, typer.Option(help="Safety radius r in metres, where its files do not say; for the report.", min=0)
    ] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Turns the recorded flight of another program into a log."""
    from groundstation.app.resources import find_config, log_to_write
    from groundstation.design.store import load_formation
    from groundstation.records.imports import import_crazyswarm
    from groundstation.records.manifest import claim_log, manifest_path, versions
    from groundstation.records.replay import load_flight

    out = Output(as_json=as_json)
    if source not in _SOURCES:
        raise UserError(f"gs import {source}: {unknown(source, _SOURCES)}")
    wanted = None
    if formation is not None:
        shape = load_formation(find_config(formation, "formations"))
        wanted = {
            "name": shape.name,
            "points": shape.points_enu_m.tolist(),
            "edges": [[i + 1, j + 1] for i, j in shape.edges],
        }
    output = log_to_write(output)
    if claim_log(output, lambda there: there.mission.get("source") == source, option="-o", force=force):
        out.console.print(Text(f"replaces {output}"))
    import_crazyswarm(folder, output, versions(), wanted, radius_m)
    flight = load_flight(output)
    values = {
        "log": str(output),
        "manifest": str(manifest_path(output)),
        "source": source,
        "vehicles": len(flight.vehicles),
        "samples": flight.samples,
        "duration_s": flight.duration_s,
        "min_distance_m": flight.min_distance_m(),
        "role_changes": flight.role_changes,
    }
    table = Table(show_header=False, box=None)
    for name, value in values.items():
        table.add_row(name, f"{value:.4f}" if isinstance(value, float) else str(value))
    out.console.print(table)
    out.result(values)
