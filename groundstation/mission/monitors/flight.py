"""Monitors of how the team flies: fence, following, distances, and our own punctuality."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator

import numpy as np

from groundstation.core.limits import Fence
from groundstation.core.metrics import near_pairs
from groundstation.core.quick import any_of, every, length, norms, renewed, some
from groundstation.core.types import BoolArray, FloatArray
from groundstation.mission.monitors.findings import SINGLE, Finding, Lasting, LastingOf, Reaction, Sight
from groundstation.mission.monitors.headings import Headings
from groundstation.mission.monitors.wind import Wind, unexplained
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.timing import SECOND_NS, SinceBefore

_BESIDE_S = 0.2  # fence and distances: longer than a bad packet, shorter than harm
_INCOMPLETE_SHARE = 0.5  # of the safety region, where a mission leaves out a part of avoidance
_SMOOTH_S = 1.0
_STRAYS_S = 2.0
_STRAYS_ON_S = 6.0
_NEW_IN_AIR_S = 3.0
_RATE_OVER_S = 2.0
_RATE_SHARE, _RATE_MIN_HZ = 0.2, 5.0
_OWN_RATE_SHARE = 0.5
_BUSY = "end what else this computer does, and keep it from sleeping"
_STREAM_OVER_S, _STREAM_MIN_HZ = 5.0, 2.0  # PX4 leaves OFFBOARD below 2 Hz, and comes back by itself with the next few


class BeyondFence:
    """Vehicles outside the fence, towards which nobody is steered.

    The floor counts for those who have risen above it: heights wander on the ground. PX4 was seen to tell of 0.09 m
    above its pad and 4 s later of 0.32 m below it, and to say that it takes off 2 s before it does.
    """

    def __init__(self, plan: MissionPlan) -> None:
        spec = plan.spec
        self._limit_m = spec.limits.fence_beyond_m
        self._fence = Fence.from_enu(np.array(spec.fence.min_m), np.array(spec.fence.max_m))
        self._lasting = Lasting(plan.size, _BESIDE_S)
        self._risen: BoolArray = np.zeros(plan.size, dtype=np.bool_)

    def look(self, sight: Sight, ours: BoolArray) -> Iterator[Finding]:
        """Brings everybody back: whatever carries one vehicle out may carry out the next."""
        floor_ned_m, down_m = self._fence.max_team_ned_m[2], sight.pos_team_ned_m[:, 2]
        self._risen = sight.airborne & (self._risen | (down_m <= floor_ned_m - self._limit_m))
        counted = sight.pos_team_ned_m
        if not every(self._risen):
            counted = counted.copy()
            counted[:, 2] = np.where(self._risen, down_m, np.minimum(down_m, floor_ned_m))
        outside_m = self._fence.outside_m(counted)
        counts = ours & ~sight.excused & ~sight.blind
        for vehicle in self._lasting((outside_m > self._limit_m) & counts, sight.now_ns):
            what = f"{outside_m[vehicle]:.2f} m outside the fence, limit {self._limit_m:g} m"
            yield Finding(Reaction.ALL_HOME, what, (vehicle,))


class Following:
    """Vehicles that do not do what they are told, compared with a first-order lag that does, in the same wind."""

    def __init__(self, plan: MissionPlan, wind: Wind, headings: Headings) -> None:
        n = plan.size
        self._wind, self._headings = wind, headings
        self._limit_m_s = plan.limits.tracking_m_s
        self._lag_s: FloatArray = np.array([profile.lag_s for profile in plan.vehicle_profiles])
        # Whoever strays gets its setpoints as they are from then on, and answers with the lag of its own.
        own_lag_s = [item.response.lag_s if item.response else item.lag_s for item in plan.vehicle_profiles]
        self._own_lag_s: FloatArray = np.array(own_lag_s)
        self._model: FloatArray = np.zeros((n, 3))
        self._error: FloatArray = np.zeros((n, 3))
        self._carried: FloatArray = np.zeros((n, 3))
        self._steered_s: FloatArray = np.zeros(n)
        self._since_before = SinceBefore(0)
        self._first, self._again = Lasting(n, _STRAYS_S), Lasting(n, _STRAYS_ON_S)
        self.strays: BoolArray = np.zeros(n, dtype=np.bool_)

    def look(self, sight: Sight, ours: BoolArray) -> Iterator[Finding]:
        """Brings back whoever strays, and lands it where it is when it goes on straying."""
        passed_s = min(self._since_before(sight.now_ns), 0.2)
        counts = sight.flown & ours
        self._steered_s = np.where(counts, self._steered_s + passed_s, 0.0)
        new = any_of(~(self._steered_s > _NEW_IN_AIR_S)[:, None])
        step = np.minimum(passed_s / np.maximum(self._lag_s, passed_s), 1.0)[:, None]
        sent = self._headings.flown(sight.sent_ned_m_s)
        self._model = renewed(new, sight.vel_ned_m_s, self._model + step * (sent - self._model))
        error = self._error + passed_s / _SMOOTH_S * (sight.vel_ned_m_s - self._model - self._error)
        unknown = any_of(~np.isfinite(error))
        self._error = renewed(new, 0.0, renewed(unknown, 0.0, error))
        carried = self._carried + passed_s / _SMOOTH_S * (self._wind.carried_m_s - self._carried)
        self._carried = renewed(new, 0.0, carried)
        off_m_s = norms(unexplained(self._error, self._carried))
        away = off_m_s > self._limit_m_s
        for vehicle in self._first(away, sight.now_ns):
            self.strays[vehicle] = True
            self._lag_s[vehicle] = self._own_lag_s[vehicle]
            what = f"does not follow its setpoints by {off_m_s[vehicle]:.2f} m/s, limit {self._limit_m_s:.2g} m/s"
            blown = self._wind.blame(vehicle)
            remedy = "" if blown else "see to its motors, propellers and load before it flies again"
            yield Finding(Reaction.HOME, what + blown, (vehicle,), remedy=remedy)
        for vehicle in self._again(away, sight.now_ns):
            yield Finding(Reaction.LAND, f"has not followed its setpoints for {_STRAYS_ON_S:g} s", (vehicle,))
        self.strays &= away


class Distance:
    """Two vehicles nearer to each other than r, or in each other's safety region, by their own reports.

    One of the two at least is in the air. The other one may stand, land, or be ours no more, as long as it says where
    it is: whoever flies can come down on it all the same. Two that stand are as they were put.
    """

    def __init__(self, plan: MissionPlan) -> None:
        self._n = plan.size
        self._region = plan.region
        self._told_ns = round(plan.spec.limits.pose_lost_s * SECOND_NS)
        self._lasting = LastingOf(_BESIDE_S)
        # Without the whole of avoidance vehicles do come nearer than r, and whoever flies them so has been told.
        self._least = 1.0 if plan.spec.avoidance.method == "both" else _INCOMPLETE_SHARE
        self._expected = LastingOf(_BESIDE_S)

    def look(self, sight: Sight, ours: BoolArray) -> Iterator[Finding]:
        """Brings everybody back: what has kept them apart has failed."""
        first, second = near_pairs(sight.pos_team_ned_m, self._region.reach_m(0.0))
        offsets = sight.pos_team_ned_m[second] - sight.pos_team_ned_m[first]
        apart = self._region.clearance(offsets)
        near: BoolArray = apart < 1.0
        if not some(near):
            self._expected([], sight.now_ns)
            self._lasting([], sight.now_ns)
            return
        known = ~sight.blind & (sight.now_ns - sight.pose_ns < self._told_ns)
        flies = sight.airborne & ours
        near &= known[first] & known[second] & (flies[first] | flies[second])
        rows = near.nonzero()[0]
        numbers = (first[rows] * self._n + second[rows]).tolist()
        of_pair = dict(zip(numbers, zip(rows.tolist(), apart[rows].tolist(), strict=True), strict=True))
        expected = [number for number in numbers if of_pair[number][1] >= self._least]
        wrong = [number for number in numbers if of_pair[number][1] < self._least]
        for number in self._expected(expected, sight.now_ns):
            row, clearance = of_pair[number]
            words = self._region.near_words(length(offsets[row]), clearance)
            yield Finding(Reaction.SAY, words, divmod(number, self._n), pair=True)
        for number in self._lasting(wrong, sight.now_ns):
            row, clearance = of_pair[number]
            both = divmod(number, self._n)
            words = self._region.near_words(length(offsets[row]), clearance)
            for other in (vehicle for vehicle in both if not ours[vehicle]):  # one of them at least is ours: it flies
                words = f"too near to vehicle {sight.fleet.ids[other]}, {words}"
            yield Finding(Reaction.ALL_HOME, words, both, pair=True)


class LateTicks:
    """Our own punctuality: control, avoidance and the autopilots all reckon with it."""

    def __init__(self, plan: MissionPlan) -> None:
        self._late_s = plan.spec.limits.late_s
        # A law of one's own that takes longer than a tick is stopped sooner than a machine that is busy for a while.
        share = _OWN_RATE_SHARE if plan.own_code else _RATE_SHARE
        self._least_hz = max(share * plan.spec.rate_hz, _RATE_MIN_HZ)
        self._since_before = SinceBefore()
        self._ticks: deque[int] = deque()
        self._recent: deque[int] = deque()
        self._late, self._slow, self._silent = Lasting(1, again=True), Lasting(1), Lasting(1)

    def look(self, sight: Sight, ours: BoolArray) -> Iterator[Finding]:
        """Brings everybody back when ticks are late; ends a stream that flickers."""
        now_ns = sight.now_ns
        gap_s = self._since_before(now_ns)
        self._ticks.append(now_ns)
        self._recent.append(now_ns)
        while now_ns - self._ticks[0] > _STREAM_OVER_S * SECOND_NS:
            self._ticks.popleft()
        while now_ns - self._recent[0] >= _RATE_OVER_S * SECOND_NS:
            self._recent.popleft()
        reach_s = (now_ns - self._ticks[0]) / SECOND_NS
        recent = len(self._recent)
        if self._late(SINGLE[gap_s > self._late_s], now_ns):
            what = f"the ground station stood still for {gap_s:.2f} s, limit {self._late_s:g} s"
            yield Finding(Reaction.ALL_HOME, what, remedy=_BUSY)
        slow = reach_s > _RATE_OVER_S and recent < self._least_hz * _RATE_OVER_S
        if self._slow(SINGLE[slow], now_ns):
            what = f"the ground station makes {recent / _RATE_OVER_S:.1f} ticks a second, minimum is"
            yield Finding(Reaction.ALL_HOME, f"{what} {self._least_hz:g}", remedy=_BUSY)
        rare = reach_s > _STREAM_OVER_S - 1.0 / _STREAM_MIN_HZ and len(self._ticks) < _STREAM_OVER_S * _STREAM_MIN_HZ
        if self._silent(SINGLE[rare], now_ns):
            what = f"the ground station makes less than {_STREAM_MIN_HZ:g} ticks a second, autopilots come and go with"
            yield Finding(Reaction.SILENCE, f"{what} that", urgent=True, remedy=_BUSY)


def bounded_growth_m(first_m: float, rate_m_s: float, age_s: FloatArray, most_m: float) -> FloatArray:
    """A radius that grows with time up to a bound, shape of ``age_s``; an age that is not known counts as long ago."""
    age_s = np.where(np.isfinite(age_s), age_s, math.inf)
    return np.asarray(np.minimum(first_m + rate_m_s * np.maximum(age_s, 0.0), most_m))
