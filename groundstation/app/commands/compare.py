"""``gs compare``: several flights side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from groundstation.app.completing import logs
from groundstation.app.options import ForceOption, JsonOption
from groundstation.app.output import Output


def compare(
    logs: Annotated[
        list[Path], typer.Argument(help="Two logs or more (.tlog), the one to compare with first.", autocompletion=logs)
    ],
    *,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Folder for pictures and a page that lay them over each other."),
    ] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Compares flights: time to form, distances, effort, and how far they deviate from each other."""
    from groundstation.app.comparing import claim_comparison, compare_logs, tables, write_comparison
    from groundstation.app.resources import find_log

    out = Output(as_json=as_json)
    comparison = compare_logs([find_log(log) for log in logs])
    for table in tables(comparison):
        out.console.print(table)
    files: list[Path] = []
    if output is not None:
        replaced = claim_comparison(output, force=force)
        with out.console.status("drawing"):
            files = write_comparison(comparison, output, force=force)
        for file in files:
            out.console.print(Text(f"{'replaced' if replaced else 'written'}: {file}"))
    out.result({**comparison.values(), "files": [str(file) for file in files]})
