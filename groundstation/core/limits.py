"""The last word before a setpoint is sent: finite, inside the fence, not too sudden, not too fast.

Everything is local NED axes, one row per vehicle. These functions only ever take away: they never make a vehicle
move that was told to stand, and they refuse (ValueError) anything that is not a number, so that no NaN reaches an
autopilot; whoever calls decides what is sent instead. Order: fence, acceleration, speed.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from groundstation.core import frames
from groundstation.core.quick import between, every, norms, some
from groundstation.core.types import FloatArray


@dataclass(frozen=True)
class Fence:
    """A box in the team frame, NED, that vehicles stay in; its bottom is the lowest height allowed.

    Attributes:
        min_team_ned_m: north, east, down at least, shape (3,).
        max_team_ned_m: north, east, down at most, shape (3,); the last is minus the floor's height.
    """

    min_team_ned_m: FloatArray
    max_team_ned_m: FloatArray

    def __post_init__(self) -> None:
        """Refuses boxes without an inside."""
        if self.min_team_ned_m.shape != (3,) or self.max_team_ned_m.shape != (3,):
            raise ValueError("fence: corners must have shape (3,)")
        if not every(self.min_team_ned_m < self.max_team_ned_m):
            raise ValueError(
                f"fence: every entry of min {self.min_team_ned_m.tolist()} must be below max "
                f"{self.max_team_ned_m.tolist()} (NED)"
            )

    @cached_property
    def corners_enu_m(self) -> tuple[FloatArray, FloatArray]:
        """Its lowest and its highest corner, ENU, shape (3,) each."""
        corners = [frames.enu_from_ned(corner) for corner in (self.min_team_ned_m, self.max_team_ned_m)]
        return np.minimum(*corners), np.maximum(*corners)

    @staticmethod
    def from_enu(min_team_enu_m: FloatArray, max_team_enu_m: FloatArray) -> Fence:
        """Makes a fence from the corners of a mission file, ENU, where the third entries are heights."""
        low, high = np.asarray(min_team_enu_m, dtype=np.float64), np.asarray(max_team_enu_m, dtype=np.float64)
        return Fence(
            min_team_ned_m=np.array([low[1], low[0], -high[2]]),
            max_team_ned_m=np.array([high[1], high[0], -low[2]]),
        )

    def outside_m(self, pos_team_ned_m: FloatArray) -> FloatArray:
        """Largest distance beyond a wall, shape (n,); 0 inside; NaN where the position is unknown."""
        beyond = np.maximum(self.min_team_ned_m - pos_team_ned_m, pos_team_ned_m - self.max_team_ned_m)
        return np.asarray(np.maximum(beyond.max(axis=-1), 0.0), dtype=np.float64)


def clamp_speed(vel_ned_m_s: FloatArray, speed_max_m_s: float) -> FloatArray:
    """Shortens velocities above the speed limit, keeping their direction.

    Args:
        vel_ned_m_s: one row per vehicle, shape (n, 3), local NED.
        speed_max_m_s: limit on the Euclidean norm, > 0.

    Returns:
        Shape (n, 3); rows within the limit come back unchanged.

    Raises:
        ValueError: shape, a non-finite entry, or a limit that is not positive.
    """
    _check(vel_ned_m_s, "velocities")
    if not speed_max_m_s > 0.0:
        raise ValueError(f"speed limit is {speed_max_m_s} m/s, must be positive")
    speed = norms(vel_ned_m_s)
    faster = speed > speed_max_m_s
    if not some(faster):
        return vel_ned_m_s.copy()
    return np.where(faster[:, None], vel_ned_m_s * _ratio(speed_max_m_s, speed), vel_ned_m_s)


def clamp_acceleration(
    vel_ned_m_s: FloatArray, previous_ned_m_s: FloatArray, accel_max_m_s2: float, period_s: float
) -> FloatArray:
    """Limits how far commanded velocities move from those sent before.

    Args:
        vel_ned_m_s: wanted now, shape (n, 3), local NED.
        previous_ned_m_s: sent one period ago, shape (n, 3).
        accel_max_m_s2: limit on the norm of the change per second, > 0.
        period_s: time since the previous setpoint, > 0.

    Returns:
        Shape (n, 3), on the straight line from the previous velocity to the wanted one.

    Raises:
        ValueError: shape, a non-finite entry, or a limit or period that is not positive.
    """
    _check(vel_ned_m_s, "velocities")
    _check(previous_ned_m_s, "previous velocities")
    if not (accel_max_m_s2 > 0.0 and period_s > 0.0):
        raise ValueError(f"acceleration limit {accel_max_m_s2} m/s^2 and period {period_s} s must be positive")
    change = vel_ned_m_s - previous_ned_m_s
    size = norms(change)
    step = accel_max_m_s2 * period_s
    farther = size > step
    if not some(farther):
        return vel_ned_m_s.copy()
    return np.where(farther[:, None], previous_ned_m_s + change * _ratio(step, size), vel_ned_m_s)


def fence_bounds(pos_team_ned_m: FloatArray, fence: Fence, rate_1_s: float) -> tuple[FloatArray, FloatArray]:
    """Largest speeds towards the six walls: proportional to the distance left, zero at and beyond the wall.

    Args:
        pos_team_ned_m: shape (n, 3). For vehicles that lag, give the place where they would come to rest,
            position + (lag + delay) * velocity.
        fence: the box.
        rate_1_s: speed allowed per metre left, > 0; 1 / (4 (delay + tick) + lag), as for the damper, can be followed.

    Returns:
        Speeds >= 0 towards the lower and towards the upper walls, each of shape (n, 3), m/s.

    Raises:
        ValueError: shape, a position that is not finite, or a rate that is not positive.
    """
    _check(pos_team_ned_m, "positions")
    if not rate_1_s > 0.0:
        raise ValueError(f"fence rate is {rate_1_s} 1/s, must be positive")
    low = np.maximum(pos_team_ned_m - fence.min_team_ned_m, 0.0) * rate_1_s
    high = np.maximum(fence.max_team_ned_m - pos_team_ned_m, 0.0) * rate_1_s
    return low, high


def clamp_to_fence(vel_ned_m_s: FloatArray, pos_team_ned_m: FloatArray, fence: Fence, rate_1_s: float) -> FloatArray:
    """Slows motion towards walls in proportion to the distance left; outside, only inward motion remains.

    Args:
        vel_ned_m_s: wanted, shape (n, 3).
        pos_team_ned_m: where the vehicles are, shape (n, 3).
        fence: the box.
        rate_1_s: see `fence_bounds`.

    Returns:
        Shape (n, 3), each component between zero and what was wanted.

    Raises:
        ValueError: shape, a non-finite entry, or a rate that is not positive.
    """
    _check(vel_ned_m_s, "velocities")
    low, high = fence_bounds(pos_team_ned_m, fence, rate_1_s)
    return between(vel_ned_m_s, -low, high)


def apply_limits(
    vel_ned_m_s: FloatArray,
    previous_ned_m_s: FloatArray,
    pos_team_ned_m: FloatArray,
    *,
    speed_max_m_s: float,
    accel_max_m_s2: float,
    period_s: float,
    fence: Fence | None,
    fence_rate_1_s: float,
) -> FloatArray:
    """Applies fence, acceleration and speed limits, in this order; the speed limit holds in any case.

    Args:
        vel_ned_m_s: wanted, shape (n, 3), local NED.
        previous_ned_m_s: sent one period ago, shape (n, 3).
        pos_team_ned_m: positions, shape (n, 3), team NED.
        speed_max_m_s: see `clamp_speed`.
        accel_max_m_s2: see `clamp_acceleration`.
        period_s: see `clamp_acceleration`.
        fence: the box, or None without one.
        fence_rate_1_s: see `fence_bounds`.

    Returns:
        What may be sent, shape (n, 3).

    Raises:
        ValueError: as those do.
    """
    _check(vel_ned_m_s, "velocities")
    vel = vel_ned_m_s if fence is None else clamp_to_fence(vel_ned_m_s, pos_team_ned_m, fence, fence_rate_1_s)
    vel = clamp_acceleration(vel, previous_ned_m_s, accel_max_m_s2, period_s)
    return clamp_speed(vel, speed_max_m_s)


def _check(rows: FloatArray, what: str) -> None:
    """Refuses anything but finite rows of three."""
    if rows.ndim != 2 or rows.shape[1] != 3:
        raise ValueError(f"{what} have shape {rows.shape}, expected (n, 3)")
    if not every(np.isfinite(rows)):
        bad = np.flatnonzero(~np.isfinite(rows).all(axis=1)).tolist()
        raise ValueError(f"{what} of rows {bad} are not finite numbers; nothing may be sent for them")


def _ratio(limit: float, size: FloatArray) -> FloatArray:
    """Factor limit / size as a column, 1 where size is within the limit (and may be zero)."""
    return np.asarray(np.minimum(1.0, limit / np.maximum(size, 1e-12))[:, None], dtype=np.float64)
