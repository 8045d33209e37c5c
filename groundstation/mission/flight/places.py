"""Which place on the ground is free for a vehicle to come down on. Pure: places in, places out.

A place is taken by whoever stands there, comes down there or shall come down there. Horizontal distances only: who
lands comes straight down from wherever it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from groundstation.core.obstacles import Obstacles
from groundstation.core.types import BoolArray, FloatArray, IntArray

_RING_SHARE, _RINGS, _BEARINGS = 0.25, 40, 24
_GRID = 41
_BY_ROUNDING_M = 1e-6


@dataclass(frozen=True)
class Taken:
    """Places that are taken.

    Attributes:
        who: rows of those who take them, shape (k,).
        at_m: north and east, shape (k, 2).
        clear_m: distance that another one has to keep from each, shape (k,).
    """

    who: IntArray
    at_m: FloatArray
    clear_m: FloatArray

    def room_m(self, places_m: FloatArray) -> FloatArray:
        """How much farther than necessary each place is from all of them; infinite where there are none.

        Args:
            places_m: shape (m, 2).
        """
        if not len(self.who):
            return np.full(len(places_m), np.inf)
        return np.asarray(self._room_of_each_m(places_m).min(axis=1))

    def in_the_way(self, place_m: FloatArray) -> int | None:
        """Row of whoever is most in the way of a place, shape (2,); None where it is free."""
        if not len(self.who):
            return None
        room_m = self._room_of_each_m(place_m[None])[0]
        worst = int(np.argmin(room_m))
        return int(self.who[worst]) if room_m[worst] < -_BY_ROUNDING_M else None

    def wider(self, by_m: float) -> Taken:
        """The same with more distance to be kept."""
        return Taken(self.who, self.at_m, self.clear_m + by_m)

    def beside(self, other: Taken) -> Taken:
        """Both together."""
        return Taken(
            np.concatenate([self.who, other.who]),
            np.concatenate([self.at_m, other.at_m]),
            np.concatenate([self.clear_m, other.clear_m]),
        )

    def _room_of_each_m(self, places_m: FloatArray) -> FloatArray:
        return np.asarray(np.linalg.norm(places_m[:, None] - self.at_m[None], axis=2) - self.clear_m)


def taken_at(who: Sequence[int] | IntArray, at_m: FloatArray, clear_m: float | FloatArray) -> Taken:
    """Places of those in ``who`` out of everybody's, shape (n, 2) or (n, 3); those that are not known take none."""
    rows = np.asarray(who, dtype=np.int64).reshape(-1)
    rows = rows[np.isfinite(at_m[rows, :2]).all(axis=1)]
    return Taken(rows, at_m[rows, :2].copy(), np.broadcast_to(clear_m, len(at_m))[rows].astype(np.float64))


@dataclass(frozen=True)
class Box:
    """The inside of the fence, north and east: corners, shape (2,), and what stands in it."""

    low_m: FloatArray
    high_m: FloatArray
    obstacles: Obstacles | None = None
    """What stands there, ENU; places above it are none to come down on."""
    spare_m: float = 0.0
    """What is kept beside: whoever flies to such a place may miss it by so much."""

    def free(self, places_m: FloatArray, spare_m: float = 0.0) -> BoolArray:
        """Whether no obstacle is at or under places, north and east, shape (m, 2)."""
        if self.obstacles is None:
            return np.ones(len(places_m), dtype=np.bool_)
        return np.asarray(self.obstacles.beside_m(places_m[:, ::-1]) >= self.obstacles.keep_m + spare_m, dtype=np.bool_)

    def near(self, start_m: FloatArray, step_m: float) -> FloatArray:
        """Places inside to be tried, the nearest to ``start_m`` first: rings around it, a grid, the corners."""
        radii_m = step_m * np.arange(1, _RINGS + 1)
        bearings = np.linspace(0.0, 2.0 * np.pi, _BEARINGS, endpoint=False)
        rings = start_m + (radii_m[:, None, None] * np.stack([np.cos(bearings), np.sin(bearings)], axis=1)).reshape(
            -1, 2
        )
        axes = (np.linspace(self.low_m[k], self.high_m[k], _GRID) for k in (0, 1))
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        places = np.concatenate([start_m[None], rings, grid])
        places = places[
            ((places >= self.low_m) & (places <= self.high_m)).all(axis=1) & self.free(places, self.spare_m)
        ]
        order = np.argsort(np.linalg.norm(places - start_m, axis=1), kind="stable")
        return np.asarray(places[order])


def nearest_free(start_m: FloatArray, taken: Taken, box: Box) -> FloatArray | None:
    """The free place inside the fence that is nearest to ``start_m``, shape (2,); None where there is none."""
    step_m = _RING_SHARE * float(taken.clear_m.max(initial=0.0)) or 1.0
    places = box.near(start_m, step_m)
    free = np.flatnonzero(taken.room_m(places) >= -_BY_ROUNDING_M)
    return np.asarray(places[free[0]]) if len(free) else None


def farthest(start_m: FloatArray, taken: Taken, box: Box) -> tuple[FloatArray, float]:
    """The place inside the fence that is farthest from all that is taken, and how much farther than necessary.

    That is negative where no place is free.
    """
    places = box.near(start_m, _RING_SHARE * float(taken.clear_m.max(initial=0.0)) or 1.0)
    room_m = taken.room_m(places)
    if not len(places):
        return start_m, -np.inf
    best = int(np.argmax(room_m))
    return np.asarray(places[best]), float(room_m[best])


def allot(
    start_ned_m: FloatArray,
    pads_ned_m: FloatArray,
    movable: BoolArray,
    taken: Taken,
    *,
    need_m: float,
    wish_m: float,
    box: Box,
) -> tuple[FloatArray, BoolArray]:
    """Where everybody can come straight down at once: nobody above or below anybody.

    The lowest keep their places, those above move sideways, by as little as is free. Who finds no place takes its pad.
    Where somebody's pad is not free either, all take their pads.

    Args:
        start_ned_m: where the vehicles are, shape (n, 3).
        pads_ned_m: shape (n, 3).
        movable: those that are to land and can be told to move, shape (n,).
        taken: places of the others.
        need_m: distance that has to be kept from somebody else's place by who stays where it is.
        wish_m: the same by who moves, larger by what it may miss its place.
        box: the inside of the fence.

    Returns:
        Places of the movable ones, shape (n, 2), NaN for the others; and who of them found none but its pad,
        shape (n,).
    """
    n = len(start_ned_m)
    places: FloatArray = np.full((n, 2), np.nan)
    homeless: BoolArray = np.zeros(n, dtype=np.bool_)
    for vehicle in sorted(np.flatnonzero(movable).tolist(), key=lambda i: -float(start_ned_m[i, 2])):
        given = np.flatnonzero(np.isfinite(places[:, 0]))
        here = start_ned_m[vehicle, :2]
        if taken.beside(taken_at(given, places, need_m)).in_the_way(here) is None and box.free(here[None])[0]:
            places[vehicle] = here
            continue
        place = nearest_free(here, taken.wider(wish_m - need_m).beside(taken_at(given, places, wish_m)), box)
        if place is None:
            homeless[vehicle] = True
        else:
            places[vehicle] = place
    for vehicle in np.flatnonzero(homeless).tolist():
        given = np.flatnonzero(np.isfinite(places[:, 0]))
        if taken.beside(taken_at(given, places, need_m)).in_the_way(pads_ned_m[vehicle, :2]) is not None:
            places[movable] = pads_ned_m[movable, :2]
            return places, movable.copy()
        places[vehicle] = pads_ned_m[vehicle, :2]
    return places, homeless
