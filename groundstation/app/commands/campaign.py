"""``gs campaign``: many dry runs of one mission over random starts and faults, and what they come to."""

from __future__ import annotations

import itertools
import math
import shlex
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table as Listing
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from groundstation.app.campaign.cases import Cases
from groundstation.app.campaign.report import FILES, write_summary
from groundstation.app.campaign.run import Row, fly_case
from groundstation.app.campaign.spread import Interrupted, Lost, dask_flyer, spread
from groundstation.app.campaign.summary import below_r, missed, summarise
from groundstation.app.campaign.table import Table
from groundstation.app.campaign.vary import Vary, load_vary
from groundstation.app.commands.fly import JsonOption, SetOption
from groundstation.app.output import Output
from groundstation.app.resources import find_config
from groundstation.core.errors import CheckFailed, MissionFailed, UserError
from groundstation.core.own_files import alone_in, claim
from groundstation.records.manifest import claim_log, versions

_FLUSH_ROWS, _FLUSH_S = 50, 2.0
_CELLS_SHOWN = 40


def campaign(
    mission: Annotated[
        Path | None, typer.Option("--mission", help="Mission file; the one that --vary names by default.")
    ] = None,
    *,
    runs: Annotated[
        int | None, typer.Option(min=1, help="How many in all; by default what --vary says, or one of each cell.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of everything random in the campaign.", min=0)] = 0,
    vary: Annotated[Path | None, typer.Option("--vary", help="What varies (YAML), see docs/campaigns.md.")] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="Address of a Dask scheduler; processes of this machine by default.")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=0, help="Processes of this machine; one per core by default, 0 for a thread.")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with the campaign in the folder.")] = False,
    only: Annotated[int | None, typer.Option(min=0, help="Fly this one run again, here and now.")] = None,
    log: Annotated[Path | None, typer.Option(help="With --only: log to record (.tlog).")] = None,
    out_dir: Annotated[Path | None, typer.Option("-o", help="Folder for table, summary and pictures.")] = None,
    changes: SetOption = None,
    as_json: JsonOption = False,
) -> None:
    """Flies a mission many times in the emulator: random starts, noise, links and faults.

    Rows go to DIR/runs.parquet as they finish; killed or stopped, it goes on with --resume.
    """
    out = Output(as_json=as_json)
    varied = load_vary(None if vary is None else find_config(vary, "campaigns"))
    path = _mission(mission, varied)
    cases = Cases(path, varied, seed, tuple(changes or ()))
    if only is not None:
        _fly_one(out, cases, only, log)
        return
    if out_dir is None or log is not None:
        raise UserError("-o DIR is needed for the table" if out_dir is None else "--log goes with --only")
    count = runs or varied.spec.runs or len(varied.cells)
    with alone_in(out_dir, "the campaign"):
        table = Table(out_dir)
        for file in FILES:
            claim(out_dir / file, "the summary", "another folder with -o", ours=table.there, force=None)
        there = table.open(
            {
                "mission": str(path),
                "vary": varied.source,
                "seed": seed,
                "runs": count,
                "fingerprint": cases.fingerprint(),
                "versions": versions(),
            },
            resume=resume,
        )
        todo = [run for run in range(count) if run not in there]
        _announce(out, varied, count, len(todo))
        interrupted = Interrupted()

        def command(run: int) -> str:
            parts = ["gs", "campaign", "--seed", str(seed)]
            parts += ["--mission", str(mission)] if mission is not None else []
            parts += ["--vary", str(vary)] if vary is not None else []
            parts += [part for change in changes or () for part in ("--set", change)]
            return shlex.join([*parts, "--only", str(run), "--log", f"run-{run}.tlog"])

        lost: list[Lost] = []
        with ExitStack() as deaf:  # from the first run on until the summary is written Ctrl-C is only taken note of
            if todo:
                lost = _fly_all(
                    out,
                    cases,
                    todo,
                    table,
                    interrupted=interrupted,
                    deaf=deaf,
                    scheduler=scheduler,
                    workers=workers,
                    done=count - len(todo),
                )
            else:
                deaf.enter_context(interrupted.listening())
            rows = [row for row in table.merge() if row["run"] < count]
            stopped = interrupted.asked and len(rows) + len(lost) < count
            values = summarise(rows, [cell.name for cell in varied.cells], command)
            values |= {
                "table": str(table.runs_path),
                "interrupted": stopped,
                "not_flown": count - len(rows),
                "seed": seed,
            }
            title = f"{path.stem}: {len(rows)} runs"
            write_summary(out_dir, title if len(rows) == count else f"{title} of {count}", rows, values)
        _tell(out, values, out_dir)
        wanting = missed(values, varied.spec.expect)
        values["missed"] = wanting
        out.result(values)
        if stopped:
            wanting = [f"stopped after {len(rows)} of {count} runs; go on with --resume"]
        elif lost:
            wanting = [_lost(lost, count), *wanting]
        if wanting:
            raise MissionFailed("; ".join(wanting))


def _mission(mission: Path | None, varied: Vary) -> Path:
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


def _announce(out: Output, varied: Vary, count: int, todo: int) -> None:
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


def _fly_all(
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


def _lost(lost: Sequence[Lost], count: int) -> str:
    """How many runs were not flown, in words; why the first of them was not."""
    first = min(lost, key=lambda item: item.run)
    were = "was" if len(lost) == 1 else "were"
    return (
        f"{len(lost)} of {count} runs {were} not flown (run {first.run}: {first.why}); --resume flies what is missing"
    )


def _fly_one(out: Output, cases: Cases, run: int, log: Path | None) -> None:
    """Flies one run again, with a log where one is asked for."""
    if log is not None:
        claim_log(log, lambda there: there.dry_run)
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


def _tell(out: Output, values: Mapping[str, Any], folder: Path) -> None:
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
