"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from groundstation.app.completing import packaged, settings

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
