"""Monitors of what is known of the vehicles' poses: too old, lost, jumping, in another frame than before, tilted.

A pose is judged against what the same vehicle said before. Nothing here can tell a position that is wrong from the
beginning; that is preflight's.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.mavlink.vehicle import NEVER
from groundstation.mission.guidance import Poses
from groundstation.mission.monitors.findings import SECOND_NS, Finding, Lasting, Reaction, Sight
from groundstation.mission.plan import MissionPlan

_FORGETS_S = 3.0
_SUSPECT_S = 0.3
_TILTED_S = 0.3
_REACH_S = 0.5  # no longer than this is a trusted position carried on by its velocity
_LINK_SHARE = 0.8  # of pose_lost_s: a link that is silent is told before its vehicles are, one by one


class PoseJump:
    """Positions that move otherwise than their velocities say: by a jump, or by a drift.

    The differences are added up and forgotten over a few seconds. Beyond the limit the vehicle stands still and counts
    as being where it was. When the next reports take it back, as after a single bad packet, nothing has happened; when
    it lasts, its position is lost.
    """

    def __init__(self, plan: MissionPlan) -> None:
        n = plan.size
        self._limit_m, self._accel_m_s2 = plan.pose_jump_m, plan.profile.acceleration_max_m_s2
        self._apart_m: FloatArray = np.zeros((n, 3))
        self._pos: FloatArray = np.full((n, 3), np.nan)
        self._vel: FloatArray = np.full((n, 3), np.nan)
        self._pose_ns: IntArray = np.full(n, NEVER, dtype=np.int64)
        self._last_ns = NEVER
        self._since_ns: IntArray = np.full(n, NEVER, dtype=np.int64)
        self._trusted: FloatArray = np.full((n, 3), np.nan)
        self._told: BoolArray = np.zeros(n, dtype=np.bool_)
        self.suspect: BoolArray = np.zeros(n, dtype=np.bool_)

    def take(self, poses: Poses, pose_ns: IntArray, now_ns: int) -> Poses:
        """Takes the poses of a tick and hands them back with trusted positions in place of suspect ones."""
        if self._last_ns != NEVER:
            passed_s = (now_ns - self._last_ns) / SECOND_NS
            moved = poses.pos_team_ned_m - self._pos - 0.5 * (self._vel + poses.vel_ned_m_s) * passed_s
            self._apart_m = self._apart_m * np.exp(-passed_s / _FORGETS_S) + moved
            # Over a gap in the reports the velocity may have changed unseen.
            gap_s = np.clip((pose_ns - self._pose_ns) / SECOND_NS, 0.0, 5.0)
            limit_m = self._limit_m + 0.5 * self._accel_m_s2 * np.where(gap_s > 2.0 * passed_s, gap_s, 0.0) ** 2
            away = np.linalg.norm(self._apart_m, axis=1) > limit_m
            begins = away & ~self.suspect
            self._trusted[begins] = self._pos[begins] + _REACH_S * 0.5 * self._vel[begins]
            self._since_ns[begins] = now_ns
            self.suspect = (away | self._told) & np.isfinite(self._trusted).all(axis=1)
        self._last_ns, self._pos, self._vel = now_ns, poses.pos_team_ned_m, poses.vel_ned_m_s
        self._pose_ns = pose_ns
        if not self.suspect.any():
            return poses
        rows = self.suspect[:, None]
        return replace(
            poses,
            pos_team_ned_m=np.where(rows, self._trusted, poses.pos_team_ned_m),
            vel_ned_m_s=np.where(rows, 0.0, poses.vel_ned_m_s),
        )

    def look(self, sight: Sight, ours: BoolArray) -> Iterator[Finding]:
        """Tells of those whose reports have not come back."""
        lasts = self.suspect & (sight.now_ns - self._since_ns >= _SUSPECT_S * SECOND_NS) & ~self._told
        for vehicle in np.flatnonzero(lasts & ours & ~sight.excused).tolist():
            self._told[vehicle] = True
            apart_m = float(np.linalg.norm(self._apart_m[vehicle]))
            what = f"its position is {apart_m:.2f} m from where its velocity leads, limit {self._limit_m:.2g} m"
            yield Finding(Reaction.LAND, what, (vehicle,), lost=True)


class LinkSilence:
    """Links on which nothing is heard of anybody any more."""

    def __init__(self, plan: MissionPlan) -> None:
        self._links = plan.links
        self._link_of_vehicle: IntArray = np.array(plan.link_of_vehicle)
        self._limit_s = _LINK_SHARE * plan.spec.limits.pose_lost_s
        self._lasting = Lasting(len(plan.links))

    def look(self, sight: Sight, ours: BoolArray) -> Iterator[Finding]:
        """Tells of a link that has several vehicles, all of them silent."""
        silent = sight.fleet.silent(sight.now_ns, self._limit_s)
        down = np.zeros(len(self._links), dtype=np.bool_)
        for link in range(len(self._links)):
            here = (self._link_of_vehicle == link) & ours
            down[link] = here.sum() > 1 and bool(silent[here].all())
        for link in self._lasting(down, sight.now_ns):
            rows = tuple(np.flatnonzero((self._link_of_vehicle == link) & ours & ~sight.excused).tolist())
            what = f"link {self._links[link]}: nothing heard of anybody for {self._limit_s:g} s"
            yield Finding(Reaction.LAND, what, rows, lost=True)


class PoseAge:
    """Poses that are too old to steer by, and poses that are lost."""

    def __init__(self, plan: MissionPlan) -> None:
        self._limits = plan.spec.limits
        self.hold: BoolArray = np.zeros(plan.size, dtype=np.bool_)
        self._old = Lasting(plan.size, again=True)
        self._lost = Lasting(plan.size)

    def look(self, sight: Sight, ours: BoolArray) -> Iterator[Finding]:
        """Holds those that are too old, lands those that are lost."""
        age_ns = sight.now_ns - sight.pose_ns
        self.hold = (age_ns > self._limits.pose_age_s * SECOND_NS) & ours
        for vehicle in self._old(self.hold, sight.now_ns):
            what = f"position is {age_ns[vehicle] / SECOND_NS:.2f} s old, limit {self._limits.pose_age_s:.2f} s"
            yield Finding(Reaction.HOLD, what, (vehicle,))
        lost = (age_ns > self._limits.pose_lost_s * SECOND_NS) & ours & ~sight.excused
        for vehicle in self._lost(lost, sight.now_ns):
            yield Finding(Reaction.LAND, f"no position for {self._limits.pose_lost_s:g} s", (vehicle,), lost=True)


class Frames:
    """Positions that no longer mean what they meant: another start, another origin, two positions that part."""

    def __init__(self, plan: MissionPlan) -> None:
        n = plan.size
        self._plan = plan
        self._origins_ns: IntArray = np.full(n, NEVER, dtype=np.int64)
        self._restarts: IntArray = np.zeros(n, dtype=np.int64)
        self._wrong = Lasting(n)
        self._twins = Lasting(n)

    def begin(self, origins_ns: IntArray, restarts: IntArray) -> None:
        """Takes what is so now for what should stay so."""
        self._origins_ns, self._restarts = origins_ns.copy(), restarts.copy()

    def look(self, sight: Sight, ours: BoolArray) -> Iterator[Finding]:
        """Lands those whose frame has changed; a second vehicle under the same id brings everybody back."""
        fleet = sight.fleet
        drifting = sight.drift_m > self._plan.frame_drift_m  # NaN is not
        restarted, moved = fleet.restarts > self._restarts, fleet.origin_moved_ns > self._origins_ns
        for vehicle in self._wrong((restarted | moved | drifting) & ours & ~sight.excused, sight.now_ns):
            if restarted[vehicle]:
                what = "its autopilot has started anew"
            elif moved[vehicle]:
                what = f"its origin has moved by {fleet.origin_moved_m[vehicle]:.2f} m"
            else:
                what = (
                    f"its local and global positions are {sight.drift_m[vehicle]:.2f} m apart, limit"
                    f" {self._plan.frame_drift_m:.2g} m"
                )
            yield Finding(Reaction.LAND, what, (vehicle,), lost=True)
        twins = {row: fleet.twin_behind_one_address(row, sight.now_ns) for row in range(len(fleet))}
        found = np.array([twins[row] is not None for row in range(len(fleet))])
        for vehicle in self._twins(found, sight.now_ns):
            yield Finding(Reaction.ALL_HOME, str(twins[vehicle]), (vehicle,))


class Tilt:
    """Vehicles that lean as nobody leans who is under control."""

    def __init__(self, plan: MissionPlan) -> None:
        self._limit_deg = plan.spec.limits.tilt_deg
        self._lasting = Lasting(plan.size, _TILTED_S)

    def look(self, sight: Sight, ours: BoolArray) -> Iterator[Finding]:
        """Lands those that are tilted for longer than a gust tilts."""
        quat = sight.fleet.quat_ned_from_frd
        cosine = np.clip(1.0 - 2.0 * (quat[:, 1] ** 2 + quat[:, 2] ** 2), -1.0, 1.0)
        tilt_deg = np.degrees(np.arccos(cosine))
        tilted = (tilt_deg > self._limit_deg) & sight.airborne & ours & ~sight.excused
        for vehicle in self._lasting(tilted, sight.now_ns):
            what = f"is tilted by {tilt_deg[vehicle]:.0f} degrees, limit {self._limit_deg:g} degrees"
            yield Finding(Reaction.LAND, what, (vehicle,), lost=True)
