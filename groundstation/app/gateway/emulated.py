"""The gateway inside a dry run: emulated Crazyflies on virtual time, no sockets, no threads, no cflib.

Speaks the few packets that a flight needs, in bytes, to an emulator that a stock client flies as well; names and
numbers of log variables and parameters it takes from the emulator's own tables, as a client with a cache would.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from groundstation.gateway.bridge import Bridge
from groundstation.gateway.handover import Handover
from groundstation.gateway.measured import POSE_VARIABLES, STATUS_MS, STATUS_VARIABLES
from groundstation.gateway.names import short_names
from groundstation.gateway.orders import LogRate
from groundstation.gateway.outbox import Outbox
from groundstation.gateway.packets import (
    ANSWER_BYTES,
    HIGH_LEVEL,
    LINK,
    LOG,
    PARAM,
    SHAPE_OF_KIND,
    echo_number,
    packed_poses,
    packet,
    packet_of,
)
from sitl.params import ParamSet
from sitl.personalities.crazyflie.radio import SharedRadio
from sitl.personalities.crazyflie.variables import SHAPES, VARIABLES
from sitl.world import Outgoing, World

BEHIND_A_GATEWAY = frozenset({"crazyflie"})
"""Personalities that speak no MAVLink."""
_LOG_RESET, _LOG_CREATE, _LOG_START = 5, 6, 3
_POSE_BLOCK, _STATUS_BLOCK = 0, 1
_SLICE_NS = 20_000_000
_ASK_AGAIN_NS = 1_000_000_000
_PROTOCOL = 12
_NAMES = list(VARIABLES)
_LOGGED = [
    (names, struct.Struct("<" + "".join(SHAPES[VARIABLES[name][0]] for name in names)))
    for names in (STATUS_VARIABLES, POSE_VARIABLES)
]


def own_params(settings: Mapping[str, float], params: ParamSet) -> tuple[tuple[str, float], ...]:
    """Of settings by their short names, those that are the vehicle's and not the gateway's, by their full names."""
    full = short_names(params.at(k)[0] for k in range(len(params)))
    return tuple((full[name], value) for name, value in settings.items() if name in full)


@dataclass(frozen=True)
class RadioConfig:
    """Radios of an emulated gateway.

    Attributes:
        of: number of the radio of each vehicle, by the vehicle's number.
        packets_s: transactions a second that one makes.
        broadcast: poses from outside go to several vehicles in one packet.
        seed: of losses.
    """

    of: Mapping[int, int]
    packets_s: float = 919.0
    broadcast: bool = False
    seed: int = 0


class _Client:
    """One emulated vehicle and its bridge."""

    def __init__(self, sysid: int, params: ParamSet, pose_hz: float, now_ns: int = 0) -> None:
        self.bridge = Bridge(sysid, now_ns, pose_hz, boot_ns=0)
        self.outbox = Outbox()
        rows = [params.at(k) for k in range(len(params))]
        self._numbers = {name: (k, kind) for k, (name, _, kind) in enumerate(rows)}
        self._by_number = [(name, kind) for name, _, kind in rows]
        self._values: dict[str, tuple[float, int]] = {}
        self._period = max(1, round(100.0 / pose_hz))
        self._heard_ns = self._asked_ns = -_ASK_AGAIN_NS
        self._connected = False
        self._questions: deque[bytes] = deque()

    def greet(self, now_ns: int) -> None:
        """Makes it log, and tell its parameters; asked for again as long as it is silent."""
        if now_ns - max(self._heard_ns, self._asked_ns) < _ASK_AGAIN_NS:
            return
        self._asked_ns = now_ns
        wanted = [packet(LOG, 1, bytes((_LOG_RESET,)))]
        for block, period, names in (
            (_POSE_BLOCK, self._period, POSE_VARIABLES),
            (_STATUS_BLOCK, STATUS_MS // 10, STATUS_VARIABLES),
        ):
            entries = b"".join(struct.pack("<BH", VARIABLES[name][0], _NAMES.index(name)) for name in names)
            head, rest = entries[:24], entries[24:]
            wanted.append(packet(LOG, 1, bytes((_LOG_CREATE, block)) + head))
            if rest:
                wanted.append(packet(LOG, 1, bytes((_LOG_CREATE + 1, block)) + rest))
            wanted.append(packet(LOG, 1, bytes((_LOG_START, block, period))))
        if not self._connected:
            wanted += [packet(PARAM, 1, struct.pack("<H", k)) for k in range(len(self._by_number))]
        self._questions = deque(wanted)

    def take(self, data: bytes, now_ns: int) -> None:
        """Takes a packet of the vehicle."""
        port, channel, rest = data[0] >> 4, data[0] & 3, data[1:]
        if port == LOG and channel == 2 and len(rest) >= 4:
            names, shape = _LOGGED[rest[0] == _POSE_BLOCK]
            if len(rest) - 4 == shape.size:
                values = dict(zip(names, shape.unpack_from(rest, 4), strict=True))
                self._heard_ns = now_ns
                self.bridge.logged(values, int.from_bytes(rest[1:4], "little"), now_ns)
        elif port == PARAM and channel in (1, 2) and len(rest) > 2:
            self._param(rest, skip=3 if channel == 1 else 2)
        elif port == HIGH_LEVEL and len(rest) >= ANSWER_BYTES:
            self.bridge.answered(rest[0], rest[3])
        elif port == LINK and (number := echo_number(rest)) is not None:
            self.bridge.echoed(number, now_ns)

    def _param(self, rest: bytes, skip: int) -> None:
        number = int.from_bytes(rest[:2], "little")
        if number >= len(self._by_number):
            return
        name, kind = self._by_number[number]
        shape = SHAPE_OF_KIND[kind]
        if len(rest) - skip != struct.calcsize(shape):
            return
        value = float(struct.unpack_from(shape, rest, skip)[0])
        self._values[name] = (value, kind)
        if self._connected:
            self.bridge.param_told(name, value)
        elif len(self._values) == len(self._by_number):
            self._connected = True
            self.bridge.connected(_PROTOCOL, self._values)

    def collect(self, now_ns: int) -> None:
        """Takes the bridge's orders."""
        for order in self.bridge.take_orders():
            self.outbox.put(order, now_ns)

    def next(self, now_ns: int) -> bytes | None:
        """The next packet to the vehicle: orders before questions."""
        while (order := self.outbox.take(now_ns)) is not None:
            if isinstance(order, LogRate):
                return packet(LOG, 1, bytes((_LOG_START, _POSE_BLOCK, max(1, round(100.0 / order.hz)))))
            data = packet_of(order, self._numbers)
            if data is not None:
                return data
        return self._questions.popleft() if self._questions else None


