"""The team in three dimensions: vehicles with attitude and trail, safety regions, graph, ghost, pads and fence."""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

import numpy as np
from nicegui import ui

from groundstation.app.console.charts import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILION
from groundstation.app.console.common import Bodies, Segments
from groundstation.app.console.feed import distances_m, ghost_enu_m, wished_m
from groundstation.app.console.snapshot import AVOIDS, FOREIGN, HELD, LOST, Snapshot
from groundstation.core import frames
from groundstation.core.types import FloatArray

_TRAIL = 150
_MANY = 24
"""More vehicles than that are drawn with fewer corners and shorter trails."""
_FRAMES_PER_S = 30  # at most: the browser waits for so long after each picture, and then for its screen
_TRAIL_COLOUR = [0.0, 0.45, 0.7]
_JUMP_S = 2.0
_NOWHERE = [0.0, 0.0, -1000.0]  # below the ground, for a cloud that has no points
_SIZE_M = 0.4  # of what is drawn where r is not known
_LINES = 20  # of the grid on the ground, each way, at most or so
_EDGE_GOOD_M, _EDGE_BAD_M = 0.1, 0.5
_UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # three.js' cylinders lie along y
_ENU_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def edge_colour(error_m: float) -> str:
    """Green where a distance is as it should be, orange, vermilion where it is far off."""
    return GREEN if error_m < _EDGE_GOOD_M else ORANGE if error_m < _EDGE_BAD_M else VERMILION


def vehicle_colour(bits: int) -> str:
    """Vermilion where the position is lost, orange where it is held or does not follow, purple where it makes way."""
    return VERMILION if bits & LOST else ORANGE if bits & (HELD | FOREIGN) else PURPLE if bits & AVOIDS else BLUE


def ground_colour(*, dark: bool) -> str:
    """What a scene stands on."""
    return "#20242a" if dark else "#f4f4f4"


def line_colour(*, dark: bool) -> str:
    """Of the grid on the ground."""
    return "#3a4048" if dark else "#cccccc"


def ground_lines_m(low_m: FloatArray, high_m: FloatArray) -> FloatArray:
    """A grid on the ground beneath a box and around it, a metre, ten or a hundred wide, shape (k, 2, 3).

    Cell by cell: the software renderer leaves out a whole line that begins behind the camera.
    """
    size_m = float(np.max((high_m - low_m)[:2]))
    step_m = float(10.0 ** np.ceil(np.log10(max(size_m, 1.0) / _LINES)))
    begin, end = np.floor(low_m[:2] / step_m) - 1, np.ceil(high_m[:2] / step_m) + 1
    xs, ys = np.arange(begin[0], end[0] + 1), np.arange(begin[1], end[1] + 1)
    north = [[[x, y, 0.0], [x, y + 1, 0.0]] for x in xs for y in ys[:-1]]
    east = [[[x, y, 0.0], [x + 1, y, 0.0]] for x in xs[:-1] for y in ys]
    return np.array(north + east) * step_m


