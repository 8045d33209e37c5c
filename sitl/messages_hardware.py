"""Columns of more message types, as in ``messages``: sensors, outputs, power, and what a stored mission has come to.

Refuses to be a sensor model: values are believable, no more.
"""

from __future__ import annotations

import numpy as np

from groundstation.mavlink.codec import StructuredArray
from sitl.frames import between
from sitl.messages import IntArray, Message, message, of, rows_of, times_ms, times_us
from sitl.state import State
from sitl.telemetry import View

HARDWARE_MESSAGES: dict[str, Message] = {}
_MILLI_G = 1000.0 / 9.80665


@message(HARDWARE_MESSAGES)
def _raw_imu(state: State, view: View, vehicles: IntArray) -> StructuredArray:
    out = rows_of("RAW_IMU", vehicles)
    out["time_usec"] = times_us(state, vehicles)
    force = between(of(view.specific_force_frd_m_s2, vehicles) * _MILLI_G, -32767, 32767)
    rates = between(of(view.rates_frd_rad_s, vehicles) * 1000.0, -32767, 32767)
    out["xacc"], out["yacc"], out["zacc"] = np.rint(force)
    out["xgyro"], out["ygyro"], out["zgyro"] = np.rint(rates)
    yaw = of(view.euler_rad[2], vehicles)
    out["xmag"], out["ymag"], out["zmag"] = np.rint(215 * np.cos(yaw)), np.rint(-215 * np.sin(yaw)), 430
    out["temperature"] = 4500
    return out


@message(HARDWARE_MESSAGES)
def _scaled_pressure(state: State, _view: View, vehicles: IntArray) -> StructuredArray:
    out = rows_of("SCALED_PRESSURE", vehicles)
    out["time_boot_ms"] = times_ms(state, vehicles)
    alt = of(state.dynamics.motion.pos_enu_m[2], vehicles) + state.config.home_alt_m
    out["press_abs"] = 1013.25 * (1.0 - 2.25577e-5 * alt) ** 5.25588
    out["temperature"] = 2500
    return out


@message(HARDWARE_MESSAGES)
def _power_status(_state: State, _view: View, vehicles: IntArray) -> StructuredArray:
    out = rows_of("POWER_STATUS", vehicles)
    out["Vcc"], out["Vservo"] = 5000, 0
    return out


@message(HARDWARE_MESSAGES)
def _mission_current(state: State, _view: View, vehicles: IntArray) -> StructuredArray:
    out = rows_of("MISSION_CURRENT", vehicles)
    out["seq"] = [state.pilots[i].mission.seq for i in vehicles]
    out["total"] = [len(state.pilots[i].mission) for i in vehicles]
    return out


@message(HARDWARE_MESSAGES)
def _nav_controller_output(state: State, view: View, vehicles: IntArray) -> StructuredArray:
    out = rows_of("NAV_CONTROLLER_OUTPUT", vehicles)
    roll, pitch, yaw = view.euler_rad
    out["nav_roll"], out["nav_pitch"] = np.degrees(of(roll, vehicles)), np.degrees(of(pitch, vehicles))
    out["nav_bearing"] = np.rint(np.degrees(of(yaw, vehicles)))
    dynamics = state.dynamics
    error = (dynamics.commands.pos_sp_enu_m - dynamics.motion.pos_enu_m)[:, vehicles]
    error *= of(dynamics.commands.pos_mask, vehicles)
    out["wp_dist"] = np.minimum(np.hypot(error[0], error[1]), 65535)
    out["alt_error"] = error[2]
    return out


@message(HARDWARE_MESSAGES)
def _servo_output_raw(state: State, _view: View, vehicles: IntArray) -> StructuredArray:
    out = rows_of("SERVO_OUTPUT_RAW", vehicles)
    out["time_usec"] = times_us(state, vehicles) & 0xFFFFFFFF
    share = between(of(state.dynamics.motion.thrust_m_s2, vehicles) / (2.0 * 9.80665), 0.0, 1.0)
    for k in range(1, 5):
        out[f"servo{k}_raw"] = np.rint(1000.0 + 1000.0 * share)
    return out


@message(HARDWARE_MESSAGES)
def _rc_channels(state: State, _view: View, vehicles: IntArray) -> StructuredArray:
    out = rows_of("RC_CHANNELS", vehicles)
    out["time_boot_ms"] = times_ms(state, vehicles)
    out["chancount"], out["rssi"] = 16, 255
    for k in range(1, 9):
        out[f"chan{k}_raw"] = 1000 if k == 3 else 1500
    return out


@message(HARDWARE_MESSAGES)
def _vibration(state: State, _view: View, vehicles: IntArray) -> StructuredArray:
    out = rows_of("VIBRATION", vehicles)
    out["time_usec"] = times_us(state, vehicles)
    share = of(state.dynamics.motion.thrust_m_s2, vehicles) / 9.80665
    out["vibration_x"] = out["vibration_y"] = out["vibration_z"] = 3.0 * share
    return out
