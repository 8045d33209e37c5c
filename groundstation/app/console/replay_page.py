"""The page of recorded flights: one, or two side by side on one time; played, paused, scrubbed, jumped through."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

from nicegui import ui
from nicegui.events import (
    EChartPointClickEventArguments,
    GenericEventArguments,
    KeyEventArguments,
    ValueChangeEventArguments,
)

from groundstation.app.console.charts import timeline_options
from groundstation.app.console.naming import named
from groundstation.app.console.player import SPEEDS, Player
from groundstation.app.console.recorded import Recorded
from groundstation.app.console.theme import Theme
from groundstation.app.console.view import TeamView
from groundstation.app.console.whatif_panel import WhatIfPanel

_TICK_S = 0.1
_SLOWLY_EVERY = 3
_FIGURES = ("min_distance_m", "distance_now_m", "radius_m", "error_now_m", "setpoints")
_COLUMNS = ("id", "role", "pose age", "setpoint", "last words")
_FIRST_RECORD = "the first record"
_WORDS_MAX = 110


@dataclass
class _Side:
    """One of the flights on the page.

    Attributes:
        recorded: the flight.
        view: what shows it.
        phase: its label.
        ahead_s: what is added to the page's time: it is another flight's.
    """

    recorded: Recorded
    view: TeamView
    phase: ui.label
    ahead_s: float = 0.0


class ReplayPage:
    """One browser's replay.

    Args:
        flights: one, or two to be compared; the marks are those of the first.
        solid: with the scene in three dimensions.
        tiles: for the map of a flight by GPS, see ``TeamView``.
    """

    def __init__(self, flights: Sequence[Recorded], *, solid: bool, tiles: tuple[str, int] | None = None) -> None:
        self._player, self._tiles = Player(flights[0].duration_s), tiles
        self._marks = flights[0].marks
        self._ticks, self._shown_s, self._seen_s = 0, -1.0, time.monotonic()
        with ui.header().classes("items-center gap-4 py-1"):
            names = " and ".join(item.flight.name for item in flights)
            ui.label(f"replay of {names}").classes("text-lg font-bold").props(named("title"))
            self._now = ui.label().classes("text-lg").props(named("age"))
            ui.space()
            theme = Theme(self._themed)
        self._desk(flights)
        first = flights[0]
        gains = first.flight.manifest.gains_npz if first.flight.manifest is not None else None
        self._what_if = None if first.log is None or gains is None else WhatIfPanel(first.log, first.flight.start_ns)
        with ui.row().classes("w-full no-wrap max-md:flex-wrap"):
            self._sides = [self._side(item, number, len(flights), solid=solid) for number, item in enumerate(flights)]
        theme.ask()
        ui.keyboard(on_key=self._key, ignore=["input", "select", "textarea", "button"])
        ui.timer(_TICK_S, self._update)

    def closed(self) -> None:
        """The browser has gone."""
        if self._what_if is not None:
            self._what_if.close()

    def _desk(self, flights: Sequence[Recorded]) -> None:
        """What the replay is steered by."""
        with ui.row().classes("w-full items-center gap-4 no-wrap max-md:flex-wrap"):
            ui.button("event before (,)", on_click=lambda: self._step(onward=False)).props("dense no-wrap")
            self._play = ui.button("play (space)", on_click=self._toggle).props("dense no-wrap")
            ui.button("next event (.)", on_click=lambda: self._step(onward=True)).props("dense no-wrap")
            ui.select({speed: f"{speed:g} times" for speed in SPEEDS}, value=1.0, on_change=self._pace).props(
                "dense options-dense"
            )
            self._slider = ui.slider(min=0.0, max=max(flights[0].duration_s, 0.1), step=0.01, value=0.0)
            self._slider.on("update:model-value", self._scrub, throttle=0.05).classes("grow").props(named("slider"))
        with ui.row().classes("w-full items-center gap-4"):
            events = {
                row: f"{t_s:8.2f} s  {kind}: {text[:_WORDS_MAX]}" for row, (t_s, kind, text) in enumerate(self._marks)
            }
            ui.select(events, label="jump to", with_input=True, on_change=self._jump).props("dense").classes("grow")
            nearest = [mark for mark in self._marks if mark[1] == "near"]
            if nearest:
                ui.button("smallest distance", on_click=lambda: self._seek(nearest[0][0])).props("dense no-wrap")
            if len(flights) > 1:
                both = [name for name, *_ in flights[0].phases() if flights[1].begin_of(name) is not None]
                choices = [_FIRST_RECORD, *dict.fromkeys(both)]
                ui.select(choices, value=_FIRST_RECORD, label="together at", on_change=self._align).props("dense")

    def _side(self, recorded: Recorded, number: int, count: int, *, solid: bool) -> _Side:
        prefix = "" if number == 0 else "other-"
        with ui.column().classes("w-full" if count == 1 else "w-1/2 max-md:w-full"):
            with ui.row().classes("items-center gap-4"):
                ui.label(recorded.flight.name).classes("font-bold")
                phase = ui.label().props(named(prefix + "phase"))
            view = TeamView(
                solid=solid,
                figures=_FIGURES,
                columns=_COLUMNS,
                narrow=count > 1,
                digits=4,
                charts=2,
                prefix=prefix,
                tiles=self._tiles,
            )
            with view.side:
                for line in (recorded.flight.message, *recorded.flight.notes):
                    if line is not None:
                        ui.label(line).classes("text-xs")
            view.happened(recorded.marks)
            radius_m = recorded.at(0.0).words.radius_m
            view.draw(recorded.history, radius_m, recorded.pairs)
            marks = recorded.marks
            view.timeline.options.update(timeline_options(recorded.phases(), marks, 0.0, recorded.duration_s))
            side = _Side(recorded, view, phase)
            view.timeline.on_point_click(lambda event: self._clicked(event, side))
        return side

    def _themed(self, dark: bool) -> None:
        for side in self._sides:
            side.view.themed(dark=dark)
        self._shown_s = -1.0

    def _toggle(self) -> None:
        self._player.toggle()

    def _pace(self, event: ValueChangeEventArguments[float]) -> None:
        self._player.speed = float(event.value)

    def _scrub(self, event: GenericEventArguments) -> None:
        self._player.playing = False
        self._player.seek(float(event.args))

    def _seek(self, t_s: float) -> None:
        self._player.playing = False
        self._player.seek(t_s)

    def _jump(self, event: ValueChangeEventArguments[int | None]) -> None:
        if event.value is not None:
            self._seek(self._marks[event.value][0])

    def _clicked(self, event: EChartPointClickEventArguments, side: _Side) -> None:
        if isinstance(event.value, list) and len(event.value) > 2:
            self._seek(side.recorded.marks[int(event.value[2])][0] - side.ahead_s)

    def _step(self, *, onward: bool) -> None:
        self._player.playing = False
        self._player.step(self._marks, onward=onward)

    def _align(self, event: ValueChangeEventArguments[str]) -> None:
        begins = [side.recorded.begin_of(event.value) or 0.0 for side in self._sides]
        for side, begin_s in zip(self._sides, begins, strict=True):
            side.ahead_s = begin_s - begins[0]
        self._shown_s = -1.0

    def _key(self, event: KeyEventArguments) -> None:
        if not event.action.keydown:
            return
        if event.key == " ":
            self._toggle()
        elif event.key in (".", ","):
            self._step(onward=event.key == ".")

    def _update(self) -> None:
        now_s = time.monotonic()
        player = self._player
        player.passed(now_s - self._seen_s)
        self._seen_s = now_s
        self._play.set_text("pause (space)" if player.playing else "play (space)")
        self._ticks += 1
        if player.t_s == self._shown_s:
            return
        slowly = not player.playing or self._ticks % _SLOWLY_EVERY == 0
        self._shown_s = player.t_s if slowly else self._shown_s
        self._now.set_text(f"{player.t_s:.2f} s")
        self._slider.value = player.t_s
        if slowly and self._what_if is not None:
            self._what_if.tell(player.t_s)
        for side in self._sides:
            t_s = player.t_s + side.ahead_s
            snapshot = side.recorded.at(t_s)
            side.view.place(snapshot, slowly=slowly)
            if slowly:
                side.phase.set_text(snapshot.words.outcome or snapshot.words.phase)
                side.view.tell(snapshot)
                side.view.stands_at(t_s)
