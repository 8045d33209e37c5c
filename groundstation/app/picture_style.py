"""How pictures and pages look: colours, matplotlib's settings, the frame of a page of HTML.

Values only: nothing is drawn here, and matplotlib is not loaded.
"""

from __future__ import annotations

import html
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
_PAGE_CSS = f"""
body {{ font: 16px/1.5 system-ui, sans-serif; color: {INK}; margin: 2rem auto; padding: 0 1rem; }}
img {{ height: auto; }}
table {{ border-collapse: collapse; }}
th, td {{ text-align: left; border-bottom: 1px solid {LINE}; }}
td {{ font-variant-numeric: tabular-nums; }}
""".strip()


def html_page(title: str, body: str, css: str) -> str:
    """A whole page of HTML: no script, no resource from elsewhere.

    Args:
        title: of the window, and the heading; as text.
        body: what follows the heading; as HTML.
        css: the page's own rules, which win over the common ones.
    """
    title = html.escape(title)
    return f"""<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
{_PAGE_CSS}
{css.strip()}
</style>
<h1>{title}</h1>
{body.strip()}
</html>
"""
