"""``gs bench NAME``: speed, as ratios of figures that were taken in one run on one machine.

Absolute seconds differ from machine to machine and from hour to hour; ratios to a yardstick in the same run do not
so much. Nothing here is asserted in a test.
"""

from __future__ import annotations

from importlib import import_module
from typing import Annotated, Any

import typer
from rich.table import Table

from groundstation.app.completing import choice
from groundstation.app.options import JsonOption
from groundstation.app.output import Output
from groundstation.core.choices import unknown
from groundstation.core.errors import UserError
from groundstation.core.extras import need

BENCHES = {
    "avoidance": "groundstation.app.bench_avoidance",
    "dryrun": "groundstation.app.bench_dryrun",
    "flight": "groundstation.app.bench_flight",
    "codec": "groundstation.app.bench_codec",
    "flood": "groundstation.app.bench_flood",
    "gains": "groundstation.app.bench_gains",
    "hostile": "groundstation.app.bench_hostile",
    "law": "groundstation.app.bench_law",
    "loop": "groundstation.app.bench_loop",
    "sigkill": "groundstation.app.bench_sigkill",
    "tick": "groundstation.app.bench_tick",
}
"""Name: module with ``run(out: Output) -> dict``; those of sigkill and law take options of their own too."""


def bench(
    name: Annotated[
        str, typer.Argument(help=f"What to measure: {', '.join(BENCHES)}.", autocompletion=choice(*BENCHES))
    ],
    *,
    runs: Annotated[int, typer.Option(help="Flights that are killed (sigkill).", min=1, max=10_000)] = 50,
    seed: Annotated[int, typer.Option(help="Of the first flight (sigkill).", min=0)] = 1,
    formations: Annotated[
        str, typer.Option(help="What is formed, with commas (law).", metavar="NAME,...")
    ] = "cube8,ring12,grid27",
    profiles: Annotated[
        str, typer.Option(help="Kinds of vehicles, with commas (law).", metavar="NAME,...")
    ] = "crazyflie,px4_quad,arducopter",
    seeds: Annotated[int, typer.Option(help="Starts of each kind (law).", min=1, max=1000)] = 3,
    as_json: JsonOption = False,
) -> None:
    """Measures speed as ratios in one run, or what a killed ground station leaves behind."""
    out = Output(as_json=as_json)
    if name not in BENCHES:
        raise UserError(f"gs bench {name}: {unknown(name, BENCHES)}")
    if name in ("codec", "hostile", "flood", "loop"):
        need("mavlink", f"gs bench {name}")
    if name == "gains":
        need("solvers", "gs bench gains")
    options: dict[str, object] = {}
    if name == "sigkill":
        options = {"runs": runs, "seed": seed}
    elif name == "law":
        options = {"formations": formations.split(","), "profiles": profiles.split(","), "seeds": seeds}
    values: dict[str, Any] = import_module(BENCHES[name]).run(out, **options)
    table = Table("figure", "value", title=f"bench {name}")
    for key, value in values.items():
        if isinstance(value, int | float | str):
            table.add_row(key, f"{value:.4g}" if isinstance(value, float) else str(value))
    if table.row_count:
        out.console.print(table)
    out.result(values)
