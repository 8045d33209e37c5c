"""Columns of every streamed message type, in wire units, made from what the vehicles believe.

One function per type: (state, view, vehicles) to a structured array with one row per vehicle. What only one kind of
autopilot sends is with its personality. Refuses to decide who sends what and when.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from groundstation.mavlink.codec import StructuredArray, layout
from sitl.frames import between, frd_from_ned
from sitl.pilot import Pilot
from sitl.state import State
from sitl.telemetry import View

IntArray = NDArray[np.int64]
_T = TypeVar("_T", bound=np.generic)
Maker = Callable[[State, View, IntArray], StructuredArray]


class Message(NamedTuple):
    """How one type is made, and what a vehicle needs before it sends it: a position, an origin, a GPS receiver."""

    make: Maker
    position: bool
    origin: bool
    gps: bool


MESSAGES: dict[str, Message] = {}
"""What vehicles of any kind can stream; ``sitl.messages_hardware`` has more of them."""
_WIRE_ORDER = (
    "HEARTBEAT", "SYS_STATUS", "SYSTEM_TIME", "TIMESYNC", "ATTITUDE", "ATTITUDE_QUATERNION", "LOCAL_POSITION_NED",
    "ODOMETRY", "GLOBAL_POSITION_INT", "GPS_RAW_INT", "HIGHRES_IMU", "ALTITUDE", "VFR_HUD",
    "POSITION_TARGET_LOCAL_NED", "ATTITUDE_TARGET", "DISTANCE_SENSOR", "PING", "EXTENDED_SYS_STATE",
    "ESTIMATOR_STATUS", "EKF_STATUS_REPORT", "BATTERY_STATUS", "HOME_POSITION", "GPS_GLOBAL_ORIGIN",
    "HIL_STATE_QUATERNION", "RAW_IMU", "SCALED_PRESSURE", "POWER_STATUS", "MEMINFO", "MISSION_CURRENT",
    "NAV_CONTROLLER_OUTPUT", "SERVO_OUTPUT_RAW", "RC_CHANNELS", "VIBRATION",
)  # fmt: skip
_SEA_LEVEL_HPA = 1013.25


def in_wire_order(names: Iterable[str]) -> tuple[str, ...]:
    """The order in which types that are due at the same time are sent: so they lie on the wire, and in every log.

    Where a type is made has no part in it; a type that stands nowhere here comes last, among its like by its name.
    """
    place = {name: k for k, name in enumerate(_WIRE_ORDER)}
    return tuple(sorted(names, key=lambda name: (place.get(name, len(place)), name)))


def message(
    table: dict[str, Message], *, position: bool = False, origin: bool = False, gps: bool = False
) -> Callable[[Maker], Maker]:
    """Puts a maker into a table under its upper-case name; with ``position`` it is silent before there is one."""

    def register(maker: Maker) -> Maker:
        table[maker.__name__.lstrip("_").upper()] = Message(maker, position, origin, gps)
        return maker

    return register


def rows_of(name: str, vehicles: IntArray) -> StructuredArray:
    """Empty rows of a message type, one for each vehicle."""
    return np.zeros(len(vehicles), dtype=layout(name).dtype)


def of(values: NDArray[_T], vehicles: IntArray) -> NDArray[_T]:
    """What belongs to some vehicles, shape (..., n) to (..., k); of all of them it is the array itself."""
    return values if len(vehicles) == values.shape[-1] else values[..., vehicles]


def pilots_of(state: State, vehicles: IntArray) -> list[Pilot]:
    """The autopilots of some vehicles."""
    return [state.pilots[i] for i in vehicles.tolist()]


def times_ms(state: State, vehicles: IntArray) -> IntArray:
    """Time since power-up as the vehicles count it, ms."""
    return of(state.clocks.own_ms(state.now_ns), vehicles)


def times_us(state: State, vehicles: IntArray) -> IntArray:
    """The same in microseconds."""
    return of(state.own_time_ns(), vehicles) // 1_000


@message(MESSAGES)
def _heartbeat(state: State, _view: View, vehicles: IntArray) -> StructuredArray:
    out = rows_of("HEARTBEAT", vehicles)
    for row, pilot in zip(out, pilots_of(state, vehicles), strict=True):
        row["type"], row["autopilot"] = 2, pilot.mav_autopilot
        row["base_mode"], row["custom_mode"] = pilot.base_mode(), pilot.custom_mode()
        row["system_status"] = pilot.system_status()
        row["mavlink_version"] = 3
    return out


@message(MESSAGES)
def _sys_status(state: State, _view: View, vehicles: IntArray) -> StructuredArray:
    out = rows_of("SYS_STATUS", vehicles)
    for row, pilot in zip(out, pilots_of(state, vehicles), strict=True):
        present, enabled, health = pilot.sensor_bits()
        row["onboard_control_sensors_present"] = present
        row["onboard_control_sensors_enabled"] = enabled
        row["onboard_control_sensors_health"] = health
        row["load"] = 250
        battery = pilot.battery
        row["voltage_battery"] = int(battery.voltage_v * 1000)
        row["current_battery"] = int(battery.current_a * 100)
        row["battery_remaining"] = battery.percent()
    return out


@message(MESSAGES)
def _system_time(state: State, _view: View, vehicles: IntArray) -> StructuredArray:
    out = rows_of("SYSTEM_TIME", vehicles)
    out["time_unix_usec"] = state.unix_us() + of(state.clocks.offset_ns, vehicles) // 1000
    out["time_boot_ms"] = times_ms(state, vehicles)
    return out


@message(MESSAGES)
def _timesync(state: State, _view: View, vehicles: IntArray) -> StructuredArray:
    out = rows_of("TIMESYNC", vehicles)
    out["ts1"] = of(state.own_time_ns(), vehicles)
    return out


@message(MESSAGES)
def _attitude(state: State, view: View, vehicles: IntArray) -> StructuredArray:
    out = rows_of("ATTITUDE", vehicles)
    roll, pitch, yaw = view.euler_rad
    rates = view.rates_frd_rad_s
    out["time_boot_ms"] = times_ms(state, vehicles)
    out["roll"], out["pitch"], out["yaw"] = of(roll, vehicles), of(pitch, vehicles), of(yaw, vehicles)
    out["rollspeed"], out["pitchspeed"], out["yawspeed"] = of(rates, vehicles)
    return out


@message(MESSAGES)
def _attitude_quaternion(state: State, view: View, vehicles: IntArray) -> StructuredArray:
    out = rows_of("ATTITUDE_QUATERNION", vehicles)
    out["time_boot_ms"] = times_ms(state, vehicles)
    out["q1"], out["q2"], out["q3"], out["q4"] = of(view.quat_ned_from_frd, vehicles)
    out["rollspeed"], out["pitchspeed"], out["yawspeed"] = of(view.rates_frd_rad_s, vehicles)
    return out


@message(MESSAGES, position=True)
def _local_position_ned(state: State, view: View, vehicles: IntArray) -> StructuredArray:
    out = rows_of("LOCAL_POSITION_NED", vehicles)
    out["time_boot_ms"] = times_ms(state, vehicles)
    out["x"], out["y"], out["z"] = of(view.local_ned_m, vehicles)
    out["vx"], out["vy"], out["vz"] = of(view.vel_ned_m_s, vehicles)
    return out


@message(MESSAGES, position=True)
def _odometry(state: State, view: View, vehicles: IntArray) -> StructuredArray:
    out = rows_of("ODOMETRY", vehicles)
    out["time_usec"] = times_us(state, vehicles)
    out["frame_id"], out["child_frame_id"] = 1, 12  # LOCAL_NED, BODY_FRD
    out["x"], out["y"], out["z"] = of(view.local_ned_m, vehicles)
    out["q"] = of(view.quat_ned_from_frd, vehicles).T
    out["vx"], out["vy"], out["vz"] = of(frd_from_ned(view.quat_ned_from_frd, view.vel_ned_m_s), vehicles)
    out["rollspeed"], out["pitchspeed"], out["yawspeed"] = of(view.rates_frd_rad_s, vehicles)
    variance = of(state.estimator.white_m[0], vehicles) ** 2 + 1e-6
    for diagonal in (0, 6, 11):
        out["pose_covariance"][:, diagonal] = variance
        out["velocity_covariance"][:, diagonal] = 1e-4
    for diagonal in (15, 18, 20):
        out["pose_covariance"][:, diagonal] = 1e-5
        out["velocity_covariance"][:, diagonal] = np.nan
    out["quality"] = 100
    return out


def _number(state: State, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Replaces what is not a number by 0, for fields that are integers on the wire."""
    return np.nan_to_num(values) if b"\1" in state.broken.invalid.tobytes() else values


