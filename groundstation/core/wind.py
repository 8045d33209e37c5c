"""What wind does to a multirotor, and what that takes away from the distance of two of them.

Air that moves past a vehicle pulls at it; the velocity loop leans against the pull, at once with its proportional part
and for good with its integral. Figures of a vehicle in, deviations out: no vehicle, no mission is known here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_continuous_lyapunov

from groundstation.core.quick import any_of, finite_rows, length, median, norms, renewed, squares
from groundstation.core.types import BoolArray, FloatArray

GUST_TAU_S = (0.5, 1.0, 2.0, 4.0, 8.0)
"""Correlation times of gusts that are tried: an eddy of metres passing at metres a second. The worst one counts."""


@dataclass(frozen=True)
class Airframe:
    """How a vehicle takes the wind.

    Attributes:
        air_1_s, air_1_m: the air pulls with (air_1_s + air_1_m |u|) u, u being its velocity past the vehicle: drag of
            the rotors, and of the body.
        drag_1_s: what the vehicle's own motion through still air costs, deceleration per speed.
        push_lag_s: time constant with which the velocity loop takes back a velocity that a push has caused: a lasting
            push of a makes push_lag_s a, at first.
        settle_s: time constant with which its integral takes back the rest.
    """

    air_1_s: float
    air_1_m: float
    drag_1_s: float
    push_lag_s: float
    settle_s: float

    def pull_m_s2(self, air_m_s: FloatArray) -> FloatArray:
        """Acceleration by air that moves past the vehicle, shape (..., 3)."""
        speed = norms(air_m_s)[..., None]
        return np.asarray((self.air_1_s + self.air_1_m * speed) * air_m_s)

    def slope_1_s(self, mean_m_s: float) -> float:
        """Acceleration by one m/s more of wind, along a mean wind."""
        return self.air_1_s + 2.0 * self.air_1_m * mean_m_s

    def air_m_s(self, pull_m_s2: FloatArray) -> FloatArray:
        """Velocity of the air past the vehicle that pulls so, shape (..., 3): the inverse of ``pull_m_s2``."""
        size = norms(pull_m_s2)[..., None]
        # The stable form of (sqrt(a^2 + 4 b p) - a) / (2 b), good for b = 0 too.
        root = np.sqrt(self.air_1_s**2 + 4.0 * self.air_1_m * size)
        return np.asarray(2.0 * pull_m_s2 / (self.air_1_s + root))


def velocity_deviation(frame: Airframe, gust_tau_s: float) -> float:
    """Standard deviation of one axis of the velocity, per standard deviation of the gusts' acceleration, s.

    v' = a - v / push_lag - (integral of v) / (push_lag settle), with a of correlation time ``gust_tau_s``.
    """
    system = np.array(
        [
            [-1.0 / gust_tau_s, 0.0, 0.0],
            [1.0, -1.0 / frame.push_lag_s, -1.0 / (frame.push_lag_s * frame.settle_s)],
            [0.0, 1.0, 0.0],
        ]
    )
    return math.sqrt(_variances(system, 2.0 / gust_tau_s)[1])


def distance_deviation(
    frame: Airframe, gust_tau_s: float, *, rate_1_s: float, horizon_s: float, stale_s: float
) -> float:
    """Standard deviation of the distance of two vehicles at the damper's bound, per that of their gusts, s^2.

    Both are in gusts of their own; the damper commands u = -rate (d + horizon d') between them, which takes effect
    ``stale_s`` late. States: the gusts' difference, d', its integral in the loops, the command, d.

    Args:
        frame: of both.
        gust_tau_s: correlation time of the gusts' acceleration.
        rate_1_s: alpha of the damper.
        horizon_s: its T.
        stale_s: from a measurement to the command's effect, > 0.
    """
    quick, slow = 1.0 / frame.push_lag_s, 1.0 / (frame.push_lag_s * frame.settle_s)
    system = np.array(
        [
            [-1.0 / gust_tau_s, 0.0, 0.0, 0.0, 0.0],
            [1.0, -quick, slow, quick, 0.0],
            [0.0, -1.0, 0.0, 1.0, 0.0],
            [0.0, -rate_1_s * horizon_s / stale_s, 0.0, -1.0 / stale_s, -rate_1_s / stale_s],
            [0.0, 1.0, 0.0, 0.0, 0.0],
        ]
    )
    if np.linalg.eigvals(system).real.max() >= 0.0:
        return math.inf
    return math.sqrt(2.0 * _variances(system, 2.0 / gust_tau_s)[4])


def blown_m(frame: Airframe, mean_m_s: float, *, rate_1_s: float, lead_s: float, speed_m_s: float) -> float:
    """How far a vehicle is blown from its place when it lifts off into a wind, until its integral holds against it.

    It is told u = -rate (x + lead x'), no faster than the speed limit.

    Args:
        frame: of the vehicle.
        mean_m_s: wind.
        rate_1_s: of the approach to a place.
        lead_s: how far ahead motion counts in it.
        speed_m_s: largest commanded speed.
    """
    pull_m_s2 = float(frame.pull_m_s2(np.array([mean_m_s, 0.0, 0.0]))[0])
    step_s = 0.05 * min(frame.push_lag_s, 1.0 / rate_1_s)
    way_m = vel_m_s = missed_m = farthest_m = 0.0
    for _ in range(round(40.0 * frame.settle_s / step_s)):
        told_m_s = min(max(-rate_1_s * (way_m + lead_s * vel_m_s), -speed_m_s), speed_m_s)
        missed_m += (vel_m_s - told_m_s) * step_s
        lean_m_s2 = (vel_m_s - told_m_s + missed_m / frame.settle_s) / frame.push_lag_s
        vel_m_s += (pull_m_s2 - lean_m_s2) * step_s
        way_m += vel_m_s * step_s
        if way_m < farthest_m:
            break
        farthest_m = way_m
    return farthest_m


def _variances(system: FloatArray, drive: float) -> FloatArray:
    """Stationary variances of x' = A x with white noise of this density on the first state."""
    noise = np.zeros_like(system)
    noise[0, 0] = drive
    return np.asarray(np.diag(solve_continuous_lyapunov(system, -noise)), dtype=np.float64)


_SMOOTH_S = 0.5  # of what accelerations are worked out with
_NEW_S = 2.0  # after lift-off, in which nothing is believed
_MEAN_S = 10.0  # slower than that is mean wind, quicker is a gust
_SPREAD_S = 20.0  # over which gusts are counted together
_KNOWN_S = 8.0
_OWN_SHARE = 0.25  # of what a vehicle's own motion costs that is not known well enough to be told from wind
_LEVEL_M_S2 = 0.06  # standard deviation of what looks like a push and is an attitude 0.35 degrees off
_SHORTFALL = 0.8  # share of gusts of some 2 s that comes through, of which smoothing and the running mean take the rest
_GRAVITY_M_S2 = 9.80665
_LEVEL = np.array([1.0, 1.0, 0.0])


class WindEstimate:
    """The wind, from how vehicles lean: what accelerates them and is not their own tilt is the air.

    A vehicle that keeps its place in a wind leans into it; one that does not lean yet is carried off. Both are one and
    the same push: measured acceleration less that of the tilt, less what its own motion through still air costs. That
    motion is the one that was commanded, as it follows with the vehicle's lag. Horizontal only. Knows no limits.

    Attributes:
        push_m_s2: on each vehicle, NED, shape (n, 3), zero where not known.
        expected_m_s: velocity that the push gives a vehicle that stands against it as its airframe says, shape (n, 3).
        mean_ned_m_s: mean wind of the team, shape (3,), the way the air goes; zeros before it is known.
        gust_m_s: standard deviation of the gusts, one axis; zero before it is known.
        known: enough was seen.

    Args:
        frames: of each vehicle.
        lag_s: with which it follows a command, shape (n,).
    """

    def __init__(self, frames: Sequence[Airframe], lag_s: FloatArray) -> None:
        n = len(frames)
        self._frames, self._lag_s = tuple(frames), lag_s[:, None]
        self._kinds = [
            (kind, np.array([i for i, frame in enumerate(frames) if frame == kind])) for kind in dict.fromkeys(frames)
        ]
        self._drag = np.array([frame.drag_1_s for frame in frames])[:, None]
        self._push_lag_s = np.array([frame.push_lag_s for frame in frames])[:, None]
        self._settle_s = np.array([frame.settle_s for frame in frames])[:, None]
        self._passed_s = -1.0
        self._pace(0.0)
        self._age_s: FloatArray = np.zeros(n)
        self._vel, self._lean, self._model, self._own = (np.zeros((n, 3)) for _ in range(4))
        self._held, self._slow = np.zeros((n, 3)), np.zeros((n, 3))
        self._square: FloatArray = np.zeros(n)
        self.push_m_s2: FloatArray = np.zeros((n, 3))
        self.expected_m_s: FloatArray = np.zeros((n, 3))
        self.mean_ned_m_s: FloatArray = np.zeros(3)
        self.gust_m_s = 0.0
        self.known = False

    def step(
        self,
        passed_s: float,
        vel_ned_m_s: FloatArray,
        down_ned: FloatArray,
        sent_ned_m_s: FloatArray,
        counts: BoolArray,
    ) -> None:
        """Takes one tick.

        Args:
            passed_s: since the tick before.
            vel_ned_m_s: measured, shape (n, 3).
            down_ned: the vehicles' downward body axes, unit vectors, shape (n, 3).
            sent_ned_m_s: commanded, shape (n, 3).
            counts: flies, is steered, and its pose can be believed, shape (n,); the others begin anew.
        """
        counts = counts & finite_rows(vel_ned_m_s) & (down_ned[:, 2] > 0.2)
        away = any_of(~counts[:, None])
        lean = renewed(away, 0.0, -_GRAVITY_M_S2 * down_ned / np.maximum(down_ned[:, 2:], 0.2))
        vel = vel_ned_m_s.copy() if away is None else np.where(away, 0.0, vel_ned_m_s)
        lean[:, 2] = vel[:, 2] = 0.0
        sent = renewed(away, 0.0, sent_ned_m_s) * _LEVEL
        new = any_of((~counts | (self._age_s == 0.0))[:, None])
        self._age_s = np.where(counts, self._age_s + passed_s, 0.0)
        step = min(passed_s / _SMOOTH_S, 1.0)
        self._pace(passed_s)
        self._model = renewed(new, vel, self._model + self._lag_share * (sent - self._model))
        self._own = renewed(new, vel, self._own + step * (self._model - self._own))
        self._lean = renewed(new, lean, self._lean + step * (lean - self._lean))
        self._vel = renewed(new, vel, self._vel + step * (vel - self._vel))
        push = (vel - self._vel) / _SMOOTH_S - self._lean + self._drag * self._own
        size = norms(push)[..., None]
        unsure = _OWN_SHARE * self._drag * norms(self._own)[..., None]
        push = push * np.maximum(1.0 - unsure / np.maximum(size, 1e-9), 0.0)
        self.push_m_s2 = renewed(new, 0.0, push)
        self._expect(new)
        self._count(passed_s, counts)

    def _pace(self, passed_s: float) -> None:
        """How far first-order lags go in this time; ticks are as long as each other, mostly."""
        if passed_s != self._passed_s:
            self._passed_s = passed_s
            self._lag_share, self._settle_share = _share(passed_s, self._lag_s), _share(passed_s, self._settle_s)
            self._push_share = _share(passed_s, self._push_lag_s)

    def _expect(self, new: BoolArray | None) -> None:
        """What the push makes of a velocity loop: at once, less what its integral holds against by now."""
        held = self._held + self._settle_share * (self.push_m_s2 - self._held)
        self._held = renewed(new, 0.0, held)
        target = self._push_lag_s * (self.push_m_s2 - self._held)
        expected = self.expected_m_s + self._push_share * (target - self.expected_m_s)
        self.expected_m_s = renewed(new, 0.0, expected)

    def _count(self, passed_s: float, counts: BoolArray) -> None:
        """Mean and spread of the pushes, and the wind that they are made by."""
        age_s = np.maximum(self._age_s - _NEW_S, 0.0)
        young = any_of(age_s <= 0.0)
        young_rows = None if young is None else young[:, None]
        since_s = np.maximum(age_s, max(passed_s, 1e-9))
        gain = (passed_s / np.minimum(since_s, _MEAN_S))[:, None]
        self._slow = renewed(young_rows, 0.0, self._slow + gain * (self.push_m_s2 - self._slow))
        rest = squares(self.push_m_s2 - self._slow) / 2.0
        gain = passed_s / np.minimum(since_s, _SPREAD_S)
        self._square = renewed(young, 0.0, self._square + gain * (rest - self._square))
        seen = (counts & (age_s >= _KNOWN_S)).nonzero()[0]
        self.known = bool(len(seen))
        if not self.known:
            self.mean_ned_m_s, self.gust_m_s = np.zeros(3), 0.0
            return
        winds, gusts = np.empty((len(seen), 3)), np.empty(len(seen))
        kinds = [(self._frames[0], seen)]  # mostly all are of one kind
        if len(self._kinds) > 1:
            kinds = [(frame, rows[np.isin(rows, seen)]) for frame, rows in self._kinds]
        for frame, rows in kinds:
            winds[np.searchsorted(seen, rows)] = frame.air_m_s(self._slow[rows])
        # One vehicle that is odd makes no weather.
        self.mean_ned_m_s = median(winds)
        mean_m_s = length(self.mean_ned_m_s)
        for frame, rows in kinds:
            beyond = np.maximum(self._square[rows] - _LEVEL_M_S2**2, 0.0)
            gusts[np.searchsorted(seen, rows)] = beyond / frame.slope_1_s(0.75 * mean_m_s) ** 2
        self.gust_m_s = math.sqrt(float(median(gusts))) / _SHORTFALL


def _share(passed_s: float, time_s: FloatArray) -> FloatArray:
    """How much of the way to its target a first-order lag goes."""
    return np.asarray(np.minimum(passed_s / np.maximum(time_s, max(passed_s, 1e-9)), 1.0))
