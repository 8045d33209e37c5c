"""Charts of a flight over its time, as options for ECharts: pure."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from groundstation.core.types import FloatArray

BLUE, ORANGE, VERMILION, GREEN, SKY, GREY = "#0072B2", "#E69F00", "#D55E00", "#009E73", "#56B4E9", "#888888"
PURPLE = "#CC79A7"
"""Of Okabe and Ito: people with any kind of colour vision tell them apart."""

Options = dict[str, object]


def chart_options(
    title: str, rows: FloatArray, colour: str, limit: float = np.nan, beside: FloatArray | None = None
) -> Options:
    """A line over time.

    Args:
        title: what it shows, with its unit.
        rows: seconds and value, shape (k, 2); rows with NaN are left out.
        colour: of the line.
        limit: drawn across; NaN for none.
        beside: thin grey lines behind it: seconds, then a value of each, shape (k, 1 + lines); None for none.
    """
    thin = [] if beside is None else [_thin(beside[:, [0, column]]) for column in range(1, beside.shape[1])]
    known = rows[np.isfinite(rows).all(axis=1)]
    label = {"formatter": "r", "position": "insideEndTop", "color": VERMILION}
    across = [{"yAxis": limit, "label": label}] if np.isfinite(limit) else []
    return {
        "title": {"text": title if len(known) else f"{title}: unknown", "top": 2, "textStyle": _TITLE},
        "grid": {"top": 32, "bottom": 25, "left": 45, "right": 25},
        "xAxis": {"type": "value", "scale": True, "name": "s", **_AXIS},
        "yAxis": {"type": "value", "min": 0, **_AXIS},
        "animation": False,
        "series": [
            *thin,
            {
                "type": "line",
                "showSymbol": False,
                "lineStyle": {"color": colour},
                "data": np.column_stack([known[:, 0].round(2), known[:, 1].round(4)]).tolist(),
                "markLine": {"symbol": "none", "silent": True, "lineStyle": {"color": VERMILION}, "data": across},
            },
        ],
    }


def _thin(rows: FloatArray) -> Options:
    known = rows[np.isfinite(rows).all(axis=1)]
    return {
        "type": "line",
        "showSymbol": False,
        "silent": True,
        "lineStyle": {"color": GREY, "width": 0.7, "opacity": 0.6},
        "data": np.column_stack([known[:, 0].round(2), known[:, 1].round(3)]).tolist(),
    }


_TITLE: Options = {"fontSize": 12, "color": GREY}
_AXIS: Options = {
    "axisLabel": {"color": GREY},
    "nameTextStyle": {"color": GREY},
    "splitLine": {"lineStyle": {"color": "#88888844"}},
}
"""Grey is read on light and on dark ground."""


def columns_of(history: Sequence[Sequence[float]] | FloatArray, column: int) -> FloatArray:
    """Seconds and one of the values, shape (k, 2)."""
    rows = np.asarray(history, dtype=np.float64)
    return rows[:, [0, column]] if len(rows) else np.zeros((0, 2))


Mark = tuple[float, str, str]
"""Seconds, kind, text of what happened."""
_MARKS = (
    ("order", "diamond", ORANGE),
    ("alarm", "triangle", VERMILION),
    ("info", "circle", SKY),
    ("near", "pin", BLUE),
)
_LABEL: Options = {"show": True, "position": "insideTop", "color": GREY, "fontSize": 10, "rotate": 0}


def spans_of(marks: Sequence[Mark], end_s: float) -> list[tuple[str, float, float]]:
    """Name, begin and end of each phase, out of what happened."""
    begins = [(t_s, text) for t_s, kind, text in marks if kind == "phase"]
    return [(name, at_s, then_s) for (at_s, name), (then_s, _) in pairwise([*begins, (end_s, "")])]


def timeline_options(
    phases: Sequence[tuple[str, float, float]], marks: Sequence[Mark], now_s: float, end_s: float
) -> Options:
    """The phases as bands, what happened as signs over it, and where the page stands.

    Args:
        phases: name, begin and end, s.
        marks: what happened; a sign has its text, and says which of them it is by ``value[2]``.
        now_s: drawn across.
        end_s: of the axis.
    """
    bands = [
        [
            {"name": name, "xAxis": begin_s, "itemStyle": {"color": GREY, "opacity": 0.28 if row % 2 else 0.12}},
            {"xAxis": stop_s},
        ]
        for row, (name, begin_s, stop_s) in enumerate(phases)
    ]
    signs = [
        {
            "type": "scatter",
            "name": kind,
            "symbol": symbol,
            "symbolSize": 9,
            "itemStyle": {"color": colour},
            "data": [
                {"value": [round(t_s, 3), height, row], "name": text}
                for row, (t_s, what, text) in enumerate(marks)
                if what == kind
            ],
        }
        for height, (kind, symbol, colour) in enumerate(_MARKS, 1)
    ]
    signs[0] |= {
        "markArea": {"silent": True, "label": _LABEL, "data": bands},
        "markLine": {
            "symbol": "none",
            "silent": True,
            "animation": False,
            "label": {"show": False},
            "lineStyle": {"color": VERMILION, "type": "solid"},
            "data": [{"xAxis": round(now_s, 3)}],
        },
    }
    return {
        "grid": {"top": 8, "bottom": 22, "left": 45, "right": 15},
        "xAxis": {"type": "value", "min": 0, "max": round(end_s, 1), "name": "s", **_AXIS},
        "yAxis": {"type": "value", "min": 0, "max": len(_MARKS) + 2, "show": False},
        "tooltip": {"trigger": "item", "formatter": "{a}: {b}"},
        "animation": False,
        "series": signs,
    }
