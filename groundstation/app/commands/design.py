"""``gs design``: from a formation file to certified gains."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from groundstation.app.output import Output
from groundstation.app.resources import find_config
from groundstation.core.errors import MissionFailed
from groundstation.design.designer import DesignResult
from groundstation.design.designer import design as design_gains
from groundstation.design.store import load_formation, save_gains


def design(
    formation: Annotated[Path, typer.Argument(help="Formation file, or the name of one that comes along.")],
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Gains file to write (.npz).")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Answer with one JSON object.")] = False,
) -> None:
    """Designs the gains of a formation and proves what they are worth."""
    out = Output(as_json=as_json)
    shape = load_formation(find_config(formation, "formations"))
    start_ns = time.monotonic_ns()
    result = design_gains(shape)
    seconds = (time.monotonic_ns() - start_ns) / 1e9
    if result.gains is not None and result.certificate is not None and output is not None:
        save_gains(output, shape, result.gains, result.certificate, result.method)
        out.console.print(f"written: {output}")
    out.result(summary(result, seconds))
    if not result.feasible:
        raise MissionFailed(f"{shape.name}: not feasible: {result.reason}")


def summary(result: DesignResult, seconds: float) -> dict[str, object]:
    """The JSON answer of ``gs design``."""
    figures = result.certificate
    values: dict[str, object] = {
        "n": result.formation.size,
        "edges": len(result.formation.edges),
        "feasible": result.feasible,
        "lambda_max": figures.lambda_max if figures else None,
        "lambda_min": figures.lambda_min if figures else None,
        "zero_eigenvalues": figures.zero_eigenvalues if figures else None,
        "kernel_residual": figures.kernel_residual if figures else None,
        "method": result.method,
        "seconds": seconds,
    }
    if not result.feasible:
        values["reason"] = result.reason
    return values
