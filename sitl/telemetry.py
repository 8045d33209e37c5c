"""What the vehicles believe at one instant, in NED, for all of them at once.

``MAKERS`` (in ``messages``) turn a view into columns of one message type. Refuses to encode and to send.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

import numpy as np

from sitl import frames
from sitl.frames import Array
from sitl.state import State

_T = TypeVar("_T")


class _once(Generic[_T]):  # noqa: N801 - a decorator, like functools' cached_property, which takes a lock
    """Works a property out when it is first asked for."""

    def __init__(self, make: Callable[[View], _T]) -> None:
        self._make = make

    def __get__(self, owner: View, _kind: object = None) -> _T:
        """Called once: from then on the value is found before this."""
        value = owner.__dict__[self._make.__name__] = self._make(owner)
        return value


class View:
    """What all vehicles believe at one instant. Everything is computed when first asked for.

    Args:
        state: where it is read from; must not move on while the view is in use.
    """

    def __init__(self, state: State) -> None:
        self.state = state

    @_once
    def pos_enu_m(self) -> Array:
        """Believed position in the world's frame, white part included, shape (3, n)."""
        state = self.state
        believed = state.dynamics.motion.pos_enu_m + state.estimator.pos_error + state.estimator.white()
        if b"\1" in state.broken.frozen.tobytes():
            believed = np.where(state.broken.frozen, state.broken.frozen_pos_enu_m, believed)
        if b"\1" in state.broken.invalid.tobytes():
            believed = np.where(state.broken.invalid, np.nan, believed)
        return np.asarray(believed)

    @_once
    def vel_enu_m_s(self) -> Array:
        """Believed velocity, shape (3, n)."""
        state = self.state
        believed = state.dynamics.motion.vel_enu_m_s + state.estimator.vel_error
        if b"\1" in state.broken.frozen.tobytes():
            believed = np.where(state.broken.frozen, 0.0, believed)
        if b"\1" in state.broken.invalid.tobytes():
            believed = np.where(state.broken.invalid, np.nan, believed)
        return np.asarray(believed)

    @_once
    def local_ned_m(self) -> Array:
        """Position from each vehicle's own origin, shape (3, n)."""
        return frames.ned_from_enu(self.pos_enu_m - self.state.known.origin_enu_m)

    @_once
    def vel_ned_m_s(self) -> Array:
        """Velocity, shape (3, n)."""
        return frames.ned_from_enu(self.vel_enu_m_s)

    @_once
    def euler_rad(self) -> tuple[Array, Array, Array]:
        """Roll, pitch, yaw of FRD to NED as estimated, shape (n,) each."""
        dynamics, error = self.state.dynamics, self.state.estimator.att_error
        up = dynamics.motion.up_enu.copy()
        up[:2] += error[:2]
        up /= np.sqrt(np.add.reduce(up * up, axis=0))
        yaw_enu_rad, own = dynamics.motion.yaw_enu_rad + error[2], self.state.own_frames
        if own is not None:
            up, yaw_enu_rad = own.believed(up), yaw_enu_rad - own.heading_rad
        yaw = frames.yaw_ned_from_enu(yaw_enu_rad)
        roll, pitch = frames.euler_from_thrust(up, yaw)
        return roll, pitch, yaw

    @_once
    def quat_ned_from_frd(self) -> Array:
        """The same as a quaternion, shape (4, n)."""
        return frames.quat_from_euler(*self.euler_rad)

    @_once
    def rates_frd_rad_s(self) -> Array:
        """Body rates, shape (3, n)."""
        dynamics = self.state.dynamics
        a, b = dynamics.motion.up_enu, dynamics.motion.up_rate
        omega = a * dynamics.motion.yaw_rate_rad_s
        omega[0] += a[1] * b[2] - a[2] * b[1]
        omega[1] += a[2] * b[0] - a[0] * b[2]
        omega[2] += a[0] * b[1] - a[1] * b[0]
        return frames.frd_from_ned(self.quat_ned_from_frd, frames.ned_from_enu(omega))

    @_once
    def specific_force_frd_m_s2(self) -> Array:
        """What an accelerometer feels: acceleration minus gravity, shape (3, n)."""
        force = self.state.dynamics.motion.acc_enu_m_s2.copy()
        force[2] += 9.80665
        return frames.frd_from_ned(self.quat_ned_from_frd, frames.ned_from_enu(force))

    @_once
    def geodetic(self) -> tuple[Array, Array, Array]:
        """Latitude and longitude in degrees, height in m, shape (n,) each."""
        return self.state.geodesy.geodetic_from_enu(self.pos_enu_m)
