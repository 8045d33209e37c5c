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
from groundstation.core.quick import between, every, norms, some
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.mavlink.vehicle import NEVER, Fleet
from groundstation.mission.flight.placement import Placement
from groundstation.mission.flight.poses import Poses
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.timing import SECOND_NS

_ATTITUDE_PERIODS = 4  # of a lean link's attitudes that may be missing
_COMPARE_AGAIN_NS = 400_000_000  # two comparisons sooner after each other are one
_TOGETHER_NS = 300_000_000  # no further than this is a position brought by its velocity for a comparison
_COMPARED_NS = 10 * SECOND_NS  # after this a comparison says nothing of now


class TeamFrame:
    """Where the vehicles' own frames lie in the team's, and where everybody is in it.

    Args:
        plan: pads, origins, anchor.

    Attributes:
        placement: where the vehicles' own frames begin.
    """

    def __init__(self, plan: MissionPlan) -> None:
        n = plan.size
        self._plan = plan
        self.placement = Placement(plan)
        self._shift_ned_m: FloatArray = np.zeros((n, 3))
        self._nobody: BoolArray = np.zeros(n, dtype=np.bool_)
        self._compared_ns: IntArray = np.full((n, 2), NEVER, dtype=np.int64)
        self._apart_m: FloatArray = np.full((n, 2), np.nan)
        rates = [plan.rates_of(i) for i in range(n)]
        self._attitude_late_ns: IntArray = np.array(
            [round(_ATTITUDE_PERIODS / rate.attitude_hz * SECOND_NS) if rate.lean else 0 for rate in rates]
        )

    def settle(self, fleet: Fleet, now_ns: int) -> None:
        """Holds everything from now on, with the vehicles standing on their pads.

        Heights that come from GPS are shifted so that every vehicle stands on its pad. Vehicles whose frames were
        declared to begin at their pads, and that fly by GPS, are shifted to their pads altogether: their estimates
        began somewhere near.
        """
        self._settle(self.placement.pads_ned_m - self._reported(fleet, now_ns)[0])

    def _settle(self, gap: FloatArray) -> None:
        """Shifts heights, and places that are only roughly known, by what the vehicles were off while they stood."""
        known = np.asarray(np.isfinite(gap).all(axis=1))
        gap = np.where(known[:, None], gap, 0.0)
        self._shift_ned_m[self.placement.gps, 2] = gap[self.placement.gps, 2]
        if self._plan.positioning == "gps":
            at_pad = np.array([vehicle.origin == "pad" for vehicle in self._plan.spec.vehicles]) & ~self.placement.gps
            self._shift_ned_m[at_pad] = gap[at_pad]
        self.placement.settle()

    # In the air: what the ground would have told, from where the vehicles took off

    def _homes_team_ned_m(self, fleet: Fleet) -> FloatArray:
        """Where the vehicles took off, as they tell it, shape (n, 3); NaN where they do not."""
        local = fleet.home_local_ned_m.copy()
        for vehicle, autopilot in enumerate(self._plan.autopilots):
            if not autopilot.tells_home_locally:
                on_earth = (*fleet.home_deg_m[vehicle], *fleet.origin_deg_m[vehicle])
                local[vehicle] = pymap3d.geodetic2ned(*on_earth) if every(np.isfinite(on_earth)) else np.nan
        return np.where(
            self.placement.on_earth[:, None],
            self.placement.from_anchor(fleet.home_deg_m),
            self.placement.origin_team_ned_m + local,
        )

    def home_off_pad_m(self, fleet: Fleet) -> FloatArray:
        """How far from their pads the vehicles took off, shape (n,); NaN where they do not tell. See ``off_pad_m``."""
        gap = self._homes_team_ned_m(fleet) - self.placement.pads_ned_m
        gap[self.placement.gps, 2] /= 3.0
        return np.asarray(norms(gap))

    def settle_in_flight(self, fleet: Fleet) -> None:
        """The same as ``settle`` for vehicles that are in the air."""
        self._settle(self.placement.pads_ned_m - self._homes_team_ned_m(fleet))

    def local_origins_enu_m(self) -> FloatArray:
        """Where LOCAL_POSITION_NED of each vehicle begins, team frame ENU, shape (n, 3); NaN where it is not used."""
        origins = frames.enu_from_ned(self.placement.origin_team_ned_m + self._shift_ned_m)
        return np.where(self.placement.on_earth[:, None], np.nan, origins)

    def words(self) -> list[str]:
        """Where the local frames lie, for the log: a line for each vehicle whose frame was not declared."""
        lines = []
        for vehicle, spec in enumerate(self._plan.spec.vehicles):
            origin = frames.enu_from_ned(self.placement.origin_team_ned_m[vehicle] + self._shift_ned_m[vehicle])
            if every(np.isfinite(origin)) and (
                self.placement.by_origin[vehicle] or np.count_nonzero(self._shift_ned_m[vehicle])
            ):
                place = " ".join(f"{value:.3f}" for value in origin)
                lines.append(f"vehicle {spec.id}: its local frame begins at {place} m in the team frame (ENU)")
        return lines

    def poses(self, fleet: Fleet, now_ns: int) -> Poses:
        """Poses of the team at one instant, each brought there from its measurement by its velocity."""
        velocity = fleet.vel_ned_m_s.copy()
        if some(self.placement.on_earth):
            velocity = np.where(self.placement.on_earth[:, None], fleet.place_vel_ned_m_s, velocity)
        position, carried_s = self._reported(fleet, now_ns)
        return Poses(position + self._shift_ned_m, velocity, fleet.quat_ned_from_frd, self._nobody, carried_s=carried_s)

    def pose_ns(self, fleet: Fleet) -> IntArray:
        """When each pose was measured: the older of position and attitude, shape (n,).

        Attitudes that are asked for less often than positions may be that much older.
        """
        attitude_ns = np.where(fleet.attitude_ns == NEVER, NEVER, fleet.attitude_ns + self._attitude_late_ns)
        return np.minimum(np.where(self.placement.on_earth, fleet.place_ns, fleet.pose_ns), attitude_ns)

    def off_pad_m(self, pos_team_ned_m: FloatArray) -> FloatArray:
        """How far from their pads the vehicles stand that report to be at these places, shape (n,).

        A height from GPS counts a third: it is that much worse, and is not flown by.
        """
        gap = pos_team_ned_m - self.placement.pads_ned_m
        gap[self.placement.gps, 2] /= 3.0
        return np.asarray(norms(gap))

    def off_pad_on_earth_m(self, fleet: Fleet, now_ns: int, old_ns: int) -> FloatArray:
        """How far from their pads, horizontally, the vehicles are by their global positions alone, shape (n,).

        NaN where that, or the anchor, is not known, or is older than a time.
        """
        told = self.placement.gps & (now_ns - fleet.place_ns <= old_ns)
        gap = self.placement.from_anchor(np.where(told[:, None], fleet.place_deg_m, np.nan)) - self.placement.pads_ned_m
        # Chords of the earth: what is far away is below the horizon, too.
        return np.asarray(np.where(np.abs(gap[:, 2]) > 10_000.0, norms(gap), np.hypot(gap[:, 0], gap[:, 1])))

    def drift_m(self, fleet: Fleet, now_ns: int) -> FloatArray:
        """How far the local and the global position of a vehicle disagree, shape (n,); NaN where not known.

        Global positions come once a second or less often, so the two are compared at the instant at which the global
        one was measured, never brought to the tick: after seconds a velocity says little. The smaller of the last two
        comparisons counts, since one alone may be a moment at which the estimator was corrected.
        """
        self._compare(fleet)
        old = now_ns - self._compared_ns > _COMPARED_NS
        least_m = np.minimum(self._apart_m[:, 0], self._apart_m[:, 1])
        return np.asarray(np.where(old[:, 0] | old[:, 1], np.nan, least_m))

    def _compare(self, fleet: Fleet) -> None:
        """Compares both positions of those whose global one is new; ``_apart_m[:, 0]`` is the newer comparison."""
        news = self.placement.by_origin & (fleet.place_ns - self._compared_ns[:, 0] >= _COMPARE_AGAIN_NS)
        gap_ns = fleet.place_ns - fleet.pose_ns
        news &= np.abs(gap_ns) <= _TOGETHER_NS
        if self.placement.anchor_deg_m is None or not some(news):
            return
        rows = news.nonzero()[0]
        local = self.placement.origin_team_ned_m[rows] + fleet.pos_local_ned_m[rows]
        local += fleet.vel_ned_m_s[rows] * (gap_ns[rows] / SECOND_NS)[:, None]
        apart = norms(local - self.placement.from_anchor(fleet.place_deg_m[rows]))
        self._apart_m[rows] = np.stack([apart, self._apart_m[rows, 0]], axis=1)
        self._compared_ns[rows] = np.stack([fleet.place_ns[rows], self._compared_ns[rows, 0]], axis=1)

    def _reported(self, fleet: Fleet, now_ns: int) -> tuple[FloatArray, FloatArray]:
        """Positions as reported, brought to an instant, shape (n, 3), and how long they were carried on, shape (n,)."""
        limit_s = self._plan.spec.limits.pose_age_s
        age_s = between((now_ns - fleet.pose_ns) / SECOND_NS, 0.0, limit_s)
        position = self.placement.origin_team_ned_m + fleet.pos_local_ned_m + fleet.vel_ned_m_s * age_s[:, None]
        if some(self.placement.on_earth):
            rows = self.placement.on_earth.nonzero()[0]
            age_s[rows] = between((now_ns - fleet.place_ns[rows]) / SECOND_NS, 0.0, limit_s)
            moved_m = fleet.place_vel_ned_m_s[rows] * age_s[rows, None]
            position[rows] = self.placement.from_anchor(fleet.place_deg_m[rows]) + moved_m
        return np.asarray(position), age_s
