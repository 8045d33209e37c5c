"""Origins of the vehicles' local frames on earth: asked for, compared with the mission, and only then given.

Nobody is given an origin before every vehicle's global position was held against its pad: what is written is the
anchor, and an anchor that is wrong is written nowhere. Global positions do not hang on any origin, so that a vehicle
in which somebody has set a wrong one is judged like the others.
"""

from __future__ import annotations

import numpy as np
import pymap3d

from groundstation.core.types import BoolArray, FloatArray
from groundstation.mavlink.station import Station
from groundstation.mission.flight.team_frame import TeamFrame
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.timing import SECOND_NS, AskAgain, HeldEach

_AGAIN_NS = 2 * SECOND_NS
_TRIES = 5
_ASKS = 5  # unanswered, then the origin is taken from the two positions
_OLD_NS = 15 * SECOND_NS  # narrow links tell a global position every few seconds
_FAR_M = 3_000.0
"""No team flies so far from where its frame begins, and local positions, single floats, are coarse there."""
_HEIGHT_OFF_M = 100.0
"""So far heights of GPS and the anchor's may be apart before an origin is given: both may be above the ellipsoid."""
_FAR_NS = 2 * SECOND_NS  # so long a place has to be far away before the mission is refused


def beyond(value: float, limit: float) -> str:
    """A value above a limit, with as many digits as it takes to see that."""
    digits = next((k for k in range(6) if round(value, k) > limit), 6)
    return f"{value:,.{digits}f}"


