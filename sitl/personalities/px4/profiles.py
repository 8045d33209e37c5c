"""How vehicles fly under PX4, and in its built-in simulator (SIH): dynamics, and errors of the estimates."""

from __future__ import annotations

import math
from dataclasses import replace

from sitl.estimator import GPS
from sitl.profiles import Airframe, CommandShape, LoopGains, Manners, Profile

PX4_QUAD = Profile(
    name="px4_quad",
    frame=Airframe(
        drag_per_s=1.35,  # heavy, as in PX4's built-in simulator: it is what makes the response creep
        air_per_s=0.25,  # as under ArduCopter: no air grips a vehicle as firmly as that simulator's still air does
        air_per_m=0.027,
        thrust_lag_s=0.05,
        thrust_max_g=2.0,
        mass_kg=1.5,
        rotor_span_m=0.5,
        hover_endurance_s=1200.0,
    ),
    loops=LoopGains(
        kp_xy_per_s=1.8,  # MPC_XY_VEL_P_ACC
        kp_z_per_s=4.0,  # MPC_Z_VEL_P_ACC
        ki_xy_per_s2=0.5,  # MPC_XY_VEL_I_ACC is 0.4; the measured creep from 1.5 to 1.7 m/s asks for a little more
        ki_z_per_s2=2.0,  # MPC_Z_VEL_I_ACC
        drag_feedforward=0.0,
        shape=CommandShape(),
        accel_max_m_s2=9.8,  # the tilt is the limit; MPC_ACC_HOR_MAX (5) is one of planned ways, not of setpoints
        dead_time_s=0.02,
        attitude_rad_s=18.0,
        tilt_rate_max_rad_s=3.8,
        tilt_max_rad=math.radians(45.0),
        yaw_rate_max_rad_s=math.radians(45.0),
        yaw_gain_per_s=2.8,
        position_gain_per_s=0.95,  # MPC_XY_P
    ),
    manners=Manners(
        speed_xy_max_m_s=5.0,
        speed_up_max_m_s=3.0,
        speed_down_max_m_s=1.5,
    ),
)
"""A 1.5 kg quadrotor under PX4: 2 m/s step seen as 1.25 m/s at 1 s, 1.5 at 3 s, 1.7 at 6 s."""

PX4_SIH = replace(
    PX4_QUAD,
    name="px4_sih",
    manners=replace(
        PX4_QUAD.manners,
        land_contact_s=3.2,
        crawl_below_m=1.0,  # MPC_LAND_ALT3, since it has a distance sensor; MPC_LAND_CRWL
        clock_rate=0.987,
    ),
)
"""The same in PX4's built-in simulator on a busy computer, as recorded: it counts time slowly, crawls down the last
metre at 0.32 m/s and is told to have landed 3.2 s after it has touched the ground."""

SIH_NOISE = replace(
    GPS,
    vel_sigma_m_s=0.31,
    vel_tau_s=2.5,
    vel_axes=(1.0, 0.45, 0.45),
    vel_in_air_only=True,
    pos_follows_s=0.9,
)
"""PX4's built-in simulator as it comes: its motors shake the sensors, so that velocities are wrong by 0.31 m/s (east)
and 0.14 (north, up) for two or three seconds at a time, up to 0.9 m/s, and positions follow them by 0.1 to 0.2 m."""
