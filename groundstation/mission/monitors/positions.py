"""Monitors of what is known of the vehicles' poses: too old, lost, jumping, in another frame than before, tilted.

A pose is judged against what the same vehicle said before. Nothing here can tell a position that is wrong from the
beginning; that is preflight's.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from groundstation.core.quick import any_of, between, equal_rows, every, norms, renewed, some
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.mavlink.vehicle import NEVER
from groundstation.mission.flight.poses import Poses, changed
from groundstation.mission.monitors.drifts import Astray
from groundstation.mission.monitors.findings import OWN_ID, SEE_TO_POSITION, Finding, Lasting, Reaction, Sight
from groundstation.mission.plan.links import LinkPlan
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.timing import SECOND_NS, HeldEach

_FORGETS_S = 3.0
_SUSPECT_S = 0.3
_TILTED_S = 0.3
_FROZEN_S, _FROZEN_REPORTS = 1.5, 5
_GAP_S, _GAP_MAX_S = 0.15, 5.0
_KICK = 2.0  # times what the profile's acceleration makes of a velocity between two reports
_LED_ASTRAY_S = 8.0  # a velocity wrong for 2.5 s at a time leads 1.7 times its error astray in 3 s; five deviations
_REACH_S = 0.5  # no longer than this is a trusted position carried on by its velocity
_ORIGIN_FAR = 2.0  # times frame_drift_m: an origin that moved further moves one of two positions, as anybody can see
_DENIED_S = 2.5  # two comparisons of local and global position, and some time for them to arrive
_LINK_SHARE = 0.8  # of pose_lost_s: a link that is silent is told before its vehicles are, one by one


class _Off(NamedTuple):
    """How far positions are from where velocities lead, how far they may be, and velocities jumped, shape (n,)."""

    away_m: FloatArray
    allowed_m: FloatArray
    kick_m_s: FloatArray


class PoseJump:
    """Positions that move otherwise than their velocities say: by a jump, or by a drift.

    The differences are added up and forgotten over a few seconds. Beyond the limit the vehicle stands still and counts
    as being where it was. When the next reports take it back, as after a single bad packet, nothing has happened; when
    it lasts, its position is lost. A velocity that changes as no vehicle can is suspect as well: believed for one tick,
    it would lead the following positions astray.

    A velocity that has been poor for seconds leads astray by itself: there the limit is wider by what that explains.

    What parts from a velocity that was good until then, faster than positions wander, has begun to drift, long before
    the limit, and from then on nothing of it is forgotten. Of one that is lost its velocity
    tells better where it is: a vehicle that lands follows its position, wherever that goes.
    """

    def __init__(self, plan: MissionPlan) -> None:
        n = plan.size
        self._limit_m, self._accel_m_s2 = plan.limits.pose_jump_m, plan.profile.acceleration_max_m_s2
        self._astray = Astray(plan)
        self._apart_m: FloatArray = np.zeros((n, 3))
        # Of the last report that was believed; a suspect one changes none of it, however absurd.
        self._pos: FloatArray = np.full((n, 3), np.nan)
        self._vel: FloatArray = np.zeros((n, 3))
        self._at_ns: IntArray = np.full(n, NEVER, dtype=np.int64)
        self._pose_ns: IntArray = np.full(n, NEVER, dtype=np.int64)
        self._away = HeldEach(n)
        self._lasts: BoolArray = np.zeros(n, dtype=np.bool_)
        self._told: BoolArray = np.zeros(n, dtype=np.bool_)
        self.suspect: BoolArray = np.zeros(n, dtype=np.bool_)
        self._silent_ns = round(plan.spec.limits.pose_age_s * SECOND_NS)
        self._off = _Off(np.zeros(n), np.full(n, self._limit_m), np.zeros(n))

    def take(
        self,
        poses: Poses,
        pose_ns: IntArray,
        vel_rms_m_s: FloatArray,
        now_ns: int,
        *,
        airborne: BoolArray | None = None,
        good: BoolArray | None = None,
        calm: BoolArray | None = None,
    ) -> Poses:
        """Takes the poses of a tick and hands them back with trusted positions in place of suspect ones.

        Args:
            poses: as reported.
            pose_ns: when each was measured, shape (n,).
            vel_rms_m_s: root mean square of the error of velocities that are known to be poor, shape (n,); zero for
                all others.
            now_ns: time of the tick.
            airborne: who flies, shape (n,); everybody when left out.
            good: whose velocity was good until now, shape (n,); everybody's when left out.
            calm: whose velocity has agreed with its positions for seconds, shape (n,); nobody's when left out.
        """
        new = any_of(self._at_ns == NEVER)
        passed_s = renewed(new, 0.0, (now_ns - self._at_ns) / SECOND_NS)[:, None]
        moved = poses.pos_team_ned_m - self._pos - 0.5 * (self._vel + poses.vel_ned_m_s) * passed_s
        moved = renewed(None if new is None else new[:, None], 0.0, moved)
        apart_m = self._apart_m * np.exp(-passed_s / _FORGETS_S) + moved
        # Over a gap in the reports the velocity may have changed unseen.
        gap_s = renewed(new, 0.0, (pose_ns - self._pose_ns) / SECOND_NS)
        gap = any_of(gap_s > _GAP_S)
        gap_s = np.zeros(len(gap_s)) if gap is None else np.where(gap, np.minimum(gap_s, _GAP_MAX_S), 0.0)
        away_m = norms(apart_m)
        silent = now_ns - pose_ns > self._silent_ns
        counts = ~silent if gap is None else ~silent & ~gap
        counts = counts if airborne is None else counts & airborne
        parting = counts if good is None else counts & good
        away_m = np.fmax(away_m, self._astray.take(poses, counts, parting, away_m, now_ns))
        if calm is not None:
            self._astray.own_up(calm)
        poor_m = np.where(self.drifting, 0.0, _LED_ASTRAY_S * vel_rms_m_s)
        allowed_m = np.hypot(self._limit_m, poor_m)
        away = ~(away_m <= allowed_m + 0.5 * self._accel_m_s2 * gap_s**2)
        kick_m_s = norms(poses.vel_ned_m_s - self._vel)
        passed_s = passed_s[:, 0]
        away |= ~(kick_m_s * passed_s <= 0.5 * self._limit_m + _KICK * self._accel_m_s2 * passed_s**2)
        # Of one that says nothing, nothing new contradicts its velocity: that it is silent is said elsewhere.
        away &= ~silent
        self._lasts = self._away(away, now_ns, round(_SUSPECT_S * SECOND_NS))
        self.suspect = away | self._told
        self._pose_ns = pose_ns
        self._off = _Off(away_m, allowed_m, kick_m_s)
        apart_m = renewed(None if gap is None else gap[:, None], 0.0, apart_m)
        if not some(self.suspect):
            self._apart_m, self._pos, self._vel = apart_m, poses.pos_team_ned_m.copy(), poses.vel_ned_m_s.copy()
            self._at_ns[:] = now_ns
            self._astray.lead_on(self._pos, self._vel, poses, self._told, now_ns)
            return poses
        believed = ~self.suspect
        self._apart_m[believed] = apart_m[believed]
        self._pos[believed], self._vel[believed] = poses.pos_team_ned_m[believed], poses.vel_ned_m_s[believed]
        self._at_ns[believed] = now_ns
        self._astray.lead_on(self._pos, self._vel, poses, self._told & ~silent, now_ns)
        # It was told to stand still, and carries on for a moment.
        carried = self._pos + self._vel * np.minimum(passed_s, _REACH_S)[:, None]
        rows = self.suspect[:, None]
        return changed(
            poses,
            pos_team_ned_m=np.where(rows, carried, poses.pos_team_ned_m),
            vel_ned_m_s=np.where(rows, 0.0, poses.vel_ned_m_s),
        )

    def may_stand_off_m(self, vehicle: int) -> tuple[float, float] | None:
        """See ``Board.may_stand_off_m``."""
        return self._astray.may_stand_off_m(vehicle, lost=bool(self._told[vehicle]))

    @property
    def drifting(self) -> BoolArray:
        """Whose position parts from a velocity that was good until then, shape (n,)."""
        return self._astray.drifts.drifting

    def look(self, sight: Sight, ours: BoolArray) -> Iterator[Finding]:
        """Tells of those whose reports have not come back; of one that lands, as long as it is not down."""
        for vehicle in (self._lasts & ~self._told & ours & (sight.airborne | ~sight.excused)).nonzero()[0].tolist():
            self._told[vehicle] = True
            away_m, allowed_m, kick_m_s = (float(values[vehicle]) for values in self._off)
            what = f"its position is {away_m:.2f} m from where its velocity leads, limit {allowed_m:.2g} m"
            if away_m <= allowed_m:
                what = f"its velocity has changed by {kick_m_s:.1f} m/s at once, more than a vehicle can"
            if sight.excused[vehicle]:
                yield Finding(Reaction.FAILED, f"{what}; it lands by it, keep people away", (vehicle,), lost=True)
            else:
                yield Finding(Reaction.LAND, what, (vehicle,), lost=True, remedy=SEE_TO_POSITION)


class LinkSilence:
    """Links on which nothing is heard of anybody any more."""

    def __init__(self, plan: LinkPlan) -> None:
        self._links = plan.links
        self._link_of_vehicle: IntArray = np.array(plan.link_of_vehicle)
        self._limit_s = _LINK_SHARE * plan.spec.limits.pose_lost_s
        self._lasting = Lasting(len(plan.links), again=True)

    def look(self, sight: Sight, ours: BoolArray) -> Iterator[Finding]:
        """Tells of a link that has several vehicles, all of them silent."""
        silent = sight.fleet.silent(sight.now_ns, self._limit_s)
        down = np.zeros(len(self._links), dtype=np.bool_)
        for link in range(len(self._links) if some(silent) else 0):
            here = (self._link_of_vehicle == link) & ours
            down[link] = here.sum() > 1 and every(silent[here])
        for link in self._lasting(down, sight.now_ns):
            rows = tuple(((self._link_of_vehicle == link) & ours & ~sight.excused).nonzero()[0].tolist())
            what = f"link {self._links[link]}: nothing heard of anybody for {self._limit_s:g} s"
            remedy = "see to its radio, cable or network"
            yield Finding(Reaction.LAND, what, rows, lost=True, unheard=True, remedy=remedy)


class RoomSilence:
    """A motion capture system of which nothing comes any more: nobody knows where it is, and everybody drifts."""

    def __init__(self, plan: LinkPlan) -> None:
        self._limit_s = plan.spec.limits.pose_age_s
        self._lasting = Lasting(1, again=True)

    def look(self, sight: Sight, ours: BoolArray) -> Iterator[Finding]:
        """Brings down who has nothing else to go by, all at once."""
        room = sight.fleet.room
        if room is None:
            return
        old = sight.now_ns - sight.pose_ns > self._limit_s * SECOND_NS
        if self._lasting(np.array([room.gone and every(old[ours])]), sight.now_ns):
            rows = tuple((ours & ~sight.excused).nonzero()[0].tolist())
            what = f"motion capture: nothing of anybody for {self._limit_s:g} s"
            yield Finding(
                Reaction.LAND, what, rows, lost=True, remedy="see to its cameras, its computer and the network"
            )


class PoseAge:
    """Poses that are too old to steer by, and poses that are lost."""

    def __init__(self, plan: LinkPlan) -> None:
        self._limits = plan.spec.limits
        self.hold: BoolArray = np.zeros(plan.size, dtype=np.bool_)
        self._old = Lasting(plan.size, again=True)
        self._lost = Lasting(plan.size, again=True)

    def look(self, sight: Sight, ours: BoolArray) -> Iterator[Finding]:
        """Holds those that are too old, lands those that are lost."""
        age_ns = sight.now_ns - sight.pose_ns
        self.hold = (age_ns > self._limits.pose_age_s * SECOND_NS) & ours
        for vehicle in self._old(self.hold, sight.now_ns):
            what = f"position is {age_ns[vehicle] / SECOND_NS:.2f} s old, limit {self._limits.pose_age_s:.2f} s"
            yield Finding(Reaction.HOLD, what, (vehicle,))
        lost = (age_ns > self._limits.pose_lost_s * SECOND_NS) & ours & ~sight.excused & ~sight.blind
        for vehicle in self._lost(lost, sight.now_ns):
            what = f"no position for {self._limits.pose_lost_s:g} s"
            remedy = "see to its link, and to its GPS or motion capture"
            yield Finding(Reaction.LAND, what, (vehicle,), lost=True, unheard=True, remedy=remedy)


class Frozen:
    """Positions that arrive and never change by a bit, as no estimate of a flying vehicle does."""

    def __init__(self, plan: MissionPlan) -> None:
        n = plan.size
        self._local: BoolArray = np.array([vehicle.position == "local" for vehicle in plan.spec.vehicles])
        self._pos: FloatArray = np.full((n, 3), np.nan)
        self._pose_ns: IntArray = np.full(n, NEVER, dtype=np.int64)
        self._reports: IntArray = np.zeros(n, dtype=np.int64)
        self._lasting = Lasting(n, _FROZEN_S)

    def look(self, sight: Sight, ours: BoolArray) -> Iterator[Finding]:
        """Lands those whose position stands still to the last bit."""
        fleet = sight.fleet
        same = equal_rows(fleet.pos_local_ned_m, self._pos)
        if some(same):
            self._reports = np.where(same, self._reports + (fleet.pose_ns > self._pose_ns), 0)
            frozen = same & self._local & (self._reports >= _FROZEN_REPORTS) & sight.in_our_air & ours
        else:
            self._reports, frozen = np.zeros(len(same), dtype=np.int64), same
        self._pos, self._pose_ns = fleet.pos_local_ned_m.copy(), fleet.pose_ns.copy()
        for vehicle in self._lasting(frozen, sight.now_ns):
            what = f"its position has not changed by a bit in {_FROZEN_S:g} s"
            yield Finding(Reaction.LAND, what, (vehicle,), lost=True, remedy=SEE_TO_POSITION)


class Frames:
    """Positions that no longer mean what they meant: another start, another origin, two positions that part."""

    def __init__(self, plan: MissionPlan) -> None:
        n = plan.size
        self._plan = plan
        self._origins_ns: IntArray = np.full(n, NEVER, dtype=np.int64)
        self._restarts: IntArray = np.zeros(n, dtype=np.int64)
        self._wrong, self._denied = Lasting(n), Lasting(n, _DENIED_S, again=True)
        self._twins = Lasting(n)

    def begin(self, origins_ns: IntArray, restarts: IntArray) -> None:
        """Takes what is so now for what should stay so."""
        self._origins_ns, self._restarts = origins_ns.copy(), restarts.copy()

    def look(self, sight: Sight, ours: BoolArray) -> Iterator[Finding]:
        """Lands those whose frame has changed; a second vehicle under the same id brings everybody back.

        An origin that has moved far has moved the local position or the global one with it. When neither has, somebody
        else has told it, or it was a slip: the vehicle's frame is what it was, and it can come home.
        """
        fleet, limit_m = sight.fleet, self._plan.limits.frame_drift_m
        drifting = sight.drift_m > limit_m  # NaN is not
        restarted, moved = fleet.restarts > self._restarts, fleet.origin_moved_ns > self._origins_ns
        denied = moved
        if some(moved):
            denied = moved & (fleet.origin_moved_m > _ORIGIN_FAR * limit_m) & (sight.drift_m <= limit_m)
        for vehicle in self._denied(denied & ~restarted & ours & ~sight.excused, sight.now_ns):
            what = (
                f"an origin {fleet.origin_moved_m[vehicle]:.0f} m from its own is told under its id"
                " (GPS_GLOBAL_ORIGIN), and neither of its positions has moved; it counts for nothing"
            )
            yield Finding(Reaction.ALL_HOME, what, (vehicle,), remedy="find who else speaks on its link")
        moved = moved & ~denied
        for vehicle in self._wrong((restarted | moved | drifting) & ours & ~sight.excused, sight.now_ns):
            if restarted[vehicle]:
                what, remedy = "its autopilot has started anew", "see to its battery and the plugs of its power"
            elif moved[vehicle]:
                what = f"its origin has moved by {fleet.origin_moved_m[vehicle]:.2f} m"
                remedy = "see to its GPS, and let nobody else set its origin"
            else:
                what = f"its local and global positions are {sight.drift_m[vehicle]:.2f} m apart, limit {limit_m:.2g} m"
                remedy = "see to its GPS"
            yield Finding(Reaction.LAND, what, (vehicle,), lost=True, remedy=remedy)
        twins = fleet.twins_behind_one_address(sight.now_ns)
        found: BoolArray = np.zeros(len(fleet), dtype=np.bool_)
        if twins:
            found[[row for row in twins if ours[row]]] = True
        for vehicle in self._twins(found, sight.now_ns):
            yield Finding(Reaction.ALL_HOME, twins[vehicle], (vehicle,), remedy=OWN_ID)


class Tilt:
    """Vehicles that lean as nobody leans who is under control."""

    def __init__(self, plan: MissionPlan) -> None:
        self._limit_deg = plan.spec.limits.tilt_deg
        self._lasting = Lasting(plan.size, _TILTED_S)

    def look(self, sight: Sight, ours: BoolArray) -> Iterator[Finding]:
        """Lands those that are tilted for longer than a gust tilts."""
        quat = sight.fleet.quat_ned_from_frd
        cosine = between(1.0 - 2.0 * (quat[:, 1] ** 2 + quat[:, 2] ** 2), -1.0, 1.0)
        tilt_deg = np.degrees(np.arccos(cosine))
        tilted = (tilt_deg > self._limit_deg) & sight.in_our_air & ours
        for vehicle in self._lasting(tilted, sight.now_ns):
            what = f"is tilted by {tilt_deg[vehicle]:.0f} degrees, limit {self._limit_deg:g} degrees"
            yield Finding(Reaction.LAND, what, (vehicle,), lost=True, remedy="keep people away")
