"""The air around the vehicles: drag, wind with gusts, and the downwash of one rotor disc on whoever flies below.

Positions, velocities and thrusts in, accelerations out. Wind and downwash are options.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from sitl.frames import Array
from sitl.loops import VelocityLoop
from sitl.motion import Motion
from sitl.profiles import Profile, column, spread
from sitl.wander import Wander

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
        keep = math.exp(-step_s / gust_tau_s)
        drive = sigma * math.sqrt(1.0 - keep**2)
        self._gust = Wander(sigma * rng.standard_normal((3, n)), keep, drive, rng=rng, block=_BLOCK)

    def step(self) -> Array:
        """Air velocity at every vehicle, one physics step later, shape (3, n), ENU m/s."""
        self._gust.step()
        return self._gust.now + self.mean


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


class Air:
    """What the air does to n vehicles: it resists, and pushes where there is wind or somebody flies above."""

    def __init__(
        self, profiles: Sequence[Profile], step_s: float, wind: Wind | None, downwash: Downwash | None
    ) -> None:
        n = len(profiles)
        self._step_s, self._wind, self._downwash = step_s, wind, downwash
        self._drag = spread(profiles, "frame.drag_per_s")
        self._per_s, self._per_m = column(profiles, "frame.air_per_s"), column(profiles, "frame.air_per_m")
        self._sticky = np.maximum(self._drag - self._per_s, 0.0)
        self._calm_vel, self._calm_integral = np.zeros((3, n)), np.zeros((3, n))

    def push(self, acc: Array, motion: Motion, ref: Array, loop: VelocityLoop) -> None:
        """Adds what the air does to the accelerations, shape (3, n).

        Args:
            acc: changed.
            motion: of the vehicles.
            ref: velocities that they follow, shape (3, n).
            loop: by which they do.
        """
        acc -= motion.vel_enu_m_s * self._drag
        if self._wind is not None:
            acc += self._blown(motion, ref, loop, self._wind.step())
        if self._downwash is not None:
            acc[2] -= self._downwash.acceleration(motion.pos_enu_m, motion.thrust_m_s2)

    def rest(self) -> None:
        """Forgets how they would have flown in still air."""
        self._calm_vel[:] = 0.0
        self._calm_integral[:] = 0.0

    def _blown(self, motion: Motion, ref: Array, loop: VelocityLoop, air: Array) -> Array:
        """What the wind adds to the acceleration in still air: nothing without any, shape (3, n).

        The pull of the air past the vehicle takes the place of that of still air. Drag beyond what air can do belongs
        to commanded motion alone, which a twin in still air follows: else it would hold a vehicle against gusts, as
        nothing holds a real one.
        """
        vel = motion.vel_enu_m_s
        past = air - vel
        blown = (self._per_s + self._per_m * np.sqrt(np.add.reduce(past * past, axis=0))) * past
        blown += (self._per_s + self._per_m * np.sqrt(np.add.reduce(vel * vel, axis=0))) * vel
        error = ref - self._calm_vel
        self._calm_integral += error * loop.ki_dt
        self._calm_vel += (error * loop.kp + self._calm_integral - self._drag * self._calm_vel) * self._step_s
        blown += self._sticky * (vel - self._calm_vel)
        if motion.any_on_ground:
            self._calm_vel *= ~motion.on_ground
            self._calm_integral *= ~motion.on_ground
        return np.asarray(blown)
