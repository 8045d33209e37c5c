"""What ``gs campaign`` does: many dry runs of one mission, and what is told of them."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table as Listing
from rich.text import Text
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from groundstation.app.campaign.cases import Cases
from groundstation.app.campaign.run import Row, fly_case
from groundstation.app.campaign.spread import Interrupted, Lost, dask_flyer, spread
from groundstation.app.campaign.summary import below_r
from groundstation.app.campaign.table import Table
from groundstation.app.campaign.vary import Vary
from groundstation.app.output import Output
from groundstation.app.resources import find_config, log_to_write
from groundstation.core.errors import CheckFailed, MissionFailed, UserError
from groundstation.records.manifest import claim_log

_FLUSH_ROWS, _FLUSH_S = 50, 2.0
_CELLS_SHOWN = 40


def mission_of(mission: Path | None, varied: Vary) -> Path:
    """Finds the mission that is flown: the one that was asked for, else the one that the vary file names.

    Raises:
        UserError: neither names one, or a mission beside an adversary, which draws its own.
    """
    if mission is not None and varied.spec.adversary is not None:
        raise UserError(f"--mission: the adversary of {varied.source} draws its own missions; leave it out")
    if mission is not None:
        return find_config(mission, "missions")
    if varied.spec.adversary is not None:
        return Path(varied.source)
    if varied.spec.mission is None:
        raise UserError("--mission FILE is missing, and the vary file names none")
    beside = Path(varied.source).parent / varied.spec.mission
    return beside if beside.is_file() else find_config(Path(varied.spec.mission), "missions")


def announce(out: Output, varied: Vary, count: int, todo: int) -> None:
    """Says how many runs there will be, how often each cell is flown, and what is there already."""
    cells = len(varied.cells)
    each = f" over {cells} cells, {_share(count, cells)}" if cells > 1 else ""
    out.console.print(
        f"{count} runs{each}; {count - todo} are there already" if todo < count else f"{count} runs{each}"
    )
    if count < cells:
        out.console.print(f"fewer runs than cells: the last {cells - count} of them are not flown")


def _share(count: int, cells: int) -> str:
    """How often each cell is flown, in words."""
    if count < cells:
        return f"one each in the first {count}" if count > 1 else "in the first one"
    least, more = divmod(count, cells)
    return f"{least} each" if not more else f"{least} or {least + 1} each"


def fly_all(
    out: Output,
    cases: Cases,
    todo: list[int],
    table: Table,
    *,
    interrupted: Interrupted,
    deaf: ExitStack,
    scheduler: str | None,
    workers: int | None,
    done: int,
) -> list[Lost]:
    """Flies what is missing; whatever happens, rows that came back are in the table.

    Returns what was lost. Ctrl-C is heard by ``interrupted`` until ``deaf`` closes.
    """
    waiting: list[Row] = []
    flushed_s = time.monotonic()
    counts = {"not formed": 0, "below r": 0, "errors": 0}
    progress = Progress(
        TextColumn("flying"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[state]}"),
        console=out.console,
        transient=True,
        disable=not out.console.is_terminal,
    )
    bar = progress.add_task("flying", total=len(todo) + done, completed=done, state="")

    def keep(rows: list[Row]) -> None:
        nonlocal flushed_s
        waiting.extend(rows)
        for row in rows:
            counts["not formed"] += not row["formed"]
            counts["below r"] += below_r(row)
            counts["errors"] += bool(row["error"])
        state = ", ".join(f"{value} {key}" for key, value in counts.items() if value)
        progress.update(bar, advance=len(rows), state=state)
        if len(waiting) >= _FLUSH_ROWS or time.monotonic() - flushed_s >= _FLUSH_S:
            table.append(waiting)
            waiting.clear()
            flushed_s = time.monotonic()

    try:
        with dask_flyer(scheduler, workers, out.console.print) as flyer, progress:
            deaf.enter_context(interrupted.listening())
            lost = spread(map(cases.case, itertools.chain(todo)), flyer, keep, interrupted)
            if lost:  # perhaps only with a worker that another run had killed, so that each gets one more chance alone
                out.console.print(f"{len(lost)} lost with their workers; flying them once more, one at a time")
                lost = [
                    again for one in lost for again in spread(iter([cases.case(one.run)]), flyer, keep, interrupted)
                ]
        if interrupted.asked:
            out.console.print("stopping: table and summary of the runs that are there")
        return lost
    finally:
        table.append(waiting)


def lost_words(lost: Sequence[Lost], count: int) -> str:
    """How many runs were not flown, in words; why the first of them was not."""
    first = min(lost, key=lambda item: item.run)
    were = "was" if len(lost) == 1 else "were"
    return (
        f"{len(lost)} of {count} runs {were} not flown (run {first.run}: {first.why}); --resume flies what is missing"
    )


def fly_one(out: Output, cases: Cases, run: int, log: Path | None, *, force: bool = False) -> None:
    """Flies one run again, with a log where one is asked for."""
    if log is not None:
        log = log_to_write(log)
        seed = cases.case(run).seed
        if claim_log(log, lambda there: there.dry_run and there.seed == seed, force=force):
            out.console.print(Text(f"replaces {log}"))
    with threadpool_limits(1):
        row = fly_case(cases.case(run), log)
    listing = Listing("column", "value", title=f"run {run}")
    unknown = ("log_mismatches", "log_complete") if row["log_mismatches"] < 0 else ()  # the log was not verified
    for key, value in row.items():
        if key not in unknown and value not in ("", None) and not (isinstance(value, float) and math.isnan(value)):
            listing.add_row(key, f"{value:.4f}" if isinstance(value, float) else str(value))
    out.console.print(listing)
    out.result({**row, "log": None if log is None else str(log)})
    if row["error"]:
        raise MissionFailed(f"run {run}: {row['error']}") if row["outcome"] else _unflown(run, row)


def _unflown(run: int, row: Row) -> UserError:
    error = CheckFailed(f"run {run}: {row['error']}")
    error.answered = True
    return error


def tell_campaign(out: Output, values: Mapping[str, Any], folder: Path) -> None:
    """Prints the table of cells, the worst runs and where the summary is."""
    cells = [*values["cells"], {"cell": "all", **values}]
    if len(cells) > _CELLS_SHOWN:
        out.console.print(f"{len(cells) - 1} cells; those that are not safe in every run:")
        cells = [cell for cell in cells[:-1] if cell["safe_rate"] < 1.0][:_CELLS_SHOWN] + cells[-1:]
    listing = Listing(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    listing.add_column("cell", min_width=12, overflow="fold")
    for heading in ("runs", "success (95 %)", "formed", "safe", "<r", "median", "nearest"):
        listing.add_column(heading, no_wrap=True, justify="right")
    for cell in cells:
        low, high = (f"{100 * cell[f'success_{end}']:.3g}" for end in ("low", "high"))
        listing.add_row(
            cell["cell"],
            str(cell["runs"]),
            f"{_figure(100 * cell['success_rate'], '%')} ({low}-{high})",
            _figure(100 * cell["formed_rate"], "%"),
            _figure(100 * cell["safe_rate"], "%"),
            str(cell["below_r"]),
            _figure(cell["median_time_to_form_s"], "s"),
            _figure(cell["min_distance_m"], "m"),
        )
    out.console.print(listing)
    for worst in values["worst"][:3]:
        out.console.print(f"run {worst['run']}: {worst['why']}\n  {worst['replay']}")
    out.console.print(f"summary and pictures: {folder / 'index.html'}")


def _figure(value: float, unit: str) -> str:
    return f"{value:.3g} {unit}" if math.isfinite(value) else "-"