class TeamScene:
    """One page's picture of the team; drawn when the first snapshot comes."""

    def __init__(self, snapshot: Snapshot, *, dark: bool) -> None:
        n, self._t_s = len(snapshot.ids), snapshot.t_s
        self._has_radius, self._follows = bool(np.isfinite(snapshot.words.radius_m)), False
        r_m = snapshot.words.radius_m if self._has_radius else _SIZE_M
        low, high = snapshot.fence_enu_m
        # Far enough away for the whole team, and for half of the fence; over a wide team from higher up.
        pads_m = snapshot.pads_enu_m
        known = np.all(np.isfinite(pads_m), axis=1)
        wide_m = float(np.ptp(pads_m[known, :2], axis=0).max()) if known.any() else 0.0
        self._middle, self._away_m = low + [0.5, 0.5, 0.4] * (high - low), max(0.5 * float(np.max(high - low)), wide_m)
        self._up_m = max(0.25 * self._away_m, 0.45 * wide_m)
        self._trails: list[deque[list[float]]] = [deque(maxlen=_TRAIL if n <= _MANY else _TRAIL // 4) for _ in range(n)]
        self.view = ui.scene(grid=False, background_color=ground_colour(dark=dark), fps=_FRAMES_PER_S).classes("w-full")
        self.view.style("height: min(60vh, 32rem)")
        body_m = 0.35 * r_m
        round_, tall = (32, 16) if n <= _MANY else (8, 4)  # corners are what a software renderer pays for
        with self.view as scene:
            Bodies("cylinder", [0.4 * r_m, 0.4 * r_m, 0.01, 32 if n <= _MANY else 12], n).place(
                pads_m, _UPRIGHT, np.ones(n), [GREY] * n
            )
            box = [
                low + np.array(ends) * (high - low)
                for ends in itertools.combinations(itertools.product((0, 1), repeat=3), 2)
                if np.sum(np.not_equal(*ends)) == 1
            ]
            Segments().draw(np.array(box), [SKY] * len(box))
            lines = ground_lines_m(low, high)
            Segments().draw(lines, [line_colour(dark=dark)] * len(lines))
            self._bodies = Bodies("box", [2 * body_m, body_m, 0.4 * body_m], n)
            self._regions = Bodies("sphere", [r_m / 2, round_, tall], n, 0.15)
            self._told = Bodies("sphere", [r_m / 2, round_, tall], n, 0.3)
            self._ghosts = Bodies("sphere", [0.3 * body_m, 6, 3], n, 0.6)
            self._edges = Segments()
            self._labels = [scene.text(str(sysid)).visible(False) for sysid in snapshot.ids.tolist()]
            self._trail_cloud = scene.point_cloud([_NOWHERE], [_TRAIL_COLOUR], 0.03)
        self._r_m = r_m
        self.look("side")

    def look(self, where: str) -> None:
        """Moves the camera: top, side, or follow, which stays near the team."""
        self._follows = where == "follow"
        if not self._follows:
            self._aim(self._middle, self._away_m, self._up_m, top=where == "top")

    def _follow(self, snapshot: Snapshot) -> None:
        known = np.isfinite(snapshot.pos_team_enu_m).all(axis=1)
        if known.any():
            pos_m = snapshot.pos_team_enu_m[known]
            away_m = 1.5 * max(1.0, float(np.ptp(pos_m, axis=0).max()))
            self._aim(pos_m.mean(axis=0), away_m, 0.4 * away_m, top=False)

    def _aim(self, at_m: FloatArray, away: float, up: float, *, top: bool) -> None:
        x, y, z = at_m.tolist()
        self.view.move_camera(
            x, y - (0.01 if top else away), z + (away if top else up), look_at_x=x, look_at_y=y, look_at_z=z
        )

    def show(self, snapshot: Snapshot, *, slowly: bool) -> None:
        """Moves everything; ``slowly``: trails, graph and ghost too, which take longer.

        All of it is one message: a browser that gets thousands of them in a second falls behind.
        """
        with self._at_once():
            self._show(snapshot, slowly=slowly)

    def _at_once(self) -> AbstractContextManager[object]:
        """Collects what is said to the scene; of NiceGUI's own, and done without where a version has it not."""
        batch: Callable[[], AbstractContextManager[object]] = getattr(self.view, "_batch_calls", nullcontext)
        return batch()

    def _show(self, snapshot: Snapshot, *, slowly: bool) -> None:
        if not self._t_s <= snapshot.t_s <= self._t_s + _JUMP_S:  # a replay that jumps leaves no trail
            for trail in self._trails:
                trail.clear()
        self._t_s = snapshot.t_s
        pos_m = snapshot.pos_team_enu_m
        quats = np.where(np.isfinite(snapshot.quat_ned_from_frd), snapshot.quat_ned_from_frd, [1.0, 0.0, 0.0, 0.0])
        colours = [vehicle_colour(bits) for bits in snapshot.state.tolist()]
        turns = _ENU_FROM_NED @ frames.rot_ned_from_flu(quats)
        self._bodies.place(
            pos_m, turns, np.ones(len(pos_m)), [BLUE if colour == PURPLE else colour for colour in colours]
        )
        grown = self._has_radius * (1.0 + 2.0 * snapshot.extra_radius_m / self._r_m)
        calm = np.array([colour == BLUE for colour in colours])
        for regions, which in ((self._regions, calm), (self._told, ~calm)):
            regions.place(pos_m, np.eye(3), grown * which, colours)
        there: list[bool] = np.all(np.isfinite(pos_m), axis=1).tolist()
        for row, label in enumerate(self._labels):
            label.visible(there[row])
            if there[row]:
                at = pos_m[row].tolist()
                label.move(at[0], at[1], at[2] + self._r_m)
                self._trails[row].append(at)
        if slowly:
            self._graph(snapshot)
            if self._follows:
                self._follow(snapshot)
            walked = [point for trail in self._trails for point in trail] or [_NOWHERE]
            self._trail_cloud.set_points(walked, [_TRAIL_COLOUR] * len(walked))
            ghost_m = ghost_enu_m(snapshot)
            at_m = np.full_like(pos_m, np.nan) if ghost_m is None else ghost_m
            self._ghosts.place(at_m, np.eye(3), np.ones(len(at_m)), [GREEN] * len(at_m))

    def _graph(self, snapshot: Snapshot) -> None:
        """Lines of all pairs whose places are known; who is lost for good has none."""
        error_m = np.abs(distances_m(snapshot) - wished_m(snapshot))
        gone = (snapshot.state & LOST) != 0
        i, j = snapshot.edges.reshape(-1, 2).T
        shown = snapshot.edges[(i != j) & ~gone[i] & ~gone[j] & np.isfinite(distances_m(snapshot)[i, j])]
        self._edges.draw(
            snapshot.pos_team_enu_m[shown], [edge_colour(float(error_m[one, other])) for one, other in shown.tolist()]
        )
