"""``gs campaign``: many dry runs of one mission over random starts and faults, and what they come to."""

from __future__ import annotations

import shlex
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from groundstation.app.completing import packaged
from groundstation.app.options import ForceOption, JsonOption, SetOption
from groundstation.app.output import Output
from groundstation.core.errors import MissionFailed, UserError
from groundstation.core.extras import need

if TYPE_CHECKING:
    from groundstation.app.campaign.spread import Lost


def campaign(
    mission: Annotated[
        Path | None,
        typer.Option(
            "--mission", help="Mission file; the one that --vary names by default.", autocompletion=packaged("missions")
        ),
    ] = None,
    *,
    runs: Annotated[
        int | None, typer.Option(min=1, help="How many in all; by default what --vary says, or one of each cell.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of everything random in the campaign.", min=0)] = 0,
    vary: Annotated[
        Path | None,
        typer.Option("--vary", help="What varies (YAML), see docs/campaigns.md.", autocompletion=packaged("campaigns")),
    ] = None,
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
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Flies a mission many times in the emulator: random starts, noise, links and faults.

    Rows go to DIR/runs.parquet as they finish; killed or stopped, it goes on with --resume.
    """
    need("campaign", "gs campaign")
    from groundstation.app.campaign import conduct
    from groundstation.app.campaign.cases import Cases
    from groundstation.app.campaign.report import FILES, write_summary
    from groundstation.app.campaign.spread import Interrupted
    from groundstation.app.campaign.summary import missed, summarise
    from groundstation.app.campaign.table import Table
    from groundstation.app.campaign.vary import load_vary
    from groundstation.app.resources import find_config
    from groundstation.core.own_files import alone_in, claim
    from groundstation.records.manifest import versions

    out = Output(as_json=as_json)
    varied = load_vary(None if vary is None else find_config(vary, "campaigns"))
    path = conduct.mission_of(mission, varied)
    cases = Cases(path, varied, seed, tuple(changes or ()))
    if only is not None:
        conduct.fly_one(out, cases, only, log, force=force)
        return
    if out_dir is None or log is not None:
        raise UserError("-o DIR is needed for the table" if out_dir is None else "--log goes with --only")
    count = runs or varied.spec.runs or len(varied.cells)
    with alone_in(out_dir, "the campaign"):
        table = Table(out_dir)
        for file in FILES:
            claim(out_dir / file, "the summary", "another folder with -o", ours=table.there, force=force)
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
        conduct.announce(out, varied, count, len(todo))
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
                lost = conduct.fly_all(
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
        conduct.tell_campaign(out, values, out_dir)
        wanting = missed(values, varied.spec.expect)
        values["missed"] = wanting
        out.result(values)
        if stopped:
            wanting = [f"stopped after {len(rows)} of {count} runs; go on with --resume"]
        elif lost:
            wanting = [conduct.lost_words(lost, count), *wanting]
        if wanting:
            raise MissionFailed("; ".join(wanting))
