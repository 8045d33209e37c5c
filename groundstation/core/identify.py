"""How a vehicle follows a velocity: lag and delay from what it was told and what it did.

The response to a step is taken for a delay and then a sum of first-order lags, fast and slow ones, with weights that
are not negative: a vehicle with much drag comes near its setpoint quickly and creeps the rest of the way. Weights and
delay are fitted by least squares over the whole record, on one axis or several together, with the offset of the
velocity left free. What is told is what the control gain and the avoidance count with: the time to 63 % of what was
asked for, and as the lag that time less the delay. Where the record does not tell (nothing was asked for, or noise
hides the answer) there is no figure, but a reason.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq, minimize_scalar, nnls
from scipy.signal import lfilter

from groundstation.core.types import FloatArray

STEP_S = 0.01
_TAUS_S = np.geomspace(0.05, 5.0, 11)
_DELAYS_S = np.array([0.0, 0.05, 0.1, 0.2, 0.3, 0.45, 0.6])
DELAY_MAX_S = 1.0
_ASKED_MIN_M_S = 0.05  # standard deviation of what was asked for; with less nothing moves
_EXPLAINED_MIN = 0.6
SHARE_63 = 1.0 - math.exp(-1.0)
_SOON_S = 3.0
_UNSURE_MAX = 0.15  # standard error of the time to 63 %, as a share of it
_LONG_MIN_S = 5.0
_BLOCK_S = 2.0
_NUDGE = 0.02


@dataclass(frozen=True)
class Response:
    """What was found.

    Attributes:
        lag_s: time to 63 % of what was asked for, less the delay; NaN where the record does not tell.
        delay_s: from the setpoint being sent to the first effect in the velocity.
        error_s: standard error of lag + delay.
        gain: share of a step that is reached within three seconds.
        explained: share of the velocity's variance that the model explains.
        problem: why there is no figure, "" where there is one.
    """

    lag_s: float = math.nan
    delay_s: float = math.nan
    error_s: float = math.nan
    gain: float = math.nan
    explained: float = math.nan
    problem: str = ""

    @property
    def t63_s(self) -> float:
        """Time from a step being sent until 63 % of it is reached."""
        return self.lag_s + self.delay_s


def identify(asked_m_s: Sequence[FloatArray], done_m_s: Sequence[FloatArray]) -> Response:
    """Fits one lag and one delay to one or more axes.

    Args:
        asked_m_s: velocity setpoints, one array per axis, every ``STEP_S``.
        done_m_s: velocities at the same times; NaN where there is none.

    Returns:
        The response, or the reason why there is none.
    """
    if problem := tells_nothing(asked_m_s, done_m_s):
        return Response(problem=problem)
    coarse = min(_DELAYS_S.tolist(), key=lambda delay: float(np.sum(_fitted(asked_m_s, done_m_s, delay)[1] ** 2)))
    found = minimize_scalar(
        lambda delay: float(np.sum(_fitted(asked_m_s, done_m_s, delay)[1] ** 2)),
        bounds=(max(coarse - 0.15, 0.0), min(coarse + 0.15, DELAY_MAX_S)),
        method="bounded",
        options={"xatol": 2e-3},
    )
    delay = float(found.x)
    weights, residual = _fitted(asked_m_s, done_m_s, delay)
    seen = np.concatenate([done[np.isfinite(done)] - np.nanmean(done) for done in done_m_s])
    explained = 1.0 - float(np.sum(residual**2)) / max(float(np.sum(seen**2)), 1e-12)
    gain = _step(weights, _SOON_S)
    if explained < _EXPLAINED_MIN:
        problem = f"lag and delay explain {explained:.0%} of the motion only, {_EXPLAINED_MIN:.0%} needed"
        return Response(gain=gain, explained=explained, problem=problem)
    if gain <= SHARE_63:
        problem = f"reaches {gain:.0%} of what it is told within {_SOON_S:g} s, more than {SHARE_63:.0%} needed"
        return Response(gain=gain, explained=explained, problem=problem)
    lag = float(brentq(lambda t: _step(weights, t) - SHARE_63, 0.0, _SOON_S))
    slower = _missed(asked_m_s, done_m_s, weights, _TAUS_S * (1.0 + _NUDGE), delay)
    later = _missed(asked_m_s, done_m_s, weights, _TAUS_S, delay + _NUDGE)
    jacobian = np.stack([(slower - residual) / (_NUDGE * lag), (later - residual) / _NUDGE], axis=1)
    error = _standard_error(jacobian, residual)
    if not error <= _UNSURE_MAX * (lag + delay):
        problem = (
            f"not sure enough: t63 {lag + delay:.2f} s with a standard error of {error:.2f} s; fly longer, or faster"
        )
        return Response(error_s=error, gain=gain, explained=explained, problem=problem)
    return Response(lag, delay, error, gain, explained)


def tells_nothing(asked_m_s: Sequence[FloatArray], done_m_s: Sequence[FloatArray]) -> str:
    """Why a record, as ``identify`` takes it, tells of no model whatever; "" where it may tell of one."""
    flown_s = len(asked_m_s[0]) * STEP_S
    if flown_s < _LONG_MIN_S:
        return f"{flown_s:.1f} s of flight by setpoints, {_LONG_MIN_S:g} s needed"
    if not all(np.isfinite(done).any() for done in done_m_s):
        return "no velocity is known at any time, its reports come too seldom: have it sent more often"
    spread = float(np.sqrt(np.mean([np.var(asked) for asked in asked_m_s])))
    if spread < _ASKED_MIN_M_S:
        return f"setpoints vary by {spread:.3f} m/s only, {_ASKED_MIN_M_S:g} m/s needed: fly something that moves"
    return ""


def _step(weights: FloatArray, t_s: float) -> float:
    """Response to a step, a time after the delay is over."""
    return float(weights @ (1.0 - np.exp(-t_s / _TAUS_S)))


def _lagged(asked: FloatArray, start_m_s: float, taus_s: FloatArray, delay_s: float) -> FloatArray:
    """What first-order lags make of setpoints, shape (t, taus), from one velocity on."""
    times = np.arange(len(asked)) * STEP_S
    # Setpoints are steps; a part of a sample of delay is a mixture of two neighbours.
    delayed = np.interp(times - delay_s, times, asked)
    out = np.empty((len(asked), len(taus_s)))
    for column, tau_s in enumerate(taus_s.tolist()):
        keep = math.exp(-STEP_S / tau_s)
        out[:, column], _ = lfilter([0.0, 1.0 - keep], [1.0, -keep], delayed, zi=[start_m_s])
    return out


def _columns(
    asked_m_s: Sequence[FloatArray], done_m_s: Sequence[FloatArray], taus_s: FloatArray, delay_s: float
) -> tuple[FloatArray, FloatArray]:
    """Lagged setpoints and velocities of all axes, one below the other, each axis without its mean."""
    models, seen = [], []
    for asked, done in zip(asked_m_s, done_m_s, strict=True):
        known = np.isfinite(done)
        start_m_s = float(done[known][0]) if known.any() else 0.0
        model = _lagged(asked, start_m_s, taus_s, delay_s)[known]
        models.append(model - model.mean(axis=0))
        seen.append(done[known] - done[known].mean())
    return np.concatenate(models), np.concatenate(seen)


def _fitted(
    asked_m_s: Sequence[FloatArray], done_m_s: Sequence[FloatArray], delay_s: float
) -> tuple[FloatArray, FloatArray]:
    """The weights that fit best for a delay, and what they miss."""
    model, velocity = _columns(asked_m_s, done_m_s, _TAUS_S, delay_s)
    weights, _ = nnls(model, velocity)
    return weights, velocity - model @ weights


def _missed(
    asked_m_s: Sequence[FloatArray],
    done_m_s: Sequence[FloatArray],
    weights: FloatArray,
    taus_s: FloatArray,
    delay_s: float,
) -> FloatArray:
    model, velocity = _columns(asked_m_s, done_m_s, taus_s, delay_s)
    return velocity - model @ weights


def _standard_error(jacobian: FloatArray, residual: FloatArray) -> float:
    """Standard error of the parameters' sum."""
    return math.sqrt(max(float(block_covariance(jacobian, residual).sum()), 0.0))


def block_covariance(jacobian: FloatArray, residual: FloatArray, step_s: float = STEP_S) -> FloatArray:
    """Covariance of fitted parameters, shape (k, k), by blocks of 2 s: what a model misses lasts, it is no noise.

    Args:
        jacobian: of what is missed, shape (t, k).
        residual: what is missed every step, shape (t,).
        step_s: that step.

    Returns:
        Infinite where the record does not tell them apart.
    """
    block = round(_BLOCK_S / step_s)
    starts = range(0, len(residual), block)
    scores = np.array([jacobian[k : k + block].T @ residual[k : k + block] for k in starts])
    try:
        inverse = np.linalg.inv(jacobian.T @ jacobian)
    except np.linalg.LinAlgError:
        return np.full((jacobian.shape[1], jacobian.shape[1]), math.inf)
    covariance: FloatArray = inverse @ (scores.T @ scores) @ inverse
    return covariance
