"""How vehicles come to the ground: harder than a landing autopilot sets them down, or leaning, is told, whoever it is.

Judged by what a vehicle itself reported last before it lay still: how fast it moved, and how much faster it became on
the rest of its way down, as far as two reports show that. A fall between two reports that nobody saw is not told.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from groundstation.core import frames
from groundstation.core.quick import between, every, some, squares
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.mavlink.vehicle import NEVER, Fleet
from groundstation.mission.monitors.findings import Finding, Reaction, Sight
from groundstation.mission.plan.links import POSE_HZ
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.timing import SECOND_NS

HARD_M_S = 1.3
"""Landings of real firmware ended at 1.04 m/s and less; a fall from 9 cm ends at this."""
LEANS_DEG = 25.0
"""They leaned by 8 degrees and less, in still air; in 8 m/s of wind vehicles lean by 20 to 28 all the time."""
_USUAL_S = 1.0  # before it came to the ground: falls from 3 m last for less
_KEPT_S = 5.0  # autopilots tell that they stand one to two seconds after they do
_STILL_M_S, _STILL_NS = 0.25, 300_000_000
_BEFORE_S = 0.3  # estimates of a vehicle that hits the ground ring for that long
_SAME_HEIGHT_M = 0.4  # estimates of height settle by some of that after a landing
_AT_GROUND_M = 0.05
_GRAVITY_M_S2 = 9.81
_STOPS_M_S2 = 12.0  # harder than any rotor can
_NEAR_M = 0.3
_SPACED_S = 0.04  # reports that are nearer to each other tell no speed by their heights
_GAP_S = 1.0
_ONCE_NS = 5 * SECOND_NS
_DOWN, _ACROSS, _DEPTH, _LEAN = range(4)


class Touchdowns:
    """Vehicles that hit the ground."""

    def __init__(self, plan: MissionPlan) -> None:
        n = plan.size
        self._by_local: BoolArray = np.array([plan.position_message(row) != "GLOBAL_POSITION_INT" for row in range(n)])
        self._all_by_local = every(self._by_local)
        self._rows: IntArray = np.arange(n)
        self._ground_ned_m: FloatArray = frames.ned_from_enu(plan.pads_enu_m)[:, 2]
        self._near_m = _NEAR_M + plan.margin_m
        kept = math.ceil(_KEPT_S * POSE_HZ)
        self._t_ns: IntArray = np.full((kept, n), NEVER, dtype=np.int64)
        self._values: FloatArray = np.zeros((kept, n, 4))
        self._last: IntArray = np.full(n, kept - 1, dtype=np.int64)
        self._moves_ns: IntArray = np.full(n, NEVER, dtype=np.int64)  # when it was last seen to move up or down
        self._lifted: BoolArray = np.zeros(n, dtype=np.bool_)
        self._told_ns: IntArray = np.full(n, NEVER, dtype=np.int64)

    def look(self, sight: Sight, ours: BoolArray) -> Iterator[Finding]:
        """Tells of those that have come down hard; who may still be told to land is, and flies no more."""
        new = self._take(sight.fleet)
        self._lifted |= sight.airborne
        if not some(self._lifted):
            return
        height_m = self._ground_ned_m - sight.pos_team_ned_m[:, 2]
        near = new & self._lifted & (height_m < self._near_m)
        found = {row: self._stopped(row) for row in self._stops(near).nonzero()[0].tolist()} if some(near) else {}
        lies = self._lifted & ~sight.airborne & new
        if some(lies):
            lies &= self._now_ns() - self._moves_ns >= _STILL_NS
        for row in lies.nonzero()[0].tolist():
            self._lifted[row] = False
            found.setdefault(row, self._lay_down(row))
        for row, what in found.items():
            if what and sight.now_ns - self._told_ns[row] > _ONCE_NS:
                self._told_ns[row] = sight.now_ns
                if ours[row]:
                    yield Finding(Reaction.FAILED if sight.excused[row] else Reaction.LAND, what, (row,), lies=True)
                else:
                    yield Finding(Reaction.SAY, what, (row,), fate=True)

    def _take(self, fleet: Fleet) -> BoolArray:
        """Keeps the reports that are new; returns whose are, shape (n,)."""
        local = None if self._all_by_local else self._by_local
        t_ns = fleet.pose_ns if local is None else np.where(local, fleet.pose_ns, fleet.place_ns)
        new: BoolArray = t_ns > self._now_ns()
        if not some(new):
            return new
        vel, depth_m, quat = fleet.vel_ned_m_s, fleet.pos_local_ned_m[:, 2], fleet.quat_ned_from_frd
        if local is not None:
            vel = np.where(local[:, None], vel, fleet.place_vel_ned_m_s)
            depth_m = np.where(local, depth_m, -fleet.place_deg_m[:, 2])
        report: FloatArray = np.empty((len(new), 4))
        report[:, _DOWN], report[:, _DEPTH] = vel[:, 2], depth_m
        np.hypot(vel[:, 0], vel[:, 1], out=report[:, _ACROSS])
        lying = quat[:, 1:3]
        report[:, _LEAN] = np.degrees(np.arccos(between(1.0 - 2.0 * squares(lying), -1.0, 1.0)))
        following = (self._last + 1) % len(self._t_ns)
        if every(new):
            self._last = following
            self._t_ns[following, self._rows], self._values[following, self._rows] = t_ns, report
        else:
            at, who = following[new], self._rows[new]
            self._last[new] = at
            self._t_ns[at, who], self._values[at, who] = t_ns[new], report[new]
        moves = new & ~(np.abs(vel[:, 2]) <= _STILL_M_S)
        self._moves_ns[moves] = t_ns[moves]
        return new

    def _now_ns(self) -> IntArray:
        """When the newest report of each was measured, shape (n,)."""
        return np.asarray(self._t_ns[self._last, self._rows])

    def _stops(self, near: BoolArray) -> BoolArray:
        """Whose fall has ended between the last two reports, as only the ground ends it, shape (n,).

        Args:
            near: who has lifted off, is near the ground and has reported since the tick before, shape (n,).
        """
        rows, before = self._rows, self._last - 1
        passed_s = np.maximum((self._now_ns() - self._t_ns[before, rows]) / SECOND_NS, 1e-3)
        was, now = self._values[before, rows], self._values[self._last, rows]
        changes_m_s = np.hypot(was[:, _DOWN] - now[:, _DOWN], was[:, _ACROSS] - now[:, _ACROSS])
        fell = (was[:, _DOWN] > 0.0) & (np.hypot(was[:, _DOWN], was[:, _ACROSS]) > 0.5 * HARD_M_S)
        # One that tumbles gets faster as hard; what has hit the ground does not go on downwards.
        fell &= (changes_m_s > _STOPS_M_S2 * passed_s) & (now[:, _DOWN] < 0.5 * was[:, _DOWN])
        return np.asarray(near & fell & (passed_s < _GAP_S))

    def _series(self, row: int) -> tuple[FloatArray, FloatArray]:
        """Times in s, shape (k,), and reports, shape (k, 4), of one vehicle, in order."""
        order = np.roll(np.arange(len(self._t_ns)), -int(self._last[row]) - 1)
        t_ns = self._t_ns[order, row]
        kept = t_ns > t_ns[-1] - round(_KEPT_S * SECOND_NS)
        return (t_ns[kept] - t_ns[-1]) / SECOND_NS, self._values[order[kept], row]

    def _stopped(self, row: int) -> str:
        """What to tell of one whose fall has just ended, "" for nothing."""
        t_s, values = self._series(row)
        lean_deg = float(values[-3:, _LEAN].max()) - _usual_deg(t_s, values, len(t_s) - 1)
        return _words(_speed_m_s(t_s, values, len(t_s) - 2), lean_deg)

    def _lay_down(self, row: int) -> str:
        """What to tell of one that has come to rest, "" for nothing."""
        t_s, values = self._series(row)
        came = np.flatnonzero(values[:, _DOWN] > _STILL_M_S)
        if not len(came):
            return ""
        last = int(came[-1])
        above_m = values[-1, _DEPTH] - values[:, _DEPTH]
        if abs(above_m[last]) > _SAME_HEIGHT_M or last + 1 == len(t_s):
            return ""  # it has crept down since
        just = (t_s >= t_s[last] - _BEFORE_S) & (np.arange(len(t_s)) <= last) & (above_m < _AT_GROUND_M)
        just[last] = True
        speed_m_s = max(_speed_m_s(t_s, values, int(k)) for k in np.flatnonzero(just))
        since = t_s >= t_s[last] - 0.5 * _BEFORE_S
        return _words(speed_m_s, float(values[since, _LEAN].max()) - _usual_deg(t_s, values, last))


def _speed_m_s(t_s: FloatArray, values: FloatArray, k: int) -> float:
    """How fast a vehicle became after its report k, when that was the last one before the ground.

    Its report k + 1 is on the ground: the rest of the way is between the two, it grew faster on it as it did between
    k - 1 and k, and took no longer than from k to k + 1.
    """
    down, across = float(values[k, _DOWN]), float(values[k, _ACROSS])
    passed_s = float(t_s[k + 1] - t_s[k])
    way_m = float(np.clip(values[k + 1, _DEPTH] - values[k, _DEPTH], 0.0, _SAME_HEIGHT_M))
    fastest = down + _GRAVITY_M_S2 * min(passed_s, _GAP_S)
    before_s = float(t_s[k] - t_s[k - 1]) if k > 0 else math.inf
    grows = np.clip((down - float(values[k - 1, _DOWN])) / before_s, 0.0, _GRAVITY_M_S2) if before_s < _GAP_S else 0.0
    at_ground = math.sqrt(max(down, 0.0) ** 2 + 2.0 * float(grows) * way_m)
    if passed_s >= _SPACED_S:
        at_ground = max(at_ground, 2.0 * way_m / passed_s - down)
    return math.hypot(min(max(at_ground, down), fastest), across)


def _usual_deg(t_s: FloatArray, values: FloatArray, last: int) -> float:
    """How far it leaned all the time before its report ``last``, as in a wind; 0 when that is not known."""
    before = t_s < t_s[last] - _USUAL_S
    return float(np.median(values[before, _LEAN])) if before.any() else 0.0


def _words(speed_m_s: float, lean_deg: float) -> str:
    """What to tell, "" where it came down as a landing does."""
    care = "look at its legs and propellers before it flies again"
    if speed_m_s > HARD_M_S:
        return f"has hit the ground at {speed_m_s:.1f} m/s, a landing ends below {HARD_M_S:g} m/s; {care}"
    if lean_deg > LEANS_DEG:
        leans = f"leaning by {lean_deg:.0f} degrees more than before, a landing by less than {LEANS_DEG:g}"
        return f"has come to the ground {leans}; {care}"
    return ""
