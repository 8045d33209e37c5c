"""Light or dark: as the browser's system has it, until somebody says otherwise."""

from __future__ import annotations

from collections.abc import Callable

from nicegui import ui
from nicegui.events import GenericEventArguments

from groundstation.app.console.charts import BLUE

_EVENT = "gs_theme"
_ASK = f"emitEvent('{_EVENT}', {{dark: window.matchMedia('(prefers-color-scheme: dark)').matches}})"


class Theme:
    """A button, and what follows from it; built where it is made.

    Args:
        changed: told whether the page is dark, first when the browser has said what its system prefers.
    """

    def __init__(self, changed: Callable[[bool], None]) -> None:
        self._changed = changed
        ui.colors(primary=BLUE)  # dark enough for white letters in the sun
        self._dark = ui.dark_mode(None)
        ui.button(icon="contrast", on_click=self._toggle).props('dense flat color=white aria-label="light / dark"')

    def ask(self) -> None:
        """Asks the browser, once it is there."""
        ui.on(_EVENT, self._take)
        ui.timer(0.0, lambda: ui.run_javascript(_ASK), once=True)

    def _take(self, event: GenericEventArguments) -> None:
        self._set(dark=bool(event.args["dark"]))

    def _toggle(self) -> None:
        self._set(dark=not self._dark.value)

    def _set(self, *, dark: bool) -> None:
        self._dark.value = dark
        self._changed(dark)
