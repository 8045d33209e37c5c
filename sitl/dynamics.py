"""Quadrotors, all of them at once: tilt and thrust make the acceleration, loops with finite lag make the tilt.

State is held as structures of arrays in ENU, shape (3, n). A vehicle is a point mass with a thrust direction (its
upward body axis) and a heading; the attitude follows from the two. Autopilots write commands (``vel_sp_enu_m_s``,
``pos_sp_enu_m`` with a mask, yaw, ``flying``) and read estimates; nothing else reaches into the state but faults.

Refuses to know MAVLink, modes and clocks: one call of ``step`` is one physics step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sitl.environment import Downwash, Wind
from sitl.estimator import Estimator
from sitl.frames import Array, wrap_pi
from sitl.profiles import Profile

GRAVITY_M_S2 = 9.80665
_THRUST_MIN_G = 0.1  # props never stop in flight
_CONTACT_M = 1e-9
_YAW_EVERY = 5  # the yaw loop is slow: it runs every fifth step
_PAD_REACH_M = 0.4  # a raised pad carries its vehicle that far from its middle


class Dynamics:
    """n quadrotors with their velocity, attitude and motor loops.

    Attributes:
        pos_enu_m, vel_enu_m_s: truth, shape (3, n).
        acc_enu_m_s2: true acceleration of the last step, shape (3, n).
        up_enu: upward body axis, unit vectors, shape (3, n).
        up_rate: its derivative, 1/s, shape (3, n).
        thrust_m_s2: thrust over mass, shape (n,).
        yaw_enu_rad, yaw_rate_rad_s: heading from east counter-clockwise, shape (n,).
        on_ground: whether the vehicle stands, shape (n,) bool.
        ground_m: height of the ground beneath each vehicle: its pad's, everywhere, unless a floor was given; then pads
            are posts on it, shape (n,).
        posts_up: False draws in every post that nobody stands on.
        vel_sp_enu_m_s: commanded velocity, feed-forward where a position is held, shape (3, n).
        pos_sp_enu_m, pos_mask: commanded position (estimated frame) and which axes hold it, shape (3, n).
        speed_limit_m_s: limits of the position loop, rows: horizontal, up, down, shape (3, n).
        yaw_sp_enu_rad, yaw_rate_sp_rad_s, yaw_mask: heading command, rate command, which of them counts, (n,).
        flying: motors may lift; without it they idle or stand, shape (n,) bool.
        thrust_share: what is left of the motors' power, 1 when healthy, shape (n,).
        tumbling: a motor has failed: attitude control is lost, shape (n,) bool.
        crashed: has hit the ground tumbling and will not fly again, shape (n,) bool.
        touchdown_m_s: largest speed with which each has come to the ground so far, shape (n,).
    """

    def __init__(
        self,
        profiles: Sequence[Profile],
        *,
        pos_enu_m: Array,
        yaw_enu_rad: Array,
        estimator: Estimator,
        step_s: float,
        wind: Wind | None = None,
        downwash: Downwash | None = None,
        floor_m: float | None = None,
    ) -> None:
        n = len(profiles)
        self.n, self.step_s, self.estimator = n, step_s, estimator
        self.profiles = tuple(profiles)
        self._wind, self._downwash = wind, downwash

        def column(name: str) -> Array:
            return np.array([getattr(profile, name) for profile in profiles], dtype=np.float64)

        def axes(xy: str, z: str) -> Array:
            return np.stack([column(xy), column(xy), column(z)])

        self._kp = axes("kp_xy_per_s", "kp_z_per_s")
        self._ki_dt = axes("ki_xy_per_s2", "ki_z_per_s2") * step_s
        self._drag = column("drag_per_s")
        self._air_per_s, self._air_per_m = column("air_per_s"), column("air_per_m")
        self._sticky = np.maximum(self._drag - self._air_per_s, 0.0)
        self._drag_ff = self._drag * column("drag_feedforward")
        filter_s = column("filter_s")
        self._filtered = bool((filter_s > 0).any())
        self._filter_gain = np.where(filter_s > 0, 1.0 - np.exp(-step_s / np.maximum(filter_s, 1e-9)), 1.0)
        self._filter_ff = column("filter_feedforward") / step_s
        self._accel_max = column("accel_max_m_s2")
        self._omega = column("attitude_rad_s")
        self._omega2_dt = self._omega**2 * step_s
        self._damp = 1.0 / (1.0 + 2.0 * self._omega * step_s)  # implicit in the damping: stable at any step
        self._tilt_rate_max = column("tilt_rate_max_rad_s")
        self._thrust_gain = 1.0 - np.exp(-step_s / column("thrust_lag_s"))
        self._tilt_tan = np.tan(column("tilt_max_rad"))
        self._thrust_max = column("thrust_max_g") * GRAVITY_M_S2
        self._yaw_gain, self._yaw_rate_max = column("yaw_gain_per_s"), column("yaw_rate_max_rad_s")
        self._kpos = column("position_gain_per_s")

        delay = np.maximum(np.rint(column("dead_time_s") / step_s).astype(np.int64), 0)
        self._delay_len = int(delay.max()) + 1
        self._delay, self._cols = delay, np.arange(n)
        self._delay_same = int(delay[0]) if (delay == delay[0]).all() else None
        self._queue = np.zeros((self._delay_len, 3, n))
        self._k = 0

        self.ground_m = pos_enu_m[2].copy()
        self._floor_m, self._pads_enu_m = floor_m, pos_enu_m.copy()
        self.posts_up = True
        self.pos_enu_m = pos_enu_m.copy()
        self.vel_enu_m_s = np.zeros((3, n))
        self.acc_enu_m_s2 = np.zeros((3, n))
        self.up_enu = np.zeros((3, n))
        self.up_enu[2] = 1.0
        self.up_rate = np.zeros((3, n))
        self.thrust_m_s2 = np.zeros(n)
        self.yaw_enu_rad = yaw_enu_rad.copy()
        self.yaw_rate_rad_s = np.zeros(n)
        self.on_ground: NDArray[np.bool_] = np.ones(n, dtype=bool)
        self.all_on_ground = self._any_on_ground = True
        self._integral = np.zeros((3, n))
        self._ref1, self._ref = np.zeros((3, n)), np.zeros((3, n))
        self._calm_vel, self._calm_integral = np.zeros((3, n)), np.zeros((3, n))

        self.vel_sp_enu_m_s = np.zeros((3, n))
        self.pos_sp_enu_m = pos_enu_m.copy()
        self.pos_mask = np.zeros((3, n))
        self.speed_limit_m_s = np.stack(
            [column("speed_xy_max_m_s"), column("speed_up_max_m_s"), column("speed_down_max_m_s")]
        )
        self.yaw_sp_enu_rad = yaw_enu_rad.copy()
        self.yaw_rate_sp_rad_s = np.zeros(n)
        self.yaw_mask: NDArray[np.bool_] = np.ones(n, dtype=bool)
        self.flying: NDArray[np.bool_] = np.zeros(n, dtype=bool)
        self.thrust_share = np.ones(n)
        self.tumbling: NDArray[np.bool_] = np.zeros(n, dtype=bool)
        self.crashed: NDArray[np.bool_] = np.zeros(n, dtype=bool)
        self.touchdown_m_s = np.zeros(n)
        self.positions_used = False  # set by whoever writes pos_mask: the position loop is skipped until then
        self.yaw_used = False
        self._idle_settled = False

    def step(self) -> None:
        """Moves every vehicle by one physics step."""
        self.estimator.step()
        if self.all_on_ground and not self.flying.any():
            if not self._idle_settled:
                self._settle_on_ground()
            self._k += 1
            return
        self._idle_settled = False
        dt = self.step_s
        ref, ref_rate = self._reference()
        flying = self.flying
        vel = self.vel_enu_m_s

        error = ref - vel
        error -= self.estimator.vel_error
        self._integral += error * self._ki_dt
        np.maximum(self._integral, -5.0, out=self._integral)
        np.minimum(self._integral, 5.0, out=self._integral)
        acc = error
        acc *= self._kp
        acc += self._integral
        acc += ref * self._drag_ff
        if ref_rate is not None:
            acc += ref_rate

        # horizontal acceleration: limited by itself, by the tilt, and by the thrust that is left beside the weight
        horizontal = np.hypot(acc[0], acc[1])
        thrust_max = self._thrust_max * self.thrust_share
        lift = acc[2]
        lift += GRAVITY_M_S2
        np.maximum(lift, _THRUST_MIN_G * GRAVITY_M_S2, out=lift)
        np.minimum(lift, thrust_max, out=lift)
        limit = np.minimum(self._accel_max, self._tilt_tan * lift)
        np.minimum(limit, np.sqrt(thrust_max * thrust_max - lift * lift), out=limit)
        acc[:2] *= np.minimum(limit / np.maximum(horizontal, 1e-9), 1.0)
        thrust = np.sqrt(acc[0] * acc[0] + acc[1] * acc[1] + lift * lift)

        # attitude: second order towards the wanted thrust direction; motors: first order
        up = self.up_enu
        acc /= np.maximum(thrust, 1e-9)
        if self.tumbling.any():
            self._tumble(acc)
        rate = self.up_rate
        acc -= up
        acc *= self._omega2_dt
        rate += acc
        rate *= self._damp
        speed = np.sqrt((rate * rate).sum(axis=0))
        rate *= np.minimum(self._tilt_rate_max / np.maximum(speed, 1e-9), 1.0)
        up += rate * dt
        up /= np.sqrt((up * up).sum(axis=0))
        thrust *= flying & ~self.crashed
        self.thrust_m_s2 += (thrust - self.thrust_m_s2) * self._thrust_gain

        # motion, semi-implicit
        force = up * self.thrust_m_s2
        force[2] -= GRAVITY_M_S2
        force -= vel * self._drag
        if self._wind is not None:
            force += self._blown(ref, self._wind.step())
        if self._downwash is not None:
            force[2] -= self._downwash.acceleration(self.pos_enu_m, self.thrust_m_s2)
        if self._any_on_ground:
            force[:2] *= ~self.on_ground  # friction, until it has lifted
        vel += force * dt
        self.pos_enu_m += vel * dt
        self.acc_enu_m_s2 = force
        self._ground()
        self._turn()
        self._k += 1

    def _reference(self) -> tuple[Array, Array | None]:
        """The velocity that the loop is to follow now: position loop, dead time, command filters."""
        command = self.vel_sp_enu_m_s
        if self.positions_used:
            pull = self.pos_sp_enu_m - self.pos_enu_m
            pull -= self.estimator.pos_error
            pull *= self._kpos
            pull *= self.pos_mask
            norm = np.hypot(pull[0], pull[1])
            pull[:2] *= np.minimum(self.speed_limit_m_s[0] / np.maximum(norm, 1e-9), 1.0)
            np.minimum(pull[2], self.speed_limit_m_s[1], out=pull[2])
            np.maximum(pull[2], -self.speed_limit_m_s[2], out=pull[2])
            command = command + pull
        queue, k = self._queue, self._k
        queue[k % self._delay_len] = command
        if self._delay_same is not None:
            ref = queue[(k - self._delay_same) % self._delay_len]
        else:
            ref = queue[(k - self._delay) % self._delay_len, :, self._cols].T
        if not self._filtered:
            return ref, None
        self._ref1 += (ref - self._ref1) * self._filter_gain
        change = (self._ref1 - self._ref) * self._filter_gain
        self._ref = self._ref + change
        return self._ref, change * self._filter_ff

    def _blown(self, ref: Array, air: Array) -> Array:
        """What the wind adds to the acceleration in still air: nothing without any, shape (3, n).

        The pull of the air past the vehicle takes the place of that of still air. Drag beyond what air can do belongs
        to commanded motion alone, which a twin in still air follows: else it would hold a vehicle against gusts, as
        nothing holds a real one.
        """
        vel = self.vel_enu_m_s
        past = air - vel
        blown = (self._air_per_s + self._air_per_m * np.sqrt((past * past).sum(axis=0))) * past
        blown += (self._air_per_s + self._air_per_m * np.sqrt((vel * vel).sum(axis=0))) * vel
        error = ref - self._calm_vel
        self._calm_integral += error * self._ki_dt
        self._calm_vel += (error * self._kp + self._calm_integral - self._drag * self._calm_vel) * self.step_s
        blown += self._sticky * (vel - self._calm_vel)
        if self._any_on_ground:
            self._calm_vel *= ~self.on_ground
            self._calm_integral *= ~self.on_ground
        return np.asarray(blown)

    def _ground(self) -> None:
        """Stops at the ground whoever has reached it and does not lift; friction holds what stands."""
        pos, vel = self.pos_enu_m, self.vel_enu_m_s
        below = pos[2] <= self.ground_m + _CONTACT_M
        below &= vel[2] <= 0.0
        landing = below & ~self.on_ground
        if landing.any():
            np.maximum(self.touchdown_m_s, np.linalg.norm(vel, axis=0), out=self.touchdown_m_s, where=landing)
        self.on_ground = below
        touching = self._any_on_ground = bool(below.any())
        self.all_on_ground = touching and bool(below.all())
        if touching:
            keep = ~below
            vel *= keep
            np.maximum(pos[2], self.ground_m, out=pos[2], where=below)
            self.acc_enu_m_s2 = self.acc_enu_m_s2 * keep
            self.up_rate *= keep
            self.up_enu[:2] *= keep
            self.up_enu[2][below] = 1.0
            self._integral *= keep
            self.crashed |= self.tumbling & below
        if self._floor_m is not None:
            self._find_ground()

    def _find_ground(self) -> None:
        """Pads on posts: each carries its own vehicle while that is above it; elsewhere there is the floor."""
        away = self.pos_enu_m - self._pads_enu_m
        carried = (away[2] >= -_CONTACT_M) & (away[0] * away[0] + away[1] * away[1] <= _PAD_REACH_M**2)
        if not self.posts_up:
            carried &= self.on_ground
        self.ground_m = np.where(carried, self._pads_enu_m[2], self._floor_m)

    def _settle_on_ground(self) -> None:
        """Brings everything to rest while nobody flies; the steps that follow have nothing to do."""
        self.vel_enu_m_s[:] = 0.0
        self.acc_enu_m_s2 = np.zeros((3, self.n))
        self.thrust_m_s2[:] = 0.0
        self.yaw_rate_rad_s[:] = 0.0
        self._integral[:] = 0.0
        self._calm_vel[:] = 0.0
        self._calm_integral[:] = 0.0
        self._queue[:] = 0.0
        self._ref1[:] = 0.0
        self._ref = np.zeros((3, self.n))
        self._idle_settled = True

    def _turn(self) -> None:
        """Turns the heading towards its command; the ground holds it."""
        if not self.yaw_used:
            return
        self.yaw_enu_rad += self.yaw_rate_rad_s * self.step_s
        if self._k % _YAW_EVERY:
            return
        error = wrap_pi(self.yaw_sp_enu_rad - self.yaw_enu_rad)
        rate = np.where(self.yaw_mask, self._yaw_gain * error, self.yaw_rate_sp_rad_s)
        rate = np.clip(rate, -self._yaw_rate_max, self._yaw_rate_max)
        rate[self.on_ground] = 0.0
        rate[self.tumbling] = 10.0
        self.yaw_rate_rad_s += (rate - self.yaw_rate_rad_s) * (_YAW_EVERY * self.step_s / 0.08)

    def _tumble(self, wanted_up: Array) -> None:
        """Replaces the wanted attitude of vehicles that have lost a motor: they roll over, turning."""
        phase = 3.0 * self._k * self.step_s
        for i in np.flatnonzero(self.tumbling):
            wanted_up[:, i] = (math.sin(1.2) * math.cos(phase), math.sin(1.2) * math.sin(phase), math.cos(1.2))
        self.yaw_used = True

    def airborne(self) -> NDArray[np.bool_]:
        """Which vehicles are off the ground, shape (n,)."""
        return ~self.on_ground
