"""The vehicles of a race: the emulator's physics, seen and told over links that delay, wander and lose.

No autopilot, no MAVLink and no limits of an autopilot's own: velocities that were told reach the velocity loops.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from groundstation.core import frames
from groundstation.core.types import BoolArray, FloatArray
from sitl.dynamics import Dynamics
from sitl.estimator import MOCAP, Estimator
from sitl.frames import euler_from_thrust, quat_from_euler, yaw_ned_from_enu
from sitl.loops import GRAVITY_M_S2
from sitl.personalities import PROFILES

STEP_S = 0.004
TICK_S = 0.02
LINK_DELAY_S = 0.1
"""Of reports and of commands together: 0.048 and 0.052 s, whole steps of physics."""
WANDER_M = 0.02
_LOSS = 0.02
_STEPS = round(TICK_S / STEP_S)
_REPORT_STEPS, _COMMAND_STEPS = 12, 13


@dataclass(frozen=True)
class Seen:
    """What a ground station knows at a tick.

    Attributes:
        pos_ned_m: shape (n, 3).
        vel_ned_m_s: shape (n, 3).
        quat_ned_from_frd: shape (n, 4).
    """

    pos_ned_m: FloatArray
    vel_ned_m_s: FloatArray
    quat_ned_from_frd: FloatArray


@dataclass(frozen=True)
class Ticked:
    """What is true of one tick.

    Attributes:
        pos_enu_m: at its end, shape (n, 3).
        smallest_m: smallest distance of two vehicles at any step of physics.
        effort_m2_s3: square of the acceleration, over its time, mean of the vehicles.
    """

    pos_enu_m: FloatArray
    smallest_m: float
    effort_m2_s3: float


class Plant:
    """n vehicles of one kind that hover at their starts.

    Args:
        profile: of the emulator's.
        start_enu_m: shape (n, 3).
        seed: of wandering, noise and losses.
    """

    def __init__(self, profile: str, start_enu_m: FloatArray, seed: int) -> None:
        n = len(start_enu_m)
        rng = np.random.default_rng(seed)
        noise = replace(MOCAP, pos_sigma_m=WANDER_M)
        self._estimator = Estimator([noise] * n, STEP_S, rng)
        below = np.array([0.0, 0.0, 100.0])
        self._dynamics = Dynamics(
            [PROFILES[profile]] * n,
            pos_enu_m=(start_enu_m - below).T.copy(),
            yaw_enu_rad=np.asarray(rng.uniform(-np.pi, np.pi, n), dtype=np.float64),
            estimator=self._estimator,
            step_s=STEP_S,
        )
        motion = self._dynamics.motion
        motion.pos_enu_m[:] = start_enu_m.T
        motion.on_ground = np.zeros(n, dtype=np.bool_)
        motion.all_on_ground = motion.any_on_ground = False
        motion.thrust_m_s2[:] = GRAVITY_M_S2
        self._dynamics.commands.flying[:] = True
        # Losses have a generator of their own: whoever steers, the same ones are lost.
        self._losses = np.random.default_rng([seed, 1])
        self._pairs = np.triu_indices(n, 1)
        self._reports = deque([self._report()] * (_REPORT_STEPS + 1), maxlen=_REPORT_STEPS + 1)
        self._told = deque([np.zeros((3, n))] * (_COMMAND_STEPS + 1), maxlen=_COMMAND_STEPS + 1)
        self._last: FloatArray = np.zeros((3, n))
        self._seen = self._reports[0]

    def see(self) -> Seen:
        """The newest reports that have come; lost ones are carried on by their velocities."""
        came, before, lost = self._reports[0], self._seen, self._lost()[:, None]
        self._seen = Seen(
            np.where(lost, before.pos_ned_m + TICK_S * before.vel_ned_m_s, came.pos_ned_m),
            np.where(lost, before.vel_ned_m_s, came.vel_ned_m_s),
            np.where(lost, before.quat_ned_from_frd, came.quat_ned_from_frd),
        )
        return self._seen

    def tell(self, vel_ned_m_s: FloatArray) -> Ticked:
        """Tells velocities, shape (n, 3), and flies one tick; a vehicle whose command is lost keeps the one before."""
        self._last = np.where(self._lost(), self._last, frames.enu_from_ned(vel_ned_m_s).T)
        smallest_m, effort = np.inf, 0.0
        motion = self._dynamics.motion
        for _ in range(_STEPS):
            self._told.append(self._last)
            self._dynamics.commands.vel_sp_enu_m_s[:] = self._told[0]
            self._dynamics.step()
            self._reports.append(self._report())
            offset = motion.pos_enu_m[:, self._pairs[0]] - motion.pos_enu_m[:, self._pairs[1]]
            smallest_m = min(smallest_m, float(np.sqrt((offset * offset).sum(axis=0).min())))
            effort += STEP_S * float((motion.acc_enu_m_s2**2).sum(axis=0).mean())
        return Ticked(motion.pos_enu_m.T.copy(), smallest_m, effort)

    def _lost(self) -> BoolArray:
        return np.asarray(self._losses.random(self._dynamics.n) < _LOSS, dtype=np.bool_)

    def _report(self) -> Seen:
        motion, estimator = self._dynamics.motion, self._estimator
        up = motion.up_enu.copy()
        up[:2] += estimator.att_error[:2]
        up /= np.sqrt((up * up).sum(axis=0))
        yaw_ned_rad = np.asarray(yaw_ned_from_enu(motion.yaw_enu_rad + estimator.att_error[2]))
        roll, pitch = euler_from_thrust(up, yaw_ned_rad)
        return Seen(
            frames.ned_from_enu((motion.pos_enu_m + estimator.pos_error + estimator.white()).T),
            frames.ned_from_enu((motion.vel_enu_m_s + estimator.vel_error).T),
            np.ascontiguousarray(quat_from_euler(roll, pitch, yaw_ned_rad).T),
        )
