"""Pictures of gain design: a suggested sensing graph with its trade-off."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from groundstation.app.picture_style import BLUE, INK, QUIET, VERMILION
from groundstation.app.pictures import save_asked_picture
from groundstation.design.graphs import Suggestion


def draw_suggestion(path: Path, suggestion: Suggestion) -> None:
    """Draws the graph in space and slowest mode over number of edges.

    Args:
        path: picture to write; the ending chooses the kind.
        suggestion: what to draw.

    Raises:
        UserError: the picture cannot be written.
    """
    figure = Figure(figsize=(11, 5), layout="constrained")
    space = figure.add_subplot(1, 2, 1, projection="3d")
    points = suggestion.formation.points_enu_m
    for i, j in suggestion.formation.edges:
        space.plot(*points[[i, j]].T, color=QUIET, linewidth=1.2)
    space.plot(*points.T, linestyle="", marker="o", color=BLUE, markersize=8)
    for agent, point in enumerate(points, start=1):
        space.text(*(float(value) for value in point), f"  {agent}", color=INK)
    space.set_xlabel("x, m", labelpad=8)
    space.set_ylabel("y, m", labelpad=12)
    space.set_zlabel("z, m", labelpad=6)
    for axis in (space.xaxis, space.yaxis, space.zaxis):
        axis.set_major_locator(MaxNLocator(5))
    # leaves room for the labels, which the layout does not see in three dimensions
    space.set_box_aspect(None, zoom=0.82)
    space.set_title(f"{suggestion.formation.name}: {len(suggestion.formation.edges)} edges")
    plane = figure.add_subplot(1, 2, 2)
    counts = np.array([len(row.edges) for row in suggestion.rows])
    slowest = np.array([row.slowest for row in suggestion.rows])
    plane.plot(counts, slowest, marker="o", color=BLUE)
    plane.plot(
        len(suggestion.formation.edges),
        suggestion.slowest,
        marker="o",
        markersize=14,
        fillstyle="none",
        color=VERMILION,
    )
    plane.annotate(
        "chosen",
        (len(suggestion.formation.edges), suggestion.slowest),
        xytext=(10, -14),
        textcoords="offset points",
        color=VERMILION,
    )
    plane.set_xlabel("edges")
    plane.set_ylabel("slowest mode, 1/s")
    plane.set_ylim(bottom=0)
    plane.spines[["top", "right"]].set_visible(False)
    save_asked_picture(figure, path)
