"""What ``gs design`` does: from a formation file to certified gains, or to the reason why there are none."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import numpy as np
from rich.markup import escape
from rich.table import Table

from groundstation.app.formation_text import formation_text
from groundstation.app.output import Output
from groundstation.app.pictures import claim_picture
from groundstation.core.choices import unknown
from groundstation.core.errors import UserError
from groundstation.core.formation import Formation
from groundstation.core.own_files import claim, write_whole
from groundstation.design.designer import METHODS, DesignResult, evaluator
from groundstation.design.diagnosis import WEAK, Mend, mend, names, weak_agents
from groundstation.design.graphs import SHARE, Suggestion
from groundstation.design.problem import SPECTRAL_NORM, Progress, Watch, split
from groundstation.design.robustness import Robustness
from groundstation.design.store import load_gains

_MEND_LIMIT = 40
"""Agents up to which mending edges are searched for without being asked."""


def check_options(
    method: str, gap: float | None, budget: float | None, graph: str | None, max_degree: int | None
) -> None:
    """Refuses values that no design can have.

    Raises:
        UserError: which one, and what would do.
    """
    if method != "auto" and method not in METHODS:
        raise UserError(f"--method {method}: {unknown(method, ('auto', *METHODS))}")
    if gap is not None and not 0 < gap < 1:
        raise UserError(f"--gap {gap:g}: must lie between 0 and 1; 0.01 means within 1 % of the optimum")
    if budget is not None and not budget > 0:
        raise UserError(f"--budget {budget:g}: must be more than 0 seconds")
    if graph is not None and graph not in SHARE:
        raise UserError(f"--suggest-graph {graph}: {unknown(graph, SHARE)}")
    if max_degree is not None and max_degree < 1:
        raise UserError(f"--max-degree {max_degree}: must be at least 1")


def claim_outputs(
    shape: Formation, output: Path | None, graph_file: Path | None, picture: Path | None, *, force: bool
) -> list[Path]:
    """Makes sure, before anything is worked out, that what is asked for may be written.

    Returns:
        Files that are there and will be replaced.

    Raises:
        UserError: a file is there that this command would not make again, see ``own_files.claim``.
    """

    def same_formation() -> bool:
        try:
            there = load_gains(output) if output is not None else None
        except UserError:
            return False
        return there is not None and np.array_equal(there.points_enu_m, shape.points_enu_m)

    replaced: list[Path] = []
    for path, what, remedy, ours in (
        (output, "the gains", "another file with -o", same_formation),
        (graph_file, "the formation", "another file with --graph-file", lambda: False),  # people work on those
    ):
        if path is not None and claim(path, what, remedy, ours=ours, force=force):
            replaced.append(path)
    if picture is not None and claim_picture(picture, force=force):
        replaced.append(picture)
    return replaced


def check_graph_options(
    graph: str | None, range_m: float, max_degree: int | None, graph_file: Path | None, picture: Path | None
) -> None:
    """Refuses options of a suggested graph where none is asked for.

    Raises:
        UserError: which ones, and what to add.
    """
    if not range_m > 0:
        raise UserError(f"--range {range_m:g}: must be more than 0 m")
    given = {
        "--range": np.isfinite(range_m),
        "--max-degree": max_degree is not None,
        "--graph-file": graph_file is not None,
        "--picture": picture is not None,
    }
    useless = [option for option, is_given in given.items() if is_given]
    if graph is None and useless:
        raise UserError(
            f"{', '.join(useless)}: only for a suggested graph; add --suggest-graph sparse, balanced or robust"
        )


@contextmanager
def interruptible(out: Output, budget: float | None) -> Iterator[Watch]:
    """Progress once a second; Ctrl-C or the end of the budget stop the method and keep the best so far."""
    interrupted: list[bool] = []
    start_ns = time.monotonic_ns()
    shown_ns = [start_ns]

    def stop() -> bool:
        return bool(interrupted) or (budget is not None and time.monotonic_ns() - start_ns > budget * 1e9)

    def report(now: Progress) -> None:
        if time.monotonic_ns() - shown_ns[0] < 1e9:
            return
        shown_ns[0] = time.monotonic_ns()
        low, high = SPECTRAL_NORM * now.slowest, SPECTRAL_NORM * now.bound
        state = f"slowest mode in [{low:.4g}, {high:.4g}] 1/s" if low > 0 else f"nothing yet, at most {high:.4g} 1/s"
        out.console.print(f"{now.block} {now.method} {now.iteration}: {state}", markup=False)

    def handle(_: int, __: FrameType | None) -> None:
        if interrupted:
            raise KeyboardInterrupt
        interrupted.append(True)
        out.console.print("stopping, the best certified matrix is kept (Ctrl-C again to quit)")

    before = signal.signal(signal.SIGINT, handle)
    try:
        yield Watch(stop=stop, report=report)
    finally:
        signal.signal(signal.SIGINT, before)


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
        "interval": list(figures.interval) if figures else None,
        "gap": figures.gap if figures else None,
        "method": result.method,
        "finished": result.finished,
        "notes": list(result.notes),
        "seconds": seconds,
    }
    if not result.feasible:
        values["reason"] = result.reason
    return values


def show_design(out: Output, result: DesignResult, seconds: float) -> None:
    """Prints the certificate of a design, its notes and whoever moves slowly."""
    shape, figures = result.formation, result.certificate
    title = escape(f"{shape.name}: {shape.size} agents, {len(shape.edges)} edges, {result.method}, {seconds:.3f} s")
    if figures is not None:
        table = Table("", "slowest mode", "at most", "fastest", "zeros", title=title, title_justify="left")
        for name, block in (("xy", figures.xy), ("z", figures.z)):
            if np.isinf(block.slowest):
                table.add_row(name, "-", "-", "-", f"{block.zeros} of {block.zeros_expected}")
                continue
            row = [f"{value:.4f} 1/s" for value in (max(block.slowest, 0.0), max(block.bound, 0.0), block.fastest)]
            table.add_row(name, *row, f"{block.zeros} of {block.zeros_expected}")
        out.console.print(table)
    for note in result.notes:
        out.console.print(f"note: {note}", markup=False)
    if result.feasible and not result.finished:
        out.console.print("note: stopped before the gap was reached; the matrix is certified all the same")
    if figures is None or result.gains is None:
        return
    blocks = split(shape)
    for label, problem, part, gain in (
        ("horizontal", blocks[0], figures.xy, result.gains.xy),
        ("vertical", blocks[1], figures.z, result.gains.z),
    ):
        if np.isfinite(part.slowest) and part.slowest < WEAK * part.fastest:
            out.console.print(
                f"weak: the slowest {label} mode, {part.slowest:.3g} 1/s, moves {names(weak_agents(problem, gain))} "
                "against the rest; edges there would help most"
            )


def find_mend(out: Output, result: DesignResult, watch: Watch) -> Mend | None:
    """Edges that would make a formation feasible that was proven not to be."""
    if result.certificate is None or result.undecided or result.formation.size > _MEND_LIMIT or watch.stop():
        return None
    out.console.print("looking for edges that mend it (Ctrl-C ends the search)", style="dim")
    found = mend(result.formation, result.certificate, evaluator(gap=0.2), stop=watch.stop)
    if found is None:
        cut = "time ran out before edges that would help were found"
        out.console.print(cut if watch.stop() else "no edges would help")
        return None
    edges = ", ".join(f"{i + 1} to {j + 1}" for i, j in found.edges)
    count = "fewest" if found.fewest else "few"
    out.console.print(f"{count} edges that mend it: {edges} (slowest mode then about {found.slowest:.3g} 1/s)")
    return found


def show_suggestion(out: Output, found: Suggestion, graph: str) -> None:
    """Prints the trade-off of a suggested graph, and its edges."""
    shape = found.formation
    table = Table("edges", "slowest mode", "", title=escape(f"{shape.name}: {graph} graph"), title_justify="left")
    for row in found.rows:
        mark = "chosen" if row.edges == found.formation.edges else ""
        table.add_row(str(len(row.edges)), f"{row.slowest:.3f} 1/s" if row.slowest > 0 else "infeasible", mark)
    out.console.print(table)
    out.console.print("edges: " + ", ".join(f"[{i + 1}, {j + 1}]" for i, j in found.formation.edges), markup=False)
    if found.slowest > found.before:
        out.console.print(
            f"edges were exchanged for others: slowest mode {found.before:.3f} -> {found.slowest:.3f} 1/s"
        )
    if found.survives_edges is not None:
        word = "stays feasible" if found.survives_edges else "does NOT stay feasible"
        out.console.print(f"{word} when any one edge is lost")


def keep_suggestion(out: Output, found: Suggestion, graph_file: Path | None, picture: Path | None) -> None:
    """Writes the suggested graph as a formation file and as a picture, where asked for.

    Raises:
        UserError: a file cannot be written.
    """
    if graph_file is not None:
        _write_formation(graph_file, found.formation)
        out.console.print(f"written: {graph_file}", markup=False)
    if picture is not None:
        from groundstation.app.design_picture import draw_suggestion  # noqa: PLC0415 - matplotlib is slow to load

        draw_suggestion(picture, found)
        out.console.print(f"written: {picture}", markup=False)


def _write_formation(path: Path, formation: Formation) -> None:
    try:
        write_whole(path, formation_text(formation).encode("utf-8"), durable=False)
    except OSError as error:
        raise UserError(f"{path}: cannot be written ({error.strerror}); choose another --graph-file") from error


def show_robustness(out: Output, report: Robustness) -> None:
    """Prints what a design withstands."""
    out.console.print(
        f"slowest mode {report.slowest:.4f} 1/s, fastest {report.fastest:.4f} 1/s, condition {report.condition:.2f}"
    )
    table = Table("lost", "gains as they are: growth", "drift of the shape", "after a new design", title="losses")
    for loss in (*report.edges, *report.agents):
        table.add_row(
            loss.what,
            f"{loss.growth:.3g} 1/s" if loss.growth > 0 else "none",
            f"{loss.drift:.3g} 1/s",
            f"{loss.redesigned:.3f} 1/s" if loss.redesigned > 0 else "infeasible",
        )
    out.console.print(table)
    runs = report.perturbed
    out.console.print(
        f"scales 0.1 to 10, rotations to 85 degrees, switching: {runs.converged} of {runs.runs} runs converged, "
        f"the slowest in {runs.slowest_time_s:.1f} s; V grew in {runs.lyapunov_rises} steps"
    )


def robustness_summary(report: Robustness) -> dict[str, object]:
    """The JSON of a robustness report."""
    return {
        "slowest": report.slowest,
        "condition": report.condition,
        "losses": [
            {"what": loss.what, "growth": loss.growth, "drift": loss.drift, "redesigned": loss.redesigned}
            for loss in (*report.edges, *report.agents)
        ],
        "runs": report.perturbed.runs,
        "converged": report.perturbed.converged,
        "lyapunov_rises": report.perturbed.lyapunov_rises,
        "slowest_time_s": report.perturbed.slowest_time_s,
    }
