"""Preflight on the page: what was found at each vehicle, what to do about it, and the two orders that belong there."""

from __future__ import annotations

from collections.abc import Sequence

from nicegui import ui

from groundstation.app.check_screen import COLUMNS
from groundstation.app.console.naming import named

_REMEDY = "what is wrong, and what to do"
_STATE = COLUMNS.index("state")


class PreflightPanel:
    """The table, and what the team waits for; there while it stands on its pads.

    Attributes:
        orders: where the page puts its buttons.
    """

    def __init__(self) -> None:
        self._shown: Sequence[Sequence[str]] = ()
        with ui.expansion("preflight", value=True).classes("w-full").props(named("preflight")) as self._panel:
            with ui.row().classes("items-center gap-4"):
                self.orders = ui.row().classes("gap-2")
                self._team = ui.label().classes("text-sm font-bold").props(named("preflight-team"))
            self._table = ui.table(columns=_columns(remedies=False), rows=[], row_key=COLUMNS[0]).classes("w-full")
            self._table.props("dense virtual-scroll hide-pagination").style("max-height: 20rem")
            self._table.props(":rows-per-page-options=[0]").props(named("preflight-table"))
            self._waiting = ui.label().classes("text-sm whitespace-pre-line").props(named("problems"))

    def show(self, checks: Sequence[Sequence[str]], problems: Sequence[str], *, there: bool) -> None:
        """Tells what was found.

        Args:
            checks: see ``Words.checks``.
            problems: of the whole team.
            there: whether it still stands on its pads.
        """
        self._panel.set_visibility(there)
        if not there:
            return
        self._waiting.set_text("\n".join(f"waiting: {text}" for text in problems))
        if checks != self._shown:
            self._shown = checks
            ready = sum(row[_STATE] == "ready" for row in checks)
            self._team.set_text(f"{ready} of {len(checks)} ready")
            self._table.columns = _columns(remedies=any(row[-1] for row in checks))
            self._table.rows = [dict(zip((*COLUMNS, _REMEDY), row, strict=False)) for row in checks]


def _columns(*, remedies: bool) -> list[dict[str, object]]:
    """What needs eyes comes first: a tablet shows the first of a row, and scrolls to the others."""
    first = [COLUMNS[0], COLUMNS[_STATE], *([_REMEDY] if remedies else ())]
    columns: list[dict[str, object]] = [
        {"name": name, "label": name, "field": name, "sortable": True, "align": "left"}
        for name in (*first, *(name for name in COLUMNS if name not in first))
    ]
    for column in columns:
        if column["name"] == _REMEDY:
            column["style"] = "white-space: normal; min-width: 20rem"
    return columns
