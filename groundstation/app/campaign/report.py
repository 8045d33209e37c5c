"""Writes what a campaign came to: summary.json, a page with tables and pictures, the cells as Markdown.

matplotlib is loaded when pictures are drawn and not before.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from groundstation.app.campaign.run import Row
from groundstation.app.output import to_json
from groundstation.app.picture_style import BLUE, GREEN, ORANGE, RED, SERIES, STYLE
from groundstation.app.pictures import save_picture
from groundstation.app.templates import render
from groundstation.core.errors import UserError
from groundstation.core.own_files import write_whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_GROUPS_MAX = 24
_CELLS_MAX = 40
_PHASES = ("ground", "takeoff", "form", "hold", "return", "land")
_COLUMNS = (
    ("cell", "cell"),
    ("runs", "runs"),
    ("success_rate", "success"),
    ("interval", "95 %"),
    ("formed_rate", "formed"),
    ("safe_rate", "safe"),
    ("below_r", "below r"),
    ("min_distance_m", "smallest distance"),
    ("safety_radius_m", "r"),
    ("median_time_to_form_s", "median time"),
    ("p95_time_to_form_s", "95 % within"),
    ("max_time_to_form_s", "slowest"),
    ("median_slower", "of kinematic"),
    ("max_hold_speed_m_s", "speed in hold"),
    ("gridlocks", "gridlocks"),
    ("role_swaps", "swaps"),
    ("detours", "detours"),
    ("errors", "errors"),
)


_PICTURES = {
    "success.png": "Success, formed and safe, with 95 % intervals",
    "time_to_form.png": "Time to form",
    "smallest_distance.png": "Smallest true distance against r",
}
FILES = ("index.html", "summary.json", "summary.md", *_PICTURES)
"""Names of the files that a campaign's summary is made of."""


def write_summary(folder: Path, title: str, rows: Sequence[Row], values: Mapping[str, Any]) -> None:
    """Writes all files of the summary; those of an earlier one are replaced.

    Args:
        folder: of the campaign.
        title: heading.
        rows: in order of run.
        values: as ``summary.summarise`` gives them.

    Raises:
        UserError: a file cannot be written.
    """
    try:
        write_whole(folder / "summary.json", (to_json(values) + "\n").encode("utf-8"))
        write_whole(folder / "summary.md", to_markdown(values).encode("utf-8"))
        pictures = draw(folder, rows, values) if rows else []
        write_whole(folder / "index.html", _page(title, values, pictures).encode("utf-8"))
    except OSError as error:
        raise UserError(
            f"{error.filename or folder}: cannot write the summary: {error.strerror or error}; "
            "all rows are in the table: make room, then --resume"
        ) from None


def lines(values: Mapping[str, Any]) -> list[list[str]]:
    """The table of cells as text, heading first, all runs last."""
    out = [[heading for _, heading in _COLUMNS]]
    for cell in [*values["cells"], {**values, "cell": "all"}]:
        out.append([_text(cell, key) for key, _ in _COLUMNS])
    return out


def fault_lines(values: Mapping[str, Any]) -> list[list[str]]:
    """The faults by phase as text, heading first; empty without any."""
    found: Mapping[str, Mapping[str, Sequence[int]]] = values["matrix"]
    phases = [phase for phase in _PHASES if any(phase in row for row in found.values())]
    out = [["fault", *phases]] if found else []
    for name, row in found.items():
        out.append([name, *(f"{row[phase][0]} of {row[phase][1]}" if phase in row else "-" for phase in phases)])
    return out


def to_markdown(values: Mapping[str, Any]) -> str:
    """The table of cells, and the worst runs."""
    table = lines(values)
    text = [f"| {' | '.join(row)} |" for row in table]
    text.insert(1, "|" + " --- |" * len(table[0]))
    faults = fault_lines(values)
    if faults:
        text += ["", "Safe and told, of all runs:", "", f"| {' | '.join(faults[0])} |", "|" + " --- |" * len(faults[0])]
        text += [f"| {' | '.join(row)} |" for row in faults[1:]]
    text += ["", *(f"- run {item['run']}: {item['why']} (`{item['replay']}`)" for item in values["worst"])]
    return "\n".join(text) + "\n"


def _text(cell: Mapping[str, Any], key: str) -> str:
    if key == "interval":
        return f"{cell['success_low']:.2%} to {cell['success_high']:.2%}"
    value = cell[key]
    if isinstance(value, float) and not math.isfinite(value):
        return "-"
    if key.endswith("_rate"):
        return f"{value:.2%}"
    if key.endswith("_m"):
        return f"{value:.3f} m"
    if key.endswith("_m_s"):
        return f"{value:.3f} m/s"
    if key.endswith("_slower"):
        return f"{value:.1f} times"
    return f"{value:.1f} s" if key.endswith("_s") else str(value)


def _page(title: str, values: Mapping[str, Any], pictures: Sequence[tuple[str, str]]) -> str:
    return render(
        "campaign.html",
        title=title,
        cells=lines(values),
        faults=fault_lines(values),
        pictures=pictures,
        worst=values["worst"],
    )


