"""The pictures of docs/robustness.md, from the rows of its campaign: a run of each line, committed beside the page."""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq  # type: ignore[import-untyped]
from matplotlib.figure import Figure

from groundstation.app.picture_style import QUIET, SERIES

ROWS = Path(__file__).parents[2] / "docs" / "robustness.csv"
_COLUMNS = (
    "cell", "run", "seed", "formed", "success", "safe", "time_to_form_s", "formation_error_m", "min_distance_m",
    "outcome",
)  # fmt: skip


@dataclass(frozen=True)
class Flown:
    """One run.

    Attributes:
        sweep: what was swept.
        value: how far.
        formed, success, safe: as the campaign judges them.
        error_m: largest true error of a distance while the formation was held, NaN where it was not.
        least_m: smallest true distance.
        time_s: to the formation, NaN where there was none.
    """

    sweep: str
    value: float
    formed: bool
    success: bool
    safe: bool
    error_m: float
    least_m: float
    time_s: float


def take(campaign: Path, runs: int | None = None) -> None:
    """Writes the rows of a campaign's folder, up to a number of runs, to the file that is committed."""
    rows = pq.read_table(campaign / "runs.parquet").to_pylist()
    with ROWS.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(_COLUMNS)
        for row in rows[:runs]:
            values = [row[name] for name in _COLUMNS]
            writer.writerow([f"{value:.3f}" if isinstance(value, float) else value for value in values])


def flown() -> list[Flown]:
    """The rows that are committed."""
    with ROWS.open(encoding="utf-8", newline="") as file:
        return [
            Flown(
                *_sweep(row["cell"]),
                *(row[name] == "True" for name in ("formed", "success", "safe")),
                *(float(row[name]) for name in ("formation_error_m", "min_distance_m", "time_to_form_s")),
            )
            for row in csv.DictReader(file)
        ]


def _sweep(cell: str) -> tuple[str, float]:
    name, value = cell.rsplit(" ", 1)
    return name, float(value)


@dataclass(frozen=True)
class Cell:
    """What the runs of one cell come to."""

    runs: tuple[Flown, ...]

    @property
    def formed(self) -> float:
        """Share of the runs that formed."""
        return float(np.mean([run.formed for run in self.runs]))

    @property
    def safe(self) -> int:
        """Number of runs that were safe."""
        return sum(run.safe for run in self.runs)

    def median(self, name: str) -> float:
        """Median of a figure of those that formed; NaN for none."""
        values = [getattr(run, name) for run in self.runs if run.formed]
        return float(np.median(values)) if values else float("nan")

    @property
    def least_m(self) -> float:
        """Smallest distance of all."""
        return min(run.least_m for run in self.runs)


def cells(rows: Iterable[Flown]) -> dict[tuple[str, float], Cell]:
    """Runs by what was swept and how far."""
    by: dict[tuple[str, float], list[Flown]] = {}
    for row in rows:
        by.setdefault((row.sweep, row.value), []).append(row)
    return {key: Cell(tuple(runs)) for key, runs in by.items()}


_PICTURES: tuple[tuple[str, tuple[tuple[str, str], ...]], ...] = (
    (
        "bias of each heading, degrees",
        (
            ("heading", "crazyflie"),
            ("heading alike", "all to one side"),
            ("heading px4_quad", "px4_quad"),
            ("camera", "of the sensor"),
        ),
    ),
    ("noise of relative positions, m", (("noise", "crazyflie"),)),
    (
        "share of time that an edge is lost",
        (
            ("loss", "waits"),
            ("loss remembered", "remembers 1 s"),
            ("loss one way", "one way"),
            ("loss left out", "goes on"),
        ),
    ),
    ("range, m", (("range", "waits"),)),
)


def pictures() -> Figure:
    """Success and error over bias, noise, loss and range."""
    by = cells(flown())
    figure = Figure(figsize=(14, 6.4), layout="constrained")
    axes: Any = figure.subplots(2, len(_PICTURES), sharex="col", sharey="row")
    for column, (label, lines) in enumerate(_PICTURES):
        for number, (sweep, words) in enumerate(lines):
            _line(axes[:, column], by, sweep, words, SERIES[number])
        axes[1, column].set_xlabel(label)
        axes[1, column].axhline(0.1, color=QUIET, linestyle=":", linewidth=1.2)
        if len(lines) > 1:
            axes[0, column].legend(fontsize=9, loc="lower left")
    axes[0, 0].set(ylabel="share that formed\n(dashed: kept r)", ylim=(-0.05, 1.05))
    axes[1, 0].set(ylabel="largest error of a distance\nwhile held, m", ylim=(0, None))
    return figure


def _line(axes: Sequence[Any], by: dict[tuple[str, float], Cell], sweep: str, words: str, colour: str) -> None:
    """One sweep: its share of success above, its errors below; from crazyflies without any of it where that is 0."""
    plain = by[("heading", 0.0)]
    here = {value: cell for (name, value), cell in sorted(by.items()) if name == sweep}
    if sweep not in {"range", "heading px4_quad"}:
        here = {0.0: plain, **here}
    values = list(here)
    axes[0].plot(values, [cell.formed for cell in here.values()], "o-", color=colour, label=words, markersize=4)
    safe = [cell.safe / len(cell.runs) for cell in here.values()]
    axes[0].plot(values, safe, "--", color=colour, linewidth=1.0)
    axes[1].plot(values, [cell.median("error_m") for cell in here.values()], "-", color=colour)
    for value, cell in here.items():
        errors = [run.error_m for run in cell.runs if run.formed]
        axes[1].plot([value] * len(errors), errors, ".", color=colour, alpha=0.5)


def table() -> list[str]:
    """The rows of the page's table."""
    lines = []
    for (sweep, value), cell in cells(flown()).items():
        formed, count = sum(run.formed for run in cell.runs), len(cell.runs)
        figures = [f"{cell.median(name):.{digits}f}" for name, digits in (("time_s", 1), ("error_m", 2))]
        took, error = figures if formed else ("-", "-")
        least = f"{cell.least_m:.2f}"
        lines.append(
            f"| {sweep} {value:g} | {formed} of {count} | {cell.safe} of {count} | {took} | {error} | {least} |"
        )
    return lines


if __name__ == "__main__":
    take(Path(sys.argv[1]), int(sys.argv[2]) if sys.argv[2:] else None)
    sys.stdout.write("\n".join(table()) + "\n")
