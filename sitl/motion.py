"""What is true of all vehicles' motion, what they are told to fly, and what is broken: arrays, one column a vehicle.

Refuses to move anything: ``dynamics`` does.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sitl.frames import Array
from sitl.profiles import Profile, column


class Motion:
    """Where n vehicles are and how they move, in truth.

    Attributes:
        pos_enu_m, vel_enu_m_s: shape (3, n).
        acc_enu_m_s2: acceleration of the last step, shape (3, n).
        up_enu: upward body axis, unit vectors, shape (3, n).
        up_rate: its derivative, 1/s, shape (3, n).
        thrust_m_s2: thrust over mass, shape (n,).
        yaw_enu_rad, yaw_rate_rad_s: heading from east counter-clockwise, shape (n,).
        on_ground: whether the vehicle stands, shape (n,) bool.
        all_on_ground, any_on_ground: whether all of them do, and whether anybody does.
        crashed: has hit the ground tumbling and will not fly again, shape (n,) bool.
        touchdown_m_s: largest speed with which each has come to the ground so far, shape (n,).
    """

    def __init__(self, pos_enu_m: Array, yaw_enu_rad: Array) -> None:
        n = pos_enu_m.shape[1]
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
        self.all_on_ground = self.any_on_ground = True
        self.crashed: NDArray[np.bool_] = np.zeros(n, dtype=bool)
        self.touchdown_m_s = np.zeros(n)

    def airborne(self) -> NDArray[np.bool_]:
        """Which vehicles are off the ground, shape (n,)."""
        return ~self.on_ground

    def rest(self) -> None:
        """Ends all motion."""
        self.vel_enu_m_s[:] = 0.0
        self.acc_enu_m_s2 = np.zeros_like(self.acc_enu_m_s2)
        self.thrust_m_s2[:] = 0.0
        self.yaw_rate_rad_s[:] = 0.0


class Commands:
    """What the autopilots want to be flown; they write it through their ``Body``.

    Attributes:
        vel_sp_enu_m_s: velocity, feed-forward where a position is held, shape (3, n).
        pos_sp_enu_m, pos_mask: position (estimated frame) and which axes hold it, shape (3, n).
        speed_limit_m_s: limits of the position loop, rows: horizontal, up, down, shape (3, n).
        yaw_sp_enu_rad, yaw_rate_sp_rad_s, yaw_mask: heading, its rate, which of them counts (the heading), (n,).
        flying: motors may lift; without it they idle or stand, shape (n,) bool.
        positions_used, yaw_used: whether anybody has held a position or turned; until then those loops are skipped.
    """

    def __init__(self, profiles: Sequence[Profile], pos_enu_m: Array, yaw_enu_rad: Array) -> None:
        n = len(profiles)
        self.vel_sp_enu_m_s = np.zeros((3, n))
        self.pos_sp_enu_m = pos_enu_m.copy()
        self.pos_mask = np.zeros((3, n))
        self.speed_limit_m_s = np.stack(
            [column(profiles, f"manners.speed_{way}_max_m_s") for way in ("xy", "up", "down")],
        )
        self.yaw_sp_enu_rad = yaw_enu_rad.copy()
        self.yaw_rate_sp_rad_s = np.zeros(n)
        self.yaw_mask: NDArray[np.bool_] = np.ones(n, dtype=bool)
        self.flying: NDArray[np.bool_] = np.zeros(n, dtype=bool)
        self.positions_used = self.yaw_used = False


class Health:
    """What is left of the motors.

    Attributes:
        thrust_share: of their power, 1 when healthy, shape (n,); set by ``power``.
        sound: it is 1 of everybody.
        tumbling: a motor has failed: attitude control is lost, shape (n,) bool; set by ``tumble``.
        any_tumbling: whether it is so of anybody.
    """

    def __init__(self, n: int) -> None:
        self.thrust_share = np.ones(n)
        self.thrust_share.flags.writeable = False
        self.sound = True
        self.tumbling: NDArray[np.bool_] = np.zeros(n, dtype=bool)
        self.tumbling.flags.writeable = False
        self.any_tumbling = False

    def power(self, index: int, share: float) -> None:
        """Sets what the motors of a vehicle can give."""
        if self.thrust_share[index] != share:
            self.thrust_share = self.thrust_share.copy()
            self.thrust_share[index] = share
            self.thrust_share.flags.writeable = False
            self.sound = bool((self.thrust_share == 1.0).all())

    def tumble(self, index: int, tumbles: bool) -> None:
        """Takes a vehicle's attitude control away, or gives it back."""
        self.tumbling = self.tumbling.copy()
        self.tumbling[index] = tumbles
        self.tumbling.flags.writeable = False
        self.any_tumbling = bool(self.tumbling.any())
