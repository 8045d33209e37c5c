"""One frame for all: every vehicle's position in the team frame, at the instant of the tick.

A vehicle reports its position from an origin of its own. Where that origin lies is declared (its pad, a point, the
team's origin) or known on earth (GPS_GLOBAL_ORIGIN, or global positions outright). On earth the team frame hangs on the
mission's anchor, or on the pad of the first vehicle that uses GPS. Heights always count from
the pads: GPS is worst there.

Everything is settled on the ground and then held. Refuses to follow an origin that moves in flight; monitors tell.
"""

from __future__ import annotations

import numpy as np
import pymap3d

from groundstation.core import frames
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.mavlink.vehicle import NEVER, Fleet
from groundstation.mission.flight.poses import Poses
from groundstation.mission.plan.plan import MissionPlan

_SECOND_NS = 1_000_000_000
_SAME_ORIGIN_M = 0.05
_LOOK_NS = 200_000_000
_ATTITUDE_PERIODS = 4  # of a lean link's attitudes that may be missing
_COMPARE_AGAIN_NS = 400_000_000  # two comparisons sooner after each other are one
_TOGETHER_NS = 300_000_000  # no further than this is a position brought by its velocity for a comparison
_NO_HEIGHT_M = 10_000.0  # no vehicle is so high: the earth bends that much
_FAR_ORIGIN_M = 3_000.0  # local positions are coarse and bent so far from where they count from
_COMPARED_NS = 10 * _SECOND_NS  # after this a comparison says nothing of now