def _geo(view: View, vehicles: IntArray) -> tuple[IntArray, IntArray, NDArray[np.float64]]:
    lat, lon, alt = view.geodetic
    state = view.state
    lat_e7 = np.rint(_number(state, of(lat, vehicles)) * 1e7).astype(np.int64)
    lon_e7 = np.rint(_number(state, of(lon, vehicles)) * 1e7).astype(np.int64)
    return lat_e7, lon_e7, _number(state, of(alt, vehicles))


@message(MESSAGES, position=True)
def _global_position_int(state: State, view: View, vehicles: IntArray) -> StructuredArray:
    out = rows_of("GLOBAL_POSITION_INT", vehicles)
    out["time_boot_ms"] = times_ms(state, vehicles)
    out["lat"], out["lon"], alt = _geo(view, vehicles)
    out["alt"] = np.rint(alt * 1000.0)
    height = _number(state, of(view.pos_enu_m[2], vehicles)) - of(state.known.home_enu_m[2], vehicles)
    out["relative_alt"] = np.rint(between(height, -2e6, 2e6) * 1000.0)  # home may be set anywhere on the globe
    vel = between(_number(state, of(view.vel_ned_m_s, vehicles)) * 100.0, -32767.0, 32767.0)
    out["vx"], out["vy"], out["vz"] = np.rint(vel)
    out["hdg"] = np.rint(np.degrees(of(view.euler_rad[2], vehicles)) % 360.0 * 100.0) % 36000
    return out


