"""PX4's parameters as the emulator knows them: name to (value, MAVLink type)."""

from __future__ import annotations

from sitl.params import INT32, REAL32, Value

PX4: dict[str, Value] = {
    "COM_ARM_WO_GPS": (1, INT32),
    "COM_DISARM_LAND": (2.0, REAL32),
    "COM_DISARM_PRFLT": (10.0, REAL32),
    "COM_DL_LOSS_T": (10, INT32),
    "COM_OBL_RC_ACT": (0, INT32),
    "COM_OF_LOSS_T": (1.0, REAL32),
    "COM_RCL_EXCEPT": (4, INT32),
    "COM_SPOOLUP_TIME": (1.0, REAL32),
    "EKF2_EV_CTRL": (15, INT32),
    "MAV_TYPE": (2, INT32),
    "MIS_TAKEOFF_ALT": (2.5, REAL32),
    "MPC_LAND_SPEED": (0.7, REAL32),
    "MPC_TKO_SPEED": (1.5, REAL32),
    "MPC_XY_VEL_MAX": (12.0, REAL32),
    "MPC_Z_V_AUTO_DN": (1.5, REAL32),
    "NAV_DLL_ACT": (0, INT32),
    "RTL_RETURN_ALT": (60.0, REAL32),
    "RTL_DESCEND_ALT": (30.0, REAL32),
    "SYS_AUTOSTART": (10040, INT32),
}