def draw(folder: Path, rows: Sequence[Row], values: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Draws the pictures; returns file names and headings."""
    import matplotlib as mpl  # noqa: PLC0415
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415
    from matplotlib.figure import Figure  # noqa: PLC0415

    count = max(len(values["cells"]), 1)
    groups = [
        ([row for row in rows if row["run"] % count == k], cell["cell"]) for k, cell in enumerate(values["cells"])
    ]
    groups = groups or [(list(rows), "all")]
    out = []
    drawings = (_draw_rates, _draw_times, _draw_distances)
    for (file, heading), drawing in zip(_PICTURES.items(), drawings, strict=True):
        with mpl.rc_context(STYLE):
            tall = file == "success.png"
            height = 1.6 + 0.42 * (min(len(groups), _CELLS_MAX) + 1) if tall else 5.2
            figure = Figure(figsize=(11.0, max(height, 3.0)), dpi=100, layout="constrained")
            FigureCanvasAgg(figure)
            drawing(figure.add_subplot(), groups, values)
            save_picture(figure, folder / file, 100)
        out.append((file, heading))
    return out


def _draw_rates(axes: Axes, groups: Sequence[tuple[list[Row], str]], values: Mapping[str, Any]) -> None:
    cells = values["cells"]
    if len(cells) > _CELLS_MAX:  # then those that are not good, the worst first
        cells = sorted((cell for cell in cells if cell["safe_rate"] < 1.0), key=lambda cell: float(cell["safe_rate"]))
    cells = [*cells[:_CELLS_MAX], {**values, "cell": "all"}]
    places = np.arange(len(cells))[::-1]
    for shift, name, colour in ((0.22, "success", BLUE), (0.0, "formed", ORANGE), (-0.22, "safe", GREEN)):
        rate = np.array([cell[f"{name}_rate"] for cell in cells])
        low = np.array([cell[f"{name}_low"] for cell in cells])
        high = np.array([cell[f"{name}_high"] for cell in cells])
        axes.errorbar(rate, places + shift, xerr=[np.maximum(rate - low, 0), np.maximum(high - rate, 0)], fmt="o",
                      ms=5, color=colour, capsize=2.5, lw=1.4, label=name)  # fmt: skip
    axes.set_yticks(places, [cell["cell"] for cell in cells])
    axes.set_xlabel("share of runs")
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:.4g}")
    axes.set_ylim(-0.6, len(cells) - 0.4)
    axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=3)
    del groups


def _draw_times(axes: Axes, groups: Sequence[tuple[list[Row], str]], values: Mapping[str, Any]) -> None:
    for number, (rows, name) in enumerate(_few(groups)):
        times = np.sort([row["time_to_form_s"] for row in rows if math.isfinite(row["time_to_form_s"])])
        if len(times):
            share = np.arange(1, len(times) + 1) / len(rows)
            axes.step(np.concatenate([[0.0], times]), np.concatenate([[0.0], share]), where="post", lw=1.8,
                      color=_colour(number, len(groups)), label=f"{name} ({len(times)} of {len(rows)})")  # fmt: skip
    axes.set_xlabel("time to form in s")
    axes.set_ylabel("share of runs that have formed")
    axes.set_ylim(0, 1.02)
    axes.set_xlim(left=0)
    _beside(axes)
    del values


def _draw_distances(axes: Axes, groups: Sequence[tuple[list[Row], str]], values: Mapping[str, Any]) -> None:
    lowest = 1.0
    for number, (rows, name) in enumerate(_few(groups)):
        ratio = [row["min_distance_m"] / row["safety_radius_m"] for row in rows if math.isfinite(row["min_distance_m"])]
        if ratio:
            ordered = np.sort(ratio)
            lowest = min(lowest, float(ordered[0]))
            share = np.arange(len(ordered) + 1) / len(ordered)  # from 0, so that one run is a line too
            axes.step(np.concatenate([ordered[:1], ordered]), share, where="post", lw=1.8,
                      marker="o" if len(ordered) == 1 else None, markevery=[-1],
                      color=_colour(number, len(groups)), label=f"{name} (least {ordered[0]:.3f})")  # fmt: skip
    axes.axvline(1.0, color=RED, lw=2, label="r")
    axes.set_xlabel("smallest true distance of a run, over r")
    axes.set_ylabel("share of runs")
    axes.set_ylim(0, 1.04)
    axes.set_xlim(left=max(lowest - 0.05, 0.0))
    _beside(axes)
    del values


def _few(groups: Sequence[tuple[list[Row], str]]) -> Sequence[tuple[list[Row], str]]:
    """All groups where they can be told apart, else all runs as one."""
    if len(groups) <= _GROUPS_MAX:
        return groups
    return [([row for rows, _ in groups for row in rows], f"all {len(groups)} cells")]


def _colour(number: int, count: int) -> Any:
    import matplotlib as mpl  # noqa: PLC0415

    return (
        SERIES[number]
        if count <= len(SERIES)
        else mpl.colormaps["viridis"](number / max(min(count, _GROUPS_MAX) - 1, 1))
    )


def _beside(axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    if handles:
        axes.legend(handles, labels, loc="upper left", bbox_to_anchor=(1.01, 1.0), fontsize=10)
