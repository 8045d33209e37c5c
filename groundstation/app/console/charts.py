"""Charts of a flight over its time, as options for ECharts: pure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from groundstation.core.types import FloatArray

BLUE, ORANGE, VERMILION, GREEN, SKY, GREY = "#0072B2", "#E69F00", "#D55E00", "#009E73", "#56B4E9", "#888888"
"""Of Okabe and Ito: people with any kind of colour vision tell them apart."""

Options = dict[str, object]


def chart_options(title: str, rows: FloatArray, colour: str, limit: float = np.nan) -> Options:
    """A line over time.

    Args:
        title: what it shows, with its unit.
        rows: seconds and value, shape (k, 2); rows with NaN are left out.
        colour: of the line.
        limit: drawn across; NaN for none.
    """
    known = rows[np.isfinite(rows).all(axis=1)]
    across = [{"yAxis": limit, "name": "r"}] if np.isfinite(limit) else []
    return {
        "title": {"text": title, "textStyle": {"fontSize": 12, "color": GREY}},
        "grid": {"top": 30, "bottom": 25, "left": 45, "right": 15},
        "xAxis": {"type": "value", "scale": True, "name": "s", **_AXIS},
        "yAxis": {"type": "value", "min": 0, **_AXIS},
        "animation": False,
        "series": [
            {
                "type": "line",
                "showSymbol": False,
                "lineStyle": {"color": colour},
                "data": np.column_stack([known[:, 0].round(2), known[:, 1].round(4)]).tolist(),
                "markLine": {"symbol": "none", "silent": True, "lineStyle": {"color": VERMILION}, "data": across},
            }
        ],
    }


_AXIS: Options = {
    "axisLabel": {"color": GREY},
    "nameTextStyle": {"color": GREY},
    "splitLine": {"lineStyle": {"color": "#88888844"}},
}
"""Grey is read on light and on dark ground."""


def columns_of(history: Sequence[Sequence[float]], column: int) -> FloatArray:
    """Seconds and one of the values, shape (k, 2)."""
    return np.array([(row[0], row[column]) for row in history], dtype=np.float64).reshape(-1, 2)
