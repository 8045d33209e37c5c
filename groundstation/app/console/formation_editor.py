"""A formation on the page: points dragged in three dimensions or typed, edges by click, a graph proposed, gains."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial

import numpy as np
from nicegui import run, ui
from nicegui.elements.scene.objects.sphere import Sphere
from nicegui.elements.scene.objects.text import Text
from nicegui.events import SceneClickEventArguments, SceneDragEventArguments

from groundstation.app.console.charts import BLUE, GREY, ORANGE
from groundstation.app.console.common import Segments
from groundstation.app.console.draft import Draft
from groundstation.app.console.naming import named
from groundstation.app.console.scene import ground_colour
from groundstation.core.errors import UserError
from groundstation.design.designer import DesignResult, design, evaluator
from groundstation.design.graphs import SHARE, Kind, suggest
from groundstation.design.problem import SPECTRAL_NORM, Progress, Watch

_DIGITS = 3  # of what was dragged, in the file's own units
_CLICK_S, _STILL = 0.5, 2.0 * 10.0**-_DIGITS
_TYPED_MAX = 64
"""Points up to which each has its fields; more are edited in the file."""


class FormationEditor:
    """The formation of one draft; built where it is made.

    Args:
        draft: what is edited.
        solid: with the scene in three dimensions.
        changed: told after each change.
    """

    def __init__(self, draft: Draft, changed: Callable[[], None], *, solid: bool) -> None:
        self._draft, self._changed, self._solid = draft, changed, solid
        self._picked: int | None = None
        self._dark: bool | None = None
        self._dropped: tuple[int, float] = (-1, 0.0)
        self._scene: _Shape | None = None
        self._progress, self._stop = "", False
        self._numbers: list[list[ui.number]] = []
        if solid:
            ui.label(
                "Drag a point to move it; click two points to join or part them; double-click the ground to add a"
                " point there. Points and edges can be typed too, below."
            ).classes("text-xs")
            self._place = ui.column().classes("w-full")
        with ui.row().classes("items-center gap-2"):
            ui.button("add point", on_click=lambda: self._add(self._beside())).props("dense")
            self._remove_button = ui.button("remove point", on_click=self._remove_picked).props("dense")
            self._size = ui.label().classes("text-sm").props(named("size"))
        with ui.row().classes("items-center gap-2"):
            self._edge = (
                ui.input("edge: 1 2").without_auto_validation().props("dense").classes("w-24").props(named("edge"))
            )
            self._edge.on("keydown.enter", self._join_typed)
            ui.button("join or part", on_click=self._join_typed).props("dense")
            self._kind = ui.select(list(SHARE), value="balanced", label="graph").props("dense options-dense")
            self._propose_button = ui.button("propose edges", on_click=self._propose).props("dense")
            self._design_button = ui.button("design gains", on_click=self._design).props("dense")
            ui.button("stop", on_click=self._end).props("dense flat")
        self._bar = ui.linear_progress(0.0, show_value=False).props("instant-feedback")
        self._gains = ui.label().classes("text-sm font-bold whitespace-pre-line").props(named("gains") + " role=status")
        self._edges = ui.label().classes("text-xs").props(named("edges"))
        with ui.expansion("points", value=not solid).classes("w-full").props(named("points")):
            self._fields = ui.column().classes("w-full")
        self._table()
        ui.timer(0.3, self._tell_progress)
        self._told = ""
        self._show()

    def _table(self) -> None:
        points, self._numbers = self._draft.points, []
        self._fields.clear()
        with self._fields:
            if len(points) > _TYPED_MAX:
                ui.label(f"{len(points)} points: drag them, or write them in the formation file").classes("text-xs")
            else:
                self._rows(points)

    def _rows(self, points: list[list[float]]) -> None:
        with ui.grid(columns="auto 1fr 1fr 1fr auto").classes("gap-x-2 gap-y-0 items-center"):
            for name in ("", "east", "north", "up", ""):
                ui.label(name).classes("text-xs")
            for row, point in enumerate(points):
                ui.label(str(row + 1))
                self._numbers.append(
                    [
                        ui.number(value=value, step=0.1, on_change=partial(self._typed, row))
                        .props("dense debounce=250")
                        .props(named(f"point-{row + 1}-{axis}"))
                        for axis, value in zip("xyz", point, strict=True)
                    ]
                )
                away = ui.button("x", on_click=partial(self._remove, row)).props("dense flat")
                away.props(f'aria-label="remove point {row + 1}"')

    def themed(self, *, dark: bool) -> None:
        """The page has become light or dark: the scene is made anew on that ground."""
        self._dark = dark
        self._anew()

    def _anew(self) -> None:
        """Another scene: it has as many points as were there when it was made."""
        if self._solid and self._draft.points and self._dark is not None:
            self._place.clear()
            with self._place:
                self._scene = _Shape(self._draft, self._dragged, self._clicked, self._add, dark=self._dark)
            self._scene.show(self._picked)

    def _beside(self) -> list[float]:
        """Free room for a point: above the middle of the others."""
        points = np.array(self._draft.points)
        size = max(float(np.ptp(points, axis=0).max()), 1.0)
        east, north, _ = points.mean(axis=0).tolist()
        return [east, north, float(points[:, 2].max()) + 0.5 * size]

    def _add(self, at: list[float]) -> None:
        self._draft.add([round(value, _DIGITS) for value in at])
        self._picked = len(self._draft.points) - 1
        self._resized()

    def _remove_picked(self) -> None:
        if self._picked is not None:
            self._remove(self._picked)

    def _remove(self, row: int) -> None:
        try:
            self._draft.remove(row)
        except UserError as error:
            self._gains.set_text(str(error))
            return
        self._picked = None
        self._resized()

    def _resized(self) -> None:
        self._table()
        self._anew()
        self._show()

    def _typed(self, row: int) -> None:
        values = [number.value for number in self._numbers[row]]
        if all(isinstance(value, int | float) and math.isfinite(value) for value in values):
            self._draft.move(row, [float(value) for value in values])
            self._show()

    def _dragged(self, row: int, at: list[float]) -> None:
        point = [round(value, _DIGITS) for value in at]
        if all(abs(one - other) < _STILL for one, other in zip(point, self._draft.points[row], strict=True)):
            return  # a click
        self._dropped = row, time.monotonic()
        self._draft.move(row, point)
        if self._numbers:
            for number, value in zip(self._numbers[row], point, strict=True):
                number.set_value(value)
        self._show()

    def _clicked(self, row: int) -> None:
        last, at_s = self._dropped
        if row == last and time.monotonic() - at_s < _CLICK_S:  # a browser ends a drag with a click
            return
        picked, self._picked = self._picked, None
        if picked is None:
            self._picked = row
        elif picked != row:
            self._draft.toggle(picked + 1, row + 1)
        self._show()

    def _join_typed(self) -> None:
        words = str(self._edge.value or "").replace(",", " ").split()
        try:
            if len(words) != 2 or not all(word.isascii() and word.isdigit() for word in words):
                raise UserError("edge: expected the numbers of two points, for example 1 2")
            self._draft.toggle(int(words[0]), int(words[1]))
            self._edge.error = None
        except UserError as error:
            self._edge.error = str(error)
            return
        self._show()

    def _show(self) -> None:
        draft, vehicles = self._draft, self._draft.vehicles
        lacks = len(draft.points) - vehicles
        more = f": {'add' if lacks > 0 else 'take out'} {abs(lacks)} in the whole file as YAML" if lacks else ""
        self._size.set_text(f"{len(draft.points)} points, {vehicles} vehicles{more}")
        self._remove_button.set_enabled(self._picked is not None)
        self._edges.set_text(f"{len(draft.edges)} edges: {', '.join(f'{i}-{j}' for i, j in draft.edges)}")
        self._gains.set_text("gains fit this shape" if draft.has_gains else "the shape has no gains yet")
        if self._scene is not None:
            self._scene.show(self._picked)
        self._changed()

    # What takes long, in a thread of its own

    def _watch(self) -> Watch:
        self._stop = False

        def report(now: Progress) -> None:
            low, high = SPECTRAL_NORM * now.slowest, SPECTRAL_NORM * now.bound
            share = max(0.0, min(1.0, low / high)) if high > 0.0 else 0.0
            self._progress = (
                f"{share:.3f} {now.block} {now.method} {now.iteration}: slowest mode {low:.4g} of {high:.4g}"
            )

        return Watch(stop=lambda: self._stop, report=report)

    def _end(self) -> None:
        self._stop = True

    def _tell_progress(self) -> None:
        if self._progress and self._progress != self._told:
            self._told = self._progress
            share, _, words = self._told.partition(" ")
            self._bar.set_value(float(share))
            self._gains.set_text(f"{words} 1/s")

    async def _design(self) -> None:
        try:
            formation = self._draft.formation()
        except UserError as error:
            self._gains.set_text(str(error))
            return
        self._busy(busy=True)
        result: DesignResult | None = await run.io_bound(design, formation, watch=self._watch())
        self._busy(busy=False)
        if result is None:  # the page was closed
            return
        now = self._draft.formation()
        if not (np.array_equal(now.points_enu_m, formation.points_enu_m) and now.edges == formation.edges):
            self._gains.set_text("the shape was changed meanwhile; design its gains again")
            return
        self._draft.keep_gains(result)
        self._show()
        if result.certificate is not None and result.feasible:
            slowest = min(result.certificate.xy.slowest, result.certificate.z.slowest)
            self._bar.set_value(1.0)
            self._gains.set_text(f"gains designed: slowest mode {slowest:.3g} 1/s, {result.method}")
        else:
            self._bar.set_value(0.0)
            self._gains.set_text(f"no gains: {result.reason}")

    async def _propose(self) -> None:
        self._busy(busy=True)
        kinds: dict[str, Kind] = {"sparse": "sparse", "balanced": "balanced", "robust": "robust"}
        try:
            formation = self._draft.formation()
            found = await run.io_bound(suggest, formation, kinds[str(self._kind.value)], evaluator())
        except UserError as error:
            self._gains.set_text(str(error))
            return
        finally:
            self._busy(busy=False)
        if found is not None:
            self._draft.propose(found.formation)
            self._show()
            self._gains.set_text(f"{len(found.formation.edges)} edges proposed; slowest mode {found.slowest:.3g} 1/s")

    def _busy(self, *, busy: bool) -> None:
        self._progress = self._told = ""
        for button in (self._design_button, self._propose_button):
            button.set_enabled(not busy)


class _Shape:
    """The scene: points that can be taken, and lines between those that see each other."""

    def __init__(
        self,
        draft: Draft,
        dragged: Callable[[int, list[float]], None],
        clicked: Callable[[int], None],
        added: Callable[[list[float]], None],
        *,
        dark: bool,
    ) -> None:
        self._draft, self._dragged, self._clicked, self._added = draft, dragged, clicked, added
        points = np.array(draft.points)
        middle, size = (points.min(axis=0) + points.max(axis=0)) / 2, max(float(np.ptp(points, axis=0).max()), 1.0)
        self._balls: list[Sphere] = []
        self._labels: list[Text] = []
        self.view = ui.scene(
            grid=(20, 20),
            background_color=ground_colour(dark=dark),
            on_drag_end=self._drop,
            on_click=self._click,
            click_events=["click", "dblclick"],
        ).classes("w-full h-80")
        with self.view as scene:
            for row in range(len(points)):
                self._balls.append(scene.sphere(0.05 * size).draggable())
                self._balls[-1].with_name(str(row))
                self._labels.append(scene.text(str(row + 1)))
            self._lines = Segments()
        x, y, z = middle.tolist()
        self.view.move_camera(x - 0.6 * size, y - 1.5 * size, z + 0.7 * size, look_at_x=x, look_at_y=y, look_at_z=z)
        self._size = size

    def _drop(self, event: SceneDragEventArguments) -> None:
        self._dragged(int(event.object_name), [event.x, event.y, event.z])

    def _click(self, event: SceneClickEventArguments) -> None:
        ball = next((hit.object_name for hit in event.hits if hit.object_name.isdigit()), None)
        if event.click_type == "dblclick":
            ground = next((hit for hit in event.hits if hit.object_id == "ground"), None)
            if ball is None and ground is not None:
                self._added([ground.x, ground.y, 0.0])
        elif ball is not None:
            self._clicked(int(ball))

    def show(self, picked: int | None) -> None:
        """Draws the shape as it is now."""
        points = self._draft.points
        for row, point in enumerate(points):
            self._balls[row].move(*point).material(ORANGE if row == picked else BLUE)
            self._labels[row].move(point[0], point[1], point[2] + 0.12 * self._size)
        ends = [[points[i - 1], points[j - 1]] for i, j in self._draft.edges]
        self._lines.draw(np.array(ends), [GREY] * len(ends))
