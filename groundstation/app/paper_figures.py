"""Figures 2, 4 and 5 of the paper from one's own flight, at the width of a paper's column and in its size of type.

Fig. 2: the formation with its graph, and what the team made of it. Fig. 4: the team at some instants, and its whole
way. Fig. 5: all distances over time, and r. Fonts are embedded (Type 42, which journals take). Whoever draws loads
matplotlib.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, cast

import numpy as np

from groundstation.app.flight_picture import Picture
from groundstation.app.picture_style import BLUE, INK, QUIET, SERIES, STYLE
from groundstation.core.types import FloatArray, IntArray
from groundstation.records.replay import Flight, Phase

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMN_IN, PAGE_IN = 3.5, 7.16
"""Width of a column and of a page of two, as IEEE has them."""
PAPER_STYLE = STYLE | {
    "font.size": 8.0,
    "axes.labelsize": 8.0,
    "legend.fontsize": 7.0,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "axes.linewidth": 0.6,
    "grid.linewidth": 0.4,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.color": INK,
    "ytick.color": INK,
    "pdf.fonttype": 42,
    "ps.fonttype": 42,
    "svg.fonttype": "path",
    "axes.titlesize": 8.0,
    "axes.titlecolor": INK,
    "axes.titlepad": 1.0,
    "axes3d.xaxis.panecolor": (1.0, 1.0, 1.0),
    "axes3d.yaxis.panecolor": (1.0, 1.0, 1.0),
    "axes3d.zaxis.panecolor": (1.0, 1.0, 1.0),
}
"""matplotlib's rc settings for these: type of 8 points, fonts embedded or drawn."""
_SHOTS = 4
_INSTANTS = 1500


def _span(flight: Flight) -> tuple[int, int, int] | None:
    """When forming began, when the formation was held first, and when that was over; None where it never was."""
    form = next((phase for phase in flight.phases if phase.name == "form"), None)
    after = [phase for phase in flight.phases if form is not None and phase.start_ns >= form.stop_ns]
    held: Phase | None = next((phase for phase in after if phase.name == "hold"), None)
    if form is None:
        return None
    return form.start_ns, form.stop_ns, form.stop_ns if held is None else held.stop_ns


def _missing(figure: Figure, text: str) -> None:
    figure.clear()
    figure.text(0.5, 0.5, text, ha="center", va="center", color=QUIET, wrap=True)


class _Room(Protocol):
    """What is used of axes in three dimensions, for which matplotlib has no types."""

    def plot(self, *values: object, **style: object) -> object:
        """Draws a line or dots."""

    def set(self, **values: object) -> object:
        """Sets limits and labels."""

    def set_box_aspect(self, aspect: FloatArray, *, zoom: float) -> None:
        """Sets the lengths of the sides."""


def _room(figure: Figure, place: tuple[int, int, int], title: str, points: FloatArray) -> _Room:
    """A box around points, without numbers on its axes."""
    axes = cast("_Room", figure.add_subplot(*place, projection="3d"))
    known = points[np.isfinite(points).all(axis=-1)]
    low, high = known.min(axis=0) - 0.1, known.max(axis=0) + 0.1
    size = np.maximum(high - low, 0.25 * float((high - low).max()))
    begin, end = (low + high - size) / 2, (low + high + size) / 2
    sides: dict[str, object] = {}
    for number, name in enumerate("xyz"):
        sides |= {f"{name}lim": (begin[number], end[number]), f"{name}ticklabels": []}
    axes.set(title=title, **sides)
    axes.set_box_aspect(size, zoom=1.05)
    return axes


def _dots(axes: _Room, points: FloatArray, size: float = 4.0) -> None:
    for number, point in enumerate(points):
        if np.isfinite(point).all():
            axes.plot(*point[:, None], "o", color=SERIES[number % len(SERIES)], markersize=size)


def _edges(flight: Flight, t_ns: int) -> list[tuple[int, int]]:
    """Pairs of vehicles, by row, that are neighbours under the roles of a time."""
    formation, roles = flight.formation_at(t_ns), flight.roles_at(t_ns)
    if formation is None or roles is None:
        return []
    row_of = {role: row for row, role in enumerate(roles) if role is not None}
    return [(row_of[i], row_of[j]) for i, j in formation.edges if i in row_of and j in row_of]


