"""One Crazyflie as a MAVLink system: what it logs becomes messages, what it is sent becomes orders.

Nothing is invented: a message about the vehicle is sent only after the vehicle was heard, a position only when a packet
brought one and its estimator vouches for it, dated when it was measured. Who is not heard any more sends no heartbeat.
Refuses to know links: frames lie in ``take_frames``, orders in ``take_orders``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from groundstation.gateway.asked import Asked
from groundstation.gateway.measured import Pose, charge, external_pose, read_pose
from groundstation.gateway.orders import Arm, ExternalPose, LogRate, Order, Ping, Place, Recover
from groundstation.gateway.params import ParamServer
from groundstation.gateway.pilot import SECOND_NS, Mode, Pilot
from groundstation.gateway.quality import LinkQuality
from groundstation.gateway.settings import LIMITS, Settings
from groundstation.gateway.stamps import Stamps
from groundstation.mavlink.codec import Encoder, Frame, Splitters, StructuredArray, decode, message_id
from groundstation.mavlink.mocap_frames import PACKED_TYPE, unpacked_poses
from groundstation.mavlink.vehicle import (
    LANDED_IN_AIR,
    LANDED_LANDING,
    LANDED_ON_GROUND,
    LANDED_TAKEOFF,
    LINK_HEARD,
    LINK_TRIP,
)

ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4  # MAV_RESULT
_MS, _US = 1_000_000, 1_000
_SILENT_NS = SECOND_NS
_DARK_NS = 3 * SECOND_NS // 10  # without a pose from outside, where there were some
_GENERIC, _QUADROTOR, _GCS = 0, 2, 6
_MAVLINK_VERSION = 3
_ARMED, _CUSTOM = 0x80, 0x01
_STANDBY, _ACTIVE, _CRITICAL, _EMERGENCY = 3, 4, 5, 6
_PREARM, _AHRS = 0x10000000, 0x200000  # MAV_SYS_STATUS_SENSOR
_NO_VELOCITY, _NO_YAW = 0x8 | 0x10 | 0x20, 0x400
_POSITION_IGNORED = 0x7
_LOCAL_NED = 1
_FORCE = 21196
_ATTITUDE_GOOD, _ALL_GOOD = 0x1, 0x1 | 0x2 | 0x4 | 0x8 | 0x10 | 0x20
_VARIANCE_GOOD_M2, _VARIANCE_LOST_M2 = 0.01, 0.09
_OLDEST_PROTOCOL, _SUPERVISOR_PORT = 9, 12  # since that one the supervisor has a port of its own
_TEXT_BYTES = 50
_WARNING, _INFO = 4, 6
_CHARGES = (1, 2)  # pm.state
_STREAMS_HZ = {"HEARTBEAT": 1.0, "SYS_STATUS": 2.0, "EXTENDED_SYS_STATE": 10.0, "ESTIMATOR_STATUS": 1.0}
_BY_POSE = ("LOCAL_POSITION_NED", "ATTITUDE_QUATERNION")


class Bridge:
    """One vehicle's.

    Args:
        sysid: of the MAVLink system that it becomes.
        now_ns: time at which it begins, on the clock of all later calls.
        log_hz: poses a second that the vehicle is made to log.
        boot_ns: what it tells as its time since start-up counts from here; None for ``now_ns``.

    Attributes:
        pilot: who flies it.
        quality: of its link, and the rates that follow.
        ignored: setpoints that were not followed.
        lateness_ns: of the last pose, against the quickest that ever came.
        told_by_flight: when the flight has told it last where it is, and what; None before that.
    """

    def __init__(self, sysid: int, now_ns: int, log_hz: float = 50.0, boot_ns: int | None = None) -> None:
        self.sysid = sysid
        self.quality = LinkQuality(log_hz)
        self.settings = Settings()
        self.pilot = Pilot(self.settings)
        self.ignored = 0
        self.told_by_flight: tuple[int, ExternalPose] | None = None
        self._begun_ns = now_ns if boot_ns is None else boot_ns
        self._encoder, self._splitters, self._stamps = Encoder(sysid), Splitters(), Stamps()
        self._params = ParamServer(self.settings, self._encoder)
        self._asked = Asked()
        self._frames: list[bytes] = []
        self._protocol: int | None = None
        self._pose: Pose | None = None
        self._heard_ns: int | None = None
        self._variance_m2 = math.inf
        self._volts, self._charge, self._pm_state = math.nan, math.nan, 0
        self._next_ns = dict.fromkeys((*_STREAMS_HZ, *_BY_POSE), 0)
        self._period_ns = {name: round(SECOND_NS / hz) for name, hz in _STREAMS_HZ.items()} | dict.fromkeys(_BY_POSE, 0)
        self._told: tuple[int, bool, int] = (-1, False, 0)
        self._link_told_ns = self._external_ns = 0
        self._trouble: str | None = None
        self._text_number = 0
        self._flew = self._ends = self._resumed = False

    @property
    def lateness_ns(self) -> int:
        """How much longer the last pose took than the quickest one."""
        return self._stamps.lateness_ns

    @property
    def heard_ever(self) -> bool:
        """Whether the vehicle has told where it is."""
        return self._heard_ns is not None

    # -- from the vehicle ---------------------------------------------------------------------------------------

    def connected(self, protocol: int, params: Mapping[str, tuple[float, int]]) -> None:
        """Takes what a connection begins with.

        Args:
            protocol: version of CRTP.
            params: full name: value, MAV_PARAM_TYPE.
        """
        self._protocol = protocol
        self._params.know(params)

    def resume(
        self, home_enu_m: Place | None, settings: Mapping[str, float], now_ns: int, *, in_a_room: bool = False
    ) -> None:
        """Takes over a vehicle that flies, whose gateway has ended: it is told to stay where it is, before all else.

        Args:
            home_enu_m: where it took off, in the room's frame; None where nobody knows.
            settings: the gateway's own, as they were.
            now_ns: time of that.
            in_a_room: it was told until now where it is, and has to be.
        """
        for name, value in settings.items():
            if name in LIMITS:
                self.settings.set_value(name, value)
        self._resumed = True
        self._variance_m2 = _VARIANCE_GOOD_M2  # as it was a moment ago; what it logs of that comes half a second later
        self._external_ns = now_ns if in_a_room else 0
        self.pilot.resume(home_enu_m, now_ns)
        self._text(_WARNING, "its gateway has begun anew; it stays where it is")

    def echoed(self, number: int, now_ns: int) -> None:
        """Takes an echo that was asked for by ``Ping``."""
        self.quality.echoed(number, now_ns)

    def answered(self, number: int, error: int) -> None:
        """Takes what the high-level commander answers to a command, by its number; error 0 is none."""
        words = self._asked.answered(number, error)
        if words is not None:
            self._text(_WARNING, words)

    def param_told(self, name: str, value: float) -> None:
        """Takes a parameter's value, after it was set."""
        self._frames += self._params.told(name, value)

    def logged(self, values: Mapping[str, float], stamp_ms: int, now_ns: int) -> None:
        """Takes the values of a log packet.

        Args:
            values: by full name, in the firmware's units.
            stamp_ms: the vehicle's time, 24 bits.
            now_ns: when it came.
        """
        if "pm.vbat" in values:
            self._status(values)
        if "stateEstimateZ.x" not in values:
            return
        restarts = self._stamps.restarts
        measured_ns = self._stamps.measured_ns(stamp_ms, now_ns)
        pose = read_pose(values)
        if measured_ns is None or pose is None:
            return
        if self._stamps.restarts != restarts:
            self._text(_WARNING, "has started anew")
        self._pose, self._heard_ns = pose, now_ns
        self.quality.posed(stamp_ms, now_ns)
        self.pilot.saw(pose, measured_ns)
        if self._variance_m2 <= _VARIANCE_LOST_M2:
            self._tell_pose(pose, measured_ns, now_ns)
        self._tell_changes(now_ns)

    def _status(self, values: Mapping[str, float]) -> None:
        self._volts, self._pm_state = float(values["pm.vbat"]), int(values.get("pm.state", 0.0))
        now = charge(self._volts, flies=self.pilot.supervisor.flies)
        if math.isnan(self._charge) or self.pilot.supervisor.flies != self._flew:
            self._charge = now
        self._charge += 0.3 * (now - self._charge)  # a single dip is no empty battery
        self._flew = self.pilot.supervisor.flies
        variances = [float(values.get(f"kalman.varP{axis}", math.inf)) for axis in "XYZ"]
        self._variance_m2 = max(variances) if all(map(math.isfinite, variances)) else math.inf

    # -- from the ground station --------------------------------------------------------------------------------

    def receive(self, data: bytes, now_ns: int) -> None:
        """Takes a datagram of MAVLink."""
        for piece in self._splitters.feed((0, ""), data, stream=False):
            if isinstance(piece, Frame):
                self.take(piece, now_ns)

    def take(self, frame: Frame, now_ns: int) -> None:
        """Takes one frame of a ground station."""
        for batch in decode([frame]):
            if batch.name == "TUNNEL":
                self._see(batch.values[0], now_ns)
            else:
                self._obey(batch.name, batch.values[0], now_ns)

    def _see(self, values: StructuredArray, now_ns: int) -> None:
        """Takes its pose out of those of several."""
        if int(values["payload_type"]) != PACKED_TYPE:
            return
        if now_ns - self._external_ns < 0.9 * SECOND_NS / self.quality.cap_hz:
            return
        for sysid, pose in unpacked_poses(bytes(values["payload"][: int(values["payload_length"])])):
            if sysid == self.sysid and all(map(math.isfinite, pose[:3])):
                self.told_by_flight = now_ns, external_pose(*pose)
                self.see(self.told_by_flight[1], now_ns)

    def see(self, pose: ExternalPose, now_ns: int) -> None:
        """Takes a pose from outside; of those that wait only the newest goes on to the vehicle."""
        self._external_ns = now_ns
        self.pilot.orders = [order for order in self.pilot.orders if not isinstance(order, ExternalPose)]
        self.pilot.orders.append(pose)

    def _obey(self, name: str, values: StructuredArray, now_ns: int) -> None:
        if name == "HEARTBEAT":
            if int(values["type"]) == _GCS:
                self.pilot.station(now_ns)
        elif name == "TIMESYNC":
            if int(values["tc1"]) == 0:
                self._emit("TIMESYNC", tc1=now_ns - self._begun_ns, ts1=int(values["ts1"]))
        elif "target_system" in (values.dtype.names or ()) and int(values["target_system"]) not in (0, self.sysid):
            return
        elif name == "COMMAND_LONG":
            command = int(values["command"])
            params = tuple(float(values[f"param{k}"]) for k in range(1, 8))
            result = self._command(command, params, now_ns)
            self._emit("COMMAND_ACK", command=command, result=result)
            self._tell_changes(now_ns)
        elif name == "SET_POSITION_TARGET_LOCAL_NED":
            self.ignored += not self._setpoint(values, now_ns)
        elif name.startswith("PARAM_"):
            frames, order = self._params.answer(name, values)
            self._frames += frames
            if order is not None:
                self.pilot.orders.append(order)

    def _setpoint(self, values: StructuredArray, now_ns: int) -> bool:
        mask = int(values["type_mask"])
        if int(values["coordinate_frame"]) != _LOCAL_NED or mask & _NO_VELOCITY or ~mask & _POSITION_IGNORED:
            return False
        north, east, down = (float(values[name]) for name in ("vx", "vy", "vz"))
        yaw_enu_rad = None if mask & _NO_YAW else math.pi / 2.0 - float(values["yaw"])
        return self.pilot.velocity((east, north, -down), yaw_enu_rad, now_ns)

    def _command(self, command: int, params: tuple[float, ...], now_ns: int) -> int:
        pilot = self.pilot
        if command == 400 and params[0] == 0.0 and params[1] == _FORCE:
            pilot.kill()  # also into the dark, and to the last moment
            return ACCEPTED if self._heard(now_ns) else FAILED
        if self._ends:
            return self._say("its gateway ends, and takes no more orders")
        if not self._heard(now_ns):
            return FAILED
        if command == 400:
            return self._arm(params, now_ns)
        if command == 22:
            return self._say(pilot.take_off(params[6], now_ns))
        if command == 21:
            return self._say(pilot.land(now_ns))
        if command == 176:
            return self._mode(params, now_ns)
        if command == 246 and params[0] == 1.0:
            return self._recover()
        if command == 401:
            trouble = self.trouble(now_ns)
            if trouble is not None:
                self._text(_WARNING, trouble)
            return ACCEPTED
        if command in (511, 512):
            return self._stream(command, params, now_ns)
        return UNSUPPORTED

    def _say(self, why_not: str | None) -> int:
        if why_not is None:
            return ACCEPTED
        self._text(_WARNING, why_not)
        return DENIED

    def _arm(self, params: tuple[float, ...], now_ns: int) -> int:
        if params[0] == 1.0:
            return self._say(self.pilot.arm(self.trouble(now_ns)))
        if params[0] != 0.0:
            return DENIED
        return self._say(None if self.pilot.disarm() else "is in the air, and disarms by force only")

    def _recover(self) -> int:
        """Begins anew after a crash, on the ground; the rest of a restart takes a hand at its switch."""
        told = self.pilot.supervisor
        if told.flies:
            return self._say("is in the air")
        if told.locked:
            return self._say("is locked, which only its switch ends; look at it, then switch it off and on")
        if told.tumbled:
            return self._say("lies on its side or back; stand it upright")
        self.pilot.orders.append(Recover())
        return ACCEPTED

    def _mode(self, params: tuple[float, ...], now_ns: int) -> int:
        mode = params[1]
        if mode == Mode.VELOCITY:
            if self.pilot.mode is Mode.OUT:
                return DENIED
            if self.pilot.mode is not Mode.VELOCITY:
                self.pilot.follow(now_ns)
            return ACCEPTED
        if mode == Mode.STAND:
            return self._say(None if self.pilot.stand() else "is in the air")
        if mode == Mode.HOLD:
            self.pilot.hold(now_ns)
            return ACCEPTED
        return self._say(self.pilot.land(now_ns)) if mode == Mode.LAND else UNSUPPORTED

    def _stream(self, command: int, params: tuple[float, ...], now_ns: int) -> int:
        name = next((name for name in self._period_ns if message_id(name) == params[0]), None)
        if command == 512 and params[0] == message_id("AUTOPILOT_VERSION"):
            self._emit("AUTOPILOT_VERSION", flight_sw_version=((self._protocol or 0) << 24 | 255))
            return ACCEPTED
        if name is None:
            return UNSUPPORTED
        if command == 511 and name != "HEARTBEAT":
            interval_us = params[1]
            if not math.isfinite(interval_us):
                return DENIED
            by_pose = name in _BY_POSE
            usual_ns = 0 if by_pose else round(SECOND_NS / _STREAMS_HZ[name])
            self._period_ns[name] = (
                usual_ns if interval_us == 0.0 else -1 if interval_us < 0.0 else round(interval_us * _US)
            )
        elif name in _STREAMS_HZ:
            self._tell(name, now_ns)
        return ACCEPTED

    # -- time ---------------------------------------------------------------------------------------------------

    def tick(self, now_ns: int) -> None:
        """Does what is due."""
        dark_ns = now_ns - self._external_ns if self._external_ns else 0
        self.pilot.dark_s = dark_ns / SECOND_NS if dark_ns > _DARK_NS else 0.0
        words = self.pilot.tick(now_ns)
        if words is not None:
            self._text(_WARNING if self.pilot.failsafe else _INFO, words)
        again = self._asked.due(now_ns)
        if again and self.pilot.asks(again[-1], now_ns):
            self.pilot.orders += again
        self._frames += self._params.due()
        if not self._heard(now_ns):
            return
        self._tell_changes(now_ns)
        self._measure_link(now_ns)
        for name in _STREAMS_HZ:
            if self._period_ns[name] >= 0 and now_ns >= self._next_ns[name]:
                self._next_ns[name] = max(self._next_ns[name] + self._period_ns[name], now_ns)
                self._tell(name, now_ns)

    def _measure_link(self, now_ns: int) -> None:
        """Measures, lowers rates where that is needed, and tells."""
        quality = self.quality
        number = quality.ping(now_ns)
        if number is not None:
            self.pilot.orders.append(Ping(number))
        if quality.step(now_ns):
            self.pilot.most_hz = quality.cap_hz
            self.pilot.orders.append(LogRate(quality.log_hz))
            self._text(_WARNING if quality.level else _INFO, quality.words())
        if now_ns - self._link_told_ns >= SECOND_NS:
            self._link_told_ns = now_ns
            stamp_ms = max(0, now_ns - self._begun_ns) // _MS
            for name, value in ((LINK_HEARD, quality.heard), (LINK_TRIP, quality.trip_s)):
                if math.isfinite(value):
                    self._emit("NAMED_VALUE_FLOAT", time_boot_ms=stamp_ms, name=name.encode(), value=value)

    def end(self, now_ns: int) -> None:
        """Lands it if it flies; from now on it obeys nothing but a kill."""
        self._ends = True
        if self.pilot.supervisor.flies:
            self.pilot.land(now_ns, failsafe=True)

    def take_frames(self) -> list[bytes]:
        """Hands out what is to be sent to ground stations."""
        frames, self._frames = self._frames, []
        return frames

    def take_orders(self) -> list[Order]:
        """Hands out what is to be sent to the vehicle."""
        orders, self.pilot.orders = self.pilot.orders, []
        if self._protocol is not None and self._protocol < _SUPERVISOR_PORT:
            orders = [replace(order, old=True) if isinstance(order, Arm | Recover) else order for order in orders]
        self._asked.sent(orders)
        return orders

    def take_external_pose(self) -> ExternalPose | None:
        """Hands out the pose from outside that waits, for whoever sends those of several together."""
        found = next((order for order in self.pilot.orders if isinstance(order, ExternalPose)), None)
        if found is not None:
            self.pilot.orders.remove(found)
        return found

    def _heard(self, now_ns: int) -> bool:
        known = self._protocol is not None or self._resumed  # else it would be asked what nobody knows yet
        return known and self._heard_ns is not None and now_ns - self._heard_ns <= _SILENT_NS

    # -- what it tells ------------------------------------------------------------------------------------------

    def trouble(self, now_ns: int) -> str | None:
        """Why it would not be armed now, None when it would."""
        if not self._heard(now_ns):
            return "is not heard"
        if self._protocol is not None and self._protocol < _OLDEST_PROTOCOL:
            return f"speaks CRTP version {self._protocol}, {_OLDEST_PROTOCOL} is needed; update its firmware"
        if self._params.value("system.selftestPassed") == 0.0:
            return "has not passed its self-test; restart it, standing still"
        if (trouble := self.pilot.supervisor.trouble()) is not None:
            return trouble
        if self._pm_state in _CHARGES:
            return "stands on its charger; take it off"
        if not self._variance_m2 <= _VARIANCE_GOOD_M2:
            return "does not know where it is; see to its positioning (motion capture, deck)"
        return None

    def _landed_state(self, now_ns: int) -> int:
        if not self.pilot.supervisor.flies:
            return LANDED_ON_GROUND
        if self.pilot.climbs(now_ns):
            return LANDED_TAKEOFF
        return LANDED_LANDING if self.pilot.mode is Mode.LAND else LANDED_IN_AIR

    def _tell_changes(self, now_ns: int) -> None:
        """Tells at once what ground stations wait for: mode, armed, landed; and trouble that is new."""
        state = (int(self.pilot.mode), self.pilot.armed, self._landed_state(now_ns))
        if state != self._told and self._heard_ns is not None and (self._protocol is not None or self._resumed):
            self._told = state
            self._tell("HEARTBEAT", now_ns)
            self._tell("EXTENDED_SYS_STATE", now_ns)
        told = self.pilot.supervisor
        trouble = told.trouble() if told.locked or told.crashed or told.tumbled or self.pilot.armed else None
        if trouble != self._trouble:
            self._trouble = trouble
            if trouble is not None:
                self._text(_WARNING, trouble)

    def _tell(self, name: str, now_ns: int) -> None:
        if name == "HEARTBEAT":
            pilot = self.pilot
            status = _EMERGENCY if pilot.mode is Mode.OUT else _CRITICAL if pilot.failsafe else _ACTIVE
            self._emit(
                "HEARTBEAT", custom_mode=int(pilot.mode), type=_QUADROTOR, autopilot=_GENERIC,
                base_mode=_CUSTOM | (_ARMED if pilot.armed else 0),
                system_status=status if pilot.armed or pilot.mode is Mode.OUT else _STANDBY,
                mavlink_version=_MAVLINK_VERSION,
            )  # fmt: skip
        elif name == "EXTENDED_SYS_STATE":
            self._emit("EXTENDED_SYS_STATE", landed_state=self._landed_state(now_ns))
        elif name == "ESTIMATOR_STATUS":
            good = self._variance_m2 <= _VARIANCE_GOOD_M2
            error_m = math.sqrt(self._variance_m2) if math.isfinite(self._variance_m2) else 0.0
            self._emit(
                "ESTIMATOR_STATUS", time_usec=(now_ns - self._begun_ns) // _US,
                flags=_ALL_GOOD if good else _ATTITUDE_GOOD, pos_horiz_accuracy=error_m, pos_vert_accuracy=error_m,
            )  # fmt: skip
        else:
            healthy = (_PREARM if self.trouble(now_ns) is None else 0) | (
                _AHRS if self._variance_m2 <= _VARIANCE_LOST_M2 else 0
            )
            self._emit(
                "SYS_STATUS", onboard_control_sensors_present=_PREARM | _AHRS,
                onboard_control_sensors_enabled=_PREARM | _AHRS, onboard_control_sensors_health=healthy,
                voltage_battery=0xFFFF if math.isnan(self._volts) else round(self._volts * 1000.0),
                current_battery=-1, battery_remaining=-1 if math.isnan(self._charge) else round(self._charge * 100.0),
            )  # fmt: skip

    def _tell_pose(self, pose: Pose, measured_ns: int, now_ns: int) -> None:
        stamp_ms = max(0, measured_ns - self._begun_ns) // _MS
        for name in _BY_POSE:
            period_ns = self._period_ns[name]
            if period_ns < 0 or now_ns < self._next_ns[name] - period_ns // 4:
                continue
            self._next_ns[name] = max(self._next_ns[name] + period_ns, now_ns)
            if name == "LOCAL_POSITION_NED":
                (x, y, z), (vx, vy, vz) = pose.pos_enu_m, pose.vel_enu_m_s
                self._emit(name, time_boot_ms=stamp_ms, x=y, y=x, z=-z, vx=vy, vy=vx, vz=-vz)
            else:
                w, qx, qy, qz = pose.quat_ned_from_frd
                self._emit(name, time_boot_ms=stamp_ms, q1=w, q2=qx, q3=qy, q4=qz)

    def _text(self, severity: int, words: str) -> None:
        data = words.encode("ascii", "replace")
        pieces = [data[k : k + _TEXT_BYTES] for k in range(0, len(data), _TEXT_BYTES)]
        self._text_number = self._text_number % 0xFFFF + 1 if len(pieces) > 1 else self._text_number
        number = self._text_number if len(pieces) > 1 else 0
        if len(pieces[-1]) == _TEXT_BYTES and number:
            pieces.append(b"")  # a chunk that is full says that there are more
        for place, piece in enumerate(pieces):
            self._emit("STATUSTEXT", severity=severity, text=piece, id=number, chunk_seq=place)

    def _emit(self, name: str, /, **fields: float | bytes) -> None:
        self._frames.append(self._encoder.encode(name, **fields))
