"""Where the vehicles' local frames begin: declared, or told on earth, or worked out from the first vehicle's place."""

from __future__ import annotations

import numpy as np
import pymap3d

from groundstation.core import frames
from groundstation.core.types import BoolArray, FloatArray
from groundstation.mavlink.vehicle import Fleet
from groundstation.mission.plan.plan import MissionPlan

_SAME_ORIGIN_M = 0.05
_LOOK_NS = 200_000_000
_FAR_ORIGIN_M = 3_000.0  # local positions are coarse and bent so far from where they count from


class Placement:
    """Where the vehicles' own frames lie in the team's.

    Args:
        plan: pads, origins, anchor.

    Attributes:
        pads_ned_m: shape (n, 3).
        on_earth: those that fly by global positions and need no local frame, shape (n,).
        gps: those whose place in the team frame comes from their place on earth, shape (n,).
        by_origin: those of them that fly in a local frame, whose origin they tell, shape (n,).
        origin_team_ned_m: of each vehicle's local frame, shape (n, 3); NaN while not known, and where it needs none.
        anchor_deg_m: place of the team frame's origin on earth: latitude, longitude, height; None while not known.
        settled: held from now on.
        hangs_on: the vehicle whose position places the frame on earth; None where the mission says where it is.
    """

    def __init__(self, plan: MissionPlan) -> None:
        spec = plan.spec
        self._plan = plan
        self.pads_ned_m = frames.ned_from_enu(plan.pads_enu_m)
        n = plan.size
        self.on_earth: BoolArray = np.array([vehicle.position == "global" for vehicle in spec.vehicles])
        self.gps: BoolArray = np.array([plan.uses_gps(i) for i in range(n)])
        self.by_origin: BoolArray = self.gps & ~self.on_earth
        self.origin_team_ned_m: FloatArray = np.full((n, 3), np.nan)
        for i, vehicle in enumerate(spec.vehicles):
            if vehicle.origin == "pad":
                self.origin_team_ned_m[i] = self.pads_ned_m[i]
            elif vehicle.origin == "team":
                self.origin_team_ned_m[i] = 0.0
            elif vehicle.origin_m is not None:
                self.origin_team_ned_m[i] = frames.ned_from_enu(np.array(vehicle.origin_m))
        self.origin_team_ned_m[self.by_origin] = np.nan
        anchor = spec.anchor
        self.anchor_deg_m: FloatArray | None = (
            None if anchor is None else np.array([anchor.lat_deg, anchor.lon_deg, anchor.alt_m])
        )
        self._anchor_is_given = anchor is not None or not self.gps.any()
        self.hangs_on = None if self._anchor_is_given else int(np.flatnonzero(self.gps)[0])
        self._derived_deg_m: FloatArray = np.full((n, 3), np.nan)
        self._next_look_ns = 0
        self.settled = False

    def look(self, fleet: Fleet, now_ns: int) -> None:
        """Follows what the vehicles say of their origins, as long as nothing is settled."""
        if self.settled or not self.gps.any() or now_ns < self._next_look_ns:
            return
        self._next_look_ns = now_ns + _LOOK_NS
        if not self._anchor_is_given:
            self._hang_on_first(fleet)
        if self.anchor_deg_m is not None:
            rows = np.flatnonzero(self.by_origin)
            self.origin_team_ned_m[rows] = self.from_anchor(self._origins_deg_m(fleet)[rows])

    def derive_origin(self, fleet: Fleet, vehicle: int) -> bool:
        """Takes a vehicle's origin from its two positions, for one that stands and does not tell it.

        Returns:
            Whether both positions are known.
        """
        place = np.array(
            pymap3d.ned2geodetic(*-fleet.pos_local_ned_m[vehicle], *fleet.place_deg_m[vehicle]), dtype=np.float64
        )
        if np.isfinite(place).all():
            self._derived_deg_m[vehicle] = place
        return bool(np.isfinite(place).all())

    def _origins_deg_m(self, fleet: Fleet) -> FloatArray:
        """Origins as told, and as derived where they are not told."""
        return np.where(np.isfinite(fleet.origin_deg_m), fleet.origin_deg_m, self._derived_deg_m)

    def far_from_origin(self, fleet: Fleet, vehicle: int) -> bool:
        """Whether a vehicle's global position is kilometres from its own origin, which somebody has set wrong then."""
        place, origin = fleet.place_deg_m[vehicle], fleet.origin_deg_m[vehicle]
        if not (np.isfinite(place).all() and np.isfinite(origin).all()):
            return False
        return not self._near(place, origin)

    @staticmethod
    def _near(place_deg_m: FloatArray, other_deg_m: FloatArray) -> bool:
        return bool(np.linalg.norm(pymap3d.geodetic2ned(*place_deg_m, *other_deg_m)) <= _FAR_ORIGIN_M)

    def settle(self) -> None:
        """What is known now holds for the flight."""
        self.settled = True

    def hold_anchor(self) -> None:
        """Keeps the anchor as it is now: vehicles are about to be given it for their origin."""
        self._anchor_is_given = True

    def has_common_origin(self, fleet: Fleet, vehicle: int) -> bool:
        """Whether a vehicle's own origin is the anchor."""
        away = self.origin_team_ned_m[vehicle]
        return bool(np.isfinite(away).all() and np.linalg.norm(away) <= _SAME_ORIGIN_M)

    def known(self, vehicle: int) -> bool:
        """Whether a vehicle's reports can be placed in the team frame."""
        if self.on_earth[vehicle]:
            return self.anchor_deg_m is not None
        return bool(np.isfinite(self.origin_team_ned_m[vehicle]).all())

    def look_in_flight(self, fleet: Fleet, now_ns: int) -> None:
        """The same as ``look`` for vehicles that are in the air: their homes stand in for where they stand."""
        if self.settled or not self.gps.any() or now_ns < self._next_look_ns:
            return
        self._next_look_ns = now_ns + _LOOK_NS
        if not self._anchor_is_given:
            # Who has told where it is, too: a home that is far from there is no home (``Fleet``).
            both = np.flatnonzero(self.gps & np.isfinite(fleet.home_deg_m + fleet.place_deg_m).all(axis=1)).tolist()
            told = [i for i in both if self._near(fleet.place_deg_m[i], fleet.home_deg_m[i])]
            if told:
                first = told[0]
                place = fleet.home_deg_m[first]
                self.anchor_deg_m = np.array(pymap3d.ned2geodetic(*-self.pads_ned_m[first], *place), dtype=np.float64)
                self._anchor_is_given = True
        if self.anchor_deg_m is not None:
            rows = np.flatnonzero(self.by_origin)
            self.origin_team_ned_m[rows] = self.from_anchor(fleet.origin_deg_m[rows])

    def from_anchor(self, places_deg_m: FloatArray) -> FloatArray:
        """Places on earth in the team frame, shape (k, 3); NaN stays NaN."""
        if self.anchor_deg_m is None:
            return np.full_like(places_deg_m, np.nan)
        north, east, down = pymap3d.geodetic2ned(*places_deg_m.T, *self.anchor_deg_m)
        return np.stack([north, east, down], axis=-1)

    def _hang_on_first(self, fleet: Fleet) -> None:
        """Places the anchor so that the first vehicle that uses GPS stands on its pad."""
        first = int(np.flatnonzero(self.gps)[0])
        place = fleet.place_deg_m[first]
        if not self.on_earth[first]:
            origin = self._origins_deg_m(fleet)[first]
            if not self.far_from_origin(fleet, first):
                place = np.array(pymap3d.ned2geodetic(*fleet.pos_local_ned_m[first], *origin))
        if np.isfinite(place).all():
            self.anchor_deg_m = np.array(pymap3d.ned2geodetic(*-self.pads_ned_m[first], *place), dtype=np.float64)