class GatewayWorld:
    """A world whose Crazyflies stand behind a gateway; all others speak for themselves.

    Args:
        world: the emulator.
        pose_hz: poses a second that are logged.
        radio: how they are reached; None for links that carry everything at once.

    Attributes:
        radios: by number.
    """

    def __init__(self, world: World, pose_hz: float = 50.0, radio: RadioConfig | None = None) -> None:
        self._world, self._pose_hz = world, pose_hz
        self._broadcast = radio is not None and radio.broadcast
        self._clients = {
            number: self._client(number, 0)
            for number, vehicle in enumerate(world.config.vehicles)
            if vehicle.autopilot in BEHIND_A_GATEWAY
        }
        self._now_ns = world.now_ns
        self._dead = False
        self.radios: dict[int, SharedRadio] = {}
        if radio is not None:
            for number in sorted(set(radio.of.values())):
                served = [vehicle for vehicle in self._clients if radio.of[vehicle] == number]
                rng = np.random.default_rng((radio.seed, number, 0x7261))
                self.radios[number] = SharedRadio(served, radio.packets_s, rng)
        self._radio_of = {vehicle: item for item in self.radios.values() for vehicle in item.vehicles}

    def _client(self, number: int, now_ns: int) -> _Client:
        sysid = self._world.config.vehicles[number].sysid
        return _Client(sysid, self._world.autopilots[number].params, self._pose_hz, now_ns)

    @property
    def bridges(self) -> dict[int, Bridge]:
        """By number of the vehicle."""
        return {number: client.bridge for number, client in self._clients.items()}

    def kill(self) -> None:
        """The gateway dies: what it knew is gone, nothing is sent any more either way."""
        self._dead = True
        for item in self.radios.values():
            item.forget()

    def begin_anew(self, handover: Mapping[int, Handover]) -> None:
        """Another gateway begins.

        Args:
            handover: what it is told of each vehicle, by system id; those that fly are told to stay.
        """
        self._dead = False
        self._clients = {number: self._client(number, self._now_ns) for number in self._clients}
        for client in self._clients.values():
            told = handover.get(client.bridge.sysid, Handover())
            if told.flies:
                client.bridge.resume(told.home_enu_m, told.settings, self._now_ns)
        self._send_all()

    def advance(self, now_ns: int) -> list[Outgoing]:
        """Moves everything to a time; returns what reached the ground station on the way, as MAVLink."""
        if not self._clients:
            return self._world.advance(now_ns)
        told: list[Outgoing] = []
        while self._now_ns < now_ns:
            self._now_ns = min(self._now_ns + _SLICE_NS, now_ns)
            told += self._carried()
            for item in self._world.advance(self._now_ns):
                if item.vehicle_index not in self._clients:
                    told.append(item)
                elif item.vehicle_index in self._radio_of:
                    self._radio_of[item.vehicle_index].says(item.vehicle_index, item.data, item.t_ns)
                else:
                    told += self._heard(item.vehicle_index, item.data, item.t_ns)
            if self._dead:
                continue
            for number, client in self._clients.items():
                client.bridge.tick(self._now_ns)
                told += self._frames(number, client, self._now_ns)
                client.greet(self._now_ns)
            self._send_all()
        return sorted(told, key=lambda item: item.t_ns)

    def receive(self, vehicle_index: int, data: bytes, now_ns: int) -> None:
        """Hands in what the ground station sent to a vehicle."""
        client = self._clients.get(vehicle_index)
        if client is None:
            self._world.receive(vehicle_index, data, now_ns)
        elif not self._dead:
            client.bridge.receive(data, now_ns)
            self._send_all()

    def _heard(self, number: int, data: bytes, t_ns: int) -> list[Outgoing]:
        if self._dead:
            return []
        client = self._clients[number]
        client.take(data, t_ns)
        return self._frames(number, client, t_ns)

    def _frames(self, number: int, client: _Client, t_ns: int) -> list[Outgoing]:
        return [Outgoing(t_ns, number, frame) for frame in client.bridge.take_frames()]

    def _carried(self) -> list[Outgoing]:
        """Lets the radios do what they have time for; returns what reached the ground station."""
        told: list[Outgoing] = []
        for radio in self.radios.values():
            for item in radio.run(self._now_ns, self._next):
                if item.up:
                    self._world.receive(item.vehicle, item.data, item.t_ns)
                else:
                    told += self._heard(item.vehicle, item.data, item.t_ns)
        return told

    def _next(self, number: int, now_ns: int) -> bytes | None:
        return None if self._dead else self._clients[number].next(now_ns)

    def _send_all(self) -> None:
        """Takes what the bridges want sent: a radio asks for it when it has time, other links take it at once."""
        if self._broadcast:
            self._send_together()
        for number, client in self._clients.items():
            client.collect(self._now_ns)
            while number not in self._radio_of and (data := client.next(self._now_ns)) is not None:
                self._world.receive(number, data, self._now_ns)

    def _send_together(self) -> None:
        """Poses from outside, several to a packet, for all behind one radio."""
        for radio in self.radios.values():
            poses = {
                self._world.config.vehicles[number].sysid: pose
                for number in radio.vehicles
                if (pose := self._clients[number].bridge.take_external_pose()) is not None
            }
            for data in packed_poses(poses):
                radio.broadcast(data)
