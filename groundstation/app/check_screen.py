"""Preflight on a screen: a line for each vehicle, with what a safety officer asks for. Judges nothing.

On a terminal that is too narrow for the table a few lines for each vehicle say the same; nothing is ever cut off.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from groundstation.mission.ground.check_table import CheckRow

COLUMNS = (
    "vehicle", "role", "firmware", "mode", "heard", "estimator", "pose", "off pad", "rates", "clock", "battery",
    "failsafe", "state",
)  # fmt: skip
"""Of the table."""
_INDENT, _BETWEEN = "  ", "   "


def show_rows(console: Console, rows: Sequence[CheckRow]) -> None:
    """Prints the rows: as a table where the console is wide enough for it, else as a list."""
    table = check_table(rows)
    if console.measure(table).maximum < console.width or not rows:
        console.print(table)
    else:
        for line in check_list(rows, console.width):
            console.print(line)


def check_table(rows: Sequence[CheckRow]) -> Table:
    """The rows as a table.

    heard: since the last heartbeat; pose: age of position and attitude; off pad, rates (positions + attitudes) and
    battery: what is, and after the stroke what is allowed, asked for, needed; clock: how far off times may be.
    """
    table = Table(*COLUMNS)
    for row in rows:
        *cells, state = cells_of(row)
        table.add_row(*cells, Text(state, style=_style(row)))
    return table


def check_list(rows: Sequence[CheckRow], width: int) -> list[Text]:
    """The rows as lines of at most ``width`` columns, unless a single entry is longer."""
    lines = []
    for row in rows:
        vehicle, role, *cells, state = cells_of(row)
        lines.append(Text(f"vehicle {vehicle}, role {role}: ") + Text(state, style=_style(row)))
        line = ""
        for name, cell in zip(COLUMNS[2:-1], cells, strict=True):
            entry = f"{name} {cell}"
            if line and len(_INDENT + line + _BETWEEN + entry) > width:
                lines.append(Text(_INDENT + line))
                line = ""
            line = f"{line}{_BETWEEN}{entry}" if line else entry
        lines.append(Text(_INDENT + line))
    return lines


def cells_of(row: CheckRow) -> tuple[str, ...]:
    """A row in words, in the order of ``COLUMNS``."""
    return (
        str(row.id),
        str(row.role),
        row.firmware or "-",
        row.mode or "-",
        _figure(row.heartbeat_age_s, "{:.1f} s"),
        row.estimator or "-",
        _figure(row.position_age_s, "{:.2f} s"),
        f"{_figure(row.off_pad_m, '{:.2f}')}/{row.off_pad_limit_m:.2f} m",
        f"{_figure(row.positions_hz, '{:.0f}')}+{_figure(row.attitudes_hz, '{:.0f}')}/{row.asked_hz:.0f} Hz",
        _figure(1000.0 * row.clock_s, "±{:.0f} ms"),
        f"{_figure(100.0 * row.battery, '{:.0f}')}/{100.0 * row.battery_need:.0f} %",
        row.failsafe or "-",
        "ready" if row.ready else "not ready" if row.problems else "not checked",
    )


def rows_as_values(rows: Sequence[CheckRow]) -> list[dict[str, Any]]:
    """The same for scripts."""
    return [{**asdict(row), "ready": row.ready} for row in rows]


def _style(row: CheckRow) -> str:
    return "bold green" if row.ready else "bold red"


def _figure(value: float, form: str) -> str:
    return form.format(value) if math.isfinite(value) else "-"
