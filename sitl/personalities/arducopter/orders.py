"""What ground stations ask ArduCopter to do: modes, takeoff, places, setpoints, origins, groups of streams."""

from __future__ import annotations

from groundstation.mavlink.codec import Frame
from sitl.autopilot import Autopilot
from sitl.config import SECOND
from sitl.frames import is_place
from sitl.mavlink_ids import (
    ACCEPTED,
    DENIED,
    FAILED,
    MSG_HEARTBEAT,
    MSG_REQUEST_DATA_STREAM,
    MSG_SET_GPS_GLOBAL_ORIGIN,
    MSG_SET_MODE,
    MSG_SET_POSITION_TARGET_LOCAL_NED,
)
from sitl.personalities.arducopter.flight import Flight
from sitl.personalities.arducopter.modes import AUTO, CRITICAL, GUIDED, LAND, RTL
from sitl.personalities.arducopter.setpoints import read_ardupilot
from sitl.personalities.arducopter.streams import DATA_STREAMS
from sitl.wire import Fields, whole


class Orders:
    """Those of one vehicle; they are entered into what it understands."""

    def __init__(self, pilot: Autopilot, flight: Flight) -> None:
        self._pilot, self._flight = pilot, flight
        self._hear = pilot.messages[MSG_HEARTBEAT]
        pilot.messages.update(
            {
                MSG_HEARTBEAT: self._on_heartbeat,
                MSG_SET_MODE: self._on_set_mode,
                MSG_SET_POSITION_TARGET_LOCAL_NED: self._on_setpoint,
                MSG_SET_GPS_GLOBAL_ORIGIN: self._on_set_origin,
                MSG_REQUEST_DATA_STREAM: self._on_data_stream,
            }
        )
        pilot.commands.update(
            {
                20: lambda _p, _f: flight.change(RTL),
                21: lambda _p, _f: flight.change(LAND),
                22: self._take_off,
                176: self._mode,
                178: self._speed,
                192: self._reposition,
                300: lambda _p, _f: flight.change(AUTO),
                401: self._prearm,
            }
        )

    def _on_heartbeat(self, fields: Fields, frame: Frame) -> None:
        """Only the ground station of MAV_GCS_SYSID counts."""
        if frame.sysid == whole(self._pilot.params["MAV_GCS_SYSID"]):
            self._hear(fields, frame)

    def _prearm(self, _params: tuple[float, ...], _frame: Frame) -> int:
        why = self._pilot.arm_refusal()
        if why is not None:
            self._pilot.voice.text(CRITICAL, why)
        return ACCEPTED

    def _mode(self, params: tuple[float, ...], _frame: Frame) -> int:
        if not whole(params[0]) & 1:
            return DENIED
        return self._flight.change(whole(params[1]))

    def _on_set_mode(self, fields: Fields, frame: Frame) -> None:
        result = self._flight.change(fields["custom_mode"]) if fields["base_mode"] & 1 else DENIED
        self._pilot.voice.ack(MSG_SET_MODE, result, frame)

    def _take_off(self, params: tuple[float, ...], _frame: Frame) -> int:
        pilot, height = self._pilot, params[6]
        if self._flight.mode != GUIDED or not pilot.armed or not pilot.landed or not 0.0 < height <= 100_000.0:
            return FAILED
        self._flight.take_off(height)
        return ACCEPTED

    def _speed(self, params: tuple[float, ...], _frame: Frame) -> int:
        if not params[1] > 0:
            return FAILED
        self._pilot.body.motors.limit_speed(xy_m_s=params[1])
        return ACCEPTED

    def _reposition(self, params: tuple[float, ...], _frame: Frame) -> int:
        lat, lon, alt = params[4:7]
        if not is_place(lat, lon, alt) or self._pilot.landed:
            return DENIED
        if self._flight.change(GUIDED) != ACCEPTED:
            return FAILED
        self._flight.go_to(*self._pilot.body.geodesy.enu_from_geodetic(lat, lon, alt).tolist())
        return ACCEPTED

    def _on_setpoint(self, fields: Fields, _frame: Frame) -> None:
        if self._flight.mode != GUIDED or self._flight.taking_off_to is not None:
            return
        body = self._pilot.body
        self._flight.follow(read_ardupilot(fields, body.now_ns, body.senses))

    def _on_set_origin(self, fields: Fields, _frame: Frame) -> None:
        """Takes an origin only while there is none; bad values fail without a word."""
        body = self._pilot.body
        lat, lon, alt = fields["latitude"] * 1e-7, fields["longitude"] * 1e-7, fields["altitude"] * 1e-3
        if body.senses.has_origin or not is_place(lat, lon, alt):
            return
        body.senses.set_origin(body.geodesy.enu_from_geodetic(lat, lon, alt))
        body.link.send_now("GPS_GLOBAL_ORIGIN")

    def _on_data_stream(self, fields: Fields, _frame: Frame) -> None:
        """Sets a group of streams; there is no acknowledgement."""
        wanted, rate = fields["req_stream_id"], fields["req_message_rate"]
        interval_ns = round(SECOND / rate) if fields["start_stop"] and rate else 0
        for group, names in DATA_STREAMS.items():
            if wanted in (0, group):
                for name in names:
                    self._pilot.body.link.set_interval(name, interval_ns)
