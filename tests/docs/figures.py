"""The figures of docs/law.md, drawn from the program's own law, avoidance and gains; and those of other pages."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch, Wedge

from groundstation.app.picture_style import BLUE, INK, LINE, QUIET, SERIES, STYLE, VERMILION
from groundstation.app.resources import packaged_configs
from groundstation.core.avoidance import avoid
from groundstation.core.control import ScaleFunction, Task, formation_control, saturate, task_for_roles
from groundstation.core.formation import Formation
from groundstation.core.regions import build_region
from groundstation.core.types import FloatArray
from groundstation.core.views import LocalViews
from groundstation.design.designer import design
from groundstation.design.store import load_formation
from tests.docs.robustness import pictures

_STEP_S = 0.01
_SPEED_M_S = 1.0
_FREE, _FIXED = ScaleFunction("free"), ScaleFunction("arctan", 2.5)


def _cube() -> tuple[Formation, Task]:
    """The cube that comes along, with designed gains; agent i is in role i."""
    shape = load_formation(packaged_configs() / "formations" / "cube8.yaml")
    gains = design(shape).gains
    if gains is None:
        raise RuntimeError("cube8 has no gains")
    return shape, task_for_roles(shape, gains, np.arange(shape.size))


def _views(pos_m: FloatArray) -> LocalViews:
    """What level agents see that all face the same way."""
    n = len(pos_m)
    visible = ~np.eye(n, dtype=np.bool_)
    rel = np.where(visible[..., None], pos_m[None] - pos_m[:, None], np.nan)
    return LocalViews(rel, np.zeros_like(rel), np.asarray(visible, dtype=np.bool_), np.zeros((n, 3)))


def _fly(
    task: Task, start_m: FloatArray, scale: ScaleFunction, seconds: float, bend: Callable[[FloatArray], FloatArray]
) -> FloatArray:
    """Points that do at once what they are told: positions at every step, shape (steps, n, 3)."""
    found = [start_m]
    for _ in range(round(seconds / _STEP_S)):
        wanted = formation_control(_views(found[-1]), task, scale)
        found.append(found[-1] + _STEP_S * saturate(bend(wanted), _SPEED_M_S))
    return np.array(found)


def _as_told(vel_m_s: FloatArray) -> FloatArray:
    return vel_m_s


def _space(figure: Figure, place: int, of: int, title: str) -> Any:
    axes = figure.add_subplot(1, of, place, projection="3d")
    axes.set_title(title, color=INK, fontsize=12)
    axes.set_box_aspect((1, 1, 1))
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_ticklabels([])
        axis.set_pane_color((1.0, 1.0, 1.0))
    return axes


def _team(axes: Any, shape: Formation, pos_m: FloatArray) -> None:
    for i, j in shape.edges:
        axes.plot(*pos_m[[i, j]].T, color=QUIET, linewidth=1.2)
    for i, point in enumerate(pos_m):
        axes.plot(*point[:, None], "o", color=SERIES[i % len(SERIES)], markersize=8)
    middle, half = pos_m.mean(axis=0), 0.55 * np.ptp(pos_m, axis=0).max()
    for number, name in enumerate("xyz"):
        getattr(axes, f"set_{name}lim")(middle[number] - half, middle[number] + half)


def free_scale() -> Figure:
    """The shape that was asked for, and what law (2) makes of two starts."""
    shape, task = _cube()
    figure = Figure(figsize=(10.5, 3.6), layout="constrained")
    _team(_space(figure, 1, 3, "asked for"), shape, shape.points_enu_m)
    for place, seed in ((2, 1), (3, 4)):
        start = np.random.default_rng(seed).uniform(-1.5, 1.5, (shape.size, 3))
        path = _fly(task, start, _FREE, 10.0, _as_told)
        _team(_space(figure, place, 3, f"law (2), start {place - 1}"), shape, path[-1])
    return figure


def fixed_scale() -> Figure:
    """All distances over time under law (14)."""
    shape, task = _cube()
    start = np.random.default_rng(3).uniform(-1.5, 1.5, (shape.size, 3))
    path = _fly(task, start, _FIXED, 4.0, _as_told)
    figure = Figure(figsize=(8, 3.8), layout="constrained")
    axes = figure.add_subplot()
    rows, columns = np.triu_indices(shape.size, 1)
    between = np.linalg.norm(path[:, rows] - path[:, columns], axis=2)
    axes.plot(np.arange(len(path)) * _STEP_S, between, color=BLUE, linewidth=0.9, alpha=0.7)
    for wanted in np.unique(shape.distances_m[rows, columns].round(6)):
        axes.axhline(wanted, color=VERMILION, linestyle="--", linewidth=1.2)
    axes.set(xlabel="time, s", ylabel="distance of each pair, m", xlim=(0, 4), ylim=(0, None))
    return figure


def half_space() -> Figure:
    """V over time, every vehicle sent up to 80 degrees aside of where it should go, anew in every step."""
    shape, task = _cube()
    figure = Figure(figsize=(8, 3.8), layout="constrained")
    axes = figure.add_subplot()
    for number, most_deg in enumerate((0.0, 50.0, 80.0)):
        rng = np.random.default_rng(5)

        def bend(vel: FloatArray, rng: np.random.Generator = rng, most_deg: float = most_deg) -> FloatArray:
            turn = rng.normal(size=vel.shape)
            aside = np.cross(vel, turn)
            length = np.linalg.norm(aside, axis=1, keepdims=True)
            aside = aside / np.where(length > 0.0, length, 1.0)
            angle = np.radians(rng.uniform(0.0, most_deg, (len(vel), 1)))
            return np.asarray(np.cos(angle) * vel + np.sin(angle) * aside * np.linalg.norm(vel, axis=1, keepdims=True))

        start = np.random.default_rng(3).uniform(-1.5, 1.5, (shape.size, 3))
        path = _fly(task, start, _FREE, 5.0, bend)
        flat = path[..., 0] + 1j * path[..., 1]
        value = -np.einsum("ti,ij,tj->t", flat.conj(), _laplacian(task.gains_xy), flat).real
        value -= np.einsum("ti,ij,tj->t", path[..., 2], _laplacian(task.gains_z).real, path[..., 2])
        label = f"up to {most_deg:.0f}° aside" if most_deg else "as told"
        axes.semilogy(np.arange(len(path)) * _STEP_S, value, color=SERIES[number], label=label)
    axes.set(xlabel="time, s", ylabel="V, how far from the formation", xlim=(0, 5), ylim=(1e-6, None))
    axes.legend()
    return figure


def _laplacian(gains: Any) -> Any:
    """The aggregate matrix of gains off the diagonal: rows sum to zero."""
    off = np.where(np.eye(len(gains), dtype=bool), 0.0, gains)
    return off - np.diag(off.sum(axis=1))


def around() -> Figure:
    """Algorithm 2: the direction that is wanted, the cone that is closed, the nearest one that is free."""
    other = np.array([0.9, 0.12, 0.0])
    radius_m, wanted = 0.45, np.array([[0.8, 0.0, 0.0], [0.0, 0.0, 0.0]])
    turned = avoid(_views(np.array([[0.0, 0.0, 0.0], other])), wanted, build_region("sphere", radius_m, 1.2, 0.0))
    free = turned.vel_flu_m_s[0]
    figure = Figure(figsize=(7, 4.2), layout="constrained")
    axes = figure.add_subplot()
    axes.set_aspect("equal")
    axes.axis("off")
    middle = np.degrees(np.arctan2(other[1], other[0]))
    half = np.degrees(np.arcsin(radius_m / np.linalg.norm(other)))
    axes.add_patch(Wedge((0, 0), 1.5, middle - half, middle + half, color=VERMILION, alpha=0.12))
    axes.add_patch(Wedge((0, 0), 1.15, -90, 90, fill=False, edgecolor=LINE, linestyle=":"))
    axes.add_patch(Circle((other[0], other[1]), radius_m, facecolor="none", edgecolor=VERMILION, linewidth=1.5))
    for place, colour, text in (((0.0, 0.0), BLUE, "agent i"), ((other[0], other[1]), VERMILION, "agent j")):
        axes.plot(*place, "o", color=colour, markersize=9)
        axes.annotate(text, place, xytext=(-8, 12), textcoords="offset points", color=INK)
    for vector, colour, text in ((wanted[0], QUIET, "u"), (free, BLUE, "u turned as little as it takes")):
        axes.add_patch(
            FancyArrowPatch((0, 0), (vector[0], vector[1]), arrowstyle="-|>", mutation_scale=16, color=colour)
        )
        axes.annotate(text, (vector[0], vector[1]), xytext=(6, -14), textcoords="offset points", color=colour)
    axes.set(xlim=(-0.3, 1.6), ylim=(-0.75, 0.75))
    return figure


FIGURES: dict[str, Callable[[], Figure]] = {
    "law-free-scale.svg": free_scale,
    "law-fixed-scale.svg": fixed_scale,
    "law-half-space.svg": half_space,
    "law-around.svg": around,
    "robustness.svg": pictures,
}
"""File in docs/img: what draws it."""


def draw(folder: Path) -> list[Path]:
    """Draws every figure.

    Args:
        folder: where to.

    Returns:
        The files.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    with mpl.rc_context({**STYLE, "svg.hashsalt": "gs", "svg.fonttype": "none", "path.simplify_threshold": 0.3}):
        for name, figure in FIGURES.items():
            content = io.StringIO()
            figure().savefig(content, format="svg", metadata={"Date": None})
            files.append(folder / name)
            text = "\n".join(line.rstrip() for line in content.getvalue().splitlines()) + "\n"
            files[-1].write_text(text, encoding="utf-8")
    return files