class TeamFrame:
    """Where the vehicles' own frames lie in the team's.

    Args:
        plan: pads, origins, anchor.

    Attributes:
        origin_team_ned_m: of each vehicle's local frame, shape (n, 3); NaN while not known, and where it needs none.
        anchor_deg_m: place of the team frame's origin on earth: latitude, longitude, height; None while not known.
        settled: held from now on.
        hangs_on: the vehicle whose position places the frame on earth; None where the mission says where it is.
    """

    def __init__(self, plan: MissionPlan) -> None:
        spec = plan.spec
        self._plan = plan
        self._pads_ned_m = frames.ned_from_enu(plan.pads_enu_m)
        n = plan.size
        self._global: BoolArray = np.array([vehicle.position == "global" for vehicle in spec.vehicles])
        self._gps: BoolArray = np.array([plan.uses_gps(i) for i in range(n)])
        self._by_origin: BoolArray = self._gps & ~self._global
        self.origin_team_ned_m: FloatArray = np.full((n, 3), np.nan)
        for i, vehicle in enumerate(spec.vehicles):
            if vehicle.origin == "pad":
                self.origin_team_ned_m[i] = self._pads_ned_m[i]
            elif vehicle.origin == "team":
                self.origin_team_ned_m[i] = 0.0
            elif vehicle.origin_m is not None:
                self.origin_team_ned_m[i] = frames.ned_from_enu(np.array(vehicle.origin_m))
        self.origin_team_ned_m[self._by_origin] = np.nan
        anchor = spec.anchor
        self.anchor_deg_m: FloatArray | None = (
            None if anchor is None else np.array([anchor.lat_deg, anchor.lon_deg, anchor.alt_m])
        )
        self._anchor_is_given = anchor is not None or not self._gps.any()
        self.hangs_on = None if self._anchor_is_given else int(np.flatnonzero(self._gps)[0])
        self._shift_ned_m: FloatArray = np.zeros((n, 3))
        self._derived_deg_m: FloatArray = np.full((n, 3), np.nan)
        self._nobody: BoolArray = np.zeros(n, dtype=np.bool_)
        self._compared_ns: IntArray = np.full((n, 2), NEVER, dtype=np.int64)
        self._apart_m: FloatArray = np.full((n, 2), np.nan)
        self._next_look_ns = 0
        rates = [plan.rates_of(i) for i in range(n)]
        self._attitude_late_ns: IntArray = np.array(
            [round(_ATTITUDE_PERIODS / rate.attitude_hz * _SECOND_NS) if rate.lean else 0 for rate in rates]
        )
        self.settled = False

    def look(self, fleet: Fleet, now_ns: int) -> None:
        """Follows what the vehicles say of their origins, as long as nothing is settled."""
        if self.settled or not self._gps.any() or now_ns < self._next_look_ns:
            return
        self._next_look_ns = now_ns + _LOOK_NS
        if not self._anchor_is_given:
            self._hang_on_first(fleet)
        if self.anchor_deg_m is not None:
            rows = np.flatnonzero(self._by_origin)
            self.origin_team_ned_m[rows] = self._from_anchor(self._origins_deg_m(fleet)[rows])

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
        return bool(np.linalg.norm(pymap3d.geodetic2ned(*place, *origin)) > _FAR_ORIGIN_M)

    def hold_anchor(self) -> None:
        """Keeps the anchor as it is now: vehicles are about to be given it for their origin."""
        self._anchor_is_given = True

    def has_common_origin(self, fleet: Fleet, vehicle: int) -> bool:
        """Whether a vehicle's own origin is the anchor."""
        away = self.origin_team_ned_m[vehicle]
        return bool(np.isfinite(away).all() and np.linalg.norm(away) <= _SAME_ORIGIN_M)

    def known(self, vehicle: int) -> bool:
        """Whether a vehicle's reports can be placed in the team frame."""
        if self._global[vehicle]:
            return self.anchor_deg_m is not None
        return bool(np.isfinite(self.origin_team_ned_m[vehicle]).all())

    def settle(self, fleet: Fleet, now_ns: int) -> None:
        """Holds everything from now on, with the vehicles standing on their pads.

        Heights that come from GPS are shifted so that every vehicle stands on its pad. Vehicles whose frames were
        declared to begin at their pads, and that fly by GPS, are shifted to their pads altogether: their estimates
        began somewhere near.
        """
        self._settle(self._pads_ned_m - self._reported(fleet, now_ns))

    def _settle(self, gap: FloatArray) -> None:
        """Shifts heights, and places that are only roughly known, by what the vehicles were off while they stood."""
        known = np.asarray(np.isfinite(gap).all(axis=1))
        gap = np.where(known[:, None], gap, 0.0)
        self._shift_ned_m[self._gps, 2] = gap[self._gps, 2]
        if self._plan.positioning == "gps":
            at_pad = np.array([vehicle.origin == "pad" for vehicle in self._plan.spec.vehicles]) & ~self._gps
            self._shift_ned_m[at_pad] = gap[at_pad]
        self.settled = True

    # In the air: what the ground would have told, from where the vehicles took off

    def look_in_flight(self, fleet: Fleet, now_ns: int) -> None:
        """The same as ``look`` for vehicles that are in the air: their homes stand in for where they stand."""
        if self.settled or not self._gps.any() or now_ns < self._next_look_ns:
            return
        self._next_look_ns = now_ns + _LOOK_NS
        if not self._anchor_is_given:
            told = np.flatnonzero(self._gps & np.isfinite(fleet.home_deg_m).all(axis=1))
            if len(told):
                first = int(told[0])
                place = fleet.home_deg_m[first]
                self.anchor_deg_m = np.array(pymap3d.ned2geodetic(*-self._pads_ned_m[first], *place), dtype=np.float64)
                self._anchor_is_given = True
        if self.anchor_deg_m is not None:
            rows = np.flatnonzero(self._by_origin)
            self.origin_team_ned_m[rows] = self._from_anchor(fleet.origin_deg_m[rows])

    def _homes_team_ned_m(self, fleet: Fleet) -> FloatArray:
        """Where the vehicles took off, as they tell it, shape (n, 3); NaN where they do not."""
        local = fleet.home_local_ned_m.copy()
        for vehicle, autopilot in enumerate(self._plan.autopilots):
            if not autopilot.tells_home_locally:
                on_earth = (*fleet.home_deg_m[vehicle], *fleet.origin_deg_m[vehicle])
                local[vehicle] = pymap3d.geodetic2ned(*on_earth) if np.isfinite(on_earth).all() else np.nan
        return np.where(self._global[:, None], self._from_anchor(fleet.home_deg_m), self.origin_team_ned_m + local)

    def home_off_pad_m(self, fleet: Fleet) -> FloatArray:
        """How far from their pads the vehicles took off, shape (n,); NaN where they do not tell. See ``off_pad_m``."""
        gap = self._homes_team_ned_m(fleet) - self._pads_ned_m
        gap[self._gps, 2] /= 3.0
        return np.asarray(np.linalg.norm(gap, axis=1))

    def settle_in_flight(self, fleet: Fleet) -> None:
        """The same as ``settle`` for vehicles that are in the air."""
        self._settle(self._pads_ned_m - self._homes_team_ned_m(fleet))

    def local_origins_enu_m(self) -> FloatArray:
        """Where LOCAL_POSITION_NED of each vehicle begins, team frame ENU, shape (n, 3); NaN where it is not used."""
        origins = frames.enu_from_ned(self.origin_team_ned_m + self._shift_ned_m)
        return np.where(self._global[:, None], np.nan, origins)

    def words(self) -> list[str]:
        """Where the local frames lie, for the log: a line for each vehicle whose frame was not declared."""
        lines = []
        for vehicle, spec in enumerate(self._plan.spec.vehicles):
            origin = frames.enu_from_ned(self.origin_team_ned_m[vehicle] + self._shift_ned_m[vehicle])
            if np.isfinite(origin).all() and (self._by_origin[vehicle] or self._shift_ned_m[vehicle].any()):
                place = " ".join(f"{value:.3f}" for value in origin)
                lines.append(f"vehicle {spec.id}: its local frame begins at {place} m in the team frame (ENU)")
        return lines

    def poses(self, fleet: Fleet, now_ns: int) -> Poses:
        """Poses of the team at one instant, each brought there from its measurement by its velocity."""
        velocity = np.where(self._global[:, None], fleet.place_vel_ned_m_s, fleet.vel_ned_m_s)
        return Poses(self._reported(fleet, now_ns) + self._shift_ned_m, velocity, fleet.quat_ned_from_frd, self._nobody)

    def pose_ns(self, fleet: Fleet) -> IntArray:
        """When each pose was measured: the older of position and attitude, shape (n,).

        Attitudes that are asked for less often than positions may be that much older.
        """
        attitude_ns = np.where(fleet.attitude_ns == NEVER, NEVER, fleet.attitude_ns + self._attitude_late_ns)
        return np.minimum(np.where(self._global, fleet.place_ns, fleet.pose_ns), attitude_ns)

    def off_pad_m(self, fleet: Fleet, now_ns: int) -> FloatArray:
        """How far from their pads the vehicles report to stand, shape (n,).

        A height from GPS counts a third: it is that much worse, and is not flown by.
        """
        gap = self._reported(fleet, now_ns) - self._pads_ned_m
        gap[self._gps, 2] /= 3.0
        return np.asarray(np.linalg.norm(gap, axis=1))

    def off_pad_on_earth_m(self, fleet: Fleet, now_ns: int, old_ns: int) -> FloatArray:
        """How far from their pads, horizontally, the vehicles are by their global positions alone, shape (n,).

        NaN where that, or the anchor, is not known, or is older than a time.
        """
        told = self._gps & (now_ns - fleet.place_ns <= old_ns)
        gap = self._from_anchor(np.where(told[:, None], fleet.place_deg_m, np.nan)) - self._pads_ned_m
        # Chords of the earth: what is far away is below the horizon, too.
        return np.asarray(
            np.where(np.abs(gap[:, 2]) > 10_000.0, np.linalg.norm(gap, axis=1), np.hypot(gap[:, 0], gap[:, 1]))
        )

    def drift_m(self, fleet: Fleet, now_ns: int) -> FloatArray:
        """How far the local and the global position of a vehicle disagree, shape (n,); NaN where not known.

        Global positions come once a second or less often, so the two are compared at the instant at which the global
        one was measured, never brought to the tick: after seconds a velocity says little. The smaller of the last two
        comparisons counts, since one alone may be a moment at which the estimator was corrected.
        """
        self._compare(fleet)
        old = now_ns - self._compared_ns > _COMPARED_NS
        return np.asarray(np.where(old.any(axis=1), np.nan, self._apart_m.min(axis=1)))

    def _compare(self, fleet: Fleet) -> None:
        """Compares both positions of those whose global one is new; ``_apart_m[:, 0]`` is the newer comparison."""
        news = self._by_origin & (fleet.place_ns - self._compared_ns[:, 0] >= _COMPARE_AGAIN_NS)
        gap_ns = fleet.place_ns - fleet.pose_ns
        news &= np.abs(gap_ns) <= _TOGETHER_NS
        if self.anchor_deg_m is None or not news.any():
            return
        rows = np.flatnonzero(news)
        local = self.origin_team_ned_m[rows] + fleet.pos_local_ned_m[rows]
        local += fleet.vel_ned_m_s[rows] * (gap_ns[rows] / _SECOND_NS)[:, None]
        apart = np.linalg.norm(local - self._from_anchor(fleet.place_deg_m[rows]), axis=1)
        self._apart_m[rows] = np.stack([apart, self._apart_m[rows, 0]], axis=1)
        self._compared_ns[rows] = np.stack([fleet.place_ns[rows], self._compared_ns[rows, 0]], axis=1)

    def _reported(self, fleet: Fleet, now_ns: int) -> FloatArray:
        """Positions as reported, brought to an instant, shape (n, 3)."""
        limit_s = self._plan.spec.limits.pose_age_s
        age_s = np.clip((now_ns - fleet.pose_ns) / _SECOND_NS, 0.0, limit_s)[:, None]
        position = self.origin_team_ned_m + fleet.pos_local_ned_m + fleet.vel_ned_m_s * age_s
        if self._global.any():
            rows = np.flatnonzero(self._global)
            age_s = np.clip((now_ns - fleet.place_ns[rows]) / _SECOND_NS, 0.0, limit_s)[:, None]
            position[rows] = self._from_anchor(fleet.place_deg_m[rows]) + fleet.place_vel_ned_m_s[rows] * age_s
        return np.asarray(position)

    def _from_anchor(self, places_deg_m: FloatArray) -> FloatArray:
        """Places on earth in the team frame, shape (k, 3); NaN stays NaN."""
        if self.anchor_deg_m is None:
            return np.full_like(places_deg_m, np.nan)
        north, east, down = pymap3d.geodetic2ned(*places_deg_m.T, *self.anchor_deg_m)
        return np.stack([north, east, down], axis=-1)

    def _hang_on_first(self, fleet: Fleet) -> None:
        """Places the anchor so that the first vehicle that uses GPS stands on its pad."""
        first = int(np.flatnonzero(self._gps)[0])
        place = fleet.place_deg_m[first]
        if not self._global[first]:
            origin = self._origins_deg_m(fleet)[first]
            if not self.far_from_origin(fleet, first):
                place = np.array(pymap3d.ned2geodetic(*fleet.pos_local_ned_m[first], *origin))
        if np.isfinite(place).all():
            self.anchor_deg_m = np.array(pymap3d.ned2geodetic(*-self._pads_ned_m[first], *place), dtype=np.float64)
