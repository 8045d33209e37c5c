"""``gs new``: a formation file with a proposed sensing graph, from a shape's name or from points; or a law."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from groundstation.app.completing import GRAPHS, choice, shape_of
from groundstation.app.options import ForceOption, JsonOption
from groundstation.app.output import Output
from groundstation.core.choices import unknown
from groundstation.core.errors import UserError

_COMPLETE, _MESH = "complete", "mesh"
_KINDS = "formation", "law"


def new(
    what: Annotated[str, typer.Argument(help="formation or law.", autocompletion=choice(*_KINDS))],
    shape: Annotated[
        str,
        typer.Argument(
            help="ring, line, v, grid, cube, sphere, a CSV file (x,y,z in metres), a .skyc show; a law's name.",
            autocompletion=shape_of,
        ),
    ],
    *,
    agents: Annotated[int | None, typer.Option("--agents", "-n", help="How many; of a file, as it has.")] = None,
    spacing_m: Annotated[
        float | None, typer.Option("--spacing", help="Shortest distance between two agents, m.", show_default="1.0")
    ] = None,
    at_s: Annotated[
        float | None, typer.Option("--at", help="Time of a .skyc show, s, whose places are taken.", show_default="0")
    ] = None,
    graph: Annotated[
        str,
        typer.Option(
            help="Edges: complete, a proposed graph that is sparse, balanced or robust, or mesh for hundreds.",
            autocompletion=choice(_COMPLETE, _MESH, *GRAPHS),
        ),
    ] = "balanced",
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="File; ring12.yaml and such by default.")
    ] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Makes a formation file: gs new formation ring --agents 12. Or a law of your own: gs new law my_law."""
    if what == "law":
        from groundstation.app.law_file import new_law

        new_law(shape, output, Output(as_json=as_json), force=force)
        return
    from groundstation.app.formation_text import formation_text
    from groundstation.app.point_files import read_points, scale_to, show_points, write_new
    from groundstation.app.schema_files import schema_line, write_schema
    from groundstation.core.formation import Formation
    from groundstation.design.common_shapes import SHAPES, points_of
    from groundstation.design.designer import design, evaluator
    from groundstation.design.graphs import SHARE, Kind, suggest
    from groundstation.design.mesh import mesh

    kinds: dict[str, Kind] = {"sparse": "sparse", "balanced": "balanced", "robust": "robust"}
    out = Output(as_json=as_json)
    if what != "formation":
        raise UserError(f"gs new {what}: {unknown(what, _KINDS)}; for example: gs new formation ring -n 12")
    if graph not in (_COMPLETE, _MESH) and graph not in SHARE:
        raise UserError(f"--graph {graph}: {unknown(graph, (_COMPLETE, _MESH, *SHARE))}")
    if spacing_m is not None and not 0.0 < spacing_m <= 1e4:
        raise UserError(f"--spacing {spacing_m:g}: must be more than 0 m and at most 10000 m")
    suffix = Path(shape).suffix.lower() if shape not in SHAPES else ""
    is_file = suffix in (".csv", ".skyc")
    if at_s is not None and suffix != ".skyc":
        raise UserError(f"--at {at_s:g}: is the time of a .skyc show, and {shape} is none; leave it out")
    if is_file and agents is not None:
        raise UserError(f"--agents {agents}: {shape} says how many there are; leave it out")
    if not is_file and agents is None:
        raise UserError("--agents: say how many, for example --agents 8")
    if is_file:
        points = read_points(Path(shape)) if suffix == ".csv" else show_points(Path(shape), at_s or 0.0)
    else:
        points = points_of(shape, agents or 0)
    name = Path(shape).stem if is_file else f"{shape}{agents}"
    scale = scale_to(points, spacing_m)
    pairs = tuple(itertools.combinations(range(len(points)), 2)) if graph == _COMPLETE else ((0, 1),)
    formation = Formation(name=name, points_enu_m=points, edges=pairs)
    if graph == _MESH:
        formation = mesh(formation)
        figures = design(formation, method="triangles").certificate
        slowest = -(figures.lambda_max or 0.0) if figures is not None else 0.0
    else:
        if graph != _COMPLETE:
            formation = suggest(formation, kinds[graph], evaluator()).formation
        slowest, _ = evaluator()(formation)
    path = output or Path(f"{name}.yaml")
    about = [f"{len(points)} agents, {len(formation.edges)} edges ({graph}), slowest mode {slowest:.4g} 1/s of 10."]
    text = formation_text(formation, scale=scale, about=about)
    replaced = write_new(path, f"{schema_line('formation')}\n{text}", force=force)
    out.console.print(Text(f"{'replaced' if replaced else 'made'} {path}: {about[0]}"))
    schema = write_schema(path.parent, "formation")
    if schema is not None:
        out.console.print(Text(f"made {schema}: for editors"))
    how = " --method triangles" if graph == _MESH else ""
    out.console.print(Text(f"next:  gs design {path}{how}"))
    out.result({
        "file": str(path), "n": len(points), "edges": len(formation.edges), "scale": scale, "slowest": slowest,
    })  # fmt: skip
