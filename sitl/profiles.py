"""How each kind of vehicle flies: the numbers behind the dynamics profiles.

Holds numbers and says where they come from; what belongs to one kind of autopilot is with its personality. Refuses to
simulate: ``dynamics`` does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter

import numpy as np

from sitl.frames import Array


@dataclass(frozen=True)
class Airframe:
    """What a vehicle is made of.

    Attributes:
        mass_kg: only for the downwash's reach and the battery.
        rotor_span_m: distance between opposite rotors.
        drag_per_s: linear drag in still air, deceleration per speed: what a step response shows.
        air_per_s, air_per_m: what moving air does: it pulls with ``(air_per_s + air_per_m |u|) u``, u being its
            velocity past the vehicle (drag of the rotors, and of the body).
        thrust_max_g: largest thrust, in weights.
        thrust_lag_s: time constant of the motors.
        hover_endurance_s: hovering time on a full battery.
    """

    mass_kg: float
    rotor_span_m: float
    drag_per_s: float
    air_per_s: float
    air_per_m: float
    thrust_max_g: float
    thrust_lag_s: float
    hover_endurance_s: float


@dataclass(frozen=True)
class CommandShape:
    """Limits of shaped velocity commands.

    Attributes:
        accel_xy_m_s2, accel_z_m_s2: largest acceleration; 0 for commands as they are.
        jerk_m_s3: largest jerk.
    """

    accel_xy_m_s2: float = 0.0
    accel_z_m_s2: float = 0.0
    jerk_m_s3: float = 0.0


@dataclass(frozen=True)
class LoopGains:
    """How its inner loops are set.

    The velocity loop is a PI controller on the estimated velocity; where commands are shaped before it sees them, it
    follows a velocity that comes nearer to the command with limited acceleration and jerk, and that is fed forward.
    It asks for an acceleration, the tilt and the thrust that produce it follow with their own lags.

    Attributes:
        kp_xy_per_s, kp_z_per_s: proportional gain, acceleration per velocity error.
        ki_xy_per_s2, ki_z_per_s2: integral gain.
        drag_feedforward: share of the drag that the controller compensates beforehand, 0 to 1.
        shape: how commands are shaped before the loop sees them.
        accel_max_m_s2: limit of the horizontal acceleration that the velocity loop asks for.
        dead_time_s: delay between a command and its first effect.
        attitude_rad_s: natural frequency of the (critically damped) attitude loop.
        tilt_rate_max_rad_s: limit of the tilt rate.
        tilt_max_rad: largest tilt.
        yaw_rate_max_rad_s: limit of the yaw rate.
        yaw_gain_per_s: gain of the yaw loop.
        position_gain_per_s: gain of the position loop.
    """

    kp_xy_per_s: float
    kp_z_per_s: float
    ki_xy_per_s2: float
    ki_z_per_s2: float
    drag_feedforward: float
    shape: CommandShape
    accel_max_m_s2: float
    dead_time_s: float
    attitude_rad_s: float
    tilt_rate_max_rad_s: float
    tilt_max_rad: float
    yaw_rate_max_rad_s: float
    yaw_gain_per_s: float
    position_gain_per_s: float


@dataclass(frozen=True)
class Manners:
    """How its autopilot flies by itself.

    Attributes:
        speed_xy_max_m_s, speed_up_max_m_s, speed_down_max_m_s: limits of the position loop.
        land_contact_s: standing on the ground for so long before the land detector says so.
        crawl_below_m: height below which it comes down at ``crawl_m_s`` only, where it measures that height; 0: never.
        crawl_m_s: that speed.
        clock_rate: how fast its clock runs against real time.
    """

    speed_xy_max_m_s: float
    speed_up_max_m_s: float
    speed_down_max_m_s: float
    land_contact_s: float = 0.45
    crawl_below_m: float = 0.0
    crawl_m_s: float = 0.3
    clock_rate: float = 1.0


@dataclass(frozen=True)
class Profile:
    """Constants of one kind of quadrotor, by its name."""

    name: str
    frame: Airframe
    loops: LoopGains
    manners: Manners


def column(profiles: Sequence[Profile], name: str) -> Array:
    """One number of all vehicles, for example "loops.filter_s", shape (n,)."""
    number = attrgetter(name)
    return np.array([number(profile) for profile in profiles], dtype=np.float64)


def spread(profiles: Sequence[Profile], name: str) -> Array:
    """One number of every profile, the same on all axes: shape (3, n)."""
    return columns(profiles, name, name, name)


def columns(profiles: Sequence[Profile], x: str, y: str, z: str) -> Array:
    """One number for each axis, shape (3, n)."""
    return np.stack([column(profiles, name) for name in (x, y, z)])