@message(MESSAGES, gps=True)
def _gps_raw_int(state: State, view: View, vehicles: IntArray) -> StructuredArray:
    out = rows_of("GPS_RAW_INT", vehicles)
    out["time_usec"] = times_us(state, vehicles)
    fixed = state.broken.no_fix_ns[vehicles] > state.now_ns
    out["fix_type"] = np.where(fixed, 3, 1)
    out["lat"], out["lon"], alt = _geo(view, vehicles)
    out["alt"] = out["alt_ellipsoid"] = np.rint(alt * 1000.0)
    out["eph"], out["epv"] = 80, 110
    vel = _number(state, of(view.vel_ned_m_s, vehicles))
    out["vel"] = np.minimum(np.rint(np.hypot(vel[0], vel[1]) * 100.0), 65534)
    out["cog"] = np.rint(np.degrees(np.arctan2(vel[1], vel[0])) % 360.0 * 100.0) % 36000
    out["satellites_visible"] = np.where(fixed, 12, 0)
    out["h_acc"], out["v_acc"], out["vel_acc"] = 900, 1400, 200
    return out


@message(MESSAGES)
def _highres_imu(state: State, view: View, vehicles: IntArray) -> StructuredArray:
    out = rows_of("HIGHRES_IMU", vehicles)
    out["time_usec"] = times_us(state, vehicles)
    out["xacc"], out["yacc"], out["zacc"] = of(view.specific_force_frd_m_s2, vehicles)
    out["xgyro"], out["ygyro"], out["zgyro"] = of(view.rates_frd_rad_s, vehicles)
    yaw = of(view.euler_rad[2], vehicles)
    out["xmag"], out["ymag"], out["zmag"] = 0.215 * np.cos(yaw), -0.215 * np.sin(yaw), 0.43
    height = _number(state, of(view.pos_enu_m[2], vehicles))
    out["pressure_alt"] = height + state.config.home_alt_m
    out["abs_pressure"] = _SEA_LEVEL_HPA * (1.0 - 2.25577e-5 * out["pressure_alt"]) ** 5.25588
    out["temperature"] = 25.0
    out["fields_updated"] = 0x1FFF
    return out


