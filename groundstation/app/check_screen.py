"""Preflight on a screen: a line for each vehicle, with what a safety officer asks for. Judges nothing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from rich.table import Table
from rich.text import Text

from groundstation.mission.check_table import CheckRow

_COLUMNS = (
    "vehicle", "role", "firmware", "mode", "heard", "estimator", "pose", "off pad", "rates", "clock", "battery",
    "failsafe", "state",
)  # fmt: skip


def check_table(rows: Sequence[CheckRow]) -> Table:
    """The rows as a table.

    heard: since the last heartbeat; pose: age of position and attitude; off pad, rates (positions + attitudes) and
    battery: what is, and after the stroke what is allowed, asked for, needed; clock: how far off times may be.
    """
    table = Table(*_COLUMNS)
    for row in rows:
        table.add_row(
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
            Text("ready", style="bold green") if row.ready else Text("not ready", style="bold red"),
        )
    return table


def rows_as_values(rows: Sequence[CheckRow]) -> list[dict[str, Any]]:
    """The same for scripts."""
    return [{**asdict(row), "ready": row.ready} for row in rows]


def _figure(value: float, form: str) -> str:
    return form.format(value) if math.isfinite(value) else "-"
