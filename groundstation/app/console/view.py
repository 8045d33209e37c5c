"""What is shown of a team at one instant, live or out of a log: the scene, figures, charts, what happened, a table."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from nicegui import ui

from groundstation.app.console.charts import BLUE, GREEN, ORANGE, SKY, Mark, chart_options, columns_of, timeline_options
from groundstation.app.console.feed import largest_error_m, smallest_distance_m
from groundstation.app.console.map_view import TeamMap
from groundstation.app.console.naming import named
from groundstation.app.console.scene import TeamScene
from groundstation.app.console.snapshot import AIRBORNE, ARMED, AVOIDS, BLOCKED, FOREIGN, HELD, LOST, Snapshot
from groundstation.core.types import FloatArray
from groundstation.mission.roster import Duty

COLUMNS = (
    "id",
    "role",
    "duty",
    "state",
    "avoidance",
    "mode",
    "armed",
    "battery",
    "pose age",
    "setpoint",
    "silent",
    "lost",
    "radio",
    "last words",
)
"""What needs eyes comes first: a tablet shows the first ten of a row, and scrolls to the others."""
_FIGURES = (
    ("smallest distance so far", "min_distance_m"),
    ("smallest distance now", "distance_now_m"),
    ("safety radius r", "radius_m"),
    ("largest error while holding", "formation_error_m"),
    ("largest error now", "error_now_m"),
    ("formed after", "time_to_form_s"),
    ("setpoints", "setpoints"),
    ("ticks", "ticks"),
    ("late ticks", "deadline_misses"),
)
"""Words for people, and the name that the answer of ``gs fly --json`` has for it."""
FIGURE_NAMES = tuple(name for _, name in _FIGURES)
_CHARTS = (
    ("distances of pairs, m (smallest: blue)", BLUE),
    ("largest error of the formation, m", GREEN),
    ("ticks sent late by, ms", SKY),
    ("frames lost on the worst link, %", ORANGE),
)
"""Of the columns of a history, after the time."""
_LINES = 400


def rows_of(snapshot: Snapshot) -> list[dict[str, str | int]]:
    """The team table, a row for each vehicle; "-" is unknown."""
    words = ((LOST, "lost"), (FOREIGN, "does not follow"), (HELD, "held"), (AIRBORNE, "in the air"))
    rows: list[dict[str, str | int]] = []
    for row, sysid in enumerate(snapshot.ids.tolist()):
        bits = int(snapshot.state[row])
        speed_m_s = float(np.linalg.norm(snapshot.setpoint_enu_m_s[row]))
        rows.append(
            {
                "id": sysid,
                "role": int(snapshot.role[row]) + 1 or "-",
                "duty": Duty(int(snapshot.duty[row])).name.lower().replace("_", " "),
                "mode": snapshot.words.modes[row] or "-",
                "armed": "yes" if bits & ARMED else "no",
                "battery": number(snapshot.battery[row] * 100.0, "%", 0),
                "pose age": number(snapshot.pose_age_s[row], " s", 2),
                "silent": number(snapshot.silent_s[row], " s", 1),
                "lost": number(snapshot.lost_share[row] * 100.0, "%", 0),
                "radio": _radio(float(snapshot.link_heard[row]), float(snapshot.link_trip_s[row])),
                "setpoint": number(speed_m_s, " m/s", 2),
                "avoidance": "no way" if bits & BLOCKED else "makes way" if bits & AVOIDS else "-",
                "state": next((name for bit, name in words if bits & bit), "on the ground"),
                "last words": snapshot.words.said[row],
            }
        )
    return rows


def _radio(heard: float, trip_s: float) -> str:
    """Share of what a radio brings, and how long it takes there and back."""
    known = [number(heard * 100.0, "%", 0), number(trip_s * 1000.0, " ms", 0)]
    return ", ".join(words for words in known if words != "-") or "-"


def number(value: float, unit: str, digits: int) -> str:
    """A figure with its unit, "-" where it is unknown."""
    return f"{value:.{digits}f}{unit}" if np.isfinite(value) else "-"


def figures_of(snapshot: Snapshot, digits: int = 3) -> dict[str, str]:
    """The figures beside the scene, by their names; distances with so many digits."""
    whole = {name: number(snapshot.figure(name), "", 0) for name in ("setpoints", "ticks", "deadline_misses")}
    return whole | {
        "min_distance_m": number(snapshot.figure("min_distance_m"), " m", digits),
        "distance_now_m": number(smallest_distance_m(snapshot), " m", digits),
        "radius_m": number(snapshot.words.radius_m, " m", 3),
        "formation_error_m": number(snapshot.figure("formation_error_m"), " m", 3),
        "error_now_m": number(largest_error_m(snapshot), " m", 3),
        "time_to_form_s": number(snapshot.figure("time_to_form_s"), " s", 2),
    }


_NUMBERS = frozenset({"role", "battery", "pose age", "silent", "lost", "setpoint"})


def _column(name: str) -> dict[str, str | bool]:
    """A column of the team table; figures with their units are sorted as figures, unknown ones first."""
    column: dict[str, str | bool] = {"name": name, "label": name, "field": name, "sortable": True, "align": "left"}
    if name in _NUMBERS:
        column[":sort"] = "(a, b) => (parseFloat(a) || -1) - (parseFloat(b) || -1)"
    return column


class TeamView:
    """The elements that show a team; built where it is made.

    Args:
        solid: with the scene in three dimensions, which is dear for small machines.
        figures: which of the figures, by their names; the others are not known where this is shown.
        columns: which of the table.
        narrow: one below the other, where there is half a page.
        digits: of distances.
        charts: how many of the charts.
        prefix: before the names of elements, where there are two on a page.
        tiles: for the map of a mission by GPS: their addresses, and the finest zoom; None for a plain grid.

    Attributes:
        side: beside the scene, above the figures: for what else the page has.
        table: the vehicles; rows can be selected.
        timeline: phases and what happened.
    """

    def __init__(
        self,
        *,
        solid: bool,
        figures: Collection[str] = FIGURE_NAMES,
        columns: Sequence[str] = COLUMNS,
        narrow: bool = False,
        digits: int = 3,
        charts: int = len(_CHARTS),
        prefix: str = "",
        tiles: tuple[str, int] | None = None,
    ) -> None:
        self._solid, self._digits, self._tiles = solid, digits, tiles
        self._map: TeamMap | None = None
        self._scene: TeamScene | None = None
        self._dark: bool | None = None
        self._told = 0
        row = "w-full" if narrow else "w-full no-wrap max-md:flex-wrap"
        with ui.row().classes(row):
            if solid:
                with ui.column().classes("w-full" if narrow else "w-2/3 max-md:w-full"):
                    with ui.row():
                        for where in ("side", "top", "follow"):
                            ui.button(where, on_click=lambda _, at=where: self.look(at)).props("dense no-wrap")
                    self._place = ui.column().classes("w-full")
            with ui.column().classes("w-full" if narrow or not solid else "w-1/3 max-md:w-full"):
                self.side = ui.column().classes("w-full")
                with ui.grid(columns="auto 1fr").classes("gap-x-4 gap-y-0 text-sm"):
                    self._figures = {}
                    for words, name in _FIGURES:
                        if name in figures:
                            ui.label(words)
                            self._figures[name] = ui.label("-").props(named(prefix + name))
                self._reason = ui.label().classes("text-sm font-bold").props(named(prefix + "reason"))
                self._news = ui.log(max_lines=_LINES).classes("w-full h-40 text-xs")
                self._news.props(named(prefix + "notes"))
        self._map_place = ui.column().classes("w-full")
        self.timeline = ui.echart(timeline_options([], [], 0.0, 1.0)).classes("w-full h-28")
        self.timeline.props(named(prefix + "timeline"))
        with ui.element("div").classes("w-full" if narrow else "w-full grid grid-cols-1 md:grid-cols-2"):
            self._charts = [
                ui.echart(chart_options(title, np.zeros((0, 2)), colour)).classes("w-full h-36")
                for title, colour in _CHARTS[:charts]
            ]
        find = ui.input("filter").props("dense clearable")
        self.table = ui.table(columns=[_column(name) for name in columns], rows=[], row_key="id", selection="multiple")
        # Two hundred are scrolled through, not leafed through; only those that are seen are drawn.
        self.table.classes("w-full").props("dense virtual-scroll hide-pagination").style("max-height: 28rem")
        self.table.props(":rows-per-page-options=[0] binary-state-sort").props(named(prefix + "team"))
        find.bind_value_to(self.table, "filter")

    def themed(self, *, dark: bool) -> None:
        """The page has become light or dark; the scene is drawn anew on that ground."""
        if dark != self._dark and self._solid:
            self._scene = None
            self._place.clear()
        self._dark = dark
        if self._map is not None:
            self._map.themed(dark=dark)

    def look(self, where: str) -> None:
        """Moves the camera of the scene: side, top or follow."""
        if self._scene is not None:
            self._scene.look(where)

    def place(self, snapshot: Snapshot, *, slowly: bool) -> None:
        """Moves the vehicles of the scene; ``slowly``: graph, trails and camera too."""
        if not self._solid or self._dark is None:  # a scene has to know its ground
            return
        if self._scene is None:
            with self._place:
                self._scene = TeamScene(snapshot, dark=self._dark)
        self._scene.show(snapshot, slowly=slowly)

    def tell(self, snapshot: Snapshot) -> None:
        """Shows figures, the table, and where the team is on earth, when that is known."""
        if np.isfinite(snapshot.anchor_deg_m).all():
            if self._map is None:
                with self._map_place:
                    self._map = TeamMap(snapshot, self._tiles, dark=bool(self._dark))
            self._map.show(snapshot)
        told = figures_of(snapshot, self._digits)
        for name, label in self._figures.items():
            label.set_text(told[name])
        self._reason.set_text(snapshot.words.reason)
        self.table.rows = rows_of(snapshot)

    def draw(
        self,
        history: Sequence[Sequence[float]] | FloatArray,
        radius_m: float,
        pairs: Sequence[Sequence[float]] | FloatArray = (),
    ) -> None:
        """Shows the charts: a row of ``history`` is seconds, then a value for each; of ``pairs`` every distance."""
        every = np.asarray(pairs, dtype=np.float64)
        for column, chart in enumerate(self._charts):
            title, colour = _CHARTS[column]
            limit = radius_m if column == 0 else np.nan
            chart.options.update(
                chart_options(
                    title, columns_of(history, column + 1), colour, limit, every if column == 0 and len(every) else None
                )
            )

    def happened(self, notes: Sequence[Mark], since_s: float = 0.0) -> int:
        """Adds what is new of what happened; returns how many alarms of that time or later are among it."""
        new = notes[self._told :]
        self._told = len(notes)
        for t_s, kind, text in new[-_LINES:]:
            bold = " font-bold" if kind == "alarm" else ""
            self._news.push(f"{t_s:8.2f} s  {kind:5}  {text}", classes=f"whitespace-pre-wrap{bold}")
        return sum(kind == "alarm" and t_s >= since_s for t_s, kind, _ in new)

    def time_goes(self, phases: Sequence[tuple[str, float, float]], marks: Sequence[Mark], end_s: float) -> None:
        """Draws the time line anew; the page stands at its end."""
        self.timeline.options.update(timeline_options(phases, marks, end_s, end_s))

    def stands_at(self, t_s: float) -> None:
        """Moves the line of the time line, and nothing else of it."""
        self.timeline.run_chart_method("setOption", {"series": [{"markLine": {"data": [{"xAxis": round(t_s, 3)}]}}]})
