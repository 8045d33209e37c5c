"""``gs new formation``: a formation file with a proposed sensing graph, from a shape's name or from points."""

from __future__ import annotations

import csv
import itertools
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.text import Text

from groundstation.app.formation_text import formation_text
from groundstation.app.output import Output
from groundstation.core.errors import UserError
from groundstation.core.formation import Formation
from groundstation.core.types import FloatArray
from groundstation.design.common_shapes import SHAPES, points_of, shortest_m
from groundstation.design.designer import evaluator
from groundstation.design.graphs import SHARE, Kind, suggest

_KINDS: dict[str, Kind] = {"sparse": "sparse", "balanced": "balanced", "robust": "robust"}
_COMPLETE = "complete"
_BYTES_MAX = 1 << 20


def new(
    what: Annotated[str, typer.Argument(help="formation")],
    shape: Annotated[str, typer.Argument(help="ring, line, v, grid, cube, sphere, or a CSV file of x,y,z in metres.")],
    *,
    agents: Annotated[int | None, typer.Option("--agents", "-n", help="How many; of a CSV file, as it has.")] = None,
    spacing_m: Annotated[
        float | None, typer.Option("--spacing", help="Shortest distance between two agents, m.", show_default="1.0")
    ] = None,
    graph: Annotated[
        str, typer.Option(help="Edges: complete, or a proposed graph that is sparse, balanced or robust.")
    ] = "balanced",
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="File; ring12.yaml and such by default.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Answer with one JSON object.")] = False,
) -> None:
    """Makes a formation file: gs new formation ring --agents 12."""
    out = Output(as_json=as_json)
    if what != "formation":
        raise UserError(f"gs new {what}: can make a formation; write gs new formation {shape}")
    if graph != _COMPLETE and graph not in SHARE:
        raise UserError(f"--graph {graph}: unknown; known are {_COMPLETE}, {', '.join(SHARE)}")
    if spacing_m is not None and not 0.0 < spacing_m <= 1e4:
        raise UserError(f"--spacing {spacing_m:g}: must be more than 0 m and at most 10000 m")
    is_file = shape not in SHAPES and Path(shape).suffix.lower() == ".csv"
    if is_file and agents is not None:
        raise UserError(f"--agents {agents}: {shape} says how many there are; leave it out")
    if not is_file and agents is None:
        raise UserError("--agents: say how many, for example --agents 8")
    points = _read_points(Path(shape)) if is_file else points_of(shape, agents or 0)
    name = Path(shape).stem if is_file else f"{shape}{agents}"
    scale = _scale(points, spacing_m)
    pairs = tuple(itertools.combinations(range(len(points)), 2)) if graph == _COMPLETE else ((0, 1),)
    formation = Formation(name=name, points_enu_m=points, edges=pairs)
    if graph != _COMPLETE:
        formation = suggest(formation, _KINDS[graph], evaluator()).formation
    slowest, _ = evaluator()(formation)
    path = output or Path(f"{name}.yaml")
    about = [f"{len(points)} agents, {len(formation.edges)} edges ({graph}), slowest mode {slowest:.4g} 1/s of 10."]
    _write(path, formation_text(formation, scale=scale, about=about))
    out.console.print(Text(f"made {path}: {about[0]}"))
    out.console.print(Text(f"next:  gs design {path}"))
    out.result({
        "file": str(path), "n": len(points), "edges": len(formation.edges), "scale": scale, "slowest": slowest,
    })  # fmt: skip


def _scale(points_m: FloatArray, spacing_m: float | None) -> float:
    """What the points are multiplied by, so that the two nearest are so far apart; points as they are where None."""
    if spacing_m is None:
        return 1.0
    return spacing_m / shortest_m(points_m)


def _read_points(path: Path) -> FloatArray:
    """Points of a CSV file: x, y, z in metres, one agent a line; a heading is passed over.

    Raises:
        UserError: cannot be read, or a line that is not three numbers; two points in one place.
    """
    try:
        with path.open("rb") as file:
            content = file.read(_BYTES_MAX + 1)
        text = content.decode("utf-8-sig")
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise UserError(f"{path}: is not a text file in UTF-8") from None
    if len(content) > _BYTES_MAX:
        raise UserError(f"{path}: is longer than {_BYTES_MAX >> 20} MB, the limit for such files")
    points: list[list[float]] = []
    for number, row in enumerate(csv.reader(text.splitlines()), start=1):
        if not row or (number == 1 and not _is_number(row[0])):
            continue
        if len(row) != 3 or not all(map(_is_number, row)):
            raise UserError(
                f"{path}: line {number}: expected three finite numbers x,y,z in metres, got {','.join(row)!r}"
            )
        points.append([float(value) for value in row])
    if not 2 <= len(points) <= 2_000:
        raise UserError(f"{path}: has {len(points)} points; a formation has 2 to 2000")
    array = np.array(points)
    if not shortest_m(array) > 0.0:
        raise UserError(f"{path}: two points are in one place; move one of them")
    return array


def _is_number(text: str) -> bool:
    try:
        return bool(abs(float(text)) <= 1e6)
    except ValueError:
        return False


def _write(path: Path, text: str) -> None:
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise UserError(f"{path}: is there already; choose another file with -o, or remove it first") from None
    except OSError as error:
        raise UserError(f"{path}: cannot be written: {error.strerror or error}; choose another file with -o") from None