class Origins:
    """Origins of n vehicles.

    Args:
        plan: pads, anchor, who uses GPS.
        station: what is asked and given goes out by it.
        frame: knows the anchor.
    """

    def __init__(self, plan: MissionPlan, station: Station, frame: TeamFrame) -> None:
        n = plan.size
        self._plan, self._station, self._frame = plan, station, frame
        self._gps: BoolArray = np.array([plan.uses_gps(vehicle) for vehicle in range(n)])
        self._asking = AskAgain(n, _AGAIN_NS)
        self._asks = np.zeros(n, dtype=np.int64)
        self._given = np.zeros(n, dtype=np.int64)
        self._far_held = HeldEach(n)
        self._far: BoolArray = np.zeros(n, dtype=np.bool_)
        self._off_m: FloatArray = np.full(n, np.nan)
        self._above_m: FloatArray = np.full(n, np.nan)  # its pad, by GPS and the mission's anchor
        self._derived: BoolArray = np.zeros(n, dtype=np.bool_)

    def look(self, now_ns: int) -> None:
        """Compares everybody's place on earth with its pad; once per tick, before anything else."""
        if not self._gps.any():
            return
        self._off_m = self._frame.off_pad_on_earth_m(self._station.fleet, now_ns, _OLD_NS)
        if (anchor := self._plan.spec.anchor) is not None:
            above_m = self._station.fleet.place_deg_m[:, 2] - (anchor.alt_m + self._plan.pads_enu_m[:, 2])
            self._above_m = np.where(np.isnan(self._off_m), np.nan, above_m)
        self._far = self._far_held(self._off_m > _FAR_M, now_ns, _FAR_NS)  # NaN is not far

    def far_away(self, vehicle: int) -> str | None:
        """Words for a vehicle that is in quite another place than the mission says; None for the others."""
        if not self._far[vehicle]:
            return None
        km = beyond(self._off_m[vehicle] / 1e3, _FAR_M / 1e3)
        first, anchor = self._frame.placement.hangs_on, self._plan.spec.anchor
        place = self._station.fleet.place_deg_m[vehicle]
        here = f"it is at {place[0]:.5f}, {place[1]:.5f}"
        if anchor is None:
            name = "?" if first is None else self._plan.spec.vehicles[first].id
            return (
                f"{here}, {km} km from its pad as vehicle {name} places it, limit {_FAR_M / 1e3:g} km; one of the"
                " two has a wrong position: wait for GPS, or restart it"
            )
        return (
            f"{here}, {km} km from its pad by the mission's anchor ({anchor.lat_deg:.5f}, {anchor.lon_deg:.5f}),"
            f" limit {_FAR_M / 1e3:g} km; {self._guess(place)}"
        )

    def _guess(self, place_deg_m: FloatArray) -> str:
        """What may be wrong with the anchor."""
        anchor = self._plan.spec.anchor
        assert anchor is not None  # noqa: S101 - asked only where there is one
        lat, lon = anchor.lat_deg, anchor.lon_deg
        for guess, words in (
            ((lon, lat), "are anchor.lat_deg and anchor.lon_deg swapped?"),
            ((-lat, lon), "is the sign of anchor.lat_deg wrong?"),
            ((lat, -lon), "is the sign of anchor.lon_deg wrong?"),
            ((-lat, -lon), "are the signs of anchor.lat_deg and anchor.lon_deg wrong?"),
        ):
            if abs(guess[0]) <= 90.0:
                away = pymap3d.geodetic2enu(*place_deg_m[:2], 0.0, *guess, 0.0)
                if np.hypot(away[0], away[1]) <= _FAR_M:
                    return words
        return "correct anchor.lat_deg and anchor.lon_deg (are they swapped?), or wait for its GPS"

    def compared(self) -> bool:
        """Whether everybody that uses GPS is where the mission says, by its global position, roughly in height."""
        beside = self._off_m[self._gps] <= self._plan.limits.pad_error_m
        return bool(beside.all()) and not (np.abs(self._above_m[self._gps]) > _HEIGHT_OFF_M).any()  # NaN is not

    def in_doubt(self, vehicle: int, now_ns: int) -> bool:
        """Whether what a vehicle told of its origin of late does not agree with itself."""
        fleet = self._station.fleet
        return self._by_origin(vehicle) and fleet.origin_unsteady(vehicle, now_ns) and not self._was_given(vehicle)

    def doubted(self, now_ns: int) -> BoolArray:
        """Vehicles whose place means nothing at the moment, shape (n,): their origin moves, or the first one's does."""
        doubted = np.array([self.in_doubt(vehicle, now_ns) for vehicle in range(self._plan.size)])
        first = self._frame.placement.hangs_on
        if first is not None and doubted[first]:
            doubted |= self._gps
        return doubted

    def untold(self, vehicle: int) -> bool:
        """Whether a vehicle's origin is neither told nor worked out."""
        return bool(np.isnan(self._station.fleet.origin_deg_m[vehicle]).any()) and not self._derived[vehicle]

    def derived(self, vehicle: int) -> bool:
        """Whether it was worked out from a vehicle's two positions."""
        return bool(self._derived[vehicle])

    def wanted(self, vehicle: int) -> bool:
        """Whether a vehicle is to take the team's origin, could, has not, and is not hopeless."""
        return (
            self._plan.spec.set_gps_origin
            and self._station.fleet.room is None
            and self._plan.autopilots[vehicle].takes_origin
            and self._given[vehicle] < _TRIES
            and not self._frame.placement.has_common_origin(self._station.fleet, vehicle)
        )

    def waiting(self, vehicle: int) -> str | None:
        """What an origin that is still to be given waits for, and what is wrong with one that nobody corrects."""
        spec = self._plan.spec
        if not self.wanted(vehicle):
            if self._by_origin(vehicle) and self._frame.placement.far_from_origin(self._station.fleet, vehicle):
                return (
                    "its origin (GPS_GLOBAL_ORIGIN) is kilometres from where it stands, somebody has set a wrong one;"
                    " restart it" + ("" if spec.set_gps_origin else ", or set_gps_origin: true")
                )
            return None
        off_m = float(self._off_m[vehicle])
        if np.isnan(off_m):
            return "is to be given the team's origin, and has not told its global position (GLOBAL_POSITION_INT) yet"
        if off_m > self._plan.limits.pad_error_m:
            return (
                f"reports a global position {off_m:,.2f} m from its pad, limit {self._plan.limits.pad_error_m:.3g} m;"
                " put it on its pad, or correct pad_m, or anchor.lat_deg and anchor.lon_deg; it is not given the team's"
                " origin before"
            )
        if abs(self._above_m[vehicle]) > _HEIGHT_OFF_M:
            words = self._height_words(vehicle, f", limit {_HEIGHT_OFF_M:g} m")
            return f"{words}; it is not given the team's origin before"
        if not self.compared():
            return "is given the team's origin when everybody is where the mission says"
        return "was given the team's origin, has not taken it yet"

    def what_to_correct(self, vehicle: int) -> str | None:
        """What puts right one that is off its pad, where the mission's anchor may be wrong; None for the others."""
        if self._plan.spec.anchor is None or not self._gps[vehicle]:
            return None
        if abs(self._above_m[vehicle]) / 3.0 > self._off_m[vehicle]:  # as ``TeamFrame.off_pad_m`` counts heights
            return self._height_words(vehicle, ", of which a third counts")
        return "put it on its pad, restart it there, or correct pad_m, or anchor.lat_deg and anchor.lon_deg"

    def _height_words(self, vehicle: int, judged: str) -> str:
        """Says by how much a vehicle's height and the anchor's are apart, and why that may be."""
        anchor, above_m = self._plan.spec.anchor, float(self._above_m[vehicle])
        assert anchor is not None  # noqa: S101 - heights are compared only where there is one
        height_m = self._station.fleet.place_deg_m[vehicle, 2]
        return (
            f"its GPS says {height_m:.0f} m above sea level, {abs(above_m):.0f} m {'above' if above_m > 0 else 'below'}"
            f" its pad by anchor.alt_m ({anchor.alt_m:g} m){judged}; correct anchor.alt_m, or wait for its GPS (heights"
            " above the ellipsoid differ by up to 100 m from those above sea level, in Europe by 40 to 50 m)"
        )

    def _place_on_earth(self, vehicle: int, now_ns: int) -> None:
        """Gives an origin to one that flies without GPS and has none: some estimators take no position before."""
        plan, fleet, anchor = self._plan, self._station.fleet, self._frame.placement.anchor_deg_m
        if not plan.spec.set_gps_origin or anchor is None or plan.autopilots[vehicle].behind_a_gateway:
            return
        if np.isfinite(fleet.origin_deg_m[vehicle]).all() or not self._asking.due(vehicle, now_ns):
            return
        self._asking.asked(vehicle, now_ns)
        self._set_origin(vehicle, anchor)

    def _set_origin(self, vehicle: int, anchor_deg_m: FloatArray) -> None:
        self._station.send(
            vehicle,
            "SET_GPS_GLOBAL_ORIGIN",
            target_system=int(self._station.fleet.sysid[vehicle]),
            latitude=round(anchor_deg_m[0] * 1e7),
            longitude=round(anchor_deg_m[1] * 1e7),
            altitude=round(anchor_deg_m[2] * 1e3),
        )

    def ask(self, vehicle: int, now_ns: int) -> None:
        """Asks a vehicle for its origin, and gives it the team's where that is wanted and everybody was compared."""
        plan, fleet = self._plan, self._station.fleet
        if fleet.room is not None:
            self._place_on_earth(vehicle, now_ns)
        if not self._by_origin(vehicle):
            return
        if not self._asking.due(vehicle, now_ns) or self._station.commands.pending(vehicle):
            return
        self._asking.asked(vehicle, now_ns)
        anchor, first = self._frame.placement.anchor_deg_m, self._frame.placement.hangs_on
        steady = first is None or not self.in_doubt(first, now_ns)
        told = bool(np.isfinite(fleet.origin_deg_m[vehicle]).all())
        if anchor is not None and steady and told and self.wanted(vehicle) and self.compared():
            self._frame.placement.hold_anchor()
            self._given[vehicle] += 1
            self._set_origin(vehicle, anchor)
        self._station.commands.request(vehicle, plan.autopilots[vehicle].once("GPS_GLOBAL_ORIGIN"))
        self._asks[vehicle] += 1
        untold = bool(np.isnan(fleet.origin_deg_m[vehicle]).any())
        self._derived[vehicle] = (
            untold and self._asks[vehicle] > _ASKS and self._frame.placement.derive_origin(fleet, vehicle)
        )

    def _by_origin(self, vehicle: int) -> bool:
        return bool(self._gps[vehicle]) and self._plan.spec.vehicles[vehicle].position == "local"

    def _was_given(self, vehicle: int) -> bool:
        return bool(self._given[vehicle]) and self._frame.placement.has_common_origin(self._station.fleet, vehicle)
