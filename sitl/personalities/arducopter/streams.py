"""What ArduCopter sends unasked, and the groups in which it is asked for more."""

from __future__ import annotations

ARDUPILOT_RATES_HZ: dict[str, float] = {"HEARTBEAT": 1.0, "TIMESYNC": 0.1}
"""ArduCopter sends nothing else unasked (STATUSTEXT aside)."""
DATA_STREAMS: dict[int, tuple[str, ...]] = {
    1: ("RAW_IMU", "SCALED_PRESSURE"),
    2: ("SYS_STATUS", "MEMINFO", "POWER_STATUS", "MISSION_CURRENT", "GPS_RAW_INT", "NAV_CONTROLLER_OUTPUT"),
    3: ("SERVO_OUTPUT_RAW", "RC_CHANNELS"),
    6: ("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED"),
    10: ("ATTITUDE",),
    11: ("VFR_HUD",),
    12: ("SYSTEM_TIME", "BATTERY_STATUS", "EKF_STATUS_REPORT", "VIBRATION"),
}
"""REQUEST_DATA_STREAM groups; 0 stands for all of them."""
