"""The ground beneath the vehicles: the same height everywhere, or a floor on which pads stand as posts."""

from __future__ import annotations

import math

import numpy as np

from sitl.frames import Array
from sitl.motion import Commands, Health, Motion

_CONTACT_M = 1e-9
_HARD_M_S, _LEANING_UP = 1.5, math.cos(math.radians(55.0))
_LIES_UP = np.array([[math.sin(math.radians(80.0))], [0.0], [math.cos(math.radians(80.0))]])  # on its side
_PAD_REACH_M = 0.4  # a raised pad carries its vehicle that far from its middle


class Ground:
    """Holds up whoever has come down.

    Args:
        pads_enu_m: where the vehicles stand at first, shape (3, n).
        floor_m: height of the ground beside the pads; None: it is everywhere as high as each vehicle's pad.

    Attributes:
        height_m: of the ground beneath each vehicle, shape (n,).
        posts_up: False draws in every post that nobody stands on.
    """

    def __init__(self, pads_enu_m: Array, floor_m: float | None) -> None:
        self.height_m = pads_enu_m[2].copy()
        self.posts_up = True
        self._floor_m, self._pads_enu_m = floor_m, pads_enu_m.copy()
        self._contact_m = self.height_m + _CONTACT_M

    def stop(self, motion: Motion, integral: Array, health: Health, commands: Commands) -> None:
        """Stops at the ground whoever has reached it and does not lift; friction holds what stands.

        Args:
            motion: of all vehicles, changed.
            integral: of their velocity loops, changed, shape (3, n).
            health: who tumbles, and comes down leaning or fast, stays where it is. A motor that fails a hand's breadth
                above the ground does no harm: the vehicle is down before it leans.
            commands: who wants to leave the ground; who tumbles then turns over, and lies on its side as its
                attitude tells.
        """
        pos, vel = motion.pos_enu_m, motion.vel_enu_m_s
        below = pos[2] <= self._contact_m
        touching = b"\1" in below.tobytes()
        if touching:
            below &= vel[2] <= 0.0
            touching = bool(below.any())
        if touching:
            landing = below & ~motion.on_ground
            if landing.any():
                speed_m_s = np.linalg.norm(vel, axis=0)
                np.maximum(motion.touchdown_m_s, speed_m_s, out=motion.touchdown_m_s, where=landing)
                hits = landing & ((speed_m_s > _HARD_M_S) | (motion.up_enu[2] < _LEANING_UP))
                motion.crashed |= health.tumbling & hits
        motion.on_ground = below
        motion.any_on_ground = touching
        motion.all_on_ground = touching and bool(below.all())
        if touching:
            keep = ~below
            vel *= keep
            np.maximum(pos[2], self.height_m, out=pos[2], where=below)
            motion.acc_enu_m_s2 = motion.acc_enu_m_s2 * keep
            motion.up_rate *= keep
            motion.up_enu[:2] *= keep
            motion.up_enu[2][below] = 1.0
            integral *= keep
            if health.any_tumbling:
                lifts = commands.flying & (commands.vel_sp_enu_m_s[2] >= 0.0)
                motion.crashed |= health.tumbling & below & lifts
            if b"\1" in motion.crashed.tobytes():
                np.copyto(motion.up_enu, _LIES_UP, where=below & motion.crashed)
        if self._floor_m is not None:
            self._find(motion)

    def _find(self, motion: Motion) -> None:
        """Pads on posts: each carries its own vehicle while that is above it; elsewhere there is the floor."""
        away = motion.pos_enu_m - self._pads_enu_m
        carried = (away[2] >= -_CONTACT_M) & (away[0] * away[0] + away[1] * away[1] <= _PAD_REACH_M**2)
        if not self.posts_up:
            carried &= motion.on_ground
        self.height_m = np.where(carried, self._pads_enu_m[2], self._floor_m)
        self._contact_m = self.height_m + _CONTACT_M
