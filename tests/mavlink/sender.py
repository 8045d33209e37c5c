"""Somebody else on the link: frames made by pymavlink's own classes, none of them by the ground station's codec."""

from __future__ import annotations

import math
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

QUAD, FIXED_WING, ROVER, COMPANION = 2, 1, 10, 18  # MAV_TYPE
ARDUPILOT, INVALID, PX4 = 3, 8, 12  # MAV_AUTOPILOT
ARMED, DISARMED = 0x80 | 0x01, 0x01
ON_GROUND, IN_AIR = 1, 2
OFFBOARD, LOITER, LAND = 393216, 50593792, 100925440


class Sender:
    """A sender under some system and component id."""

    def __init__(self, sysid: int, compid: int = 1, *, version: int = 2) -> None:
        self._mav = dialect.MAVLink(None, srcSystem=sysid, srcComponent=compid)
        self._version = version

    def raw(self, message: Any) -> bytes:
        """One message on the wire."""
        return bytes(message.pack(self._mav, force_mavlink1=self._version == 1))

    def heartbeat(
        self, base_mode: int = ARMED, custom_mode: int = OFFBOARD, *, kind: int = QUAD, autopilot: int = PX4
    ) -> bytes:
        """HEARTBEAT."""
        return self.raw(dialect.MAVLink_heartbeat_message(kind, autopilot, base_mode, custom_mode, 4, 3))

    def landed(self, landed_state: int) -> bytes:
        """EXTENDED_SYS_STATE."""
        return self.raw(dialect.MAVLink_extended_sys_state_message(0, landed_state))

    def battery(self, percent: int) -> bytes:
        """SYS_STATUS."""
        return self.raw(dialect.MAVLink_sys_status_message(0, 0, 0x10000000, 0, 11_000, 0, percent, 0, 0, 0, 0, 0, 0))

    def position(self, boot_ms: int, north_m: float, east_m: float = 0.0, down_m: float = -1.0) -> bytes:
        """LOCAL_POSITION_NED."""
        return self.raw(dialect.MAVLink_local_position_ned_message(boot_ms, north_m, east_m, down_m, 0.0, 0.0, 0.0))

    def origin(self, lat_e7: int, lon_e7: int, alt_mm: int = 0) -> bytes:
        """GPS_GLOBAL_ORIGIN."""
        return self.raw(dialect.MAVLink_gps_global_origin_message(lat_e7, lon_e7, alt_mm))

    def home(self, lat_e7: int, lon_e7: int, north_m: float = 0.0) -> bytes:
        """HOME_POSITION, so far north in the vehicle's own frame."""
        rest = (0, north_m, 0.0, 0.0, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0)
        return self.raw(dialect.MAVLink_home_position_message(lat_e7, lon_e7, *rest))

    def set_origin(self, lat_deg: float, lon_deg: float, alt_m: float = 488.0, *, target: int = 1) -> bytes:
        """SET_GPS_GLOBAL_ORIGIN."""
        place = (round(lat_deg * 1e7), round(lon_deg * 1e7), round(alt_m * 1e3))
        return self.raw(dialect.MAVLink_set_gps_global_origin_message(target, *place))

    def text(self, words: bytes, number: int = 0, piece: int = 0, severity: int = 4) -> bytes:
        """STATUSTEXT, whole or a piece."""
        return self.raw(dialect.MAVLink_statustext_message(severity, words, number, piece))

    def timesync(self, tc1_ns: int, ts1_ns: int) -> bytes:
        """TIMESYNC."""
        return self.raw(dialect.MAVLink_timesync_message(tc1_ns, ts1_ns))

    def aircraft(
        self,
        place_deg_m: tuple[float, float, float],
        vel_ned_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0),
        *,
        icao: int = 0x4B1234,
        callsign: bytes = b"HB-ABC",
        flags: int = 1 | 2 | 4 | 8 | 128,
        geometric: bool = True,
        since_s: int = 0,
    ) -> bytes:
        """ADSB_VEHICLE."""
        lat_deg, lon_deg, height_m = place_deg_m
        north, east, down = vel_ned_m_s
        heading_cdeg = round(math.degrees(math.atan2(east, north)) * 100) % 36000
        message = dialect.MAVLink_adsb_vehicle_message(
            icao, round(lat_deg * 1e7), round(lon_deg * 1e7), int(geometric), round(height_m * 1e3), heading_cdeg,
            round(math.hypot(north, east) * 100), round(-down * 100), callsign, 1, since_s, flags, 0,
        )  # fmt: skip
        return self.raw(message)
