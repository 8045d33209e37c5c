"""What PX4 sends unasked, by the kind of its link."""

from __future__ import annotations

ONBOARD_RATES_HZ: dict[str, float] = {
    "ATTITUDE": 99.0,
    "ATTITUDE_QUATERNION": 50.0,
    "HIGHRES_IMU": 50.0,
    "GLOBAL_POSITION_INT": 50.0,
    "LOCAL_POSITION_NED": 30.0,
    "ODOMETRY": 30.0,
    "TIMESYNC": 10.0,
    "ALTITUDE": 10.0,
    "VFR_HUD": 10.0,
    "POSITION_TARGET_LOCAL_NED": 10.0,
    "GPS_RAW_INT": 8.0,
    "ATTITUDE_TARGET": 10.0,
    "DISTANCE_SENSOR": 10.0,
    "SERVO_OUTPUT_RAW": 10.0,
    "SYS_STATUS": 5.0,
    "EXTENDED_SYS_STATE": 5.0,
    "HEARTBEAT": 1.0,
    "ESTIMATOR_STATUS": 1.0,
    "SYSTEM_TIME": 1.0,
    "MISSION_CURRENT": 1.0,
    "PING": 1.0,
    "SCALED_PRESSURE": 1.0,
    "BATTERY_STATUS": 0.5,
    "HOME_POSITION": 0.5,
    "VIBRATION": 0.5,
}
"""PX4's onboard link, as seen unasked."""
GCS_RATES_HZ: dict[str, float] = {
    **ONBOARD_RATES_HZ,
    "ATTITUDE": 50.0,
    "LOCAL_POSITION_NED": 50.0,
    "HIGHRES_IMU": 0.0,
    "DISTANCE_SENSOR": 0.0,
    "PING": 0.0,
}
"""PX4's link to a ground station: as seen for positions and attitude, the others as on the onboard link."""
RADIO_RATES_HZ: dict[str, float] = {
    "HEARTBEAT": 1.0,
    "ATTITUDE": 5.0,
    "LOCAL_POSITION_NED": 1.0,
    "GLOBAL_POSITION_INT": 1.0,
    "SYS_STATUS": 1.0,
    "EXTENDED_SYS_STATE": 1.0,
    "GPS_RAW_INT": 1.0,
    "BATTERY_STATUS": 0.5,
    "SYSTEM_TIME": 1.0,
    "TIMESYNC": 10.0,
}
"""PX4 behind a telemetry radio: LOCAL_POSITION_NED at 1 Hz as seen, the others believable."""
