"""The control loops of all vehicles at once, each with its own parameters and its own memory.

What is commanded becomes a velocity (``Reference``), that an acceleration (``VelocityLoop``), that a thrust direction
and a thrust (``AttitudeLoop``); the heading has a loop of its own. Numbers come from the profiles. Refuses to know
where vehicles are but by what it is given.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sitl.frames import Array, between, wrap_pi
from sitl.motion import Commands, Health, Motion
from sitl.own_frame import OwnFrames
from sitl.profiles import Profile, column, columns, spread

GRAVITY_M_S2 = 9.80665
# Every step of every flight comes through here, and arrays are small: an operation on two arrays of one shape takes
# less time than one with a plain number, and a third of one in which a row is spread over three. Shortening what is
# short enough, times 1, is left out.
_GRAVITY, _TINY, _ONE = np.array(GRAVITY_M_S2), np.array(1e-9), np.array(1.0)
_THRUST_MIN_G = 0.1  # props never stop in flight
_INTEGRAL_MIN_M_S2, _INTEGRAL_MAX_M_S2 = np.array(-5.0), np.array(5.0)
_YAW_EVERY = 5  # the yaw loop is slow: it runs every fifth step


def _all(mask: NDArray[np.bool_]) -> bool:
    """Whether it is so of everybody: ``mask.all()`` in a seventh of its time."""
    return b"\0" not in mask.tobytes()


def _shorten(vectors: Array, limit: Array) -> None:
    """Shortens the first two rows, shape (3, n), to a length, shape (n,), where they are longer."""
    length = np.hypot(vectors[0], vectors[1])
    if not _all(length <= limit):
        vectors[:2] *= np.minimum(limit / np.maximum(length, _TINY), _ONE)


class Reference:
    """The velocity that is to be followed now: position loop, own idea of north and level, dead time, shaping."""

    def __init__(self, profiles: Sequence[Profile], step_s: float, own_frames: OwnFrames | None = None) -> None:
        n, self._own_frames = len(profiles), own_frames
        self._kpos = spread(profiles, "loops.position_gain_per_s")
        delay = np.maximum(np.rint(column(profiles, "loops.dead_time_s") / step_s).astype(np.int64), 0)
        self._delay, self._cols = delay, np.arange(n)
        self._delay_same = int(delay[0]) if (delay == delay[0]).all() else None
        self._length = int(delay.max()) + 1
        self._queue = np.zeros((self._length, 3, n))
        shaped = column(profiles, "loops.shape.accel_xy_m_s2") > 0.0
        self._shaping = Shaping(profiles, step_s) if shaped.any() else None

    def step(self, k: int, commands: Commands, pos_enu_m: Array, pos_error_m: Array) -> tuple[Array, Array | None]:
        """Moves on by one step.

        Args:
            k: number of the step.
            commands: of the autopilots.
            pos_enu_m: truth, shape (3, n).
            pos_error_m: by how much what is believed differs from it, shape (3, n).

        Returns:
            The velocity, and what its change adds to the acceleration (None: nothing), shape (3, n), not to be written.
        """
        command = commands.vel_sp_enu_m_s
        if commands.positions_used and np.count_nonzero(commands.pos_mask):
            limits = commands.speed_limit_m_s
            pull = commands.pos_sp_enu_m - pos_enu_m
            pull -= pos_error_m
            pull *= self._kpos
            pull *= commands.pos_mask
            _shorten(pull, limits[0])
            np.minimum(pull[2], limits[1], out=pull[2])
            np.maximum(pull[2], -limits[2], out=pull[2])
            command = command + pull
        if self._own_frames is not None:
            command = self._own_frames.flown(command)
        queue = self._queue
        queue[k % self._length] = command
        if self._delay_same is not None:
            ref = queue[(k - self._delay_same) % self._length]
        else:
            ref = queue[(k - self._delay) % self._length, :, self._cols].T
        return (ref, None) if self._shaping is None else self._shaping.step(ref)

    def rest(self) -> None:
        """Forgets what was commanded."""
        self._queue[:] = 0.0
        if self._shaping is not None:
            self._shaping.rest()


class Shaping:
    """Commands that change with limited acceleration and jerk, as ArduCopter's GUIDED mode gives them to its loop.

    What is left of the way to the command asks for an acceleration: in proportion while that is little, so that a
    small change is one lag, and as its root beyond, so that the jerk has room to end it (``shape_vel_accel`` and
    ``sqrt_controller`` of ArduPilot's AP_Math). Level it is one length, upward another.
    """

    def __init__(self, profiles: Sequence[Profile], step_s: float) -> None:
        level, up = "loops.shape.accel_xy_m_s2", "loops.shape.accel_z_m_s2"
        accel = columns(profiles, level, level, up)
        self._as_is: NDArray[np.bool_] = accel <= 0.0
        self._some_as_is = bool(self._as_is.any())
        self._accel = np.where(self._as_is, 1.0, accel)
        jerk = np.where(self._as_is, 1.0, spread(profiles, "loops.shape.jerk_m_s3"))
        self._twice_jerk, self._jerk_dt, self._dt = 2.0 * jerk, jerk * step_s, np.array(step_s)
        self._per_s = jerk / self._accel
        self._little = jerk / self._per_s**2
        self._half_little = 0.5 * self._little
        self._vel, self._acc = np.zeros_like(accel), np.zeros_like(accel)

    def step(self, ref: Array) -> tuple[Array, Array]:
        """The velocity to follow and its acceleration, shape (3, n), not to be written, of commands, shape (3, n)."""
        left = ref - self._vel
        size = self._sizes(left)
        asked = self._per_s * size
        if not _all(size <= self._little):
            beyond = np.sqrt(self._twice_jerk * np.maximum(size - self._half_little, _TINY))
            asked = np.where(size <= self._little, asked, beyond)
        np.minimum(asked, self._accel, out=asked)
        left *= asked
        left /= size
        left -= self._acc
        left *= np.minimum(self._jerk_dt / self._sizes(left), _ONE)
        self._acc = self._acc + left
        self._vel = self._vel + self._acc * self._dt
        if self._some_as_is:
            self._vel[self._as_is] = ref[self._as_is]
            self._acc[self._as_is] = 0.0
        return self._vel, self._acc

    def rest(self) -> None:
        """Forgets what was commanded."""
        self._vel, self._acc = np.zeros_like(self._vel), np.zeros_like(self._acc)

    @staticmethod
    def _sizes(vectors: Array) -> Array:
        """Length of the level part in the first two rows, of the upward part in the third, shape (3, n), > 0."""
        out = np.abs(vectors)
        out[1] = out[0] = np.hypot(vectors[0], vectors[1])
        np.maximum(out, _TINY, out=out)
        return out


class VelocityLoop:
    """A PI controller on the estimated velocity, with the drag and the change of the command fed forward.

    Attributes:
        kp: its gain, shape (3, n), 1/s.
        ki_dt: integral gain times the step, shape (3, n), 1/s.
        integral: shape (3, n), m/s^2.
    """

    def __init__(self, profiles: Sequence[Profile], step_s: float) -> None:
        self.kp = columns(profiles, "loops.kp_xy_per_s", "loops.kp_xy_per_s", "loops.kp_z_per_s")
        self.ki_dt = columns(profiles, "loops.ki_xy_per_s2", "loops.ki_xy_per_s2", "loops.ki_z_per_s2") * step_s
        self.integral = np.zeros((3, len(profiles)))
        self._drag_ff = spread(profiles, "frame.drag_per_s") * spread(profiles, "loops.drag_feedforward")
        self._accel_max = column(profiles, "loops.accel_max_m_s2")
        self._tilt_tan = np.tan(column(profiles, "loops.tilt_max_rad"))
        self._thrust_max = column(profiles, "frame.thrust_max_g") * GRAVITY_M_S2
        self._thrust_max_squared = self._thrust_max * self._thrust_max
        self._thrust_min = np.full(len(profiles), _THRUST_MIN_G * GRAVITY_M_S2)

    def wanted(
        self, ref: Array, ref_rate: Array | None, vel: Array, vel_error: Array, thrust_share: Array | None
    ) -> tuple[Array, Array]:
        """The specific force that it asks for.

        Args:
            ref: as ``Reference.step`` gives it, shape (3, n).
            ref_rate: the same.
            vel: truth, shape (3, n).
            vel_error: by how much what is believed differs from it, shape (3, n).
            thrust_share: what is left of the motors' power, shape (n,); None: all of everybody's.

        Returns:
            The force, shape (3, n), and its size, shape (n,), m/s^2: limited as a horizontal acceleration by itself,
            by the tilt, and by the thrust that is left beside the weight.
        """
        acc = ref - vel
        acc -= vel_error
        integral = self.integral
        integral += acc * self.ki_dt
        np.maximum(integral, _INTEGRAL_MIN_M_S2, out=integral)
        np.minimum(integral, _INTEGRAL_MAX_M_S2, out=integral)
        acc *= self.kp
        acc += integral
        acc += ref * self._drag_ff
        if ref_rate is not None:
            acc += ref_rate
        thrust_max, thrust_max_squared = self._thrust_max, self._thrust_max_squared
        if thrust_share is not None:
            thrust_max = thrust_max * thrust_share
            thrust_max_squared = thrust_max * thrust_max
        lift = acc[2]
        lift += _GRAVITY
        np.maximum(lift, self._thrust_min, out=lift)
        np.minimum(lift, thrust_max, out=lift)
        limit = np.minimum(self._accel_max, self._tilt_tan * lift)
        np.minimum(limit, np.sqrt(thrust_max_squared - lift * lift), out=limit)
        _shorten(acc, limit)
        squares = acc * acc
        size = squares[0] + squares[1]
        size += squares[2]
        return acc, np.sqrt(size, out=size)


class AttitudeLoop:
    """Attitude of second order towards the wanted thrust direction; motors of first order."""

    def __init__(self, profiles: Sequence[Profile], step_s: float) -> None:
        omega = spread(profiles, "loops.attitude_rad_s")
        self._step_s, self._dt = step_s, np.array(step_s)
        self._omega2_dt = omega**2 * step_s
        self._damp = 1.0 / (1.0 + 2.0 * omega * step_s)  # implicit in the damping: stable at any step
        self._rate_max = column(profiles, "loops.tilt_rate_max_rad_s")
        self._thrust_gain = 1.0 - np.exp(-step_s / column(profiles, "frame.thrust_lag_s"))

    def step(self, k: int, motion: Motion, commands: Commands, health: Health, wanted: tuple[Array, Array]) -> None:
        """Moves on by one step.

        Args:
            k: number of the step.
            motion: of which the upward axes and the thrusts are moved on.
            commands: who may lift.
            health: who tumbles.
            wanted: force and thrust as ``VelocityLoop.wanted`` gives them; used up.
        """
        (force, thrust), up, rate = wanted, motion.up_enu, motion.up_rate
        force /= thrust if health.sound else np.maximum(thrust, _TINY)
        if health.any_tumbling:
            self._tumble(force, health, 3.0 * k * self._step_s)
        force -= up
        force *= self._omega2_dt
        rate += force
        rate *= self._damp
        speed = np.sqrt(np.add.reduce(rate * rate, axis=0))
        if not _all(speed <= self._rate_max):
            rate *= np.minimum(self._rate_max / np.maximum(speed, _TINY), _ONE)
        up += rate * self._dt
        up /= np.sqrt(np.add.reduce(up * up, axis=0))
        able = commands.flying
        if b"\1" in motion.crashed.tobytes():
            able = able & ~motion.crashed
        if not _all(able):
            thrust *= able
        motion.thrust_m_s2 += (thrust - motion.thrust_m_s2) * self._thrust_gain

    def _tumble(self, wanted_up: Array, health: Health, phase: float) -> None:
        """Replaces the wanted attitude of vehicles that have lost a motor: they roll over, turning."""
        for i in np.flatnonzero(health.tumbling):
            wanted_up[:, i] = (math.sin(1.2) * math.cos(phase), math.sin(1.2) * math.sin(phase), math.cos(1.2))


class HeadingLoop:
    """Turns headings towards their commands; the ground holds them."""

    def __init__(self, profiles: Sequence[Profile], step_s: float) -> None:
        self._dt = np.array(step_s)
        self._slew = _YAW_EVERY * step_s / 0.08
        self._gain, self._rate_max = (
            column(profiles, "loops.yaw_gain_per_s"),
            column(profiles, "loops.yaw_rate_max_rad_s"),
        )

    def step(self, k: int, motion: Motion, commands: Commands, health: Health) -> None:
        """Moves on by one step; ``k`` is its number."""
        motion.yaw_enu_rad += motion.yaw_rate_rad_s * self._dt
        if k % _YAW_EVERY:
            return
        error = wrap_pi(commands.yaw_sp_enu_rad - motion.yaw_enu_rad)
        rate = np.where(commands.yaw_mask, self._gain * error, commands.yaw_rate_sp_rad_s)
        rate = between(rate, -self._rate_max, self._rate_max)
        rate[motion.on_ground] = 0.0
        rate[health.tumbling] = 10.0
        motion.yaw_rate_rad_s += (rate - motion.yaw_rate_rad_s) * self._slew
