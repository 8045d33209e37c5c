"""What the vehicles believe: truth plus correlated errors, drawn from the seed.

Position, velocity and attitude errors are Gauss-Markov processes (first order, stationary from the start); a small
white part is added at the moment of reporting. Faults put offsets on top. The position and velocity errors act on the
control loops too: a vehicle flies by what it believes.

Refuses to draw from anything but the generator that it is given.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sitl.frames import Array
from sitl.wander import Wander


@dataclass(frozen=True)
class Noise:
    """Errors of one vehicle's estimate.

    Attributes:
        pos_sigma_m: standard deviation of the slow position error on each axis.
        pos_tau_s: its correlation time.
        pos_white_m: standard deviation of the white part in each report.
        vel_sigma_m_s, vel_tau_s: the same for the velocity.
        att_sigma_rad, att_tau_s: the same for the tilt (two axes) and the heading.
        origin_sigma_m: error of the estimator's origin at start, horizontal; vertical 1.2 times as large; both are
            cut off at two sigma.
        vel_axes: shares of the velocity error on the east, north and upward axis.
        vel_in_air_only: the velocity is right while the vehicle stands: its own motors shake what makes it wrong.
        pos_follows_s: for about so long the position follows the wrong velocity before it is corrected; 0: never.
    """

    pos_sigma_m: float = 0.005
    pos_tau_s: float = 1.0
    pos_white_m: float = 0.0005
    vel_sigma_m_s: float = 0.01
    vel_tau_s: float = 0.3
    att_sigma_rad: float = math.radians(0.3)
    att_tau_s: float = 2.0
    origin_sigma_m: float = 0.0
    vel_axes: tuple[float, float, float] = (1.0, 1.0, 1.0)
    vel_in_air_only: bool = False
    pos_follows_s: float = 0.0


NOISELESS = Noise(0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0)
MOCAP = Noise()
"""Motion capture, millimetres."""
GPS = Noise(
    pos_sigma_m=0.12,
    pos_tau_s=60.0,
    pos_white_m=0.002,
    vel_sigma_m_s=0.035,
    vel_tau_s=15.0,
    att_sigma_rad=math.radians(0.5),
    att_tau_s=10.0,
    origin_sigma_m=0.25,
)
"""GPS and IMU: seen to wander by 1 to 2.5 m a minute at zero command, origins off by up to 0.5 m / 0.6 m."""

_BLOCK = 128
_EVERY = 5  # the errors move every fifth physics step: they are slow
_SHAKES_AFTER_S = 2.0  # off the ground, until the motors' shaking shows in full


class Shaking:
    """Motors that shake the sensors: velocities are wrong in the air only, and positions follow them for a while.

    Attributes:
        followed_m: by how much the positions have followed, shape (3, n), ENU.
    """

    def __init__(self, noises: Sequence[Noise], dt_s: float) -> None:
        n = len(noises)
        self._dt = dt_s
        self._calm = np.array([noise.vel_in_air_only for noise in noises])
        self._keep = np.exp(-dt_s / np.maximum(np.array([noise.pos_follows_s for noise in noises]), 1e-9))
        self._shaken, self.followed_m = np.zeros(n), np.zeros((3, n))

    def step(self, vel_error: Array, on_ground: NDArray[np.bool_]) -> Array:
        """The velocity errors that show of those that there would be in full, shape (3, n)."""
        self._shaken = np.where(on_ground, 0.0, np.minimum(self._shaken + self._dt / _SHAKES_AFTER_S, 1.0))
        shown = vel_error * np.where(self._calm, self._shaken, 1.0)
        self.followed_m = self._keep * (self.followed_m + shown * self._dt)
        return np.asarray(shown)


_COASTS_M_S = 1.7  # PX4 1.16 in its own simulator: 1.7 m/s off 11 s after its GPS was gone, blind and landing by then


class Coasting:
    """Estimates of n vehicles that are carried on by accelerometers alone, and go astray.

    Position and velocity go astray together, so that neither contradicts the other.

    Attributes:
        on: somebody's is.
    """

    def __init__(self, n: int) -> None:
        self._enu_m_s2, self._gone_m_s, self._gone_m = np.zeros((3, n)), np.zeros((3, n)), np.zeros((3, n))
        self.on = False

    def set(self, index: int, enu_m_s2: Sequence[float] | None) -> tuple[Array, Array]:
        """Begins, or ends with None; returns by how much velocity (m/s) and position (m) have gone, when it ends."""
        gone = np.zeros(3), np.zeros(3)
        if enu_m_s2 is None:
            gone = self._gone_m_s[:, index].copy(), self._gone_m[:, index].copy()
            self._gone_m_s[:, index] = self._gone_m[:, index] = 0.0
        self._enu_m_s2[:, index] = 0.0 if enu_m_s2 is None else enu_m_s2
        self.on = bool(self._enu_m_s2.any())
        return gone

    def step(self, dt_s: float, on_ground: NDArray[np.bool_]) -> Array:
        """By how much the velocities have gone further, shape (3, n), m/s; who stands knows that it does not move."""
        before_m_s = self._gone_m_s
        gone_m_s = before_m_s + self._enu_m_s2 * dt_s
        speed_m_s = np.linalg.norm(gone_m_s, axis=0)
        gone_m_s *= np.minimum(1.0, _COASTS_M_S / np.maximum(speed_m_s, _COASTS_M_S))
        self._gone_m_s = np.where(on_ground, 0.0, gone_m_s)
        self._gone_m += self._gone_m_s * dt_s
        return np.asarray(self._gone_m_s - before_m_s)


class Estimator:
    """Errors of n vehicles' estimates.

    Attributes:
        pos_error: error of the position used for control and reports, shape (3, n), ENU m.
        vel_error: error of the velocity, shape (3, n), ENU m/s.
        att_error: errors of the upward axis (east, north) and of the heading, shape (3, n), rad.
        offset_enu_m: what faults add to the position, shape (3, n).
        drift_enu_m_s: how fast that offset grows, shape (3, n).
        misled_enu_m_s: what is added to the velocity's error, shape (3, n).
        faulty: a fault adds to somebody's position or velocity.
    """

    def __init__(self, noises: Sequence[Noise], step_s: float, rng: np.random.Generator) -> None:
        n = len(noises)
        self._rng, self._dt = rng, step_s * _EVERY

        def rows(name: str) -> Array:
            return np.repeat(np.array([[getattr(noise, name) for noise in noises]]), 3, axis=0)

        sigma = np.concatenate([rows("pos_sigma_m"), rows("vel_sigma_m_s"), rows("att_sigma_rad")])
        tau = np.concatenate([rows("pos_tau_s"), rows("vel_tau_s"), rows("att_tau_s")])
        keep = np.exp(-self._dt / tau)
        sigma[3:6] *= np.array([noise.vel_axes for noise in noises]).T
        drive = sigma * np.sqrt(1.0 - keep**2)
        self._errors = Wander(sigma * rng.standard_normal((9, n)), keep, drive, rng=rng, block=_BLOCK)
        self._count = 0
        self.white_m = rows("pos_white_m")
        self.offset_enu_m = np.zeros((3, n))
        self.drift_enu_m_s = np.zeros((3, n))
        self.misled_enu_m_s = np.zeros((3, n))
        self._coasting = Coasting(n)
        self.faulty = False
        self.pos_error, self.vel_error, self.att_error = np.split(self._errors.now, 3)
        shaken = any(noise.vel_in_air_only or noise.pos_follows_s for noise in noises)
        self._shaking = Shaking(noises, self._dt) if shaken else None
        if self._shaking is not None:
            self._shake(self._shaking, np.ones(n, dtype=bool))
        origin = np.array([noise.origin_sigma_m for noise in noises])
        self.origin_error_enu_m = np.clip(rng.standard_normal((3, n)), -2.0, 2.0) * origin
        self.origin_error_enu_m[2] *= 1.2

    def step(self, on_ground: NDArray[np.bool_]) -> None:
        """Lets the errors wander by one physics step; ``on_ground``: who stands, shape (n,)."""
        self._count += 1
        if self._count % _EVERY:
            return
        self._errors.step()
        if self._coasting.on:
            gained_m_s = self._coasting.step(self._dt, on_ground)
            self.drift_enu_m_s += gained_m_s
            self.misled_enu_m_s += gained_m_s
        if self.faulty:
            self.offset_enu_m += self.drift_enu_m_s * self._dt
        if self._shaking is not None:
            self._shake(self._shaking, on_ground)
        elif self.faulty:
            self.pos_error = self._errors.now[:3] + self.offset_enu_m
        if self.faulty:
            self._mislead()

    def _shake(self, shaking: Shaking, on_ground: NDArray[np.bool_]) -> None:
        self.vel_error = shaking.step(self._errors.now[3:6], on_ground)
        self.pos_error = self._errors.now[:3] + shaking.followed_m + self.offset_enu_m

    def refresh(self) -> None:
        """Lets what faults add, changed, act at once."""
        added = (self.offset_enu_m, self.drift_enu_m_s, self.misled_enu_m_s)
        self.faulty = self._coasting.on or any(bool(values.any()) for values in added)
        if self._shaking is not None:
            self.pos_error = self._errors.now[:3] + self._shaking.followed_m + self.offset_enu_m
        else:
            self.pos_error = self._errors.now[:3] + self.offset_enu_m if self.faulty else self._errors.now[:3]
        self._mislead()

    def mislead(self, index: int, by_enu_m_s: Sequence[float]) -> None:
        """Sets what is added to the error of one vehicle's velocity."""
        self.misled_enu_m_s[:, index] = by_enu_m_s
        self.refresh()

    def coast(self, index: int, enu_m_s2: Sequence[float] | None) -> None:
        """Lets one vehicle's estimate go astray with an acceleration; None: it is measured again, at once."""
        gone_m_s, gone_m = self._coasting.set(index, enu_m_s2)
        self.drift_enu_m_s[:, index] -= gone_m_s
        self.misled_enu_m_s[:, index] -= gone_m_s
        self.offset_enu_m[:, index] -= gone_m
        self.refresh()

    def _mislead(self) -> None:
        if self._shaking is None:  # a shaken one's velocity is made anew at every step
            self.vel_error = self._errors.now[3:6] + self.misled_enu_m_s if self.faulty else self._errors.now[3:6]

    def white(self) -> Array:
        """White part of one report of every position, shape (3, n), m."""
        return np.asarray(self._rng.standard_normal(self.white_m.shape) * self.white_m)