def _graph(axes: _Room, points: FloatArray, edges: list[tuple[int, int]]) -> None:
    for i, j in edges:
        axes.plot(*points[[i, j]].T, color=QUIET, linewidth=0.8)


def figure_2(figure: Figure, flight: Flight) -> None:
    """The formation with its sensing graph, and what the team made of it."""
    span = _span(flight)
    formation = None if span is None else flight.formation_at(span[2] - 1)
    if span is None or formation is None:
        _missing(figure, "The log tells no formation that was formed.")
        return
    axes = _room(figure, (1, 2, 1), "formation", formation.points_enu_m)
    _graph(axes, formation.points_enu_m, list(formation.edges))
    _dots(axes, formation.points_enu_m)
    team = flight.positions_at(np.array([span[2] - 1]))[0]
    if not np.isfinite(team).all(axis=-1).any():
        _missing(figure, "No position is known while the formation was held.")
        return
    axes = _room(figure, (1, 2, 2), "the team", team)
    _graph(axes, team, _edges(flight, span[2] - 1))
    roles = flight.roles_at(span[2] - 1) or ()
    for row, point in enumerate(team):
        role = roles[row] if row < len(roles) else None
        if role is not None and np.isfinite(point).all():
            axes.plot(*point[:, None], "o", color=SERIES[role % len(SERIES)], markersize=4.0)


def figure_4(figure: Figure, flight: Flight) -> None:
    """The team at some instants, and its ways with the sensing graph where they end."""
    span = _span(flight)
    if span is None:
        _missing(figure, "The log tells of no forming.")
        return
    start, formed, stop = span
    ways = flight.positions_at(np.linspace(start, stop - 1, 400).astype(np.int64))
    if not np.isfinite(ways).all(axis=-1).any():
        _missing(figure, "No position is known while the team formed.")
        return
    times: IntArray = np.linspace(start, formed, _SHOTS).astype(np.int64)
    for place, (t_ns, shot) in enumerate(zip(times.tolist(), flight.positions_at(times), strict=True), start=1):
        title = f"{(t_ns - start) / 1e9:.1f} s"
        _dots(_room(figure, (1, _SHOTS + 1, place), title, ways.reshape(-1, 3)), shot, 3.0)
    axes = _room(figure, (1, _SHOTS + 1, _SHOTS + 1), "the way", ways.reshape(-1, 3))
    _graph(axes, ways[-1], _edges(flight, stop - 1))
    for number in range(ways.shape[1]):
        axes.plot(*ways[:, number].T, color=SERIES[number % len(SERIES)], linewidth=0.6)
    _dots(axes, ways[-1], 3.0)


def figure_5(figure: Figure, flight: Flight) -> None:
    """All distances over time, and r."""
    span = _span(flight)
    if span is None or not flight.distances_known:
        _missing(figure, "Distances while forming are not known.")
        return
    start, formed, stop = span
    instants = np.linspace(start, stop - 1, _INSTANTS).astype(np.int64)
    axes = figure.add_subplot()
    axes.plot((instants - start) / 1e9, flight.distances_at(instants), color=BLUE, linewidth=0.5, alpha=0.7)
    if flight.safety_radius_m is not None:
        axes.axhline(flight.safety_radius_m, color=INK, linewidth=1.2, linestyle="--")
        axes.annotate("$r$", (1.0, flight.safety_radius_m), xycoords=("axes fraction", "data"), xytext=(2, -2),
                      textcoords="offset points")  # fmt: skip
    axes.axvline((formed - start) / 1e9, color=QUIET, linewidth=0.6)
    axes.set(xlabel="time in s", ylabel="distances in m", ylim=(0, None))
    axes.set_xlim(0.0, (stop - start) / 1e9)


PAPER_FIGURES = (
    Picture(
        "paper_fig2",
        "Figure 2",
        "The formation with its sensing graph, and the team at the end of its hold; colours are roles.",
        (COLUMN_IN, 2.0),
        figure_2,
    ),
    Picture(
        "paper_fig4",
        "Figure 4",
        "The team while it forms, and its whole way with the sensing graph.",
        (PAGE_IN, 1.7),
        figure_4,
    ),
    Picture(
        "paper_fig5",
        "Figure 5",
        "All distances between vehicles, from the beginning of forming to the end of the hold; r is dashed, the line"
        " is where the formation was reached.",
        (COLUMN_IN, 2.2),
        figure_5,
    ),
)
