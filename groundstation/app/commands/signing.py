"""``gs signing``: makes a signing key, and gives it to the vehicles of a mission."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from groundstation.app.completing import choice, packaged
from groundstation.app.options import JsonOption, SetOption
from groundstation.app.output import Output
from groundstation.core.choices import unknown
from groundstation.core.errors import UserError

_ACTIONS = "new", "setup"


def signing(
    action: Annotated[
        str,
        typer.Argument(
            help="new: make a key. setup: give a mission's key to its vehicles.", autocompletion=choice(*_ACTIONS)
        ),
    ],
    file: Annotated[Path | None, typer.Argument(help="new: key file to make.")] = None,
    *,
    mission: Annotated[
        Path | None,
        typer.Option("--mission", help="setup: mission file that names the key.", autocompletion=packaged("missions")),
    ] = None,
    changes: SetOption = None,
    in_the_clear: Annotated[
        bool, typer.Option("--in-the-clear", help="setup: send the key over a network too, where others may hear it.")
    ] = False,
    seconds: Annotated[float, typer.Option(help="setup: how long to try.", min=1, max=600)] = 15.0,
    as_json: JsonOption = False,
) -> None:
    """Makes a key for MAVLink signing (new FILE), or gives a mission's key to its vehicles (setup --mission FILE)."""
    from groundstation.app.key_giving import give_key
    from groundstation.app.resources import find_config
    from groundstation.mavlink.keys import new_key
    from groundstation.mission.plan.reading import load_mission

    out = Output(as_json=as_json)
    if action == "new" and file is not None and mission is None:
        new_key(file)
        out.console.print(
            Text(f"{file}: a new key, readable by you alone. Name it in the mission: signing: {{key_file: {file}}}")
        )
        out.result({"key_file": str(file)})
    elif action == "setup" and mission is not None and file is None:
        plan = load_mission(find_config(mission, "missions"), changes or ())
        give_key(out, plan, seconds, in_the_clear=in_the_clear)
    elif action not in _ACTIONS:
        raise UserError(f"gs signing {action}: {unknown(action, _ACTIONS)}")
    else:
        raise UserError(
            f"signing {action}: expected gs signing new FILE, or gs signing setup --mission FILE (which names the key)"
        )
