"""``gs params``: keeps the parameters of a mission's vehicles, compares them, gives them back."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from groundstation.app.completing import choice
from groundstation.app.options import ForceOption, JsonOption, MissionOption, SetOption
from groundstation.app.output import Output
from groundstation.core.choices import unknown
from groundstation.core.errors import UserError

_ACTIONS = "save", "diff", "restore"


def params(
    action: Annotated[str, typer.Argument(help="save, diff or restore.", autocompletion=choice(*_ACTIONS))],
    mission: MissionOption,
    *,
    file: Annotated[
        Path | None,
        typer.Option("--file", "-f", help="File of parameters; save makes MISSION.params by default, diff takes that."),
    ] = None,
    changes: SetOption = None,
    seconds: Annotated[float, typer.Option(help="How long to try.", min=1, max=600)] = 30.0,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Keeps a mission's parameters in a file (save), tells what differs from one (diff), gives it back (restore).

    Files are those of QGroundControl. Nothing is set in a vehicle that is armed, and what is set is read back.
    """
    from groundstation.app.param_keeping import diff, kept_path, local_time, restore, save
    from groundstation.app.resources import find_config
    from groundstation.mission.plan.reading import load_mission

    out = Output(as_json=as_json)
    if action not in _ACTIONS:
        raise UserError(f"gs params {action}: {unknown(action, _ACTIONS)}")
    plan = load_mission(find_config(mission, "missions"), changes or ())
    if action == "save":
        save(out, plan, file or kept_path(plan), seconds, force=force)
        return
    if file is None and action == "diff":
        file = kept_path(plan)
        if not file.exists():
            raise UserError(
                f"gs params diff: {file}: nothing was saved here under this name; begin with gs params save --mission"
                f" {mission}, or name a file that was kept with --file"
            )
        out.console.print(Text(f"compared with {file}, saved {local_time(file)}"))
    if file is None:
        raise UserError(f"gs params {action}: --file: is missing; name the file that gs params save or a flight kept")
    (diff if action == "diff" else restore)(out, plan, file, seconds)
