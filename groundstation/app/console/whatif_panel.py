"""What if, on the replay's page: other gains or avoidance on the poses that were recorded, setpoints side by side."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from nicegui import run, ui

from groundstation.app.console.charts import PURPLE, chart_options
from groundstation.app.console.naming import named
from groundstation.app.console.view import number
from groundstation.app.whatif import WhatIf, what_if
from groundstation.core.errors import CheckFailed, UserError
from groundstation.core.types import FloatArray

_ROWS = 600
_COLUMNS = "vehicle", "was told, m/s (east north up)", "would be told", "apart"


class WhatIfPanel:
    """The panel; built where it is made.

    Args:
        log: that is replayed.
        start_ns: its first record.
    """

    def __init__(self, log: Path, start_ns: int) -> None:
        self._log, self._start_ns, self._closed = log, start_ns, False
        self._found: WhatIf | None = None
        with ui.expansion("what if").classes("w-full").props(named("what-if")):
            with ui.row().classes("w-full items-center gap-2"):
                self._changes = ui.input("keys of the mission, gain=0.4 avoidance.radius_m=0.6").props("dense")
                self._changes.classes("grow").props(named("changes")).on("keydown.enter", self._ask)
                self._gains = ui.input("other gains (.npz)").props("dense")
                self._button = ui.button("compare setpoints", on_click=self._ask).props("dense no-wrap")
            self._said = ui.label().classes("text-sm font-bold").props(named("what-if-said") + " role=status")
            self._chart = ui.echart(chart_options("largest difference of a setpoint, m/s", np.zeros((0, 2)), PURPLE))
            self._chart.classes("w-full h-36")
            columns = [{"name": name, "label": name, "field": name, "align": "left"} for name in _COLUMNS]
            self._table = ui.table(columns=columns, rows=[], row_key=_COLUMNS[0]).props("dense").classes("w-full")

    def close(self) -> None:
        """Whoever asked has gone."""
        self._closed = True

    async def _ask(self) -> None:
        changes = str(self._changes.value or "").split()
        gains = Path(self._gains.value) if self._gains.value else None
        self._button.set_enabled(False)
        self._said.set_text("both missions are given the log's poses")
        try:
            found = await run.io_bound(what_if, self._log, changes, gains, stop=lambda: self._closed)
        except (UserError, CheckFailed) as error:
            self._said.set_text(str(error))
            return
        finally:
            self._button.set_enabled(True)
        if found is None:
            return
        self._found = found
        self._said.set_text(_words(found))
        self._chart.options.update(chart_options("largest difference of a setpoint, m/s", self._history(found), PURPLE))

    def _history(self, found: WhatIf) -> FloatArray:
        """Seconds and the largest difference of each short span, shape (k, 2)."""
        with np.errstate(invalid="ignore"):
            most = np.fmax.reduce(found.apart_m_s, axis=1)
        spans = np.array_split(np.arange(len(most)), min(_ROWS, len(most)))
        begins_s = (found.t_ns[[span[0] for span in spans]] - self._start_ns) / 1e9
        return np.column_stack([begins_s, [float(np.fmax.reduce(most[span])) for span in spans]])

    def tell(self, t_s: float) -> None:
        """Shows both setpoints of each vehicle at a moment."""
        found = self._found
        if found is None:
            return
        row = int(np.searchsorted(found.t_ns, self._start_ns + round(t_s * 1e9), side="right")) - 1
        if row < 0:
            return
        was, would_be, apart = found.was_enu_m_s[row], found.would_be_enu_m_s[row], found.apart_m_s[row]
        self._table.rows = [
            {
                _COLUMNS[0]: int(sysid),
                _COLUMNS[1]: _vector(was[at]),
                _COLUMNS[2]: _vector(would_be[at]),
                _COLUMNS[3]: number(apart[at], " m/s", 3),
            }
            for at, sysid in enumerate(found.ids)
        ]


def _words(found: WhatIf) -> str:
    figures = found.figures()
    if not figures["whatif_ticks"]:
        return "the team is never in the air in it"
    return (
        f"largest difference {figures['whatif_max_m_s']:.3f} m/s, vehicle {figures['whatif_max_vehicle']} at"
        f" {figures['whatif_max_at_s']:.2f} s; on average (rms) {figures['whatif_rms_m_s']:.4f} m/s"
        f"{'; ' + found.note if found.note else ''}"
    )


def _vector(values: FloatArray) -> str:
    return " ".join(f"{value:+.3f}" for value in values) if np.isfinite(values).all() else "-"
