"""``make paper``: Figures 2 to 5 of the paper from our own law, avoidance and flight, on one page."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from groundstation.app.picture_style import BLUE, INK, QUIET, SERIES, STYLE, VERMILION
from groundstation.core.avoidance import avoid
from groundstation.core.control import ScaleFunction, Task, formation_control
from groundstation.core.regions import build_region
from groundstation.core.types import FloatArray
from groundstation.core.views import LocalViews
from groundstation.records.replay import Flight, load_flight
from tests.docs.figures import free_scale

SNAPSHOTS = 4
_RADIUS_M = 1.0  # of the spheres of Fig. 3
_WORDS = {
    "fig2": "Figure 2. The cube, and what law (2) makes of two random starts: width and height are free. (Points that"
    " do at once what they are told, gains of cube8.)",
    "fig3": "Figure 3. Example 1: the wish u of agent 1 by the gains of (4) meets the sphere of agent {met}; Algorithm"
    " 2 turns it by {angle:.0f} degrees, within the half space above the plane.",
    "fig4": "Figure 4. The flight of paper_cube8: the team at {times} s of forming, and on the right the whole way with"
    " the sensing graph. Formed after {formed}.",
    "fig5": "Figure 5. All {pairs} distances between vehicles from the beginning of forming to the end of the hold."
    " Smallest: {least:.3f} m, r = {radius:g} m. Like the paper's quadrotors ours come nearer than r, for they lag: the"
    " law is for points that do not.",
}


def example_1() -> tuple[FloatArray, FloatArray, FloatArray, tuple[int, ...]]:
    """Example 1 and Fig. 3: places of agents 2 and 3, the wish (5), what Algorithm 2 makes of it, and who is met."""
    places = np.array([[0.0, 0.0, 0.0], [2.0, 3.0, 1.0], [2.0, 1.0, 2.0]])
    neighbours = np.array([[False, True, True]])
    rel = np.where(neighbours[..., None], places[None], np.nan)
    views = LocalViews(rel, np.zeros_like(rel), neighbours, np.zeros((1, 3)))
    gains_xy, gains_z = np.array([[0.0, 2.0 + 1.0j, -1.0 - 3.0j]]), np.array([[0.0, -1.0, 2.0]])
    task = Task(gains_xy, gains_z, neighbours, np.zeros((1, 3)), np.zeros((1, 3)))
    wish = formation_control(views, task, ScaleFunction("free"))
    turned = avoid(views, wish, build_region("sphere", _RADIUS_M, 10.0, 0.0))
    return places[1:], wish[0], turned.vel_flu_m_s[0], tuple(int(k) + 1 for k in np.flatnonzero(turned.in_the_way[0]))


def _room(axes: Any, title: str, low: FloatArray, high: FloatArray) -> Any:
    axes.set_title(title, color=INK, fontsize=11)
    for name, least, most in zip("xyz", low, high, strict=True):
        getattr(axes, f"set_{name}lim")(least, most)
    axes.set_box_aspect(high - low)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_ticklabels([])
        axis.set_pane_color((1.0, 1.0, 1.0))
    return axes


def figure_3() -> Figure:
    """The wish of Example 1, both spheres, the plane whose upper side is allowed, and the turned wish."""
    others, wish, turned, _ = example_1()
    figure = Figure(figsize=(7.5, 6.0), layout="constrained")
    axes = _room(figure.add_subplot(projection="3d"), "", np.array([-1.5, -1.5, -1.5]), np.array([4.0, 4.5, 4.0]))
    across, up = np.mgrid[0 : 2 * np.pi : 28j, 0 : np.pi : 15j]
    ball = np.stack([np.cos(across) * np.sin(up), np.sin(across) * np.sin(up), np.cos(up)])
    for number, centre in enumerate(others, start=2):
        axes.plot_wireframe(*(centre[:, None, None] + _RADIUS_M * ball), color=QUIET, linewidth=0.4)
        axes.text(*(centre + np.array([1.2, 0.0, 0.0 if number == 2 else 0.6])), f"agent {number}", color=INK)
    unit = wish / np.linalg.norm(wish)
    first = np.cross(unit, [0.0, 0.0, 1.0])
    first /= np.linalg.norm(first)
    second = np.cross(unit, first)
    rim = np.linspace(0.0, 2.0 * np.pi, 61)[:, None]
    disc = 1.4 * (np.cos(rim) * first + np.sin(rim) * second)
    axes.plot_trisurf(*np.vstack([np.zeros(3), disc]).T, triangles=[(0, k, k + 1) for k in range(1, 61)],
                      color=QUIET, alpha=0.3)  # fmt: skip
    labels = ((wish, VERMILION, "  u", 0.35, "left"), (turned, BLUE, "u turned  ", 0.8, "right"))
    for vector, colour, text, share, side in labels:
        axes.quiver(0, 0, 0, *vector, color=colour, linewidth=2.0, arrow_length_ratio=0.08)
        axes.text(*(share * vector), text, color=colour, ha=side)
    axes.plot(0, 0, 0, "o", color=INK)
    axes.text(0.0, -0.4, -0.4, "agent 1", color=INK)
    axes.view_init(elev=18, azim=-75)
    return figure


def forming(flight: Flight) -> tuple[int, int, int]:
    """When the team began to form, when it had formed, and when its hold was over, ns of the log.

    Raises:
        ValueError: it never held the formation.
    """
    spans = {phase.name: phase for phase in flight.phases}
    if "hold" not in spans:
        raise ValueError(f"{flight.name}: was not formed; fly it with another seed")
    return spans["form"].start_ns, spans["hold"].start_ns, spans["hold"].stop_ns


def _ways(flight: Flight) -> FloatArray:
    start, _, stop = forming(flight)
    return flight.positions_at(np.linspace(start, stop, 400).astype(np.int64))


def snapshot_times_s(flight: Flight) -> FloatArray:
    """Times of the snapshots from the beginning of forming, s."""
    start, formed, _ = forming(flight)
    return np.asarray(np.linspace(0.0, (formed - start) / 1e9, SNAPSHOTS).round(1))


def figure_4(flight: Flight) -> Figure:
    """The team at some instants, and its ways with the sensing graph where they end."""
    start, _, _ = forming(flight)
    ways = _ways(flight)
    low, high = np.nanmin(ways, axis=(0, 1)) - 0.2, np.nanmax(ways, axis=(0, 1)) + 0.2
    times_s = snapshot_times_s(flight)
    shots = flight.positions_at(start + (times_s * 1e9).astype(np.int64))
    figure = Figure(figsize=(15, 3.8), layout="constrained")
    for place, (time_s, shot) in enumerate(zip(times_s, shots, strict=True), start=1):
        axes = _room(figure.add_subplot(1, SNAPSHOTS + 1, place, projection="3d"), f"{time_s:g} s", low, high)
        for number, point in enumerate(shot):
            axes.plot(*point[:, None], "o", color=SERIES[number % len(SERIES)], markersize=8)
    axes = _room(figure.add_subplot(1, SNAPSHOTS + 1, SNAPSHOTS + 1, projection="3d"), "the whole way", low, high)
    # paper_cube8 has fixed roles: vehicle i is agent i.
    for i, j in flight.formations[0].edges:
        axes.plot(*ways[-1][[i, j]].T, color=QUIET, linewidth=1.2)
    for number in range(ways.shape[1]):
        colour = SERIES[number % len(SERIES)]
        axes.plot(*ways[:, number].T, color=colour, linewidth=1.0)
        axes.plot(*ways[-1, number][:, None], "o", color=colour, markersize=8)
    return figure


def figure_5(flight: Flight) -> Figure:
    """All distances over time, and r."""
    start, _, stop = forming(flight)
    instants = np.linspace(start, stop, 1500).astype(np.int64)
    figure = Figure(figsize=(9, 4.2), layout="constrained")
    axes = figure.add_subplot()
    axes.plot((instants - start) / 1e9, flight.distances_at(instants), color=BLUE, linewidth=0.9, alpha=0.7)
    axes.axhline(flight.safety_radius_m or 0.0, color=QUIET, linewidth=3.0)
    axes.set(xlabel="time, s", ylabel="distances between vehicles, m", ylim=(0, None))
    axes.set_xlim(0.0, float(stop - start) / 1e9)
    return figure


def words(flight: Flight) -> dict[str, str]:
    """What stands below each figure."""
    start, formed, stop = forming(flight)
    least = float(np.nanmin(flight.distances_at(np.linspace(start, stop, 5000).astype(np.int64))))
    _, wish, turned, met = example_1()
    angle = np.degrees(np.arccos(wish @ turned / (np.linalg.norm(wish) * np.linalg.norm(turned))))
    figures = {
        "met": " and ".join(str(agent) for agent in met),
        "angle": float(angle),
        "times": ", ".join(f"{time_s:g}" for time_s in snapshot_times_s(flight)),
        "formed": f"{(formed - start) / 1e9:.1f} s",
        "pairs": len(flight.vehicles) * (len(flight.vehicles) - 1) // 2,
        "least": least,
        "radius": flight.safety_radius_m,
    }
    return {name: text.format(**figures) for name, text in _WORDS.items()}


def write_page(log: Path, folder: Path) -> Path:
    """Draws the figures of a flight of paper_cube8 and writes the page; returns it."""
    flight = load_flight(log)
    draws: dict[str, Callable[[], Figure]] = {
        "fig2": free_scale,
        "fig3": figure_3,
        "fig4": lambda: figure_4(flight),
        "fig5": lambda: figure_5(flight),
    }
    folder.mkdir(parents=True, exist_ok=True)
    with mpl.rc_context(STYLE):
        for name, draw in draws.items():
            draw().savefig(folder / f"{name}.png", dpi=110, bbox_inches="tight")
    shown = "\n".join(
        f'<figure><img src="{name}.png" alt="{text}"><figcaption>{text}</figcaption></figure>'
        for name, text in words(flight).items()
    )
    page = folder / "index.html"
    page.write_text(
        '<!doctype html><html lang="en"><meta charset="utf-8"><title>The paper, flown again</title>'
        "<style>body{font:16px/1.5 sans-serif;max-width:1100px;margin:2em auto;padding:0 1em;color:#22272e}"
        "img{max-width:100%}figure{margin:2em 0}figcaption{color:#57606a}</style>"
        "<h1>The paper, flown again</h1><p>Figures 2 to 5 of Fathian, Safaoui, Summers and Gans by <code>gs</code>:"
        f" the pure law of mission {flight.name}, on the emulator.</p>\n{shown}\n</html>\n",
        encoding="utf-8",
    )
    return page


if __name__ == "__main__":
    sys.stdout.write(f"{write_page(Path(sys.argv[1]), Path(sys.argv[2]))}\n")
