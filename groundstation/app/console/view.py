"""What is shown of a team at one instant, live or out of a log: the scene, figures, charts, what happened, a table."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from nicegui import ui

from groundstation.app.console.charts import BLUE, GREEN, chart_options, columns_of
from groundstation.app.console.feed import largest_error_m, smallest_distance_m
from groundstation.app.console.scene import TeamScene
from groundstation.app.console.snapshot import AIRBORNE, ARMED, FOREIGN, HELD, LOST, Snapshot
from groundstation.mission.roster import Duty

COLUMNS = ("id", "role", "duty", "mode", "armed", "battery", "pose age", "silent", "setpoint", "state", "last words")
_FIGURES = (
    ("smallest distance so far", "min_distance_m"),
    ("now", "distance_now_m"),
    ("largest error while holding", "formation_error_m"),
    ("now", "error_now_m"),
    ("formed after", "time_to_form_s"),
    ("setpoints", "setpoints"),
    ("ticks", "ticks"),
    ("late ticks", "deadline_misses"),
)
"""Words for people, and the name that the answer of ``gs fly --json`` has for it."""
_CHARTS = (("smallest distance, m", BLUE, 1), ("largest error of the formation, m", GREEN, 2))
_LINES = 400

Note = tuple[float, str, str]


def named(name: str) -> str:
    """What makes an element findable for whoever looks at the page by a program."""
    return f'data-testid="{name}"'


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
                "role": int(snapshot.role[row]) + 1,
                "duty": Duty(int(snapshot.duty[row])).name.lower().replace("_", " "),
                "mode": snapshot.words.modes[row] or "-",
                "armed": "yes" if bits & ARMED else "no",
                "battery": number(snapshot.battery[row] * 100.0, "%", 0),
                "pose age": number(snapshot.pose_age_s[row], " s", 2),
                "silent": number(snapshot.silent_s[row], " s", 1),
                "setpoint": number(speed_m_s, " m/s", 2),
                "state": next((name for bit, name in words if bits & bit), "on the ground"),
                "last words": snapshot.words.said[row],
            }
        )
    return rows


def number(value: float, unit: str, digits: int) -> str:
    """A figure with its unit, "-" where it is unknown."""
    return f"{value:.{digits}f}{unit}" if np.isfinite(value) else "-"


def figures_of(snapshot: Snapshot) -> dict[str, str]:
    """The figures beside the scene, by their names."""
    whole = {name: number(snapshot.figure(name), "", 0) for name in ("setpoints", "ticks", "deadline_misses")}
    return whole | {
        "min_distance_m": number(snapshot.figure("min_distance_m"), " m", 3),
        "distance_now_m": f"{number(smallest_distance_m(snapshot), ' m', 3)}; r = {snapshot.words.radius_m:g} m",
        "formation_error_m": number(snapshot.figure("formation_error_m"), " m", 3),
        "error_now_m": number(largest_error_m(snapshot), " m", 3),
        "time_to_form_s": number(snapshot.figure("time_to_form_s"), " s", 2),
    }


class TeamView:
    """The elements that show a team; built where it is made.

    Args:
        solid: with the scene in three dimensions, which is dear for small machines.

    Attributes:
        side: beside the scene, above the figures: for what else the page has.
        table: the vehicles; rows can be selected.
    """

    def __init__(self, *, solid: bool) -> None:
        self._solid = solid
        self._scene: TeamScene | None = None
        self._dark: bool | None = None
        self._told = 0
        with ui.row().classes("w-full no-wrap max-md:flex-wrap"):
            if solid:
                with ui.column().classes("w-2/3 max-md:w-full"):
                    with ui.row():
                        for where in ("side", "top", "follow"):
                            ui.button(where, on_click=lambda _, at=where: self._look(at)).props("dense outline")
                    self._place = ui.column().classes("w-full")
            with ui.column().classes("w-1/3 max-md:w-full" if solid else "w-full"):
                self.side = ui.column().classes("w-full")
                with ui.grid(columns="auto 1fr").classes("gap-x-4 gap-y-0 text-sm"):
                    self._figures = {}
                    for words, name in _FIGURES:
                        ui.label(words)
                        self._figures[name] = ui.label("-").props(named(name))
                self._reason = ui.label().classes("text-sm font-bold").props(named("reason"))
                self._news = ui.log(max_lines=_LINES).classes("w-full h-40 text-xs").props(named("notes"))
        with ui.row().classes("w-full no-wrap max-md:flex-wrap"):
            self._charts = [
                ui.echart(chart_options(title, np.zeros((0, 2)), colour)).classes("w-1/2 h-44 max-md:w-full")
                for title, colour, _ in _CHARTS
            ]
        find = ui.input("filter").props("dense clearable")
        columns = [{"name": name, "label": name, "field": name, "sortable": True, "align": "left"} for name in COLUMNS]
        self.table = ui.table(columns=columns, rows=[], row_key="id", selection="single").classes("w-full")
        self.table.props("dense").props(named("team"))
        find.bind_value_to(self.table, "filter")

    def themed(self, *, dark: bool) -> None:
        """The page has become light or dark; the scene is drawn anew on that ground."""
        if dark != self._dark and self._solid:
            self._scene = None
            self._place.clear()
        self._dark = dark

    def _look(self, where: str) -> None:
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

    def tell(self, snapshot: Snapshot, history: Sequence[Sequence[float]]) -> None:
        """Shows figures, charts and the table."""
        for name, text in figures_of(snapshot).items():
            self._figures[name].set_text(text)
        self._reason.set_text(snapshot.words.reason)
        self.table.rows = rows_of(snapshot)
        limits = (snapshot.words.radius_m, np.nan)
        for chart, (title, colour, column), limit in zip(self._charts, _CHARTS, limits, strict=True):
            chart.options.update(chart_options(title, columns_of(history, column), colour, limit))

    def happened(self, notes: Sequence[Note]) -> int:
        """Adds what is new of what happened; returns how many alarms are among it."""
        new = notes[self._told :]
        self._told = len(notes)
        for t_s, kind, text in new[-_LINES:]:
            self._news.push(f"{t_s:8.2f} s  {kind:5}  {text}", classes="font-bold" if kind == "alarm" else "")
        return sum(kind == "alarm" for _, kind, _ in new)
