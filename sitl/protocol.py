"""The parts of MAVLink that any autopilot answers: time, parameters, streams, requests, missions, acknowledgements.

``Protocol`` holds them for one vehicle; the flying is in ``autopilot`` and the personalities. What the two autopilots
do differently here (parameter encoding, who may be addressed how) are attributes and small overrides.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any, ClassVar

from groundstation.mavlink.codec import Encoder, Frame, message_id, message_name
from sitl.body import Body
from sitl.config import VehicleConfig
from sitl.outfit import Outfit
from sitl.wire import V1_LAST_ID, Fields, unpack, whole

ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED, FAILED, IN_PROGRESS = range(6)
Command = Callable[[tuple[float, ...], Frame], int | None]
_TEXT_BYTES = 50
_PARAMS_PER_TICK = 20  # about 1000 a second, as PX4 was seen to send them
_TYPE_GCS = 6
_ITEM_PATIENCE_NS = 250_000_000
_ITEM_TRIES = 20
MISSION_ACCEPTED, MISSION_UNSUPPORTED, MISSION_BAD_X, MISSION_BAD_Y, MISSION_BAD_SEQUENCE = 0, 3, 10, 11, 13
_FLIGHT, _ALL_KINDS = 0, 255  # mission types; fences (1) and rally points (2) are not emulated

MSG_HEARTBEAT, MSG_PING, MSG_SET_MODE = 0, 4, 11
MSG_PARAM_REQUEST_READ, MSG_PARAM_REQUEST_LIST, MSG_PARAM_SET = 20, 21, 23
MSG_MISSION_REQUEST, MSG_MISSION_SET_CURRENT, MSG_MISSION_REQUEST_LIST = 40, 41, 43
MSG_MISSION_COUNT, MSG_MISSION_CLEAR_ALL, MSG_MISSION_ACK = 44, 45, 47
MSG_MISSION_ITEM, MSG_MISSION_REQUEST_INT, MSG_MISSION_ITEM_INT = 39, 51, 73
MSG_SET_GPS_GLOBAL_ORIGIN, MSG_REQUEST_DATA_STREAM = 48, 66
MSG_COMMAND_INT, MSG_COMMAND_LONG, MSG_COMMAND_CANCEL = 75, 76, 80
MSG_SET_POSITION_TARGET_LOCAL_NED, MSG_SET_POSITION_TARGET_GLOBAL_INT = 84, 86
MSG_VISION_POSITION_ESTIMATE, MSG_VICON_POSITION_ESTIMATE, MSG_TIMESYNC = 102, 104, 111
MSG_ATT_POS_MOCAP, MSG_SETUP_SIGNING, MSG_ODOMETRY = 138, 256, 331


class Protocol:
    """One vehicle's MAVLink conversation.

    Attributes:
        body: the vehicle that it speaks for.
        armed: whether the motors may turn.
        sysid, compid: its MAVLink address.
        encoder: makes its frames and numbers them.
        params: its parameters.
        rates_hz: streams that run unasked.
        mission: stored mission items, fields of MISSION_ITEM_INT.
        gcs_heard_ns: last heartbeat of a ground station; None before.
    """

    mav_autopilot = 0
    param_bytewise = True
    version_fields: ClassVar[Fields] = {}
    commands_to_system_0 = False

    def __init__(self, body: Body, config: VehicleConfig, outfit: Outfit) -> None:
        self.body, self.config = body, config
        self.armed = False
        self.sysid, self.compid = config.sysid, 1
        self.encoder = Encoder(config.sysid, self.compid, version=2 if config.mavlink_version == 2 else 1)
        self.params, self.rates_hz = outfit.params, outfit.rates_hz
        self.mission: list[Fields] = []
        self.mission_seq = 0
        self.gcs_heard_ns: int | None = None
        self.ignore_commands = False
        self._param_queue: list[int] = []
        self._upload: dict[str, Any] | None = None
        self._text_id = 0
        self.messages: dict[int, Callable[[Fields, Frame], None]] = {
            MSG_HEARTBEAT: self._on_heartbeat,
            MSG_PING: self._on_ping,
            MSG_TIMESYNC: self._on_timesync,
            MSG_SETUP_SIGNING: self._on_setup_signing,
            MSG_COMMAND_LONG: self._on_command_long,
            MSG_COMMAND_INT: self._on_command_int,
            MSG_PARAM_REQUEST_LIST: self._on_param_list,
            MSG_PARAM_REQUEST_READ: self._on_param_read,
            MSG_PARAM_SET: self._on_param_set,
            MSG_MISSION_REQUEST_LIST: self._on_mission_list,
            MSG_MISSION_REQUEST: self._on_mission_request,
            MSG_MISSION_REQUEST_INT: self._on_mission_request,
            MSG_MISSION_COUNT: self._on_mission_count,
            MSG_MISSION_ITEM: self._on_mission_item,
            MSG_MISSION_ITEM_INT: self._on_mission_item,
            MSG_MISSION_CLEAR_ALL: self._on_mission_clear,
            MSG_MISSION_SET_CURRENT: self._on_mission_set_current,
        }
        self.commands: dict[int, Command] = {
            224: lambda p, _f: ACCEPTED if self._set_current(whole(p[0])) else DENIED,
            410: lambda p, f: self._request(242, f),  # GET_HOME_POSITION
            510: self._get_interval,
            511: self._set_interval,
            512: lambda p, f: self._request(whole(p[0]), f),
            519: lambda p, f: self._request(300, f),
            520: lambda p, f: self._request(148, f),
        }

    # -- sending ------------------------------------------------------------------------------------------------

    def send(self, name: str, **fields: Any) -> None:
        """Sends one message; what MAVLink 1 cannot carry is left out there, as the firmwares do."""
        if self.encoder.version == 2 or message_id(name) <= V1_LAST_ID:
            self.body.emit(self.encoder.encode(name, **fields))

    def text(self, severity: int, message: str) -> None:
        """Sends a STATUSTEXT, in chunks of 50 bytes when it is longer."""
        data = message.encode()
        if len(data) <= _TEXT_BYTES:
            self.send("STATUSTEXT", severity=severity, text=data)
            return
        self._text_id = self._text_id % 0xFFFF + 1
        for chunk, start in enumerate(range(0, len(data), _TEXT_BYTES)):
            piece = data[start : start + _TEXT_BYTES]
            self.send("STATUSTEXT", severity=severity, text=piece, id=self._text_id, chunk_seq=chunk)

    def ack(self, command: int, result: int, to: Frame) -> None:
        """Acknowledges a command to whoever sent it."""
        self.send(
            "COMMAND_ACK",
            command=command,
            result=result,
            progress=255 if result != IN_PROGRESS else 0,
            target_system=to.sysid,
            target_component=to.compid,
        )

    # -- receiving ----------------------------------------------------------------------------------------------

    def receive(self, frame: Frame) -> None:
        """Handles one frame of a ground station or companion; unknown types are ignored."""
        handler = self.messages.get(frame.msgid)
        if handler is None or frame.sysid == self.sysid:
            return
        if self.ignore_commands and frame.msgid in (MSG_SET_MODE, MSG_MISSION_SET_CURRENT):  # commands in all but name
            return
        if frame.version == 2 and self.config.mavlink_version == 0:
            self.encoder.version = 2
        fields = unpack(frame)
        if fields is not None and self._addressed(fields, frame):
            handler(fields, frame)

    def _addressed(self, fields: Fields, frame: Frame) -> bool:
        """Whether a message is for this vehicle: its own address or a broadcast."""
        if frame.msgid == MSG_PING:
            return True
        system = fields.get("target_system", 0)
        component = fields.get("target_component", 0)
        return system in (0, self.sysid) and component in (0, self.compid)

    def _on_heartbeat(self, fields: Fields, _frame: Frame) -> None:
        if fields["type"] == _TYPE_GCS:
            self.gcs_heard_ns = self.body.now_ns

    def _on_ping(self, fields: Fields, frame: Frame) -> None:
        if fields["target_system"] == 0 and fields["target_component"] == 0:
            self.send(
                "PING",
                time_usec=fields["time_usec"],
                seq=fields["seq"],
                target_system=frame.sysid,
                target_component=frame.compid,
            )

    def _on_timesync(self, fields: Fields, _frame: Frame) -> None:
        if fields["tc1"] == 0:
            self.send("TIMESYNC", tc1=self.body.own_time_ns, ts1=fields["ts1"])

    def _on_setup_signing(self, fields: Fields, _frame: Frame) -> None:
        """Takes a key, or gives its own up for one of zeros; not while armed, as ArduPilot."""
        if not self.armed:
            key = bytes(fields["secret_key"])
            self.body.signing.set_key(key if any(key) else None)

    # -- commands -----------------------------------------------------------------------------------------------

    def _on_command_long(self, fields: Fields, frame: Frame) -> None:
        if fields["target_system"] == 0 and not self.commands_to_system_0:
            return
        self._command(int(fields["command"]), tuple(fields[f"param{k}"] for k in range(1, 8)), frame)

    def _on_command_int(self, fields: Fields, frame: Frame) -> None:
        if fields["target_system"] == 0 and not self.commands_to_system_0:
            return
        local = fields["frame"] in (1, 7, 8, 9)
        scale = 1e-4 if local else 1e-7
        none = -0x80000000
        x, y = (float("nan") if fields[k] in (none, 0x7FFFFFFF) else fields[k] * scale for k in ("x", "y"))
        params = (*(fields[f"param{k}"] for k in range(1, 5)), x, y, fields["z"])
        self._command(int(fields["command"]), params, frame)

    def _command(self, command: int, params: tuple[float, ...], frame: Frame) -> None:
        if self.ignore_commands:
            return
        handler = self.commands.get(command)
        result = UNSUPPORTED if handler is None else handler(params, frame)
        if result is not None:
            self.ack(command, result, frame)

    def _set_interval(self, params: tuple[float, ...], _frame: Frame) -> int:
        if whole(params[2]) or whole(params[3]):
            return FAILED
        name = message_name(whole(params[0])) or ""
        interval_us = min(whole(params[1]), 10**12)
        if interval_us == 0:  # the default rate
            rate = self.rates_hz.get(name, 0.0)
            interval_ns = round(1e9 / rate) if rate else 0
        else:
            interval_ns = max(interval_us, 0) * 1000
        return ACCEPTED if self.body.set_interval(name, interval_ns) else DENIED

    def _get_interval(self, params: tuple[float, ...], _frame: Frame) -> int:
        name = message_name(whole(params[0])) or ""
        interval = self.body.interval(name)
        interval_us = 0 if interval is None else (interval // 1000 or -1)
        self.send("MESSAGE_INTERVAL", message_id=whole(params[0]) & 0xFFFF, interval_us=interval_us)
        return ACCEPTED

    def _request(self, msgid: int, _frame: Frame) -> int:
        """Sends one message on request."""
        name = message_name(msgid) or ""
        if name == "AUTOPILOT_VERSION":
            self.send(name, uid=0x5117000000000000 + self.sysid, **self.version_fields)
        elif name == "PROTOCOL_VERSION":
            self.send(name, version=200, min_version=100, max_version=200)
        elif self.body.can_stream(name):
            return ACCEPTED if self.body.send_now(name) else DENIED
        else:
            return DENIED
        return ACCEPTED

    # -- parameters ---------------------------------------------------------------------------------------------

    def send_queued_params(self) -> None:
        """Sends the next parameters of a list that was asked for."""
        for position in self._param_queue[:_PARAMS_PER_TICK]:
            self._send_param(position)
        del self._param_queue[:_PARAMS_PER_TICK]

    @property
    def params_waiting(self) -> bool:
        """Whether a parameter list is being sent."""
        return bool(self._param_queue)

    def _send_param(self, position: int) -> None:
        params = self.params
        name, value, kind = params.at(position)
        if self.param_bytewise and params.is_integer(kind):
            value = struct.unpack("<f", struct.pack("<i", int(value)))[0]
        self.send(
            "PARAM_VALUE",
            param_id=name.encode(),
            param_value=value,
            param_type=kind,
            param_count=len(params),
            param_index=position,
        )

    def _on_param_list(self, _fields: Fields, _frame: Frame) -> None:
        self._param_queue = list(range(len(self.params)))

    def _on_param_read(self, fields: Fields, _frame: Frame) -> None:
        position: int | None = fields["param_index"]
        if position == -1:
            position = self.params.position(fields["param_id"].decode(errors="replace"))
        if position is not None and 0 <= position < len(self.params):
            self._send_param(position)

    def _on_param_set(self, fields: Fields, _frame: Frame) -> None:
        name = fields["param_id"].decode(errors="replace")
        position = self.params.position(name)
        if position is None:
            self.unknown_param(name)
            return
        value: float = fields["param_value"]
        _, _, kind = self.params.at(position)
        if self.param_bytewise and self.params.is_integer(kind):
            value = struct.unpack("<i", struct.pack("<f", value))[0]
        # sent bytewise, a value of another type means another number: it is refused and the old one told
        refused = self.param_bytewise and fields["param_type"] != kind
        if not refused and self.params.set_value(name, value):
            self.param_changed(name)
        self._send_param(position)

    def unknown_param(self, name: str) -> None:
        """Reacts to a parameter that does not exist: silence unless overridden."""

    def param_changed(self, name: str) -> None:
        """Reacts to a changed parameter."""

    # -- missions -----------------------------------------------------------------------------------------------

    def _mission_ack(self, result: int, kind: int, frame: Frame) -> None:
        self.send(
            "MISSION_ACK",
            target_system=frame.sysid,
            target_component=frame.compid,
            type=result,
            mission_type=kind,
        )

    def _on_mission_list(self, fields: Fields, frame: Frame) -> None:
        kind = fields.get("mission_type", 0)
        count = len(self.mission) if kind == 0 else 0  # fences and rally points are not stored
        self.send(
            "MISSION_COUNT",
            target_system=frame.sysid,
            target_component=frame.compid,
            count=count,
            mission_type=kind,
        )

    def _on_mission_request(self, fields: Fields, frame: Frame) -> None:
        seq, kind = fields["seq"], fields.get("mission_type", 0)
        if kind != _FLIGHT or seq >= len(self.mission):
            self._mission_ack(MISSION_BAD_SEQUENCE, kind, frame)
            return
        item = {k: v for k, v in self.mission[seq].items() if not k.startswith("target_")}
        name = "MISSION_ITEM_INT"
        if frame.msgid == MSG_MISSION_REQUEST:
            name = "MISSION_ITEM"
            scale = 1e-7 if item["frame"] not in (1, 2) else 1e-4
            item["x"], item["y"] = item["x"] * scale, item["y"] * scale
        self.send(name, target_system=frame.sysid, target_component=frame.compid, **item)

    def _on_mission_count(self, fields: Fields, frame: Frame) -> None:
        kind = fields.get("mission_type", 0)
        if kind != _FLIGHT:
            self._mission_ack(MISSION_UNSUPPORTED, kind, frame)
            return
        if fields["count"] == 0:
            self.mission = []
            self.mission_changed()
            self._mission_ack(MISSION_ACCEPTED, kind, frame)
            return
        self._upload = {"count": fields["count"], "items": [], "kind": kind}
        self._ask_item(frame)

    def _ask_item(self, frame: Frame) -> None:
        upload = self._upload
        if upload is not None:
            upload["asked_ns"], upload["from"] = self.body.now_ns, frame
            self.send(
                "MISSION_REQUEST_INT",
                target_system=frame.sysid,
                target_component=frame.compid,
                seq=len(upload["items"]),
                mission_type=upload["kind"],
            )

    def _on_mission_item(self, fields: Fields, frame: Frame) -> None:
        upload = self._upload
        kind = fields.get("mission_type", 0)
        if upload is None or kind != upload["kind"]:
            return
        if fields["seq"] == len(upload["items"]):
            item = dict(fields)
            if frame.msgid == MSG_MISSION_ITEM:
                scale = 1e7 if item["frame"] not in (1, 2) else 1e4
                for axis, refusal in (("x", MISSION_BAD_X), ("y", MISSION_BAD_Y)):
                    # NaN fails the comparison too; what is stored has to fit MISSION_ITEM_INT
                    if not abs(item[axis] * scale) <= 0x7FFFFFFF:
                        self._upload = None
                        self._mission_ack(refusal, kind, frame)
                        return
                    item[axis] = round(item[axis] * scale)
            upload["items"].append(item)
        if len(upload["items"]) == upload["count"]:
            self.mission = upload["items"]
            self.mission_changed()
            self._upload = None
            self._mission_ack(MISSION_ACCEPTED, kind, frame)
        else:
            self._ask_item(frame)

    def ask_again(self) -> None:
        """Repeats the request for a mission item that has not come; gives an upload up after a while."""
        upload = self._upload
        if upload is None or self.body.now_ns - upload["asked_ns"] < _ITEM_PATIENCE_NS:
            return
        upload["tries"] = 0 if len(upload["items"]) != upload.get("stuck_at") else upload["tries"] + 1
        upload["stuck_at"] = len(upload["items"])
        if upload["tries"] >= _ITEM_TRIES:
            self._upload = None
            return
        self._ask_item(upload["from"])

    def _on_mission_clear(self, fields: Fields, frame: Frame) -> None:
        kind = fields.get("mission_type", 0)
        if kind not in (_FLIGHT, _ALL_KINDS):
            self._mission_ack(MISSION_UNSUPPORTED, kind, frame)
            return
        self.mission = []
        self.mission_changed()
        self._mission_ack(MISSION_ACCEPTED, kind, frame)

    def _set_current(self, seq: int) -> bool:
        """Goes on with another item of the mission. Returns whether there is such an item."""
        if not 0 <= seq < len(self.mission):
            return False
        self.mission_seq = seq
        self.send("MISSION_CURRENT", seq=seq, total=len(self.mission))
        return True

    def _on_mission_set_current(self, fields: Fields, _frame: Frame) -> None:
        self._set_current(fields["seq"])

    def mission_changed(self) -> None:
        """Reacts to a new mission: it starts at its beginning."""
        self.mission_seq = 0
