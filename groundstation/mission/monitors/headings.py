"""Vehicles whose own north is wrong: they fly every velocity turned, and report the heading that they believe.

What a vehicle was told, delayed by its lag, is held against how its positions move, both level: the turn that takes
one to the other is the error of its heading, where it moves enough for that and the turn explains what it does. A wind
carries, it does not turn: what the wind explains is taken off first. On a curve a vehicle that is quicker or slower
than its lag says looks turned as well: the turn counts only if it is there with less than half and with twice the lag.
A vehicle steers by its own velocity, and where that is poor it goes aside by as much as it is wrong: slow ones look
turned then, and are not judged.

Who was found so is told everything turned back by as much, for what keeps vehicles apart counts on what is flown.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from groundstation.core.quick import any_of, renewed, some, squares
from groundstation.core.types import BoolArray, FloatArray
from groundstation.mission.monitors.findings import Finding, Lasting, Reaction, Sight
from groundstation.mission.monitors.speeds import PoorSpeeds
from groundstation.mission.monitors.wind import Wind, unexplained
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.timing import SinceBefore

_FORGETS_S = 1.0
_NEW_IN_AIR_S = 1.0
_LIMIT_RAD = math.radians(45.0)
_LASTS_S = 0.2
_APART_RAD = math.radians(40.0)
_LEAST_M_S, _LEAST_BY_GPS_M_S = 0.1, 0.3
"""Root mean square of what was told over the memory, level: below that a turn is not told from noise."""
_TIMES_POOR = 3.0
"""The same against the root mean square of a poor velocity's error. Seen on PX4's simulator as it comes: turned by 30
degrees and more up to 2.4 times that, by 55 degrees at 1.5 times."""
_LEVEL_SHARE = 0.3
"""Of what was told at all: who climbs steeply is blown and tilted aside by as much as it goes aside."""
_COHERENT = 0.85
"""Share of the motion that the turned velocities explain."""
_SLOW, _FAST = 0.5, 1.6
_LAGS = (1.0, 0.4, 2.0)
"""Times its lag that a vehicle may answer with; the first one is what its turn is measured by."""
REMEDY = "see to its compass, or to how its body is defined in the motion capture (front to the room's x axis)"


class Headings:
    """Turns between what vehicles are told and what they fly.

    Args:
        plan: with lags.
        wind: what carries healthy vehicles.
        speeds: how poor velocities are.

    Attributes:
        turn_rad: by how much those fly to the right of what they are told whose heading was found to be off, shape
            (n,); 0 for all others.
    """

    def __init__(self, plan: MissionPlan, wind: Wind, speeds: PoorSpeeds) -> None:
        n = plan.size
        self._wind, self._speeds = wind, speeds
        self._lag_s: FloatArray = np.outer(_LAGS, [profile.lag_s for profile in plan.vehicle_profiles])
        self._delay_s: FloatArray = np.array([profile.delay_s for profile in plan.vehicle_profiles])
        self._late: FloatArray = np.zeros((n, 3))
        self._model: FloatArray = np.zeros((len(_LAGS), n, 3))
        self._least_m_s = _LEAST_BY_GPS_M_S if plan.positioning == "gps" else _LEAST_M_S
        # Mean squares: told, level; told at all; flown, level.
        self._squares: FloatArray = np.zeros((3, n))
        self._both: FloatArray = np.zeros((len(_LAGS), n, 2))
        self._steered_s: FloatArray = np.zeros(n)
        self._since_before = SinceBefore(0)
        self._off, self._other = Lasting(n, _LASTS_S), Lasting(n, _LASTS_S)
        self.turn_rad: FloatArray = np.zeros(n)

    def look(self, sight: Sight, ours: BoolArray) -> Iterator[Finding]:
        """Names whose heading is off, and brings everybody back: avoidance counts on what is flown."""
        passed_s = min(self._since_before(sight.now_ns), 0.2)
        counts = sight.flown & ours
        self._steered_s = np.where(counts, self._steered_s + passed_s, 0.0)
        new = any_of(~(self._steered_s > _NEW_IN_AIR_S)[:, None])
        moves = sight.vel_ned_m_s - sight.vel_error_ned_m_s
        # A delay and a lag: two lags, which is near enough for a direction.
        late = np.minimum(passed_s / np.maximum(self._delay_s, passed_s), 1.0)[:, None] if passed_s > 0.0 else 1.0
        lags = np.minimum(passed_s / np.maximum(self._lag_s, passed_s), 1.0)[..., None] if passed_s > 0.0 else 1.0
        self._late = renewed(new, sight.sent_ned_m_s, self._late + late * (sight.sent_ned_m_s - self._late))
        self._model = renewed(new, moves, self._model + lags * (self._late - self._model))
        carried = unexplained(moves - self._model, self._wind.carried_m_s)
        told, flown = self._model[..., :2], (self._model + carried)[..., :2]
        share = min(passed_s / _FORGETS_S, 1.0)
        both = np.empty(told.shape)
        both[..., 0] = np.add.reduce(told * flown, axis=-1)
        both[..., 1] = told[..., 0] * flown[..., 1] - told[..., 1] * flown[..., 0]
        now = np.stack((squares(told[0]), squares(self._model[0]), squares(flown[0])))
        unknown = ~np.isfinite(now[2])
        fresh = any_of(unknown if new is None else new[:, 0] | unknown)
        self._squares = renewed(fresh, 0.0, self._squares + share * (now - self._squares))
        rows = None if fresh is None else fresh[:, None]
        self._both = renewed(rows, 0.0, self._both + share * (both - self._both))
        length = np.hypot(self._both[..., 0], self._both[..., 1])
        clear = self._clear(length[0])
        off = self._not_blown(clear & self._turned(length)) if some(clear) else clear
        news = self._off(off, sight.now_ns)
        found = clear & (self.turn_rad != 0.0)
        if not some(off | found):
            self._other(found, sight.now_ns)
            return
        angle_rad = np.arctan2(self._both[0, :, 1], self._both[0, :, 0])
        # Told everything turned back, a vehicle with a wrong north goes on flying turned by as much. One that does not
        # was never turned, is not any more, or goes its own way, which is for others to find.
        apart_rad = np.abs(np.mod(angle_rad - self.turn_rad + math.pi, 2.0 * math.pi) - math.pi)
        for vehicle in self._other(found & (apart_rad > _APART_RAD), sight.now_ns):
            self.turn_rad[vehicle] = 0.0
        self.turn_rad = np.where(found & (apart_rad <= _APART_RAD), angle_rad, self.turn_rad)
        for vehicle in news:
            self.turn_rad[vehicle] = angle_rad[vehicle]
            degrees = math.degrees(angle_rad[vehicle])
            side = "to the right" if degrees > 0.0 else "to the left"
            what = f"flies {abs(degrees):.0f} degrees {side} of what it is told, limit {math.degrees(_LIMIT_RAD):.0f}"
            what += ": its heading is off, and it is told that much less"
            yield Finding(Reaction.HOME, what, (vehicle,), remedy=REMEDY)

    def told(self, velocity_ned_m_s: FloatArray) -> FloatArray:
        """What vehicles are told so that they move as wanted, shape (n, 3); the same where no heading is off."""
        return self._rotated(velocity_ned_m_s, -1.0)

    def flown(self, sent_ned_m_s: FloatArray) -> FloatArray:
        """What they fly of what they are told, shape (n, 3)."""
        return self._rotated(sent_ned_m_s, 1.0)

    def _rotated(self, velocity_ned_m_s: FloatArray, sign: float) -> FloatArray:
        if not np.count_nonzero(self.turn_rad):
            return velocity_ned_m_s
        cos, sin = np.cos(sign * self.turn_rad), np.sin(sign * self.turn_rad)
        north, east, down = velocity_ned_m_s.T
        return np.stack([cos * north - sin * east, sin * north + cos * east, down], axis=1)

    def _clear(self, length: FloatArray) -> BoolArray:
        """Whose motion is what it was told, turned by some angle, shape (n,)."""
        told, told_at_all, flown = self._squares
        least_m_s = np.maximum(self._least_m_s, _TIMES_POOR * self._speeds.rms_m_s)
        moves = (told > least_m_s**2) & (told > _LEVEL_SHARE**2 * told_at_all)
        gain = length / np.maximum(told, 1e-9)
        explained = length**2 / np.maximum(told * flown, 1e-12)
        return np.asarray(moves & (explained > _COHERENT) & (gain > _SLOW) & (gain < _FAST), dtype=np.bool_)

    def _not_blown(self, off: BoolArray) -> BoolArray:
        """Without those that more wind pushes than the mission allows: they go where it carries them, shape (n,).

        In a room there is no such wind, and one that leans by a wrong north looks as if there were.
        """
        if self._least_m_s != _LEAST_BY_GPS_M_S or not some(off):  # no GPS, or nobody is turned
            return off
        blown = [bool(off[vehicle]) and bool(self._wind.blame(vehicle)) for vehicle in range(len(off))]
        return np.asarray(off & ~np.array(blown))

    def _turned(self, length: FloatArray) -> BoolArray:
        """Whose motion points more than the limit away from what it was told, to one side by all lags, shape (n,)."""
        along, across = self._both[..., 0], self._both[..., 1]
        far = along < math.cos(_LIMIT_RAD) * length
        one_side = (across > 0.0).all(axis=0) | (across < 0.0).all(axis=0)
        return np.asarray(far.all(axis=0) & one_side, dtype=np.bool_)
