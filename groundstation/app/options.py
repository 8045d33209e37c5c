"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from groundstation.app.completing import choice, packaged, settings
from groundstation.core.choices import unknown
from groundstation.core.errors import UserError

ForceOption = Annotated[bool, typer.Option("--force", help="Replace files that this command did not make.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Answer with one JSON object on the last line of stdout.")]
MissionOption = Annotated[
    Path,
    typer.Option(
        "--mission", help="Mission file, as given or among those that come along.", autocompletion=packaged("missions")
    ),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", help="key.path=value: changes the mission, may be repeated.", autocompletion=settings),
]

_LIVE = ("foxglove",)
StreamOption = Annotated[
    str | None,
    typer.Option(
        "--stream", help="Show the flight live to foxglove, on this machine alone.", autocompletion=choice(*_LIVE)
    ),
]


def check_stream(stream: str | None) -> None:
    """Makes sure that it is one to which flights can be streamed.

    Raises:
        UserError: it is not.
    """
    if stream == "rerun":
        raise UserError("--stream rerun: flights are streamed to foxglove; for Rerun: gs export LOG --to rrd")
    if stream is not None and stream not in _LIVE:
        raise UserError(f"--stream {stream}: {unknown(stream, _LIVE)}")
