"""``gs sitl-env``: the lines that start a mission's team on the autopilots' own simulators."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from groundstation.app.completing import packaged
from groundstation.app.options import JsonOption, SetOption
from groundstation.app.output import Output
from groundstation.core.errors import UserError

_HOME = "47.397742,8.545594,489.4"  # where PX4's own simulator begins


def sitl_env(
    mission: Annotated[
        Path,
        typer.Argument(
            help="Mission file, as given or among those that come along.", autocompletion=packaged("missions")
        ),
    ],
    *,
    home: Annotated[
        str, typer.Option(help="Where the team frame has its origin: LAT,LON,ALT in degrees and metres.")
    ] = _HOME,
    stock: Annotated[
        bool, typer.Option("--stock", help="Simulators as they come, without the parameters that cure them.")
    ] = False,
    changes: SetOption = None,
    as_json: JsonOption = False,
) -> None:
    """Prints a shell script that starts a mission's team on the autopilots' own simulators; starts nothing.

    ``gs sitl-env px4_cube8.yaml > team.sh; PX4=... sh team.sh``, then ``gs fly --mission px4_cube8.yaml`` elsewhere.
    """
    from groundstation.app.real_sitl import lines, starts
    from groundstation.app.resources import find_config
    from groundstation.mission.plan.reading import load_mission

    out = Output(as_json=as_json)
    place = _place(home)
    plan = load_mission(find_config(mission, "missions"), changes or ())
    script = lines(plan, place, stock=stock)
    values: dict[str, object] = {
        "mission": plan.spec.name,
        "script": script,
        "vehicles": [
            {"id": plan.spec.vehicles[start.vehicle].id, "instance": start.instance, "place": start.place}
            for start in starts(plan, place, stock=stock)
        ],
    }
    if not as_json:
        typer.echo("\n".join(script))  # as it is: no wrapping, no colours
    out.result(values)


def _place(text: str) -> tuple[float, float, float]:
    """Reads LAT,LON,ALT.

    Raises:
        UserError: something else, or no place on earth.
    """
    try:
        lat, lon, alt = (float(part) for part in text.split(","))
    except ValueError:
        lat, lon, alt = math.nan, math.nan, math.nan
    if not (abs(lat) <= 89.0 and abs(lon) <= 180.0 and -500.0 <= alt <= 9000.0):
        raise UserError(
            f"--home {text}: expected LAT,LON,ALT in degrees and metres, for example 47.397742,8.545594,489.4"
        )
    return lat, lon, alt
