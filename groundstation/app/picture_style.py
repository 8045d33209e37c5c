"""How pictures and pages look: colours, and matplotlib's settings.

Values only: nothing is drawn here, and matplotlib is not loaded.
"""

from __future__ import annotations

from typing import Any

INK = "#22272e"
QUIET = "#8a929b"
LINE = "#d5d9de"
RED = "#B2182B"
# Okabe and Ito's colours, without the yellow that is lost on white, and two that keep apart from them.
BLUE, VERMILION, GREEN, PINK, SKY, ORANGE = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00"
BLACK, PURPLE = "#222222", "#7B3294"
SERIES = (BLUE, VERMILION, GREEN, PINK, SKY, ORANGE, BLACK, PURPLE)
"""In this order, for what stands side by side."""
STYLE: dict[Any, Any] = {
    "font.size": 12.0,
    "axes.edgecolor": QUIET,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e8eaed",
    "grid.linewidth": 0.8,
    "legend.frameon": False,
    "legend.fontsize": 12.0,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
}
"""matplotlib's rc settings."""
