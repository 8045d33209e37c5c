"""``gs design``: from a formation file to certified gains, or to the reason why there are none."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Annotated

import typer

from groundstation.app.completing import GRAPHS, choice, packaged
from groundstation.app.options import ForceOption, JsonOption
from groundstation.app.output import Output
from groundstation.core.errors import MissionFailed, UserError

_METHODS = "closed-form", "interior-point", "splitting", "clarabel", "cvxpy", "triangles"


def design(
    formation: Annotated[
        Path,
        typer.Argument(
            help="Formation file, or the name of one that comes along.", autocompletion=packaged("formations")
        ),
    ],
    *,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Gains file to write (.npz).")] = None,
    method: Annotated[
        str, typer.Option(help=f"auto, {', '.join(_METHODS)}.", autocompletion=choice("auto", *_METHODS))
    ] = "auto",
    gap: Annotated[float | None, typer.Option(help="Certified relative gap at which to stop.")] = None,
    budget: Annotated[float | None, typer.Option(help="Seconds after which the best so far is kept.")] = None,
    graph: Annotated[
        str | None,
        typer.Option(
            "--suggest-graph", help="Propose the edges: sparse, balanced or robust.", autocompletion=choice(*GRAPHS)
        ),
    ] = None,
    sensing_range: Annotated[float, typer.Option("--range", help="Sensing range for a suggested graph, m.")] = math.inf,
    max_degree: Annotated[int | None, typer.Option(help="Most neighbours of an agent in a suggested graph.")] = None,
    graph_file: Annotated[Path | None, typer.Option(help="Formation file to write with the suggested graph.")] = None,
    picture: Annotated[Path | None, typer.Option(help="Picture of the suggested graph and its trade-off.")] = None,
    robustness: Annotated[bool, typer.Option("--robustness", help="Report what the design withstands.")] = False,
    seed: Annotated[int, typer.Option(help="Seed of the perturbations in the robustness report.")] = 1,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Designs the gains of a formation and proves what they are worth."""
    import numpy as np

    from groundstation.app import designing
    from groundstation.app.resources import find_config
    from groundstation.design.designer import design as design_gains
    from groundstation.design.designer import evaluator
    from groundstation.design.graphs import Kind, suggest
    from groundstation.design.robustness import assess
    from groundstation.design.store import load_formation, save_gains

    out = Output(as_json=as_json)
    designing.check_options(method, gap, budget, graph, max_degree)
    designing.check_graph_options(graph, sensing_range, max_degree, graph_file, picture)
    shape = load_formation(find_config(formation, "formations"))
    values: dict[str, object] = {}
    for path in designing.claim_outputs(shape, output, graph_file, picture, force=force):
        out.console.print(f"replaces {path}", markup=False)
    if graph is not None:
        kinds: dict[str, Kind] = {"sparse": "sparse", "balanced": "balanced", "robust": "robust"}
        suggestion = suggest(shape, kinds[graph], evaluator(), range_m=sensing_range, max_degree=max_degree)
        designing.show_suggestion(out, suggestion, graph)
        designing.keep_suggestion(out, suggestion, graph_file, picture)
        shape = suggestion.formation
        values["suggested_edges"] = [[i + 1, j + 1] for i, j in shape.edges]
        values["trade_off"] = [{"edges": len(row.edges), "slowest": row.slowest} for row in suggestion.rows]
    if method == "closed-form" and 2 * len(shape.edges) != shape.size * (shape.size - 1):
        raise UserError("--method closed-form: the graph is not complete; use auto")
    start_ns = time.monotonic_ns()
    with designing.interruptible(out, budget) as watch:
        result = design_gains(shape, method=method, gap=gap, watch=watch)
        seconds = (time.monotonic_ns() - start_ns) / 1e9
        values = designing.summary(result, seconds) | values
        designing.show_design(out, result, seconds)
        repair = None if result.feasible else designing.find_mend(out, result, watch)
    if repair is not None:
        values["mend"] = [[i + 1, j + 1] for i, j in repair.edges]
    if result.gains is not None and result.certificate is not None:
        if robustness:
            rng = np.random.default_rng(seed)
            report = assess(shape, result.gains, result.certificate, evaluator(), rng=rng)
            designing.show_robustness(out, report)
            values["robustness"] = designing.robustness_summary(report)
        if output is not None:
            save_gains(output, shape, result.gains, result.certificate, result.method)
            out.console.print(f"written: {output}", markup=False)
    out.result(values)
    if not result.feasible:
        raise MissionFailed(f"{shape.name}: {'' if result.undecided else 'not feasible: '}{result.reason}")
