"""The team on a map, for missions by GPS: on tiles from a folder, or on a plain grid; nothing comes from elsewhere."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pymap3d
from fastapi import Response
from fastapi.responses import FileResponse
from nicegui import app, ui
from nicegui.elements.leaflet.leaflet_layers import GenericLayer

from groundstation.app.console.charts import GREY, SKY
from groundstation.app.console.naming import named
from groundstation.app.console.scene import ground_colour, vehicle_colour
from groundstation.app.console.snapshot import Snapshot
from groundstation.core.errors import UserError
from groundstation.core.types import FloatArray

_KINDS = ".png", ".jpg", ".jpeg", ".webp"
_NOTHING = bytes.fromhex(
    "89504e470d0a1a0a0000000d49484452000000010000000108060000001f15c4890000000d49444154789c6360000002000001e221bc33"
    "0000000049454e44ae426082"
)
"""A picture of one dot that is not seen, for tiles that are not there."""
_ZOOM_MAX = 24
_LINES = 10  # of the grid, each way from the middle


class Tiles:
    """A folder of tiles, ``ZOOM/X/Y.png``, as programs for offline maps write them.

    Args:
        folder: the folder.

    Attributes:
        zoom_max: the finest that is there.

    Raises:
        UserError: there are no tiles in it.
    """

    def __init__(self, folder: Path) -> None:
        zooms = [int(path.name) for path in folder.glob("*") if path.name.isdecimal() and path.is_dir()]
        first = next((path for path in folder.glob("*/*/*") if path.suffix.lower() in _KINDS), None)
        if not zooms or first is None:
            raise UserError(
                f"--tiles {folder}: no tiles in it, expected {folder}/ZOOM/X/Y.png ({', '.join(_KINDS)}); leave it out"
                " for a plain grid"
            )
        self.zoom_max = max(zooms)
        self._folder, self._kind = folder, first.suffix

    def tile(self, zoom: int, x: int, y: int) -> Response:
        """One of them, or nothing to be seen where it is not there: no page is told of an error for that."""
        path = self._folder / str(zoom) / str(x) / f"{y}{self._kind}"
        return FileResponse(path) if path.is_file() else Response(_NOTHING, media_type="image/png")

    def serve(self) -> str:
        """Gives them to pages; returns the template of their addresses."""
        app.get("/tiles/{zoom}/{x}/{y}")(self.tile)
        return "/tiles/{z}/{x}/{y}"


class TeamMap:
    """One page's map; made when the first snapshot with a place on earth comes.

    Args:
        snapshot: the first one.
        tiles: where tiles are, and the finest zoom; None for a plain grid.
        dark: the page is.
    """

    def __init__(self, snapshot: Snapshot, tiles: tuple[str, int] | None, *, dark: bool) -> None:
        self._anchor = snapshot.anchor_deg_m
        low, high = snapshot.fence_enu_m
        centre = self._places((low + high)[None] / 2)[0]
        self.view = ui.leaflet(
            center=(centre[0], centre[1]),
            zoom=_zoom_for(float(np.max((high - low)[:2]))),
            options={"maxZoom": _ZOOM_MAX, "attributionControl": False},
        )
        self.view.classes("w-full h-80").props(named("map"))
        self.view.clear_layers()  # the one that it begins with is of the internet
        if tiles is not None:
            self.view.tile_layer(url_template=tiles[0], options={"maxNativeZoom": tiles[1], "maxZoom": _ZOOM_MAX})
        else:
            self._grid((low + high) / 2, float(np.max((high - low)[:2])))
        corners = np.array([[x, y, 0.0] for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))])
        box = low + corners * (high - low)
        self.view.generic_layer(name="polygon", args=[self._places(box), {"color": SKY, "weight": 2, "fill": False}])
        r_m = snapshot.words.radius_m if np.isfinite(snapshot.words.radius_m) else 0.5
        for pad in self._places(snapshot.pads_enu_m):
            if np.isfinite(pad).all():
                self.view.generic_layer(name="circle", args=[pad, {"radius": 0.3 * r_m, "color": GREY, "weight": 1}])
        self._r_m = r_m
        self._ids = snapshot.ids.tolist()
        self._marks: list[GenericLayer | None] = [None] * len(self._ids)
        self._shown: list[tuple[str, float]] = [("", 0.0)] * len(self._ids)
        self._labelled: set[int] = set()
        self.view.on("init", self._label)
        self.themed(dark=dark)

    def themed(self, *, dark: bool) -> None:
        """What is seen where there are no tiles."""
        self.view.style(f"background-color: {ground_colour(dark=dark)}")

    def _label(self) -> None:
        """Ids, which a browser takes only for what it has drawn: some are drawn before it is there, others later."""
        for row, mark in enumerate(self._marks):
            if mark is not None and row not in self._labelled:
                self._labelled.add(row)
                mark.run_method("bindTooltip", str(self._ids[row]), {"permanent": True, "direction": "top"})

    def _places(self, pos_enu_m: FloatArray) -> list[list[float]]:
        """Latitudes and longitudes of places in the team's frame, shape (k, 3)."""
        lat, lon, _ = pymap3d.enu2geodetic(*pos_enu_m.T, *self._anchor)
        places: list[list[float]] = np.column_stack([lat, lon]).tolist()
        return places

    def _grid(self, middle: FloatArray, size_m: float) -> None:
        """Lines a metre, ten or a hundred apart."""
        step_m = float(10.0 ** np.ceil(np.log10(max(size_m, 1.0) / 12.0)))
        begin = np.floor(middle / step_m) * step_m
        reach_m = _LINES * step_m
        for number in range(-_LINES, _LINES + 1):
            for along in (0, 1):
                ends = np.tile(begin, (2, 1))
                ends[:, 2] = 0.0
                ends[:, 1 - along] += number * step_m
                ends[:, along] += (-reach_m, reach_m)
                style = {"color": GREY, "weight": 1, "opacity": 0.4, "interactive": False}
                self.view.generic_layer(name="polyline", args=[self._places(ends), style])

    def show(self, snapshot: Snapshot) -> None:
        """Moves the vehicles; a circle is a vehicle's safety region, and what is added where it is lost."""
        places = self._places(snapshot.pos_team_enu_m)
        for row, place in enumerate(places):
            if not np.isfinite(place).all():
                continue
            colour = vehicle_colour(int(snapshot.state[row]))
            radius_m = self._r_m / 2 + float(snapshot.extra_radius_m[row])
            mark = self._marks[row]
            if mark is None:
                mark = self._marks[row] = self.view.generic_layer(
                    name="circle", args=[place, {"radius": radius_m, "color": colour, "weight": 2}]
                )
                self._shown[row] = colour, radius_m
                continue
            mark.args[0] = place  # a page that comes back is told where it is now
            mark.run_method("setLatLng", place)
            if self._shown[row] != (colour, radius_m):
                self._shown[row] = colour, radius_m
                mark.args[1] = {"radius": radius_m, "color": colour, "weight": 2}
                mark.run_method("setStyle", {"color": colour})
                mark.run_method("setRadius", radius_m)
        if self.view.is_initialized:
            self._label()


def _zoom_for(size_m: float) -> int:
    """At which a box of that size is about 400 dots wide; 156 km a dot at zoom 0."""
    return int(np.clip(np.floor(np.log2(156_543.0 * 400.0 / max(size_m, 1.0))), 2, _ZOOM_MAX))
