"""The gateway inside a dry run: emulated Crazyflies on virtual time, no sockets, no threads, no cflib.

Speaks the few packets that a flight needs, in bytes, to an emulator that a stock client flies as well; names and
numbers of log variables and parameters it takes from the emulator's own tables, as a client with a cache would.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping

from groundstation.gateway.bridge import Bridge
from groundstation.gateway.measured import POSE_VARIABLES, STATUS_MS, STATUS_VARIABLES
from groundstation.gateway.names import short_names
from groundstation.gateway.orders import (
    VALID_MS,
    Arm,
    EmergencyStop,
    ExternalPose,
    GoTo,
    HighLevelStop,
    LandAt,
    Order,
    SetParam,
    SetpointsStop,
    TakeOff,
    Velocity,
)
from sitl.params import ParamSet
from sitl.personalities.crazyflie.variables import SHAPES, VARIABLES
from sitl.world import Outgoing, World

BEHIND_A_GATEWAY = frozenset({"crazyflie"})
"""Personalities that speak no MAVLink."""
_PARAM, _LOG, _LOCALISATION, _GENERIC, _HIGH_LEVEL, _SUPERVISOR = 2, 5, 6, 7, 8, 9
_POSE = 8
_VELOCITY, _STOP, _TAKE_OFF, _LAND, _GO_TO = 8, 3, 7, 8, 12
_LOG_RESET, _LOG_CREATE, _LOG_START = 5, 6, 3
_POSE_BLOCK, _STATUS_BLOCK = 0, 1
_SLICE_NS = 20_000_000
_ASK_AGAIN_NS = 1_000_000_000
_PROTOCOL = 12
_SHAPE_OF_KIND = {1: "<B", 2: "<b", 3: "<H", 5: "<I", 9: "<f"}  # MAV_PARAM_TYPE
_NAMES = list(VARIABLES)


def own_params(settings: Mapping[str, float], params: ParamSet) -> tuple[tuple[str, float], ...]:
    """Of settings by their short names, those that are the vehicle's and not the gateway's, by their full names."""
    full = short_names(params.at(k)[0] for k in range(len(params)))
    return tuple((full[name], value) for name, value in settings.items() if name in full)


def packet(port: int, channel: int, data: bytes) -> bytes:
    """One CRTP packet."""
    return bytes((port << 4 | 0xC | channel,)) + data


def packet_of(order: Order, numbers: Mapping[str, tuple[int, int]]) -> bytes | None:
    """An order as a packet; None for a parameter that there is not, or a value that it does not hold.

    Args:
        order: to be sent.
        numbers: of parameters: full name: number and MAV_PARAM_TYPE.
    """
    match order:
        case Velocity((x, y, z), rate):
            return packet(_GENERIC, 0, struct.pack("<Bffff", _VELOCITY, x, y, z, rate * 57.29577951308232))
        case SetpointsStop():
            return packet(_GENERIC, 1, struct.pack("<BI", 0, VALID_MS))
        case TakeOff(height_m, duration_s):
            return packet(_HIGH_LEVEL, 0, struct.pack("<BBff?f", _TAKE_OFF, 0, height_m, 0.0, True, duration_s))
        case LandAt(height_m, duration_s):
            return packet(_HIGH_LEVEL, 0, struct.pack("<BBff?f", _LAND, 0, height_m, 0.0, True, duration_s))
        case GoTo((x, y, z), relative, yaw, duration_s):
            turn = 0.0 if relative else yaw
            head = struct.pack("<BB??", _GO_TO, 0, relative, False)
            return packet(_HIGH_LEVEL, 0, head + struct.pack("<fffff", x, y, z, turn, duration_s))
        case HighLevelStop():
            return packet(_HIGH_LEVEL, 0, struct.pack("<BB", _STOP, 0))
        case Arm(arm):
            return packet(_SUPERVISOR, 1, struct.pack("<B?", 1, arm))
        case EmergencyStop():
            return packet(_SUPERVISOR, 1, b"\x03")
        case ExternalPose(place, quat):
            if quat is None:
                return packet(_LOCALISATION, 0, struct.pack("<fff", *place))
            return packet(_LOCALISATION, 1, struct.pack("<Bfffffff", _POSE, *place, *quat))
        case SetParam(name, value):
            if name not in numbers:
                return None
            number, kind = numbers[name]
            try:
                held = value if kind == 9 else round(value)
                return packet(_PARAM, 2, struct.pack("<H", number) + struct.pack(_SHAPE_OF_KIND[kind], held))
            except (struct.error, ValueError, OverflowError):
                return None


class _Client:
    """One emulated vehicle and its bridge."""

    def __init__(self, sysid: int, params: ParamSet, pose_hz: float) -> None:
        self.bridge = Bridge(sysid, 0)
        rows = [params.at(k) for k in range(len(params))]
        self._numbers = {name: (k, kind) for k, (name, _, kind) in enumerate(rows)}
        self._by_number = [(name, kind) for name, _, kind in rows]
        self._values: dict[str, tuple[float, int]] = {}
        self._period = max(1, round(100.0 / pose_hz))
        self._heard_ns = self._asked_ns = -_ASK_AGAIN_NS
        self._connected = False

    def greetings(self, now_ns: int) -> list[bytes]:
        """Packets that make it log, and tell its parameters; asked for again as long as it is silent."""
        if now_ns - max(self._heard_ns, self._asked_ns) < _ASK_AGAIN_NS:
            return []
        self._asked_ns = now_ns
        wanted = [packet(_LOG, 1, bytes((_LOG_RESET,)))]
        for block, period, names in (
            (_POSE_BLOCK, self._period, POSE_VARIABLES),
            (_STATUS_BLOCK, STATUS_MS // 10, STATUS_VARIABLES),
        ):
            entries = b"".join(struct.pack("<BH", VARIABLES[name][0], _NAMES.index(name)) for name in names)
            head, rest = entries[:24], entries[24:]
            wanted.append(packet(_LOG, 1, bytes((_LOG_CREATE, block)) + head))
            if rest:
                wanted.append(packet(_LOG, 1, bytes((_LOG_CREATE + 1, block)) + rest))
            wanted.append(packet(_LOG, 1, bytes((_LOG_START, block, period))))
        if not self._connected:
            wanted += [packet(_PARAM, 1, struct.pack("<H", k)) for k in range(len(self._by_number))]
        return wanted

    def take(self, data: bytes, now_ns: int) -> None:
        """Takes a packet of the vehicle."""
        port, channel, rest = data[0] >> 4, data[0] & 3, data[1:]
        if port == _LOG and channel == 2 and len(rest) >= 4:
            names = POSE_VARIABLES if rest[0] == _POSE_BLOCK else STATUS_VARIABLES
            shape = "<" + "".join(SHAPES[VARIABLES[name][0]] for name in names)
            if len(rest) - 4 == struct.calcsize(shape):
                values = dict(zip(names, struct.unpack_from(shape, rest, 4), strict=True))
                self._heard_ns = now_ns
                self.bridge.logged(values, int.from_bytes(rest[1:4], "little"), now_ns)
        elif port == _PARAM and channel in (1, 2) and len(rest) > 2:
            self._param(rest, skip=3 if channel == 1 else 2)

    def _param(self, rest: bytes, skip: int) -> None:
        number = int.from_bytes(rest[:2], "little")
        if number >= len(self._by_number):
            return
        name, kind = self._by_number[number]
        shape = _SHAPE_OF_KIND[kind]
        if len(rest) - skip != struct.calcsize(shape):
            return
        value = float(struct.unpack_from(shape, rest, skip)[0])
        self._values[name] = (value, kind)
        if self._connected:
            self.bridge.param_told(name, value)
        elif len(self._values) == len(self._by_number):
            self._connected = True
            self.bridge.connected(_PROTOCOL, self._values)

    def packets(self) -> list[bytes]:
        """Orders that wait, as packets."""
        made = (packet_of(order, self._numbers) for order in self.bridge.take_orders())
        return [data for data in made if data is not None]


class GatewayWorld:
    """A world whose Crazyflies stand behind a gateway; all others speak for themselves.

    Args:
        world: the emulator.
        pose_hz: poses a second that are logged.
    """

    def __init__(self, world: World, pose_hz: float = 50.0) -> None:
        self._world = world
        self._clients = {
            number: _Client(vehicle.sysid, world.autopilots[number].params, pose_hz)
            for number, vehicle in enumerate(world.config.vehicles)
            if vehicle.autopilot in BEHIND_A_GATEWAY
        }
        self._now_ns = world.now_ns

    @property
    def bridges(self) -> dict[int, Bridge]:
        """By number of the vehicle."""
        return {number: client.bridge for number, client in self._clients.items()}

    def advance(self, now_ns: int) -> list[Outgoing]:
        """Moves everything to a time; returns what reached the ground station on the way, as MAVLink."""
        if not self._clients:
            return self._world.advance(now_ns)
        told: list[Outgoing] = []
        while self._now_ns < now_ns:
            self._now_ns = min(self._now_ns + _SLICE_NS, now_ns)
            for item in self._world.advance(self._now_ns):
                client = self._clients.get(item.vehicle_index)
                if client is None:
                    told.append(item)
                    continue
                client.take(item.data, item.t_ns)
                told += self._frames(item.vehicle_index, client, item.t_ns)
            for number, client in self._clients.items():
                client.bridge.tick(self._now_ns)
                told += self._frames(number, client, self._now_ns)
                self._send(number, [*client.greetings(self._now_ns), *client.packets()], self._now_ns)
        return sorted(told, key=lambda item: item.t_ns)

    def receive(self, vehicle_index: int, data: bytes, now_ns: int) -> None:
        """Hands in what the ground station sent to a vehicle."""
        client = self._clients.get(vehicle_index)
        if client is None:
            self._world.receive(vehicle_index, data, now_ns)
            return
        client.bridge.receive(data, now_ns)
        self._send(vehicle_index, client.packets(), now_ns)

    def _frames(self, number: int, client: _Client, t_ns: int) -> list[Outgoing]:
        return [Outgoing(t_ns, number, frame) for frame in client.bridge.take_frames()]

    def _send(self, number: int, packets: list[bytes], now_ns: int) -> None:
        for data in packets:
            self._world.receive(number, data, now_ns)
