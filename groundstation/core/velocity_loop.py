"""How a vehicle's velocity loop answers, as a model of second order: what compensation inverts.

A loop with a proportional and an integral gain that fights drag answers a velocity u, a delay later, with
G(s) = (p s + i) / (s^2 + (p + d) s + i). One lag is the special case of much p and no i. G begins as steeply as p
says, creeps where i is small, and begins slowly and overshoots where p is small beside i (the S of a setpoint that is
shaped before the loop sees it). The four figures are fitted by least squares over the whole record, on one axis or
several together, each without its mean. Beside them stands what one lag and a delay explain: whether the data ask for
more.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

from groundstation.core.identify import DELAY_MAX_S, SHARE_63, STEP_S, block_covariance, tells_nothing
from groundstation.core.types import FloatArray

FIT_EVERY = 2
"""Of samples every ``STEP_S`` one in so many is fitted."""
FIT_STEP_S = FIT_EVERY * STEP_S
_LEAST = np.array([0.05, 0.01, 0.01])
_MOST = np.array([40.0, 60.0, 8.0])
_STARTS = ((0.5, 6.0, 3.0), (2.0, 0.5, 0.5), (6.0, 3.0, 0.5))
_LAG_STARTS_S = (0.15, 0.8)
_EXPLAINED_MIN = 0.9
_ERROR_MAX = 0.1
_LEFT_MAX = 0.75
_SEEN_S = 8.0
_ERROR_WITHIN_S = 3.0
_NUDGE = 1e-4


@dataclass(frozen=True)
class VelocityLoop:
    """What was found; figures are NaN where nothing was.

    Attributes:
        p_1_s: proportional gain.
        i_1_s2: integral gain.
        drag_1_s: drag that the loop fights.
        delay_s: from the setpoint being sent to the first effect in the velocity.
        explained: share of the velocity's variance that the model explains.
        one_lag_explained: share that one lag and a delay explain.
        lag_s, lag_delay_s: those.
        error: largest standard error of the answer to a step within three seconds, as a share of the step.
        problem: why it is not to be built upon, "" where it can be.
    """

    p_1_s: float = math.nan
    i_1_s2: float = math.nan
    drag_1_s: float = math.nan
    delay_s: float = math.nan
    explained: float = math.nan
    one_lag_explained: float = math.nan
    lag_s: float = math.nan
    lag_delay_s: float = math.nan
    error: float = math.nan
    problem: str = ""

    @property
    def needed(self) -> bool:
        """Whether the data ask for it: one lag leaves a third more of the motion unexplained, or more."""
        return 1.0 - self.explained <= _LEFT_MAX * (1.0 - self.one_lag_explained)

    def step(self) -> FloatArray:
        """The answer to a step of 1 m/s, every 20 ms for eight seconds from when it is sent."""
        return self.answer(np.ones(round(_SEEN_S / FIT_STEP_S)), 0.0)

    def answer(self, asked_m_s: FloatArray, start_m_s: float) -> FloatArray:
        """Velocities after setpoints every 20 ms, from a steady velocity on, shape (t,)."""
        return _loop_answer(asked_m_s, start_m_s, (self.p_1_s, self.i_1_s2, self.drag_1_s), self.delay_s)

    def one_lag_answer(self, asked_m_s: FloatArray, start_m_s: float) -> FloatArray:
        """The same of one lag and a delay."""
        return _lag_answer(asked_m_s, start_m_s, self.lag_s, self.lag_delay_s)

    def reached_s(self, share: float = SHARE_63) -> float:
        """When that share of a step is first reached; infinite if not within eight seconds."""
        there = np.flatnonzero(self.step() >= share)
        return float(there[0]) * FIT_STEP_S if len(there) else math.inf

    @property
    def overshoot(self) -> float:
        """By how much of a step it goes beyond, >= 0."""
        return max(float(self.step().max()) - 1.0, 0.0)


def identify_loop(asked_m_s: Sequence[FloatArray], done_m_s: Sequence[FloatArray]) -> VelocityLoop:
    """Fits the second order, and one lag beside it, to one or more axes.

    Args:
        asked_m_s: velocity setpoints, one array per axis, every ``STEP_S``.
        done_m_s: velocities at the same times; NaN where there is none.
    """
    if problem := tells_nothing(asked_m_s, done_m_s):
        return VelocityLoop(problem=problem)
    asked_m_s, done_m_s = [asked[::FIT_EVERY] for asked in asked_m_s], [done[::FIT_EVERY] for done in done_m_s]
    seen = np.concatenate([done[np.isfinite(done)] - np.nanmean(done) for done in done_m_s])
    motion = max(float(seen @ seen), 1e-12)

    def loop(x: FloatArray, asked: FloatArray, start_m_s: float) -> FloatArray:
        p, i, drag = np.exp(x[:3]).tolist()
        return _loop_answer(asked, start_m_s, (p, i, drag), float(x[3]))

    def lag(x: FloatArray, asked: FloatArray, start_m_s: float) -> FloatArray:
        return _lag_answer(asked, start_m_s, math.exp(float(x[0])), float(x[1]))

    least, most = np.append(np.log(_LEAST), 0.0), np.append(np.log(_MOST), DELAY_MAX_S)
    starts = [np.append(np.log(start), 0.1) for start in _STARTS]
    x, left = _best(lambda x: _missed(loop, x, asked_m_s, done_m_s), starts, least, most)
    lag_starts = [np.array([math.log(start_s), 0.1]) for start_s in _LAG_STARTS_S]
    y, lag_left = _best(
        lambda y: _missed(lag, y, asked_m_s, done_m_s), lag_starts, np.array([-4.0, 0.0]), np.array([2.0, DELAY_MAX_S])
    )
    p, i, drag = np.exp(x[:3]).tolist()
    error = _step_error(lambda x: _missed(loop, x, asked_m_s, done_m_s), x)
    found = VelocityLoop(
        p, i, drag, float(x[3]), 1.0 - left / motion, 1.0 - lag_left / motion, math.exp(y[0]), float(y[1]), error
    )
    return replace(found, problem=_problem(found))


def _problem(found: VelocityLoop) -> str:
    if found.explained < _EXPLAINED_MIN:
        return f"the second order explains {found.explained:.0%} of the motion only, {_EXPLAINED_MIN:.0%} needed"
    if not found.error <= _ERROR_MAX:
        return f"its answer to a step is sure to {found.error:.0%} only, {_ERROR_MAX:.0%} needed; fly longer, or faster"
    return ""


def _loop_answer(asked: FloatArray, start_m_s: float, gains: tuple[float, float, float], delay_s: float) -> FloatArray:
    """What a loop makes of setpoints every 20 ms, by the bilinear rule, from a steady velocity on.

    Args:
        asked: shape (t,), m/s.
        start_m_s: velocity before.
        gains: p in 1/s, i in 1/s^2, drag in 1/s.
        delay_s: >= 0.
    """
    p, i, drag = gains
    r = 2.0 / FIT_STEP_S
    above = np.array([p * r + i, 2.0 * i, i - p * r])
    first = (p + drag) * r
    below = np.array([r * r + first + i, 2.0 * (i - r * r), r * r - first + i])
    moved: FloatArray = lfilter(above / below[0], below / below[0], _late(asked, start_m_s, delay_s) - start_m_s)
    return start_m_s + moved


def _lag_answer(asked: FloatArray, start_m_s: float, lag_s: float, delay_s: float) -> FloatArray:
    keep = math.exp(-FIT_STEP_S / lag_s)
    moved: FloatArray = lfilter([0.0, 1.0 - keep], [1.0, -keep], _late(asked, start_m_s, delay_s) - start_m_s)
    return start_m_s + moved


def _late(asked: FloatArray, start_m_s: float, delay_s: float) -> FloatArray:
    """Setpoints a delay later; before the first of them the vehicle is as it was."""
    times = np.arange(len(asked)) * FIT_STEP_S
    late: FloatArray = np.interp(times - delay_s, times, asked, left=start_m_s)
    return late


def _missed(
    model: Callable[[FloatArray, FloatArray, float], FloatArray],
    x: FloatArray,
    asked_m_s: Sequence[FloatArray],
    done_m_s: Sequence[FloatArray],
) -> FloatArray:
    """What a model misses, of all axes, each without its mean."""
    out = []
    for asked, done in zip(asked_m_s, done_m_s, strict=True):
        known = np.isfinite(done)
        off = (done - model(x, asked, float(done[known][0])))[known]
        out.append(off - off.mean())
    return np.concatenate(out)


def _best(
    missed: Callable[[FloatArray], FloatArray], starts: Sequence[FloatArray], least: FloatArray, most: FloatArray
) -> tuple[FloatArray, float]:
    """The best of the fits from several starts, and the sum of squares that it leaves."""
    fits = [least_squares(missed, start, bounds=(least, most)) for start in starts]
    best = min(fits, key=lambda fit: float(fit.cost))
    x: FloatArray = best.x
    return x, 2.0 * float(best.cost)


def _step_error(missed: Callable[[FloatArray], FloatArray], x: FloatArray) -> float:
    """Largest standard error of the answer to a step: gains that make up for each other do no harm in it."""
    soon = round(_ERROR_WITHIN_S / FIT_STEP_S)

    def step(x: FloatArray) -> FloatArray:
        p, i, drag = np.exp(x[:3]).tolist()
        return _loop_answer(np.ones(soon), 0.0, (p, i, drag), float(x[3]))

    residual = missed(x)
    # One-sided, inwards for a delay of 0.
    nudges = np.eye(4) * _NUDGE
    jacobian = np.stack([(missed(x + nudge) - residual) / _NUDGE for nudge in nudges], axis=1)
    covariance = block_covariance(jacobian, residual, FIT_STEP_S)
    slopes = np.stack([(step(x + nudge) - step(x)) / _NUDGE for nudge in nudges], axis=1)
    return float(np.sqrt(np.maximum(np.einsum("tk,kl,tl->t", slopes, covariance, slopes), 0.0)).max())
