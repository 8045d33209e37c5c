"""The page: what the flight does, and the orders that may be given. Everything is shown; the flight decides."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from nicegui import run, ui
from nicegui.events import KeyEventArguments

from groundstation.app.console.feed import Feed, largest_error_m, smallest_distance_m
from groundstation.app.console.guard import Role
from groundstation.app.console.helm import HelmSeat
from groundstation.app.console.scene import BLUE, GREEN, VERMILION, TeamScene
from groundstation.app.console.snapshot import AIRBORNE, ARMED, FOREIGN, HELD, LOST, Snapshot
from groundstation.mission.operator import Order
from groundstation.mission.roster import Duty

KILL_HELD_S = 1.5

_SLOWLY_EVERY = 5
_SHOWN = 400
_KEYS = {"h": Order.HOLD, "r": Order.RESUME, "b": Order.RETURN}
_BUTTONS = (
    ("hold (h)", "hold", Order.HOLD),
    ("resume (r)", "resume", Order.RESUME),
    ("back to pads (b)", "return", Order.RETURN),
    ("land all (l)", "land all", Order.LAND),
)
_COLUMNS = ("id", "role", "duty", "mode", "armed", "battery", "pose age", "silent", "setpoint", "state", "last words")
Tell = Callable[[str, str], Mapping[str, object]]
"""Gives an order in somebody's name and returns the flight's answer; waits for it."""


@dataclass
class Desk:
    """What all pages of one console share."""

    feed: Feed
    helm: HelmSeat
    tell: Tell


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
                "battery": _number(snapshot.battery[row] * 100.0, "%", 0),
                "pose age": _number(snapshot.pose_age_s[row], " s", 2),
                "silent": _number(snapshot.silent_s[row], " s", 1),
                "setpoint": _number(speed_m_s, " m/s", 2),
                "state": next((name for bit, name in words if bits & bit), "on the ground"),
                "last words": snapshot.words.said[row],
            }
        )
    return rows


def _number(value: float, unit: str, digits: int) -> str:
    return f"{value:.{digits}f}{unit}" if np.isfinite(value) else "-"


class Page:
    """One browser's view of the flight.

    Args:
        desk: what all pages share.
        role: what this one may do.
        page: its own name, for the helm.
        name: for people and the log.
    """

    def __init__(self, desk: Desk, role: Role, page: str, name: str) -> None:
        self._desk, self._role, self._page, self._name = desk, role, page, name
        self._scene: TeamScene | None = None
        self._ticks = 0
        self._alarms = 0
        self._pressed_s: float | None = None
        self._dark = ui.dark_mode(None)
        self._build()
        ui.keyboard(on_key=self._key)
        ui.timer(0.1, self._update)

    def _build(self) -> None:
        with ui.header().classes("items-center gap-4 py-1"):
            self._title = ui.label("waiting for the flight").classes("text-lg font-bold").mark("title")
            self._phase = ui.label().classes("text-lg").mark("phase")
            self._age = ui.label().mark("age")
            ui.space()
            self._who = ui.label().mark("helm")
            ui.button("take the helm", on_click=self._take).props("dense outline color=white").mark("take")
            self._mute = ui.switch("sound", value=True).props("dense color=orange")
            ui.button("light / dark", on_click=self._dark.toggle).props("dense flat color=white")
        with ui.row().classes("w-full no-wrap max-md:flex-wrap"):
            with ui.column().classes("w-2/3 max-md:w-full"):
                with ui.row():
                    for where in ("side", "top", "follow"):
                        ui.button(where, on_click=lambda _, at=where: self._look(at)).props("dense outline")
                self._place = ui.column().classes("w-full")
            with ui.column().classes("w-1/3 max-md:w-full"):
                self._controls()
                self._figures = ui.label().classes("whitespace-pre-line").mark("figures")
                self._news = ui.log(max_lines=200).classes("w-full h-40 text-xs").mark("notes")
        with ui.row().classes("w-full no-wrap max-md:flex-wrap"):
            self._near = _chart("smallest distance, m", BLUE).mark("near")
            self._error = _chart("largest error of the formation, m", GREEN).mark("error")
        find = ui.input("filter").props("dense clearable")
        columns = [{"name": name, "label": name, "field": name, "sortable": True, "align": "left"} for name in _COLUMNS]
        self._table = ui.table(columns=columns, rows=[], row_key="id", selection="single").classes("w-full")
        self._table.props("dense").mark("team")
        find.bind_value_to(self._table, "filter")

    def _controls(self) -> None:
        self._buttons: list[tuple[ui.button, ui.tooltip, Order]] = []
        with ui.row().classes("gap-2"):
            for text, line, order in _BUTTONS:
                self._button(text, order, lambda _, at=line: self._give(at))
            self._button("land selected", Order.LAND, self._land_selected)
            kill = self._button(f"KILL: hold {KILL_HELD_S:g} s", Order.KILL, None)
            kill.props("color=red-9").on("pointerdown", self._press).on("pointerup", self._release)
            kill.on("pointerleave", self._forget)
        ui.label("Kill stops motors at once, vehicles fall: those selected in the table, or all.").classes("text-xs")

    def _button(self, text: str, order: Order, act: Callable[..., object] | None) -> ui.button:
        button = (
            ui.button(text, on_click=act).props("dense").mark(text.split(" (", maxsplit=1)[0].split(":", maxsplit=1)[0])
        )
        with button:
            tip = ui.tooltip("")
        self._buttons.append((button, tip, order))
        return button

    def _look(self, where: str) -> None:
        if self._scene is not None:
            self._scene.look(where, self._desk.feed.last)

    def _take(self) -> None:
        if why := self._desk.helm.take(self._page, self._name, self._role):
            ui.notify(why, type="warning")

    async def _key(self, event: KeyEventArguments) -> None:
        key = str(event.key).lower()
        if event.action.keydown and not event.action.repeat and not event.modifiers.ctrl:
            if key in _KEYS:
                await self._give(_KEYS[key].value)
            elif key == "l":
                await self._give("land all")

    def _selected(self) -> str:
        return " ".join(str(row["id"]) for row in self._table.selected)

    async def _land_selected(self) -> None:
        if chosen := self._selected():
            await self._give(f"land {chosen}")
        else:
            ui.notify("select a vehicle in the table first", type="warning")

    def _press(self) -> None:
        self._pressed_s = time.monotonic()

    def _forget(self) -> None:
        self._pressed_s = None

    async def _release(self) -> None:
        pressed_s, self._pressed_s = self._pressed_s, None
        if pressed_s is None or time.monotonic() - pressed_s < KILL_HELD_S:
            ui.notify(f"kill: hold the button for {KILL_HELD_S:g} s", type="warning")
            return
        await self._give(f"kill {self._selected() or 'all'}")

    async def _give(self, line: str) -> None:
        """Gives an order, when this page may; the flight has the last word."""
        last = self._desk.feed.last
        why = self._desk.helm.refusal(
            self._page, self._role, Order(line.split(maxsplit=1)[0]), "" if last is None else last.words.phase
        )
        if why:
            ui.notify(f"{line}: {why}", type="warning")
            return
        answer = await run.io_bound(self._desk.tell, line, self._name) or {}
        taken = bool(answer.get("ok"))
        ui.notify(f"{line}: {'taken' if taken else answer.get('why')}", type="positive" if taken else "negative")

    def _update(self) -> None:
        desk = self._desk
        snapshot = desk.feed.last
        self._who.set_text(f"{self._role.value}; {desk.helm.news or 'nobody steers from a console'}")
        if snapshot is None:
            self._age.set_text(desk.feed.problem)
            return
        self._ticks += 1
        slowly = self._ticks % _SLOWLY_EVERY == 1
        if self._scene is None:
            with self._place:
                self._scene = TeamScene(snapshot, dark=bool(self._dark.value))
        self._scene.show(snapshot, slowly=slowly)
        if slowly:
            self._words(snapshot)

    def _words(self, snapshot: Snapshot) -> None:
        words, feed = snapshot.words, self._desk.feed
        self._title.set_text(words.mission)
        self._phase.set_text(words.outcome or words.phase)
        self._age.set_text(f"{snapshot.t_s:.1f} s{', ' + feed.problem if feed.problem else ''}")
        self._figures.set_text(
            f"smallest distance so far {_number(snapshot.figure('min_distance_m'), ' m', 3)},"
            f" now {_number(smallest_distance_m(snapshot), ' m', 3)}; r = {words.radius_m:g} m\n"
            f"largest error while holding {_number(snapshot.figure('formation_error_m'), ' m', 3)},"
            f" now {_number(largest_error_m(snapshot), ' m', 3)}\n"
            f"formed after {_number(snapshot.figure('time_to_form_s'), ' s', 1)};"
            f" setpoints {snapshot.figure('setpoints'):.0f}, late ticks {snapshot.figure('deadline_misses'):.0f}"
            + (f"\n{words.reason}" if words.reason else "")
        )
        for button, tip, order in self._buttons:
            why = self._desk.helm.refusal(self._page, self._role, order, words.phase)
            button.set_enabled(not why)
            tip.set_text(why or order.value)
        self._table.rows = rows_of(snapshot)
        self._news.clear()
        for t_s, kind, text in words.notes:
            self._news.push(f"{t_s:8.2f} s  {kind:5}  {text}")
        self._sound(sum(kind == "alarm" for _, kind, _ in words.notes))
        rows = list(feed.history)[-_SHOWN:]
        for chart, column in ((self._near, 1), (self._error, 2)):
            chart.options["series"][0]["data"] = [
                [round(row[0], 1), round(row[column], 3)] for row in rows if np.isfinite(row[column])
            ]
            if column == 1:
                chart.options["series"][0]["markLine"]["data"] = [{"yAxis": words.radius_m, "name": "r"}]
            chart.update()

    def _sound(self, alarms: int) -> None:
        if alarms > self._alarms and self._mute.value:
            ui.run_javascript(
                "try{const c=new AudioContext();const o=c.createOscillator();o.connect(c.destination);"
                "o.frequency.value=880;o.start();o.stop(c.currentTime+0.25);}catch(e){}"
            )
        self._alarms = alarms


def _chart(title: str, colour: str) -> ui.echart:
    return ui.echart(
        {
            "title": {"text": title, "textStyle": {"fontSize": 12, "color": "#888"}},
            "grid": {"top": 30, "bottom": 25, "left": 45, "right": 10},
            "xAxis": {"type": "value", "scale": True, "name": "s"},
            "yAxis": {"type": "value", "min": 0},
            "animation": False,
            "series": [
                {
                    "type": "line",
                    "showSymbol": False,
                    "lineStyle": {"color": colour},
                    "data": [],
                    "markLine": {"symbol": "none", "silent": True, "lineStyle": {"color": VERMILION}, "data": []},
                }
            ],
        }
    ).classes("w-1/2 h-44 max-md:w-full")
