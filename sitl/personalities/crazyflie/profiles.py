"""How a Crazyflie flies."""

from __future__ import annotations

import math

from sitl.profiles import Airframe, CommandShape, LoopGains, Manners, Profile

CRAZYFLIE = Profile(
    name="crazyflie",
    frame=Airframe(
        drag_per_s=0.25,
        air_per_s=0.3,  # rotor drag as identified by Foerster (2015): 9.2e-7 kg a rad times 8,600 rad/s, over 28 g
        air_per_m=0.05,  # a body of 27 cm2 with a coefficient of 1, over 33 g
        thrust_lag_s=0.03,
        thrust_max_g=1.9,
        mass_kg=0.033,
        rotor_span_m=0.13,
        hover_endurance_s=360.0,
    ),
    loops=LoopGains(
        kp_xy_per_s=4.6,
        kp_z_per_s=5.0,
        ki_xy_per_s2=0.2,
        ki_z_per_s2=0.2,
        drag_feedforward=1.0,
        shape=CommandShape(),
        accel_max_m_s2=6.0,
        dead_time_s=0.02,
        attitude_rad_s=50.0,
        tilt_rate_max_rad_s=10.0,
        tilt_max_rad=math.radians(35.0),
        yaw_rate_max_rad_s=math.radians(200.0),
        yaw_gain_per_s=5.0,
        position_gain_per_s=2.0,
    ),
    manners=Manners(
        speed_xy_max_m_s=2.0,
        speed_up_max_m_s=1.0,
        speed_down_max_m_s=1.0,
    ),
)
"""A palm-size quadrotor under motion capture: velocity lag about 0.2 s after about 0.05 s in which little happens."""
