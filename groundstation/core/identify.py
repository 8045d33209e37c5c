"""How a vehicle follows a velocity: lag and delay from what it was told and what it did.

The model is a first-order lag behind a delay, with a gain below one where drag keeps the vehicle from what it is told:
v' = (gain u(t - delay) - v) / tau, one axis at a time or several together, fitted by least squares over the whole record
with the offset of the velocity left free. The lag that is told is what the control gain and the avoidance count with: the
time to 63 % of what was *asked for*, less the delay. Where the record does not tell (nothing was asked for, or noise
hides the answer) there is no figure, but a reason.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

from groundstation.core.types import FloatArray

STEP_S = 0.01
_LAGS_S = np.geomspace(0.05, 2.5, 8)
_DELAYS_S = np.array([0.0, 0.06, 0.15, 0.3, 0.5])
_LAG_MAX_S, _DELAY_MAX_S = 5.0, 1.0
_ASKED_MIN_M_S = 0.05  # standard deviation of what was asked for; with less nothing moves
_EXPLAINED_MIN = 0.6
_SHARE = 1.0 - math.exp(-1.0)
_GAIN_MIN, _GAIN_MAX = 0.7, 1.3
_UNSURE_MAX = 0.15  # standard error of lag + delay, as a share of it
_LONG_MIN_S = 5.0
_BLOCK_S = 2.0
_NUDGE_S = 0.01


@dataclass(frozen=True)
class Response:
    """What was found.

    Attributes:
        lag_s: time to 63 % of what was asked for, less the delay; NaN where the record does not tell.
        delay_s: from the setpoint being sent to the first effect in the velocity.
        error_s: standard error of lag + delay, the gain taken for known.
        gain: velocity reached over velocity asked for, at the speeds of the record.
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
    if len(asked_m_s[0]) * STEP_S < _LONG_MIN_S:
        return Response(problem=f"{len(asked_m_s[0]) * STEP_S:.1f} s of flight by setpoints, {_LONG_MIN_S:g} s needed")
    spread = float(np.sqrt(np.mean([np.var(asked) for asked in asked_m_s])))
    if spread < _ASKED_MIN_M_S:
        return Response(
            problem=f"setpoints vary by {spread:.3f} m/s only, {_ASKED_MIN_M_S:g} m/s needed: fly something that moves"
        )
    _, tau, delay = min(
        (float(np.sum(_residual(asked_m_s, done_m_s, tau, delay)[0] ** 2)), float(tau), float(delay))
        for tau in _LAGS_S
        for delay in _DELAYS_S
    )
    fit = least_squares(
        lambda x: _residual(asked_m_s, done_m_s, x[0], x[1])[0],
        [tau, delay],
        bounds=([1e-2, 0.0], [_LAG_MAX_S, _DELAY_MAX_S]),
        x_scale=[0.1, 0.05],
    )
    tau, delay = float(fit.x[0]), float(fit.x[1])
    residual, gain = _residual(asked_m_s, done_m_s, tau, delay)
    seen = np.concatenate([done[np.isfinite(done)] - np.nanmean(done) for done in done_m_s])
    explained = 1.0 - float(np.sum(residual**2)) / max(float(np.sum(seen**2)), 1e-12)
    if explained < _EXPLAINED_MIN or tau >= 0.99 * _LAG_MAX_S or delay >= 0.99 * _DELAY_MAX_S:
        problem = f"lag and delay explain {explained:.0%} of the motion only, {_EXPLAINED_MIN:.0%} needed"
        return Response(gain=gain, explained=explained, problem=problem)
    if not _GAIN_MIN <= gain <= _GAIN_MAX:
        problem = f"reaches {gain:.0%} of what it is told, {_GAIN_MIN:.0%} to {_GAIN_MAX:.0%} can be flown with"
        return Response(gain=gain, explained=explained, problem=problem)
    stretch = -math.log(1.0 - _SHARE / gain)  # of the time constant, until 63 % of what was asked for is reached
    steps = [_residual(asked_m_s, done_m_s, tau + _NUDGE_S, delay)[0], _residual(asked_m_s, done_m_s, tau, delay + _NUDGE_S)[0]]  # fmt: skip
    jacobian = np.stack([(moved - residual) / _NUDGE_S for moved in steps], axis=1)
    error = _standard_error(jacobian, residual, np.array([stretch, 1.0]))
    t63 = stretch * tau + delay
    if not error <= _UNSURE_MAX * t63:
        problem = f"not sure enough: t63 {t63:.2f} s with a standard error of {error:.2f} s; fly longer, or faster"
        return Response(error_s=error, gain=gain, explained=explained, problem=problem)
    return Response(stretch * tau, delay, error, gain, explained)


def _modelled(asked: FloatArray, start: float, tau_s: float, delay_s: float) -> FloatArray:
    """What a first-order lag makes of setpoints that are held between samples."""
    times = np.arange(len(asked)) * STEP_S - delay_s
    # Setpoints are steps; a part of a sample of delay is a mixture of two neighbours.
    delayed = np.interp(times, np.arange(len(asked)) * STEP_S, asked)
    keep = math.exp(-STEP_S / tau_s)
    out, _ = lfilter([1.0 - keep], [1.0, -keep], delayed, zi=[keep * start])
    return np.asarray(out, dtype=np.float64)


def _residual(
    asked_m_s: Sequence[FloatArray], done_m_s: Sequence[FloatArray], tau_s: float, delay_s: float
) -> tuple[FloatArray, float]:
    """What the model misses, with the gain that fits best, and that gain."""
    models, seen = [], []
    for asked, done in zip(asked_m_s, done_m_s, strict=True):
        known = np.isfinite(done)
        start = float(done[known][0]) if known.any() else 0.0
        model = _modelled(asked, start, tau_s, delay_s)[known]
        models.append(model - model.mean())
        seen.append(done[known] - done[known].mean())
    model, velocity = np.concatenate(models), np.concatenate(seen)
    gain = float(model @ velocity) / max(float(model @ model), 1e-12)
    return velocity - gain * model, gain


def _standard_error(jacobian: FloatArray, residual: FloatArray, weights: FloatArray) -> float:
    """Standard error of a weighted sum of the parameters, by blocks: what the model misses lasts, it is no noise."""
    block = round(_BLOCK_S / STEP_S)
    starts = range(0, len(residual), block)
    scores = np.array([jacobian[k : k + block].T @ residual[k : k + block] for k in starts])
    try:
        inverse = np.linalg.inv(jacobian.T @ jacobian)
    except np.linalg.LinAlgError:
        return math.inf
    covariance = inverse @ (scores.T @ scores) @ inverse
    return math.sqrt(max(float(weights @ covariance @ weights), 0.0))
