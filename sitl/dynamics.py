"""Quadrotors, all of them at once: tilt and thrust make the acceleration, loops with finite lag make the tilt.

State is held as structures of arrays in ENU, shape (3, n). A vehicle is a point mass with a thrust direction (its
upward body axis) and a heading; the attitude follows from the two. Autopilots write ``commands`` and read estimates;
nothing else reaches into the state but faults.

Refuses to know MAVLink, modes and clocks: one call of ``step`` is one physics step.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sitl.environment import Air, Downwash, Wind
from sitl.estimator import Estimator
from sitl.frames import Array
from sitl.ground import Ground
from sitl.loops import GRAVITY_M_S2, AttitudeLoop, HeadingLoop, Reference, VelocityLoop
from sitl.motion import Commands, Health, Motion
from sitl.own_frame import OwnFrames
from sitl.profiles import Profile


class Dynamics:
    """n quadrotors with their velocity, attitude and motor loops.

    Attributes:
        n: how many.
        motion: where they are and how they move, in truth.
        commands: what they are told to fly.
        health: what is left of their motors.
        ground: what they stand on.
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
        own_frames: OwnFrames | None = None,
        floor_m: float | None = None,
    ) -> None:
        self.n = len(profiles)
        self.motion = Motion(pos_enu_m, yaw_enu_rad)
        self.commands = Commands(profiles, pos_enu_m, yaw_enu_rad)
        self.health = Health(self.n)
        self.ground = Ground(pos_enu_m, floor_m)
        self._estimator = estimator
        self._dt, self._gravity = np.array(step_s), np.full(self.n, GRAVITY_M_S2)
        self._reference = Reference(profiles, step_s, own_frames)
        self._velocity = VelocityLoop(profiles, step_s)
        self._attitude = AttitudeLoop(profiles, step_s)
        self._heading = HeadingLoop(profiles, step_s)
        self._air = Air(profiles, step_s, wind, downwash)
        self._k = 0
        self._settled = False

    def step(self) -> None:
        """Moves every vehicle by one physics step."""
        estimator, motion, commands, k = self._estimator, self.motion, self.commands, self._k
        estimator.step(motion.on_ground)
        self._k = k + 1
        if motion.all_on_ground and b"\1" not in commands.flying.tobytes():
            if not self._settled:
                self._settle()
            return
        self._settled = False
        health, velocity, dt = self.health, self._velocity, self._dt
        ref, ref_rate = self._reference.step(k, commands, motion.pos_enu_m, estimator.pos_error)
        share = None if health.sound else health.thrust_share
        wanted = velocity.wanted(ref, ref_rate, motion.vel_enu_m_s, estimator.vel_error, share)
        self._attitude.step(k, motion, commands, health, wanted)

        # motion, semi-implicit
        acc = motion.up_enu * motion.thrust_m_s2
        acc[2] -= self._gravity
        self._air.push(acc, motion, ref, velocity)
        if motion.any_on_ground:
            acc[:2] *= ~motion.on_ground  # friction, until it has lifted
        motion.vel_enu_m_s += acc * dt
        motion.pos_enu_m += motion.vel_enu_m_s * dt
        motion.acc_enu_m_s2 = acc
        self.ground.stop(motion, velocity.integral, health, commands)
        if commands.yaw_used or health.any_tumbling:
            commands.yaw_used = True
            self._heading.step(k, motion, commands, health)

    def _settle(self) -> None:
        """Brings everything to rest while nobody flies; the steps that follow have nothing to do."""
        self.motion.rest()
        self._velocity.integral[:] = 0.0
        self._air.rest()
        self._reference.rest()
        self._settled = True
