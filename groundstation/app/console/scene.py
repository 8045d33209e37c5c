"""The team in three dimensions: vehicles with attitude and trail, safety regions, graph, ghost, pads and fence."""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

import numpy as np
from nicegui import ui
from nicegui.elements.scene.objects.line import Line

from groundstation.app.console.charts import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILION
from groundstation.app.console.feed import distances_m, ghost_enu_m, wished_m
from groundstation.app.console.snapshot import AVOIDS, FOREIGN, HELD, LOST, Snapshot
from groundstation.core import frames
from groundstation.core.types import FloatArray

_TRAIL = 150
_MANY = 24
"""More vehicles than that are drawn with fewer corners and shorter trails; their pads and the formation's points are
dots of one cloud each: a renderer without a graphics card pays for every object."""
_FRAMES_PER_S = 30  # at most: the browser waits for so long after each picture, and then for its screen
_TRAIL_COLOUR, _PAD_COLOUR, _GHOST_COLOUR = [0.0, 0.45, 0.7], [0.53, 0.53, 0.53], [0.0, 0.62, 0.45]
_JUMP_S = 2.0
_NOWHERE = [0.0, 0.0, -1000.0]  # below the ground, for clouds that have no points
_SIZE_M = 0.4  # of what is drawn where r is not known
_EDGE_GOOD_M, _EDGE_BAD_M = 0.1, 0.5
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


def along(begin_m: FloatArray, end_m: FloatArray) -> list[list[float]]:
    """Rotation that takes the x axis into a direction, as rows."""
    x = (end_m - begin_m) / max(float(np.linalg.norm(end_m - begin_m)), 1e-9)
    other = np.array([0.0, 0.0, 1.0]) if abs(x[2]) < 0.9 else np.array([0.0, 1.0, 0.0])
    y = np.cross(other, x)
    y /= np.linalg.norm(y)
    rows: list[list[float]] = np.stack([x, y, np.cross(x, y)], axis=1).tolist()
    return rows


