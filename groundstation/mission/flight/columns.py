"""Who stands, flies or may come down in the column in which another one would land. Judges, decides nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from groundstation.core import frames
from groundstation.core.quick import norms
from groundstation.core.types import BoolArray, FloatArray
from groundstation.mission.flight.places import Taken, taken_at
from groundstation.mission.plan.pads import pads_above

_OVER = 0.5  # over its own pad is who is within this share of r, horizontally


@dataclass(frozen=True)
class Distances:
    """Horizontal distances that landing keeps, metres.

    Attributes:
        radius_m: r.
        beside_m: from which on two vehicles are clear of each other at any heights: r and what positions may be off.
        margin_m: what two positions may be off.
        wish_m: that is looked for where there is a choice: larger by what a vehicle may miss its place.
        lost_m: how far one that nobody sees may have gone.
        tolerance_m: how far from its place a vehicle has arrived.
        height_m: at which one is clear of those who stand.
    """

    radius_m: float
    beside_m: float
    margin_m: float
    wish_m: float
    lost_m: float
    tolerance_m: float
    height_m: float


@dataclass(frozen=True)
class Scene:
    """The team at one instant, shape (n,) where nothing else is said.

    Attributes:
        pos_ned_m: where everybody is, or was last seen, shape (n, 3).
        home_ned_m: where everybody gathers before it lands, above its pad mostly, shape (n, 3).
        down: stands, or is disarmed.
        sinks: in the air, told to land or landing by itself.
        lost: in the air perhaps, and nobody knows where.
        unheard: lost since nothing is heard of it, which may end.
        loose: in the air and not steered by us: it may come down where it is.
        led: can be told to go elsewhere.
        wanted: shall land as soon as it may.
        coming: is on its way home.
        hurries: its battery does not let it wait.
    """

    pos_ned_m: FloatArray
    home_ned_m: FloatArray
    down: BoolArray
    sinks: BoolArray
    lost: BoolArray
    unheard: BoolArray
    loose: BoolArray
    led: BoolArray
    wanted: BoolArray
    coming: BoolArray
    hurries: BoolArray


class Columns:
    """Columns over the places of one team.

    Args:
        pads_enu_m: shape (n, 3).
        distances: what is kept.

    Attributes:
        distances: as given.
        pads_ned_m: shape (n, 3).
        content: vehicles that have waited so long that they ask for r and nothing more, shape (n,).
    """

    def __init__(self, pads_enu_m: FloatArray, distances: Distances) -> None:
        self.distances = distances
        self.pads_ned_m = frames.ned_from_enu(pads_enu_m)
        self.content: BoolArray = np.zeros(len(pads_enu_m), dtype=np.bool_)
        self._pads_above = pads_above(pads_enu_m, distances.beside_m)
        self._pads_apart_m = norms(self.pads_ned_m[:, None, :2] - self.pads_ned_m[None, :, :2])

    def content_with_r(self, vehicle: int) -> None:
        """It has waited so long that it asks for r and nothing more."""
        self.content[vehicle] = True

    def taken(self, vehicle: int, scene: Scene, place_m: FloatArray | None, *, but_higher_ones: bool = False) -> Taken:
        """Places of those who stand, come down, or may: with the distances that a place has to have.

        Args:
            vehicle: for whom.
            scene: the team.
            place_m: the place in question, shape (2,); None while one is looked for.
            but_higher_ones: those that fly higher than the vehicle do not count.
        """
        there = scene.down | scene.sinks | scene.lost
        if scene.wanted[vehicle] or not scene.coming[vehicle]:
            there = there | scene.loose
        if but_higher_ones:
            there = there & (scene.down | ~(scene.pos_ned_m[:, 2] < scene.pos_ned_m[vehicle, 2]))
        need_m = self.need_m(vehicle, scene.pos_ned_m, place_m)
        if place_m is None:
            need_m = need_m + np.where(scene.lost & ~scene.down, self.distances.lost_m, 0.0)
        who = there.nonzero()[0]
        return taken_at(who[who != vehicle], scene.pos_ned_m, need_m)

    def need_m(self, vehicle: int, at_m: FloatArray, place_m: FloatArray | None) -> FloatArray:
        """Horizontal distance that a vehicle's place has to have from everybody at ``at_m``, shape (n,).

        Two over their own pads are as near to each other as preflight has let them be.

        Args:
            vehicle: which.
            at_m: where the others are, or are going to come down, north and east first, shape (n, 2) or (n, 3).
            place_m: the place, shape (2,); None for any but a pad.
        """
        distances = self.distances
        keep_m = distances.radius_m if self.content[vehicle] else distances.beside_m
        need_m: FloatArray = np.full(len(at_m), keep_m)
        if place_m is None or np.linalg.norm(place_m - self.pads_ned_m[vehicle, :2]) >= _OVER * distances.radius_m:
            return need_m
        pads_m = np.minimum(distances.radius_m, self._pads_apart_m[vehicle] - distances.margin_m)
        return np.where(self._over_pad(at_m), pads_m, need_m)

    def below(self, vehicle: int, scene: Scene) -> BoolArray:
        """Who flies where this vehicle would come down, shape (n,).

        Of two over their own pads, one pad above the other, the pads say more than two positions: the upper vehicle
        waits until the lower one stands, the lower one for nobody who is higher than itself.
        """
        away = scene.pos_ned_m - scene.pos_ned_m[vehicle]
        near = np.hypot(away[:, 0], away[:, 1]) < self.need_m(vehicle, scene.pos_ned_m, scene.pos_ned_m[vehicle, :2])
        below = near & ~(away[:, 2] < -self.distances.radius_m) & ~scene.sinks
        over_pad = self._over_pad(scene.pos_ned_m)
        if over_pad[vehicle]:
            below = np.where(over_pad & self._pads_above[:, vehicle], True, below)
            below = np.where(over_pad & self._pads_above[vehicle], ~(away[:, 2] < 0.0), below)
        below = below & ~scene.down & np.isfinite(away).all(axis=1)
        below[vehicle] = False
        return np.asarray(below, dtype=np.bool_)

    def _over_pad(self, at_m: FloatArray) -> BoolArray:
        off_m = norms(at_m[:, :2] - self.pads_ned_m[:, :2])
        return np.asarray(off_m < _OVER * self.distances.radius_m)
