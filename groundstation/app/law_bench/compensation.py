"""Velocities that make vehicles follow faster: the inverse of how a velocity loop answers, slowed down to a lag.

A velocity loop that answers with G(s) is told G^-1(s) / (tau s + 1) u, and so answers u with 1 / (tau s + 1), as far as
its G is known and nothing saturates. A trial for races (docs/avoidance-measured.md): no mission is flown so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from groundstation.core.quick import norms
from groundstation.core.types import BoolArray, FloatArray

MOST_OVER_LIMIT = 2.0
"""Commands exceed the speed limit by this factor at most, for moments in which the speed itself does not."""
_TERMS = 3


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


@dataclass(frozen=True)
class Response:
    """How a vehicle answers velocities, and how fast it can be made to.

    Attributes:
        horizontal: along north and east.
        vertical: along down.
        lag_s: of what is left behind the compensation, > 0; less asks for commands that are larger.
    """

    horizontal: AxisResponse
    vertical: AxisResponse
    lag_s: float


RESPONSES = {"px4_quad": Response(AxisResponse(1.8, 0.5, 1.35), AxisResponse(4.0, 2.0, 1.35), lag_s=0.3)}
"""By profile: PX4's gains MPC_XY_VEL_* and MPC_Z_VEL_*, and the drag of its built-in simulator.

Of the others none is given: a Crazyflie is quick already (0.12 s in place of 0.2 saved 0.1 s of 4.2 in races), and what
ArduCopter does to a setpoint before its velocity loop takes two more orders to invert.
"""


class Compensator:
    """Compensates the commands of one team, tick by tick.

    Args:
        responses: of each vehicle; None where commands go as they are.
        lag_s: what compensated vehicles are to answer with, > 0.
        tick_s: > 0.
        speed_limit_m_s: of the vehicles, > 0.

    Attributes:
        compensated: whose commands are shaped, shape (n,).
    """

    def __init__(
        self, responses: Sequence[Response | None], lag_s: float, tick_s: float, speed_limit_m_s: float
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
                self._above[:, k, axis], self._below[:, k, axis] = _discrete(item, lag_s, tick_s)
        self._most_m_s = MOST_OVER_LIMIT * speed_limit_m_s
        self._kept: FloatArray = np.zeros((_TERMS, n, 3))

    def rest(self) -> None:
        """Everybody was told to stand still."""
        self._kept[:] = 0.0

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