@message(MESSAGES, position=True)
def _altitude(state: State, view: View, vehicles: IntArray) -> StructuredArray:
    out = rows_of("ALTITUDE", vehicles)
    out["time_usec"] = times_us(state, vehicles)
    alt = of(view.geodetic[2], vehicles)
    out["altitude_monotonic"] = out["altitude_amsl"] = alt
    out["altitude_local"] = -of(view.local_ned_m[2], vehicles)
    out["altitude_relative"] = of(view.pos_enu_m[2], vehicles) - of(state.known.home_enu_m[2], vehicles)
    out["altitude_terrain"] = np.nan
    out["bottom_clearance"] = np.nan
    return out


@message(MESSAGES)
def _vfr_hud(state: State, view: View, vehicles: IntArray) -> StructuredArray:
    out = rows_of("VFR_HUD", vehicles)
    vel = of(view.vel_ned_m_s, vehicles)
    out["airspeed"] = out["groundspeed"] = np.hypot(vel[0], vel[1])
    out["climb"] = -vel[2]
    out["alt"] = of(view.geodetic[2], vehicles)
    out["heading"] = np.rint(np.degrees(of(view.euler_rad[2], vehicles)) % 360.0) % 360
    out["throttle"] = between(of(state.dynamics.motion.thrust_m_s2, vehicles) / 9.80665 * 50.0, 0.0, 100.0)
    return out


@message(MESSAGES, position=True)
def _position_target_local_ned(state: State, _view: View, vehicles: IntArray) -> StructuredArray:
    out = rows_of("POSITION_TARGET_LOCAL_NED", vehicles)
    dynamics = state.dynamics
    out["time_boot_ms"] = times_ms(state, vehicles)
    out["coordinate_frame"] = 1
    target = of(dynamics.commands.pos_sp_enu_m, vehicles) - of(state.known.origin_enu_m, vehicles)
    held = of(dynamics.commands.pos_mask, vehicles) > 0
    target = np.where(held, target, np.nan)
    out["x"], out["y"], out["z"] = target[1], target[0], -target[2]
    vel = of(dynamics.commands.vel_sp_enu_m_s, vehicles)
    out["vx"], out["vy"], out["vz"] = vel[1], vel[0], -vel[2]
    out["yaw"] = math.pi / 2.0 - of(dynamics.commands.yaw_sp_enu_rad, vehicles)
    return out


@message(MESSAGES)
def _attitude_target(state: State, view: View, vehicles: IntArray) -> StructuredArray:
    """As far as the dynamics have one: the attitude that is flown, with the thrust."""
    out = rows_of("ATTITUDE_TARGET", vehicles)
    out["time_boot_ms"] = times_ms(state, vehicles)
    out["q"] = of(view.quat_ned_from_frd, vehicles).T
    out["thrust"] = between(of(state.dynamics.motion.thrust_m_s2, vehicles) / (2.0 * 9.80665), 0.0, 1.0)
    return out


@message(MESSAGES)
def _distance_sensor(state: State, _view: View, vehicles: IntArray) -> StructuredArray:
    """The one that PX4's built-in simulator has, looking down."""
    out = rows_of("DISTANCE_SENSOR", vehicles)
    dynamics = state.dynamics
    out["time_boot_ms"] = times_ms(state, vehicles)
    out["max_distance"], out["orientation"] = 10_000, 25  # cm; MAV_SENSOR_ROTATION_PITCH_270
    height_m = of(dynamics.motion.pos_enu_m[2], vehicles) - of(dynamics.ground.height_m, vehicles)
    out["current_distance"] = np.rint(between(height_m * 100.0, 0.0, 10_000.0))
    return out


@message(MESSAGES)
def _ping(state: State, _view: View, vehicles: IntArray) -> StructuredArray:
    out = rows_of("PING", vehicles)
    out["time_usec"] = times_us(state, vehicles)
    out["seq"] = times_us(state, vehicles) // 1_000_000
    return out


@message(MESSAGES)
def _extended_sys_state(state: State, _view: View, vehicles: IntArray) -> StructuredArray:
    out = rows_of("EXTENDED_SYS_STATE", vehicles)
    out["landed_state"] = [pilot.landed_state() for pilot in pilots_of(state, vehicles)]
    return out


