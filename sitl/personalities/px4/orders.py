"""What ground stations ask PX4 to do: modes, takeoff, landing, places, setpoints, origins."""

from __future__ import annotations

from groundstation.mavlink.codec import Frame
from sitl.autopilot import Autopilot
from sitl.frames import is_place
from sitl.mavlink_ids import (
    ACCEPTED,
    DENIED,
    MSG_SET_GPS_GLOBAL_ORIGIN,
    MSG_SET_MODE,
    MSG_SET_POSITION_TARGET_LOCAL_NED,
    TEMPORARILY_REJECTED,
)
from sitl.personalities.px4.commander import Commander
from sitl.personalities.px4.modes import CRITICAL, INFO, LAND, LOITER, MISSION, NAMES, OFFBOARD, RTL, TAKEOFF, Mode
from sitl.personalities.px4.navigator import Navigator
from sitl.personalities.px4.setpoints import read_px4
from sitl.wire import Fields, whole


class Orders:
    """Those of one vehicle; they are entered into what it understands."""

    def __init__(self, pilot: Autopilot, commander: Commander, navigator: Navigator) -> None:
        self._pilot, self._commander, self._navigator = pilot, commander, navigator
        pilot.messages.update(
            {
                MSG_SET_MODE: self._on_set_mode,
                MSG_SET_POSITION_TARGET_LOCAL_NED: self._on_setpoint,
                MSG_SET_GPS_GLOBAL_ORIGIN: self._on_set_origin,
            }
        )
        pilot.commands.update(
            {
                20: lambda _p, _f: self.change_mode(RTL),
                21: self._land,
                22: self._take_off,
                176: self._mode,
                178: self._speed,
                192: self._reposition,
                300: lambda _p, _f: self.change_mode(MISSION),
                401: lambda _p, _f: ACCEPTED,
            }
        )

    def change_mode(self, mode: Mode) -> int:
        """Changes the mode. Returns the MAV_RESULT."""
        result = self._commander.change(mode)
        if result == ACCEPTED and mode == TAKEOFF:
            self._navigator.aim_as_usual()
        return result

    def _mode(self, params: tuple[float, ...], _frame: Frame) -> int:
        if not whole(params[0]) & 1:
            return DENIED
        mode = (whole(params[1]), whole(params[2]) if whole(params[1]) == 4 else 0)
        return self.change_mode(mode) if mode in NAMES else DENIED

    def _on_set_mode(self, fields: Fields, _frame: Frame) -> None:
        if fields["base_mode"] & 1:
            mode = (fields["custom_mode"] >> 16 & 0xFF, fields["custom_mode"] >> 24)
            if mode in NAMES:
                self.change_mode(mode)

    def _take_off(self, params: tuple[float, ...], _frame: Frame) -> int:
        if not self._pilot.has_position:
            return TEMPORARILY_REJECTED
        self._navigator.aim(*params[4:7])
        return self.change_mode(TAKEOFF)

    def _land(self, _params: tuple[float, ...], _frame: Frame) -> int:
        result = self.change_mode(LAND)
        if result == ACCEPTED and self._pilot.armed and not self._pilot.landed:
            self._pilot.voice.text(INFO, "Landing at current position\t")
        return result

    def _speed(self, params: tuple[float, ...], _frame: Frame) -> int:
        if params[1] > 0:
            self._pilot.body.motors.limit_speed(xy_m_s=params[1])
        return ACCEPTED

    def _reposition(self, params: tuple[float, ...], _frame: Frame) -> int:
        pilot, body = self._pilot, self._pilot.body
        if not pilot.has_position or not pilot.armed or pilot.landed:
            return DENIED
        x, y, z = body.senses.pos_enu_m
        lat, lon, alt = params[4:7]
        if is_place(lat, lon, 0.0):
            x, y, _ = body.geodesy.enu_from_geodetic(lat, lon, body.home_alt_m).tolist()
        if abs(alt) <= 100_000.0:
            z = alt - body.home_alt_m
        self.change_mode(LOITER)
        self._navigator.go_to((x, y, z))
        return ACCEPTED

    def _on_setpoint(self, fields: Fields, _frame: Frame) -> None:
        pilot, body = self._pilot, self._pilot.body
        try:
            point = read_px4(fields, body.now_ns, body.senses)
        except ValueError as error:
            pilot.voice.text(CRITICAL, f"SET_POSITION_TARGET_LOCAL_NED {error}\t")
            return
        if point is not None:
            pilot.setpoint = point
            if pilot.armed and self._commander.mode == OFFBOARD:
                self._navigator.fly_setpoint()

    def _on_set_origin(self, fields: Fields, _frame: Frame) -> None:
        """Moves the estimator's origin, and LOCAL_POSITION_NED with it."""
        body = self._pilot.body
        lat, lon, alt = fields["latitude"] * 1e-7, fields["longitude"] * 1e-7, fields["altitude"] * 1e-3
        if not self._pilot.has_position or not is_place(lat, lon, alt):
            return
        body.senses.set_origin(body.geodesy.enu_from_geodetic(lat, lon, alt))
        body.link.send_now("GPS_GLOBAL_ORIGIN")
