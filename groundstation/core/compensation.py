"""Velocities that make vehicles follow faster: the inverse of how a velocity loop answers, slowed down to a lag.

A velocity loop that answers with G(s) is told G^-1(s) / (tau s + 1) u, and so answers u with 1 / (tau s + 1), as far as
its G is known and nothing saturates. What this asks of the argument for r: docs/avoidance-why.md. Knows no vehicles
and no limits but that of how large commands may become.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from groundstation.core.quick import norms
from groundstation.core.types import BoolArray, FloatArray

MOST_OVER_LIMIT = 2.0
"""Commands exceed the speed limit by this factor at most, for moments in which the speed itself does not."""
_TERMS = 3
_SHARE_63 = 1.0 - math.exp(-1.0)
_SEEN_S, _STEP_S = 12.0, 0.002


@dataclass(frozen=True)
class AxisResponse:
    """How one axis of a velocity loop answers: v' = p (u - v) + i x - d v with x' = u - v.

    So G = (p s + i) / (s^2 + (p + d) s + i).

    Attributes:
        p_1_s: proportional gain, > 0.
        i_1_s2: integral gain, > 0.
        drag_1_s: drag that the loop has to fight, >= 0.
    """

    p_1_s: float
    i_1_s2: float
    drag_1_s: float

    @property
    def damping(self) -> float:
        """Damping ratio of its poles: the less, the longer it swings."""
        return (self.p_1_s + self.drag_1_s) / (2.0 * math.sqrt(self.i_1_s2))

    def t63_s(self) -> float:
        """Time after which 63 % of a step is reached; infinite if not within ``_SEEN_S``."""
        velocity = missing = 0.0
        for k in range(round(_SEEN_S / _STEP_S)):
            if velocity >= _SHARE_63:
                return k * _STEP_S
            missing += (1.0 - velocity) * _STEP_S
            push = self.p_1_s * (1.0 - velocity) + self.i_1_s2 * missing - self.drag_1_s * velocity
            velocity += push * _STEP_S
        return math.inf


@dataclass(frozen=True)
class Response:
    """How a vehicle answers velocities by itself.

    Attributes:
        horizontal: along north and east.
        vertical: along down.
        lag_s: what the slower of both counts for without compensation, > 0.
    """

    horizontal: AxisResponse
    vertical: AxisResponse
    lag_s: float


class Compensator:
    """Compensates the commands of one team, tick by tick.

    Args:
        responses: of each vehicle; None where commands go as they are.
        lag_s: what each compensated vehicle is to answer with, shape (n,), > 0; of the others it does not count.
        tick_s: > 0.
        speed_limit_m_s: of the vehicles, > 0.

    Attributes:
        compensated: whose commands are shaped, shape (n,).
    """

    def __init__(
        self, responses: Sequence[Response | None], lag_s: FloatArray, tick_s: float, speed_limit_m_s: float
    ) -> None:
        n = len(responses)
        self.compensated: BoolArray = np.array([response is not None for response in responses], dtype=np.bool_)
        self._above: FloatArray = np.zeros((_TERMS, n, 3))
        self._below: FloatArray = np.zeros((_TERMS, n, 3))
        self._above[0] = self._below[0] = 1.0
        for k, response in enumerate(responses):
            if response is None:
                continue
            for axis, item in enumerate((response.horizontal, response.horizontal, response.vertical)):
                self._above[:, k, axis], self._below[:, k, axis] = _discrete(item, float(lag_s[k]), tick_s)
        self._most_m_s = MOST_OVER_LIMIT * speed_limit_m_s
        self._kept: FloatArray = np.zeros((_TERMS, n, 3))

    def rest(self, who: BoolArray) -> None:
        """Forgets what those were told, shape (n,): nothing was sent to them, so they answer nothing."""
        self._kept[:, who] = 0.0

    def stop(self, who: BoolArray) -> None:
        """From now on commands of those go as they are, shape (n,)."""
        self.compensated = self.compensated & ~who
        self._above[:, who] = self._below[:, who] = 0.0
        self._above[0, who] = self._below[0, who] = 1.0
        self._kept[:, who] = 0.0

    def __call__(self, vel_ned_m_s: FloatArray) -> FloatArray:
        """What to send so that velocities follow with the lag, shape (n, 3), NED; within twice the speed limit."""
        # Direct form II, transposed.
        out = self._above[0] * vel_ned_m_s + self._kept[0]
        self._kept[:-1] = self._kept[1:] + self._above[1:] * vel_ned_m_s - self._below[1:] * out
        size = norms(out)
        over = self.compensated & (size > self._most_m_s)
        kept: FloatArray = out * np.where(over, self._most_m_s / np.maximum(size, 1e-12), 1.0)[:, None]
        return kept


def _discrete(axis: AxisResponse, lag_s: float, tick_s: float) -> tuple[FloatArray, FloatArray]:
    """G^-1 / (lag s + 1) by the bilinear rule: coefficients of 1, z^-1, z^-2, shape (3,) each."""
    p, i = axis.p_1_s, axis.i_1_s2
    above = _bilinear(1.0, p + axis.drag_1_s, i, tick_s)
    below = _bilinear(p * lag_s, p + i * lag_s, i, tick_s)
    return above / below[0], below / below[0]


def _bilinear(second: float, first: float, zeroth: float, tick_s: float) -> FloatArray:
    """A quadratic in s with s = r (1 - w) / (1 + w), r = 2 / tick, times (1 + w)^2: coefficients of 1, w, w^2."""
    r = 2.0 / tick_s
    high, middle = second * r * r, first * r
    return np.array([high + middle + zeroth, 2.0 * (zeroth - high), high - middle + zeroth])
