"""What many have in common is one object of the scene: bodies of one shape, straight lines.

A renderer without a graphics card pays for every object. NiceGUI has no common ones but clouds of points; these are two
more, made as it provides for: a class here, and a few lines of three.js beside it that make the object and change it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from nicegui.elements.scene.scene_object3d import Object3D

from groundstation.core.types import FloatArray

_DIGITS = 4  # of a metre, and of a rotation: what is sent 20 times a second


class Bodies(Object3D, component="bodies.js"):
    """Bodies of one shape, each with its own place, turn, size and colour.

    Args:
        shape: of all of them.
        sizes: what three.js' geometry of that shape is made from.
        count: how many, at most.
        opacity: below 1 the inner sides alone are seen, so that what is in them is seen too.

    Attributes:
        colours: of each that is seen; nobody is at first.
        places: of the same: three rows of rotation times size, and of the place, one after the other.
    """

    def __init__(
        self,
        shape: Literal["box", "sphere", "cylinder"],
        sizes: Sequence[float],
        count: int,
        opacity: float = 1.0,
    ) -> None:
        self.places: list[list[float]] = []
        self.colours: list[str] = []
        super().__init__(shape, list(sizes), opacity, count, self.places, self.colours)

    def place(self, at_m: FloatArray, turns: FloatArray, sizes: FloatArray, colours: Sequence[str]) -> None:
        """Puts all of them somewhere.

        Args:
            at_m: middles, shape (n, 3); who has NaN is not seen.
            turns: rotations, shape (n, 3, 3), or one for all, shape (3, 3).
            sizes: times their own, shape (n,); 0 is not seen.
            colours: of each.
        """
        seen = np.flatnonzero(np.isfinite(at_m).all(axis=1) & (sizes > 0.0))
        turned = sizes[seen, None, None] * np.broadcast_to(turns, (len(at_m), 3, 3))[seen]
        rows = np.concatenate([turned, at_m[seen, :, None]], axis=2)
        self.places = rows.reshape(-1, 12).round(_DIGITS).tolist()
        shades = [colours[row] for row in seen.tolist()]
        changed = None if shades == self.colours else shades
        self.colours = shades
        self.args[-2:] = self.places, self.colours  # for a page that draws the scene anew
        self.run_method("set", self.places, changed)


class Segments(Object3D, component="segments.js"):
    """Straight lines, each with its own colour.

    Attributes:
        ends: of each: east, north, up of one end and of the other.
        colours: of each.
    """

    def __init__(self) -> None:
        self.ends: list[list[float]] = []
        self.colours: list[str] = []
        super().__init__(self.ends, self.colours)

    def draw(self, ends_m: FloatArray, colours: Sequence[str]) -> None:
        """Draws these in place of those before.

        Args:
            ends_m: shape (m, 2, 3).
            colours: of each.
        """
        self.ends = np.asarray(ends_m).reshape(-1, 6).round(_DIGITS).tolist()
        self.colours = list(colours)
        self.args[:] = self.ends, self.colours
        self.run_method("set", self.ends, self.colours)
