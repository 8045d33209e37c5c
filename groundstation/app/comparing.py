"""``gs compare``, and ``gs report`` of several logs: tables, pictures that lay flights over each other, and a page.

matplotlib is loaded when something is drawn and not before.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.table import Table

from groundstation.app.picture_style import INK, QUIET, SERIES, STYLE
from groundstation.app.pictures import save_picture, source
from groundstation.app.report import claim_report, write_report
from groundstation.app.templates import render
from groundstation.core.errors import CheckFailed, UserError
from groundstation.core.own_files import claim, write_whole
from groundstation.core.types import FloatArray, IntArray
from groundstation.records.comparison import (
    Deviation,
    Summary,
    begin_ns,
    common,
    deviations,
    labels,
    placed,
    summary,
)
from groundstation.records.replay import Flight, load_flight

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LOGS_MAX = 50
_MOST_INSTANTS = 3_000
_MARK = '<meta name="generator" content="gs compare">'
_COLUMNS = {
    "label": "flight",
    "outcome": "outcome",
    "vehicles": "vehicles",
    "time_to_form_s": "formed after, s",
    "hold_error_m": "largest error held, m",
    "min_distance_m": "smallest distance, m",
    "safety_radius_m": "r, m",
    "flight_s": "flight, s",
    "way_m": "way flown, m",
    "effort_m": "setpoints, m",
    "effort_m2_s": "setpoints squared, m²/s",
}
_DEVIATION_COLUMNS = {
    "first": "flight",
    "second": "and",
    "vehicles": "vehicles",
    "seconds": "over, s",
    "rms_m": "places apart, rms, m",
    "max_m": "at most, m",
    "vehicle": "vehicle",
    "at_s": "at, s",
    "distance_max_m": "distances apart at most, m",
}


@dataclass(frozen=True)
class Comparison:
    """Several flights, read and compared.

    Attributes:
        logs: their files.
        flights: as read.
        summaries: figures of each.
        deviations: of every two.
    """

    logs: tuple[Path, ...]
    flights: tuple[Flight, ...]
    summaries: tuple[Summary, ...]
    deviations: tuple[Deviation, ...]

    def values(self) -> dict[str, object]:
        """For JSON: what is not known is NaN."""
        return {
            "logs": [{"log": str(log), **asdict(item)} for log, item in zip(self.logs, self.summaries, strict=True)],
            "deviations": [asdict(item) for item in self.deviations],
        }


def compare_logs(logs: Sequence[Path]) -> Comparison:
    """Reads logs and compares them.

    Raises:
        UserError: fewer than two, more than fifty, or one that cannot be read.
        CheckFailed: one holds nothing that could be compared.
    """
    if not 2 <= len(logs) <= _LOGS_MAX:
        raise UserError(f"{len(logs)} logs: can compare 2 to {_LOGS_MAX}; name them one after the other")
    flights = [load_flight(log) for log in logs]
    for log, flight in zip(logs, flights, strict=True):
        if not flight.useful:
            raise CheckFailed(f"{log}: holds no position and no setpoint; leave it out")
    names = labels(flights, [log.stem for log in logs])
    return Comparison(
        tuple(logs),
        tuple(flights),
        tuple(summary(flight, name) for flight, name in zip(flights, names, strict=True)),
        tuple(deviations(flights, names)),
    )


def tables(comparison: Comparison) -> list[Table]:
    """The figures for a terminal: a row for each flight, then one for every two of them."""
    made = []
    for columns, rows in _tables(comparison):
        table = Table(*columns)
        for row in rows:
            table.add_row(*row)
        made.append(table)
    return made


def _tables(comparison: Comparison) -> list[tuple[list[str], list[list[str]]]]:
    kinds: tuple[tuple[dict[str, str], Sequence[Summary | Deviation]], ...] = (
        (_COLUMNS, comparison.summaries),
        (_DEVIATION_COLUMNS, comparison.deviations),
    )
    return [
        (
            [columns[field.name] for field in fields(items[0])],
            [[_cell(getattr(item, field.name)) for field in fields(item)] for item in items],
        )
        for columns, items in kinds
    ]


def _cell(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.3f}" if math.isfinite(value) else "-"
    return str(value) or "-"


@dataclass(frozen=True)
class _Picture:
    file: str
    title: str
    height_in: float
    draw: Callable[[Figure, Comparison], None]


def claim_comparison(folder: Path, *, force: bool) -> bool:
    """Makes sure that a comparison may be written into a folder; returns whether an earlier one is replaced.

    Raises:
        UserError: files of its names are there that are of no comparison.
    """
    page = folder / "index.html"

    def ours() -> bool:
        with contextlib.suppress(OSError):
            return _MARK.encode() in page.read_bytes()[: 1 << 16]
        return False

    paths = (page, *(folder / item.file for item in _PICTURES))
    replaced = [claim(path, "the comparison", "another folder with -o", ours=ours, force=force) for path in paths]
    return any(replaced)


def write_comparison(
    comparison: Comparison, folder: Path, *, logs: Sequence[Path] = (), force: bool = False
) -> list[Path]:
    """Draws pictures and writes a page that has them in it; with ``logs`` a report of each flight, in its own folder.

    Args:
        comparison: what to show.
        folder: made when missing.
        logs: that the flights were read from, each of which gets a report, linked from the page.
        force: replace files of these names whatever they are.

    Returns:
        The files written, the page first.

    Raises:
        UserError: a file cannot be written, or is not ours to replace.
    """
    import matplotlib as mpl  # noqa: PLC0415 - takes a second to load, which no other command should pay
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415
    from matplotlib.figure import Figure  # noqa: PLC0415

    claim_comparison(folder, force=force)
    folders = [folder / f"{number + 1}" for number in range(len(logs))]
    for own in folders:
        claim_report(own, force=force)
    written = [folder / "index.html"]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for picture in _PICTURES:
            with mpl.rc_context(STYLE):
                figure = Figure(figsize=(12.0, picture.height_in), dpi=100, layout="constrained")
                FigureCanvasAgg(figure)
                picture.draw(figure, comparison)
                save_picture(figure, folder / picture.file, 100)
            written.append(folder / picture.file)
        drawn = {picture.file: source((folder / picture.file).read_bytes()) for picture in _PICTURES}
        for own, flight, log in zip(folders, comparison.flights, logs, strict=False):
            written += write_report(flight, own, log=log)
        write_whole(written[0], _page(comparison, folders, drawn).encode("utf-8"), durable=False)
    except OSError as error:
        raise UserError(
            f"{error.filename or folder}: cannot write the comparison: {error.strerror or error}; give another folder"
            " with -o"
        ) from error
    return written


def _page(comparison: Comparison, folders: Sequence[Path], drawn: Mapping[str, str]) -> str:
    return render(
        "comparison.html",
        title=f"{len(comparison.flights)} flights compared",
        tables=_tables(comparison),
        links=[f"{folder.name}/index.html" for folder in folders],
        pictures=_PICTURES,
        sources=drawn,
    )


def _since(flight: Flight) -> tuple[IntArray, FloatArray]:
    """Instants of a flight, thinned, and the same in seconds from the common begin."""
    instants = flight.instants_ns()
    if len(instants) > _MOST_INSTANTS:
        instants = instants[np.unique(np.linspace(0, len(instants) - 1, _MOST_INSTANTS).astype(np.int64))]
    return instants, (instants - begin_ns(flight)) / 1e9


def _colour(number: int) -> str:
    return SERIES[number % len(SERIES)]


def _finish(figure: Figure, axes: Axes, label: str, *, any_line: bool) -> None:
    axes.set_xlabel("time from the first step in s")
    axes.set_ylabel(label)
    if any_line:
        figure.legend(loc="outside lower center", ncols=4)
    else:
        axes.text(0.5, 0.5, "not known of any of these flights", transform=axes.transAxes, ha="center", color=QUIET)


def _draw_errors(figure: Figure, comparison: Comparison) -> None:
    axes, drawn = figure.add_subplot(), False
    for number, flight in enumerate(comparison.flights):
        instants, since_s = _since(flight)
        error = flight.formation_error_at(instants)
        wanted = (since_s >= 0.0) & np.isfinite(error)
        if wanted.any():
            drawn = True
            axes.semilogy(
                since_s[wanted], error[wanted], color=_colour(number), lw=1.8, label=comparison.summaries[number].label
            )
    _finish(figure, axes, "formation error in m", any_line=drawn)


def _draw_distances(figure: Figure, comparison: Comparison) -> None:
    axes, drawn = figure.add_subplot(), False
    for number, flight in enumerate(comparison.flights):
        instants, since_s = _since(flight)
        distances = flight.distances_at(instants)
        if not distances.size:
            continue
        least = np.min(np.where(np.isnan(distances), np.inf, distances), axis=1)
        known = np.isfinite(least)
        if known.any():
            drawn = True
            axes.plot(
                since_s[known], least[known], color=_colour(number), lw=1.6, label=comparison.summaries[number].label
            )
    for radius_m in sorted(
        {item.safety_radius_m for item in comparison.summaries if math.isfinite(item.safety_radius_m)}
    ):
        axes.axhline(radius_m, color=QUIET, lw=2.5, zorder=1)
        text = f"r = {radius_m:g} m"
        axes.annotate(text, (1.0, radius_m), xycoords=("axes fraction", "data"), ha="right", va="bottom", color=INK)
    axes.set_ylim(bottom=0.0)
    _finish(figure, axes, "smallest distance in m", any_line=drawn)


def _draw_deviations(figure: Figure, comparison: Comparison) -> None:
    """Of each flight from the first one."""
    axes, drawn = figure.add_subplot(), False
    first = comparison.flights[0]
    for number, flight in enumerate(comparison.flights[1:], start=1):
        since_s, vehicles = common(first, flight)
        off_m = np.linalg.norm(placed(first, since_s, vehicles) - placed(flight, since_s, vehicles), axis=2)
        known = np.isfinite(off_m).any(axis=1)
        if known.any():
            drawn = True
            label = f"{comparison.summaries[number].label} from {comparison.summaries[0].label}"
            axes.plot(since_s[known], np.nanmax(off_m[known], axis=1), color=_colour(number), lw=1.6, label=label)
    axes.set_ylim(bottom=0.0)
    _finish(figure, axes, "farthest vehicle from its place in m", any_line=drawn)


def _draw_paths(figure: Figure, comparison: Comparison) -> None:
    plan, side = figure.subplots(1, 2)
    for number, flight in enumerate(comparison.flights):
        for first, track in enumerate(flight.vehicles):
            path = track.pos_team_enu_m
            label = {"label": comparison.summaries[number].label} if first == 0 else {}
            plan.plot(path[:, 0], path[:, 1], color=_colour(number), lw=1.0, alpha=0.7, **label)
            side.plot(path[:, 0], path[:, 2], color=_colour(number), lw=1.0, alpha=0.7)
    for axes, up in ((plan, "north in m"), (side, "up in m")):
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_xlabel("east in m")
        axes.set_ylabel(up)
    figure.legend(loc="outside lower center", ncols=4)


_PICTURES = (
    _Picture("compare_error.png", "Formation error", 5.0, _draw_errors),
    _Picture("compare_distance.png", "Smallest distance between two vehicles", 5.0, _draw_distances),
    _Picture("compare_deviation.png", "Deviation from the first flight", 5.0, _draw_deviations),
    _Picture("compare_paths.png", "Paths, from above and from the south", 6.0, _draw_paths),
)
