"""The parts of MAVLink that any autopilot answers: who is addressed, heartbeats, time, keys, commands.

``Conversation`` is one vehicle's; parameters, missions and requests have objects of their own, the flying is in
``autopilot`` and the personalities. What autopilots do differently here are attributes and small overrides.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

from groundstation.mavlink.codec import Frame
from sitl.body import Body
from sitl.config import VehicleConfig
from sitl.mavlink_ids import (
    ACCEPTED,
    DENIED,
    MSG_COMMAND_INT,
    MSG_COMMAND_LONG,
    MSG_HEARTBEAT,
    MSG_MISSION_CLEAR_ALL,
    MSG_MISSION_COUNT,
    MSG_MISSION_ITEM,
    MSG_MISSION_ITEM_INT,
    MSG_MISSION_REQUEST,
    MSG_MISSION_REQUEST_INT,
    MSG_MISSION_REQUEST_LIST,
    MSG_MISSION_SET_CURRENT,
    MSG_PARAM_REQUEST_LIST,
    MSG_PARAM_REQUEST_READ,
    MSG_PARAM_SET,
    MSG_PING,
    MSG_SET_MODE,
    MSG_SETUP_SIGNING,
    MSG_TIMESYNC,
    UNSUPPORTED,
)
from sitl.mission_store import MissionStore
from sitl.outfit import Outfit
from sitl.param_server import ParamServer
from sitl.requests import Requests
from sitl.voice import Voice
from sitl.wire import Fields, unpack, whole

Command = Callable[[tuple[float, ...], Frame], int | None]
_TYPE_GCS = 6


class Conversation:
    """One vehicle's MAVLink conversation.

    Attributes:
        body: the vehicle that it speaks for.
        armed: whether the motors may turn.
        sysid: its MAVLink system id.
        voice: says what it has to say.
        params, param_server: its parameters, and who tells and changes them.
        mission: stored mission items.
        gcs_heard_ns: last heartbeat of a ground station; None before.
        messages, commands: what is done with each that it understands, by number.
    """

    mav_autopilot = 0
    param_bytewise = True
    version_fields: ClassVar[Fields] = {}
    commands_to_system_0 = False
    accepts_unready = False

    def __init__(self, body: Body, config: VehicleConfig, outfit: Outfit) -> None:
        self.body, self.config = body, config
        self.armed = False
        self.sysid = config.sysid
        self.voice = Voice(body.link.emit, config)
        self.params = outfit.params
        self.param_server = ParamServer(self)
        self.mission = MissionStore(self.voice, body)
        self.gcs_heard_ns: int | None = None
        self.ignore_commands = False
        params, mission = self.param_server, self.mission
        requests = Requests(self, body.link, outfit.rates_hz)
        self.messages: dict[int, Callable[[Fields, Frame], None]] = {
            MSG_HEARTBEAT: self._on_heartbeat,
            MSG_PING: self._on_ping,
            MSG_TIMESYNC: self._on_timesync,
            MSG_SETUP_SIGNING: self._on_setup_signing,
            MSG_COMMAND_LONG: self._on_command_long,
            MSG_COMMAND_INT: self._on_command_int,
            MSG_PARAM_REQUEST_LIST: params.on_list,
            MSG_PARAM_REQUEST_READ: params.on_read,
            MSG_PARAM_SET: params.on_set,
            MSG_MISSION_REQUEST_LIST: mission.on_list,
            MSG_MISSION_REQUEST: mission.on_request,
            MSG_MISSION_REQUEST_INT: mission.on_request,
            MSG_MISSION_COUNT: mission.on_count,
            MSG_MISSION_ITEM: mission.on_item,
            MSG_MISSION_ITEM_INT: mission.on_item,
            MSG_MISSION_CLEAR_ALL: mission.on_clear,
            MSG_MISSION_SET_CURRENT: mission.on_set_current,
        }
        self.commands: dict[int, Command] = {
            224: lambda p, _f: ACCEPTED if mission.set_current(whole(p[0])) else DENIED,
            410: lambda _p, _f: requests.send_one(242),  # GET_HOME_POSITION
            510: requests.get_interval,
            511: requests.set_interval,
            512: lambda p, _f: requests.send_one(whole(p[0])),
            519: lambda _p, _f: requests.send_one(300),
            520: lambda _p, _f: requests.send_one(148),
        }

    # -- receiving ----------------------------------------------------------------------------------------------

    def receive(self, frame: Frame) -> None:
        """Handles one frame of a ground station or companion; unknown types are ignored."""
        handler = self.messages.get(frame.msgid)
        if handler is None or frame.sysid == self.sysid:
            return
        if self.ignore_commands and frame.msgid in (MSG_SET_MODE, MSG_MISSION_SET_CURRENT):  # commands in all but name
            return
        if frame.version == 2 and self.config.mavlink_version == 0:
            self.voice.encoder.version = 2
        fields = unpack(frame)
        if fields is not None and self._addressed(fields, frame):
            handler(fields, frame)

    def _addressed(self, fields: Fields, frame: Frame) -> bool:
        """Whether a message is for this vehicle: its own address or a broadcast."""
        if frame.msgid == MSG_PING:
            return True
        system = fields.get("target_system", 0)
        component = fields.get("target_component", 0)
        return system in (0, self.sysid) and component in (0, self.voice.compid)

    def _on_heartbeat(self, fields: Fields, _frame: Frame) -> None:
        if fields["type"] == _TYPE_GCS:
            self.gcs_heard_ns = self.body.now_ns

    def _on_ping(self, fields: Fields, frame: Frame) -> None:
        if fields["target_system"] == 0 and fields["target_component"] == 0:
            self.voice.send(
                "PING",
                time_usec=fields["time_usec"],
                seq=fields["seq"],
                target_system=frame.sysid,
                target_component=frame.compid,
            )

    def _on_timesync(self, fields: Fields, _frame: Frame) -> None:
        if fields["tc1"] == 0:
            self.voice.send("TIMESYNC", tc1=self.body.own_time_ns, ts1=fields["ts1"])

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
            self.voice.ack(command, result, frame)

    def unknown_param(self, name: str) -> None:
        """Reacts to a parameter that does not exist: silence unless overridden."""