class TeamScene:
    """One page's picture of the team; drawn when the first snapshot comes."""

    def __init__(self, snapshot: Snapshot, *, dark: bool) -> None:
        n, self._t_s = len(snapshot.ids), snapshot.t_s
        self._has_radius, self._follows = bool(np.isfinite(snapshot.words.radius_m)), False
        r_m = snapshot.words.radius_m if self._has_radius else _SIZE_M
        low, high = snapshot.fence_enu_m
        # Far enough away for the whole team, and for half of the fence; over a wide team from higher up.
        pads_m = snapshot.pads_enu_m[np.all(np.isfinite(snapshot.pads_enu_m), axis=1)]
        wide_m = float(np.ptp(pads_m[:, :2], axis=0).max()) if len(pads_m) else 0.0
        self._middle, self._away_m = low + [0.5, 0.5, 0.4] * (high - low), max(0.5 * float(np.max(high - low)), wide_m)
        self._up_m = max(0.25 * self._away_m, 0.45 * wide_m)
        self._trails: list[deque[list[float]]] = [deque(maxlen=_TRAIL if n <= _MANY else _TRAIL // 4) for _ in range(n)]
        self.view = ui.scene(grid=(20, 20), background_color=ground_colour(dark=dark), fps=_FRAMES_PER_S).classes(
            "w-full"
        )
        self.view.style("height: min(60vh, 32rem)")
        body_m = 0.35 * r_m
        with self.view as scene:
            if n > _MANY and len(pads_m):
                scene.point_cloud(pads_m.tolist(), [_PAD_COLOUR] * len(pads_m), 0.8 * r_m)
            for pad_m in pads_m if n <= _MANY else ():
                scene.cylinder(0.4 * r_m, 0.4 * r_m, 0.01, 32).move(*pad_m.tolist()).rotate(1.5708, 0, 0).material(GREY)
            for one, other in itertools.combinations(itertools.product((0, 1), repeat=3), 2):
                if sum(a != b for a, b in zip(one, other, strict=True)) == 1:
                    ends = [[float((low, high)[c][axis]) for axis, c in enumerate(end)] for end in (one, other)]
                    scene.line(*ends).material(SKY)
            # Their inner sides alone: outer ones may be drawn before what is in them, which is then not seen.
            round_, tall = (32, 16) if n <= _MANY else (12, 8)  # corners are what a software renderer pays for
            self._vehicles, self._bodies, self._regions = [], [], []
            for sysid in snapshot.ids.tolist():
                with scene.group() as vehicle:  # moved as one
                    self._bodies.append(scene.box(2 * body_m, body_m, 0.4 * body_m).material(BLUE))
                    self._regions.append(scene.sphere(r_m / 2, round_, tall).material(BLUE, 0.15, "back"))
                    self._regions[-1].visible(self._has_radius)
                    scene.text(str(sysid)).move(0.0, 0.0, r_m)
                self._vehicles.append(vehicle)
            self._ghosts = [
                scene.sphere(0.3 * body_m, 8, 6).material(GREEN, 0.6).visible(False)
                for _ in (snapshot.ids if n <= _MANY else ())
            ]
            self._ghost_cloud = scene.point_cloud([_NOWHERE], [_GHOST_COLOUR], 0.6 * body_m)
            self._trail_cloud = scene.point_cloud([_NOWHERE], [_TRAIL_COLOUR], 0.03)
        self._edges: list[Line] = []
        self._colours: dict[int, str] = {}
        self._r_m, self._grown = r_m, [1.0] * n
        self._there: list[bool | None] = [None] * n
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
        known = np.all(np.isfinite(snapshot.pos_team_enu_m), axis=1)
        if not self._t_s <= snapshot.t_s <= self._t_s + _JUMP_S:  # a replay that jumps leaves no trail
            for trail in self._trails:
                trail.clear()
        self._t_s = snapshot.t_s
        for row in range(len(snapshot.ids)):
            there = bool(known[row])
            if there != self._there[row]:
                self._there[row] = there
                self._vehicles[row].visible(there)
        quats = np.where(np.isfinite(snapshot.quat_ned_from_frd), snapshot.quat_ned_from_frd, [1.0, 0.0, 0.0, 0.0])
        rotations = _ENU_FROM_NED @ frames.rot_ned_from_flu(quats)
        for row in np.flatnonzero(known).tolist():
            at = snapshot.pos_team_enu_m[row].tolist()
            self._vehicles[row].move(*at)
            self._bodies[row].rotate_R(rotations[row].tolist())
            bits = int(snapshot.state[row])
            colour = vehicle_colour(bits)
            if self._colours.get(row) != colour:
                self._colours[row] = colour
                self._bodies[row].material(BLUE if colour == PURPLE else colour)
                self._regions[row].material(colour, 0.15 if colour == BLUE else 0.3, "back")
            grown = 1.0 + 2.0 * float(snapshot.extra_radius_m[row]) / self._r_m
            if grown != self._grown[row]:
                self._grown[row] = grown
                self._regions[row].scale(grown)
            self._trails[row].append(at)
        if slowly:
            self._graph(snapshot)
            if self._follows:
                self._follow(snapshot)
            walked = [point for trail in self._trails for point in trail] or [_NOWHERE]
            self._trail_cloud.set_points(walked, [_TRAIL_COLOUR] * len(walked))
            ghost_m = ghost_enu_m(snapshot)
            if not self._ghosts:
                points = [_NOWHERE] if ghost_m is None else ghost_m.tolist()
                self._ghost_cloud.set_points(points, [_GHOST_COLOUR] * len(points))
            for row, ghost in enumerate(self._ghosts):
                ghost.visible(ghost_m is not None)
                if ghost_m is not None:
                    ghost.move(*ghost_m[row].tolist())

    def _graph(self, snapshot: Snapshot) -> None:
        between_m, error_m = distances_m(snapshot), np.abs(distances_m(snapshot) - wished_m(snapshot))
        with self.view as scene:
            while len(self._edges) < len(snapshot.edges):
                self._edges.append(scene.line([0.0, 0.0, 0.0], [1.0, 0.0, 0.0]).material(GREEN))
        for row, line in enumerate(self._edges):
            i, j = snapshot.edges[row].tolist() if row < len(snapshot.edges) else (0, 0)
            gone = bool((int(snapshot.state[i]) | int(snapshot.state[j])) & LOST)
            shown = i != j and not gone and bool(np.isfinite(between_m[i, j]))
            line.visible(shown)
            if shown:
                begin_m, end_m = snapshot.pos_team_enu_m[i], snapshot.pos_team_enu_m[j]
                line.move(*begin_m.tolist()).rotate_R(along(begin_m, end_m)).scale(float(between_m[i, j]))
                line.material(edge_colour(float(error_m[i, j])))
