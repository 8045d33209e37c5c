"""The page of a flight: what it does, and the orders that may be given. Everything is shown; the flight decides."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

from nicegui import run, ui
from nicegui.events import GenericEventArguments, KeyEventArguments

from groundstation.app.console.charts import spans_of
from groundstation.app.console.feed import Feed
from groundstation.app.console.guard import Role
from groundstation.app.console.helm import HelmSeat
from groundstation.app.console.naming import named
from groundstation.app.console.preflight_panel import PreflightPanel
from groundstation.app.console.theme import Theme
from groundstation.app.console.view import TeamView
from groundstation.mission.operator import Order

KILL_HELD_S = 1.5

_SLOWLY_EVERY = 5
_SHOWN, _PAIRS_SHOWN = 400, 100
_NEWS_S = 5.0  # before a page was opened: alarms older than that are past, and make no sound
_SILENT = "gs_silent"
_SOUND = (
    "try{const c=new AudioContext(),o=c.createOscillator();o.connect(c.destination);o.frequency.value=880;"
    f"o.onended=()=>c.close();o.start();o.stop(c.currentTime+0.25);if(c.state=='suspended')emitEvent('{_SILENT}');}}"
    f"catch(e){{emitEvent('{_SILENT}');}}"
)
_KEYS = {"s": "start", "h": "hold", "r": "resume", "b": "return", "l": "land all"}
_LOOKS = {"1": "side", "2": "top", "3": "follow"}
_SHORTCUTS = "keys: s start, h hold, r resume, b back to pads, l land all; 1 side, 2 top, 3 follow; m sound on or off"
_BUTTONS = (
    ("hold (h)", "hold", Order.HOLD),
    ("resume (r)", "resume", Order.RESUME),
    ("back to pads (b)", "return", Order.RETURN),
    ("land all (l)", "land all", Order.LAND),
)
Tell = Callable[[str, str], Mapping[str, object]]
"""Gives an order in somebody's name and returns the flight's answer; waits for it."""


@dataclass
class Desk:
    """What all pages of one console share."""

    feed: Feed
    helm: HelmSeat
    tell: Tell
    tiles: tuple[str, int] | None = None


class Page:
    """One browser's view of the flight.

    Args:
        desk: what all pages share.
        role: what this one may do.
        page: its own name, for the helm.
        name: for people and the log.
        solid: with the scene in three dimensions.
    """

    def __init__(self, desk: Desk, role: Role, page: str, name: str, *, solid: bool) -> None:
        self._desk, self._role, self._page, self._name = desk, role, page, name
        self._ticks = 0
        self._since_s: float | None = None
        self._pressed_s: float | None = None
        self._buttons: list[tuple[ui.button, ui.tooltip, Order]] = []
        with ui.header().classes("items-center gap-4 py-1"):
            self._title = ui.label("waiting for the flight").classes("text-lg font-bold").props(named("title"))
            self._phase = ui.label().classes("text-lg").props(named("phase"))
            self._outcome = ui.label().classes("text-lg").props(named("outcome"))
            self._age = ui.label().props(named("age"))
            ui.space()
            self._who = ui.label().classes("text-sm").props(named("helm"))
            ui.button("take the helm", on_click=self._take).props("dense outline color=white")
            self._mute = ui.switch("sound", value=True).props("dense color=orange")
            theme = Theme(lambda dark: self._view.themed(dark=dark))
        self._preflight = PreflightPanel()
        with self._preflight.orders:
            self._button("start (s)", Order.START, lambda: self._give("start"))
            self._button("set parameters (--fix)", Order.FIX, lambda: self._give("fix"))
        self._view = TeamView(solid=solid, tiles=desk.tiles)
        with self._view.side:
            self._controls()
        theme.ask()
        ui.on(_SILENT, lambda: self._say("alarm: this browser makes no sound before the page was clicked", "warning"))
        # A button that was clicked keeps the focus: keys count there too, but not where somebody writes.
        ui.keyboard(on_key=self._key, ignore=["input", "select", "textarea"], repeating=False)
        ui.timer(0.1, self._update)

    def _controls(self) -> None:
        with ui.row().classes("gap-2"):
            for text, line, order in _BUTTONS:
                self._button(text, order, lambda _, at=line: self._give(at))
            self._button("land selected", Order.LAND, self._land_selected)
            kill = self._button(f"KILL: hold {KILL_HELD_S:g} s", Order.KILL, None)
            kill.props("color=red-9").on("pointerdown", self._press).on("pointerup", self._release)
            kill.on("pointerleave", self._forget).on("blur", self._forget)
            for held in ("space", "enter"):  # without a mouse: held as long
                kill.on(f"keydown.{held}", self._press_key, ["repeat"]).on(f"keyup.{held}", self._release)
        ui.label("Kill stops motors at once, vehicles fall: those selected in the table, or all.").classes("text-xs")
        ui.label(_SHORTCUTS).classes("text-xs").props(named("shortcuts"))
        self._why = ui.label().classes("text-xs whitespace-pre-line").props(named("why-not"))
        self._answer = ui.label("no order yet").classes("text-sm font-bold").props(named("answer") + " role=status")

    def _button(self, text: str, order: Order, act: Callable[..., object] | None) -> ui.button:
        button = ui.button(text, on_click=act).props("dense")
        with button:
            tip = ui.tooltip("")
        self._buttons.append((button, tip, order))
        return button

    def _say(self, text: str, kind: Literal["positive", "warning", "negative"]) -> None:
        """Says what came of something; a notice goes by while people look up, the line stays."""
        self._answer.set_text(text)
        ui.notify(text, type=kind)

    def _take(self) -> None:
        if why := self._desk.helm.take(self._page, self._name, self._role):
            self._say(f"take the helm: {why}", "warning")

    async def _key(self, event: KeyEventArguments) -> None:
        key, held = str(event.key).lower(), event.modifiers
        if event.action.keydown and not (event.action.repeat or held.ctrl or held.alt or held.meta):
            if key in _KEYS:
                await self._give(_KEYS[key])
            elif key in _LOOKS:
                self._view.look(_LOOKS[key])
            elif key == "m":
                self._mute.set_value(not self._mute.value)

    def _selected(self) -> str:
        return " ".join(str(row["id"]) for row in self._view.table.selected)

    async def _land_selected(self) -> None:
        if chosen := self._selected():
            await self._give(f"land {chosen}")
        else:
            self._say("land selected: select a vehicle in the table first", "warning")

    def _press(self) -> None:
        self._pressed_s = time.monotonic()

    def _press_key(self, event: GenericEventArguments) -> None:
        if not event.args["repeat"]:  # a key that is held tells so again and again
            self._press()

    def _forget(self) -> None:
        self._pressed_s = None

    async def _release(self) -> None:
        pressed_s, self._pressed_s = self._pressed_s, None
        if pressed_s is None or time.monotonic() - pressed_s < KILL_HELD_S:
            self._say(f"kill: hold the button for {KILL_HELD_S:g} s", "warning")
            return
        await self._give(f"kill {self._selected() or 'all'}")

    async def _give(self, line: str) -> None:
        """Gives an order, when this page may; the flight has the last word."""
        last = self._desk.feed.last
        refused = {} if last is None else last.words.refused
        why = self._desk.helm.refusal(self._page, self._role, Order(line.split(maxsplit=1)[0]), refused)
        if why:
            self._say(f"{line}: {why}", "warning")
            return
        answer = await run.io_bound(self._desk.tell, line, self._name) or {}
        taken = bool(answer.get("ok"))
        self._say(f"{line}: {'taken' if taken else answer.get('why')}", "positive" if taken else "negative")

    def _update(self) -> None:
        desk = self._desk
        snapshot = desk.feed.last
        news = desk.helm.news.replace("console ", "")  # which all of them are
        self._who.set_text(f"you: {self._role.value}; {news or 'nobody steers from a console'}")
        if snapshot is None:
            self._age.set_text(desk.feed.problem)
            return
        self._ticks += 1
        slowly = self._ticks % _SLOWLY_EVERY == 1
        self._view.place(snapshot, slowly=slowly)
        if not slowly:
            return
        words, feed = snapshot.words, desk.feed
        self._title.set_text(words.mission)
        self._phase.set_text(words.phase)
        self._outcome.set_text(words.outcome)
        self._preflight.show(feed.checks, words.problems, there=words.phase == "connect")
        self._age.set_text(f"{snapshot.t_s:.1f} s{', ' + feed.problem if feed.problem else ''}")
        reasons: dict[str, list[str]] = {}
        for button, tip, order in self._buttons:
            why = desk.helm.refusal(self._page, self._role, order, words.refused)
            button.set_enabled(not why)
            tip.set_text(why or order.value)
            seen = words.phase == "connect" or order not in (Order.START, Order.FIX)
            if why and seen and order.value not in reasons.setdefault(why, []):
                reasons[why].append(order.value)
        # A tablet has no mouse that could rest on a button.
        self._why.set_text("\n".join(f"not now, {', '.join(orders)}: {why}" for why, orders in reasons.items()))
        self._view.tell(snapshot)
        self._view.draw(list(feed.history)[-_SHOWN:], words.radius_m, list(feed.pairs)[-_PAIRS_SHOWN:])
        self._view.time_goes(spans_of(feed.notes, snapshot.t_s), feed.notes, snapshot.t_s)
        if self._since_s is None:
            self._since_s = snapshot.t_s - _NEWS_S
        if self._view.happened(feed.notes, self._since_s) and self._mute.value:
            ui.run_javascript(_SOUND)
