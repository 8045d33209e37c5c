"""The air around the vehicles: wind with gusts, and the downwash of one rotor disc on whoever flies below.

Refuses to know vehicles: positions and thrusts in, air velocities and accelerations out. Both are options.
"""

from __future__ import annotations

import math

import numpy as np

from sitl.frames import Array

_BLOCK = 256


class Wind:
    """Mean wind and gusts that are correlated in time (Gauss-Markov), each vehicle in its own gusts.

    Args:
        mean_enu_m_s: mean wind, shape (3,), the direction in which the air moves.
        gust_sigma_m_s: standard deviation of the gusts on each horizontal axis; vertically half of it.
        gust_tau_s: correlation time of the gusts.
        n: number of vehicles.
        step_s: physics step.
        rng: source of the gusts.
    """

    def __init__(
        self,
        *,
        mean_enu_m_s: tuple[float, float, float],
        gust_sigma_m_s: float,
        gust_tau_s: float,
        n: int,
        step_s: float,
        rng: np.random.Generator,
    ) -> None:
        self.mean = np.array(mean_enu_m_s, dtype=np.float64)[:, None]
        sigma = gust_sigma_m_s * np.array([[1.0], [1.0], [0.5]])
        self._keep = math.exp(-step_s / gust_tau_s)
        self._drive = sigma * math.sqrt(1.0 - self._keep**2)
        self._rng, self._n = rng, n
        self._gust = sigma * rng.standard_normal((3, n))
        self._drawn = np.empty((0, 3, n))
        self._next = 0

    def step(self) -> Array:
        """Air velocity at every vehicle, one physics step later, shape (3, n), ENU m/s."""
        if self._next == len(self._drawn):
            self._drawn = self._rng.standard_normal((_BLOCK, 3, self._n))
            self._next = 0
        self._gust *= self._keep
        self._gust += self._drawn[self._next] * self._drive
        self._next += 1
        return self._gust + self.mean


class Downwash:
    """Downward push on vehicles that fly below others.

    The jet of a rotor disc has the induced velocity of momentum theory, ``w = sqrt(thrust / (2 rho A))``, doubled far
    below, widens with distance and fades; the lower vehicle loses lift in proportion. This is an order-of-magnitude
    model: it makes flying below another vehicle visibly costly, not exactly so.

    Args:
        mass_kg: shape (n,).
        span_m: distance between opposite rotors, shape (n,).
    """

    def __init__(self, mass_kg: Array, span_m: Array) -> None:
        disc_m2 = math.pi * (span_m * 0.5) ** 2
        self._induced = np.sqrt(mass_kg / (2.0 * 1.225 * disc_m2))  # times sqrt(thrust per mass) is the velocity
        self._radius = span_m * 0.75
        self._response = 0.35 / np.maximum(span_m, 0.05) ** 0.5  # deceleration per jet velocity, 1/s

    def acceleration(self, pos_enu_m: Array, thrust_m_s2: Array) -> Array:
        """Downward acceleration of every vehicle, shape (n,), m/s^2, from positions (3, n) and thrusts (n,)."""
        x, y, z = pos_enu_m
        above = z[:, None] - z[None, :]  # row i above column j
        sideways2 = (x[:, None] - x[None, :]) ** 2 + (y[:, None] - y[None, :]) ** 2
        height = np.maximum(above, 0.0)
        width = self._radius[:, None] + 0.15 * height
        jet = 2.0 * (self._induced * np.sqrt(np.maximum(thrust_m_s2, 0.0)))[:, None] * self._radius[:, None] / width
        jet = jet * np.exp(-sideways2 / (width * width)) * (above > 0.05)
        return np.asarray(jet.sum(axis=0) * self._response)
