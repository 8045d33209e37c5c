"""How vehicles fly under ArduCopter."""

from __future__ import annotations

import math

from sitl.profiles import Airframe, CommandShape, LoopGains, Manners, Profile

ARDUCOPTER = Profile(
    name="arducopter",
    frame=Airframe(
        drag_per_s=0.25,
        air_per_s=0.25,  # ArduPilot's own model of a multicopter: momentum drag of 0.2, and 45 degrees at 15 m/s in all
        air_per_m=0.027,
        thrust_lag_s=0.05,
        thrust_max_g=2.0,
        mass_kg=1.5,
        rotor_span_m=0.5,
        hover_endurance_s=1200.0,
    ),
    loops=LoopGains(
        kp_xy_per_s=4.0,
        kp_z_per_s=5.0,
        ki_xy_per_s2=1.0,  # PSC_VELXY_I; that GUIDED also holds the place it has reckoned is left out
        ki_z_per_s2=0.2,
        drag_feedforward=1.0,
        # WPNAV_ACCEL, WPNAV_ACCEL_Z, PSC_JERK_XY and PSC_JERK_Z
        shape=CommandShape(accel_xy_m_s2=2.5, accel_z_m_s2=1.0, jerk_m_s3=5.0),
        accel_max_m_s2=5.6,  # ANGLE_MAX of 30 degrees
        dead_time_s=0.08,
        attitude_rad_s=14.0,
        tilt_rate_max_rad_s=3.5,
        tilt_max_rad=math.radians(30.0),
        yaw_rate_max_rad_s=math.radians(60.0),
        yaw_gain_per_s=3.0,
        position_gain_per_s=1.0,
    ),
    manners=Manners(
        speed_xy_max_m_s=5.0,
        speed_up_max_m_s=2.5,
        speed_down_max_m_s=1.5,
        land_contact_s=1.5,
    ),
)
"""A 1.5 kg quadrotor under ArduCopter: 2 m/s step seen as 1.45 m/s at 1 s, 1.94 at 2 s, 2.0 at 3 s. Changes of less
than 1.25 m/s come as one lag of 0.5 s (acceleration over jerk), upward of 0.2 s."""