@message(MESSAGES)
def _estimator_status(state: State, _view: View, vehicles: IntArray) -> StructuredArray:
    out = rows_of("ESTIMATOR_STATUS", vehicles)
    out["time_usec"] = times_us(state, vehicles)
    good = of(state.known.has_position, vehicles) & ~of(state.broken.invalid, vehicles)
    # attitude, vertical velocity, heights above sea and ground; with a position: horizontal velocity, positions,
    # and that they are measured. Standing still sets "constant position", whatever is known.
    resting = np.array([pilot.landed for pilot in pilots_of(state, vehicles)], dtype=bool)
    out["flags"] = np.where(good, 0x37F, 0x65) | np.where(resting, 0x80, 0)
    for name, value in (("vel_ratio", 0.03), ("pos_horiz_ratio", 0.02), ("pos_vert_ratio", 0.03)):
        out[name] = np.where(good, value, 2.0)
    out["mag_ratio"], out["tas_ratio"] = 0.01, math.nan
    out["pos_horiz_accuracy"], out["pos_vert_accuracy"] = 0.3, 0.4
    return out


@message(MESSAGES)
def _battery_status(state: State, _view: View, vehicles: IntArray) -> StructuredArray:
    out = rows_of("BATTERY_STATUS", vehicles)
    for row, pilot in zip(out, pilots_of(state, vehicles), strict=True):
        battery = pilot.battery
        row["current_consumed"] = int(battery.used_mah())
        row["energy_consumed"] = -1
        row["temperature"] = 2500
        cells = [65535] * 10
        cells[: battery.cells] = [int(battery.voltage_v / battery.cells * 1000)] * battery.cells
        row["voltages"] = cells
        row["current_battery"] = int(battery.current_a * 100)
        row["battery_function"], row["type"] = 1, 1
        row["battery_remaining"] = battery.percent()
        row["charge_state"] = 1 if battery.left > 0.15 else 2
    return out


@message(MESSAGES, position=True)
def _home_position(state: State, view: View, vehicles: IntArray) -> StructuredArray:
    out = rows_of("HOME_POSITION", vehicles)
    home = of(state.known.home_enu_m, vehicles)
    lat, lon, alt = state.geodesy.geodetic_from_enu(home)
    out["latitude"], out["longitude"] = np.rint(lat * 1e7), np.rint(lon * 1e7)
    out["altitude"] = np.rint(alt * 1000.0)
    local = home - of(state.known.origin_enu_m, vehicles)
    out["x"], out["y"], out["z"] = local[1], local[0], -local[2]
    out["q"] = of(view.quat_ned_from_frd, vehicles).T
    out["time_usec"] = times_us(state, vehicles)
    return out


@message(MESSAGES, origin=True)
def _gps_global_origin(state: State, _view: View, vehicles: IntArray) -> StructuredArray:
    out = rows_of("GPS_GLOBAL_ORIGIN", vehicles)
    lat, lon, alt = state.geodesy.geodetic_from_enu(of(state.known.origin_enu_m, vehicles))
    out["latitude"], out["longitude"] = np.rint(lat * 1e7), np.rint(lon * 1e7)
    out["altitude"] = np.rint(alt * 1000.0)
    out["time_usec"] = times_us(state, vehicles)
    return out


@message(MESSAGES)
def _hil_state_quaternion(state: State, _view: View, vehicles: IntArray) -> StructuredArray:
    """The simulator's truth, not the estimate."""
    out = rows_of("HIL_STATE_QUATERNION", vehicles)
    dynamics = state.dynamics
    out["time_usec"] = times_us(state, vehicles)
    out["attitude_quaternion"] = of(state.true_quat(), vehicles).T
    lat, lon, alt = state.geodesy.geodetic_from_enu(of(dynamics.motion.pos_enu_m, vehicles))
    out["lat"], out["lon"] = np.rint(lat * 1e7), np.rint(lon * 1e7)
    out["alt"] = np.rint(alt * 1000.0)
    vel = np.clip(of(dynamics.motion.vel_enu_m_s, vehicles) * 100.0, -32767, 32767)
    out["vx"], out["vy"], out["vz"] = np.rint(vel[1]), np.rint(vel[0]), np.rint(-vel[2])
    acc = np.clip(of(dynamics.motion.acc_enu_m_s2, vehicles) / 9.80665 * 1000.0, -32767, 32767)
    out["xacc"], out["yacc"], out["zacc"] = np.rint(acc[1]), np.rint(acc[0]), np.rint(-acc[2])
    return out
