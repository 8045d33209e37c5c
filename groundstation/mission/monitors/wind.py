"""The wind, judged against what the mission allows: told when it comes near to the limit, everybody home beyond it."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from groundstation.core import frames
from groundstation.core.quick import between, every, finite_rows, length, norms, squares
from groundstation.core.types import BoolArray, FloatArray
from groundstation.core.wind import WindEstimate
from groundstation.mission.monitors.findings import SINGLE, Finding, Lasting, Reaction, Sight
from groundstation.mission.monitors.speeds import PoorSpeeds
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.wind import sway_s2
from groundstation.mission.timing import SinceBefore
from groundstation.mission.verdict import Figures

_LASTS_S = 3.0
_SAY_SHARE = 0.85
_MEAN_OVER, _GUST_OVER = 1.15, 1.3  # what an estimate of some seconds may be off by chance
_GUST_UNSURE_M_S = 0.1
_CALM_M_S = 0.2  # gusts less than that are not told from errors of the attitude
_LEVEL_M_S2 = 0.12
_FADES_S = 4.0  # missing setpoints is found two seconds after the gust, or later
_SHAKEN_LOOKS = 4.0  # times the error of a poor velocity looks like gusts: 1.0 m/s of 0.25, 2.6 of 0.77 in calm air
_POINTS = ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")


class Wind:
    """Wind as the vehicles feel it; holds what else wants to know of it.

    Vehicles whose link is too narrow for attitudes are left out: how they lean is not known.
    """

    def __init__(self, plan: MissionPlan, speeds: PoorSpeeds) -> None:
        n = plan.size
        self._limit, self._speeds = plan.wind, speeds
        self._leans: BoolArray = np.array([not plan.rates_of(i).lean for i in range(n)])
        profiles = plan.vehicle_profiles
        self._airframes = [profile.airframe for profile in profiles]
        self.estimate = WindEstimate(self._airframes, np.array([profile.lag_s for profile in profiles]))
        # More than the wind of the limit does is no excuse.
        strongest = np.array([plan.wind.mean_m_s + 3.0 * plan.wind.gust_m_s, 0.0, 0.0])
        self._excuse_max_m_s: FloatArray = np.array(
            [[profile.airframe.push_lag_s * profile.airframe.pull_m_s2(strongest)[0]] for profile in profiles]
        )
        self._frame, self._sway_s2 = plan.profile.airframe, sway_s2(plan.profile, plan.lead_s)
        # A vehicle that hangs half a degree askew looks as if it leant into a wind.
        self._unsure_m_s = _LEVEL_M_S2 / plan.profile.airframe.air_1_s
        self._hardest_m_s2: FloatArray = np.zeros(n)
        self._since_before = SinceBefore(0)
        self._felt: tuple[FloatArray, float, float] | None = None
        self._carried: tuple[FloatArray | None, FloatArray] = (None, np.zeros((n, 3)))
        self._near, self._beyond = Lasting(1, _LASTS_S), Lasting(1, _LASTS_S)

    @property
    def carried_m_s(self) -> FloatArray:
        """Velocity that a healthy vehicle may be carried with at the moment, against its will, shape (n, 3)."""
        expected = self.estimate.expected_m_s
        if self._carried[0] is not expected:  # several ask in a tick
            size = norms(expected)[..., None]
            self._carried = expected, expected * np.minimum(1.0, self._excuse_max_m_s / np.maximum(size, 1e-9))
        return self._carried[1]

    def blame(self, vehicle: int) -> str:
        """What is said besides of a vehicle that misses its setpoints in more wind than the limit; else nothing.

        By the hardest push on this vehicle of the last seconds: the wind of the team is known later, and is a mean.
        """
        pull_m_s2 = np.array([self._hardest_m_s2[vehicle], 0.0, 0.0])
        felt_m_s = length(self._airframes[vehicle].air_m_s(pull_m_s2))
        limit = self._limit
        if not self._leans[vehicle] or felt_m_s <= limit.mean_m_s + 2.0 * limit.gust_m_s + self._unsure_m_s:
            return ""
        return f"; a wind of {felt_m_s:.1f} m/s pushes it, the limit is {limit.words()}"

    @property
    def _gust_m_s(self) -> float:
        """Gusts as they are felt, less what poor velocities look like: a vehicle leans to mend what is no motion."""
        told, felt_m_s = self._speeds.told_error_m_s, self.estimate.gust_m_s
        if self._felt is None or self._felt[0] is not told or self._felt[1] != felt_m_s:  # several ask in a tick
            rms_m_s = self._speeds.rms_m_s
            shaken_m_s = _SHAKEN_LOOKS * math.sqrt(np.add.reduce(rms_m_s * rms_m_s) / len(rms_m_s))
            self._felt = told, felt_m_s, math.sqrt(max(felt_m_s**2 - shaken_m_s**2, 0.0))
        return self._felt[2]

    @property
    def sway_m(self) -> float:
        """How far distances may sway in the gusts of the moment, up to those of the limit; 0 in calm air."""
        gust_m_s = min(self._gust_m_s, self._limit.gust_m_s)
        if self._gust_m_s < _CALM_M_S:
            return 0.0
        mean_m_s = min(length(self.estimate.mean_ned_m_s), self._limit.mean_m_s)
        return self._sway_s2 * self._frame.slope_1_s(mean_m_s) * gust_m_s

    def enter(self, figures: Figures) -> None:
        """Enters the strongest wind that was seen."""
        if self.estimate.known:
            mean_m_s = length(self.estimate.mean_ned_m_s)
            figures.felt(mean_m_s, self._gust_m_s)

    def look(self, sight: Sight, ours: BoolArray) -> Iterator[Finding]:
        """Tells of wind near the limit, and brings everybody back from more than that."""
        passed_s = min(self._since_before(sight.now_ns), 0.2)
        counts = sight.flown & ours & self._leans
        quat = sight.fleet.quat_ned_from_frd
        leans: BoolArray = finite_rows(quat)  # who was never heard has no attitude
        counts &= leans
        level = quat if every(leans) else np.where(leans[:, None], quat, np.array([1.0, 0.0, 0.0, 0.0]))
        down_ned = frames.down_ned(level)
        # A vehicle whose velocity is wrong leans to what it takes for its velocity, and that is no wind.
        moves_m_s, told_m_s = (vel - sight.vel_error_ned_m_s for vel in (sight.vel_ned_m_s, sight.sent_ned_m_s))
        self.estimate.step(passed_s, moves_m_s, down_ned, told_m_s, counts)
        faded_m_s2 = self._hardest_m_s2 * (1.0 - passed_s / _FADES_S)
        self._hardest_m_s2 = np.maximum(faded_m_s2, norms(self.estimate.push_m_s2))
        mean_m_s, gust_m_s = length(self.estimate.mean_ned_m_s), self._gust_m_s
        limit = self._limit
        near = (
            mean_m_s > _SAY_SHARE * limit.mean_m_s + self._unsure_m_s
            or gust_m_s > _SAY_SHARE * limit.gust_m_s + _GUST_UNSURE_M_S
        )
        beyond = mean_m_s > _MEAN_OVER * limit.mean_m_s + self._unsure_m_s
        beyond |= gust_m_s > _GUST_OVER * limit.gust_m_s + _GUST_UNSURE_M_S
        for _ in self._beyond(SINGLE[self.estimate.known and beyond], sight.now_ns):
            what = f"{self._words(mean_m_s, gust_m_s)}; the limit is {limit.words()}"
            yield Finding(Reaction.ALL_HOME, what, remedy="wait for less wind, or state more of it in the mission")
        for _ in self._near(SINGLE[self.estimate.known and near], sight.now_ns):
            what = f"{self._words(mean_m_s, gust_m_s)}; the limit is {limit.words()}"
            yield Finding(Reaction.SAY, what, remedy="bring them back before it is more")

    def _words(self, mean_m_s: float, gust_m_s: float) -> str:
        north, east, _ = self.estimate.mean_ned_m_s
        point = _POINTS[round(math.atan2(-east, -north) / (math.pi / 4.0)) % 8]
        return f"wind of {mean_m_s:.1f} m/s from the {point} with gusts of {gust_m_s:.1f} m/s"


def unexplained(error_m_s: FloatArray, carried_m_s: FloatArray) -> FloatArray:
    """What is left of errors when the wind explains what it can of them, and nothing besides, shape (..., n, 3)."""
    along = np.add.reduce(error_m_s * carried_m_s, axis=-1) / np.maximum(squares(carried_m_s), 1e-12)
    return np.asarray(error_m_s - between(along, 0.0, 1.0)[..., None] * carried_m_s)
