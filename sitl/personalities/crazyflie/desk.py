"""What a Crazyflie answers to packets, port by port.

Refuses to fly: commander and supervisor take what concerns them.
"""

from __future__ import annotations

from typing import Protocol

from sitl.battery import Battery
from sitl.body import Body
from sitl.params import ParamSet
from sitl.personalities.crazyflie.commander import Commander
from sitl.personalities.crazyflie.crtp import (
    COMMANDER,
    GENERIC,
    HIGH_LEVEL,
    LINK,
    LOCALISATION,
    LOG,
    MEMORY,
    PARAM,
    PLATFORM,
    SUPERVISOR,
    Packet,
)
from sitl.personalities.crazyflie.logs import LogPort
from sitl.personalities.crazyflie.params import ParamPort
from sitl.personalities.crazyflie.poses import Poses
from sitl.personalities.crazyflie.supervisor import Supervisor

_PROTOCOL_VERSION = 12
_ECHO, _SOURCE = 0, 1
_VERSION_CHANNEL, _GET_PROTOCOL, _GET_FIRMWARE = 1, 0, 1
_PLATFORM_ARM, _PLATFORM_RECOVER = 1, 2
_GET_STATE, _ANSWER = 0x0C, 0x80
_ARM, _RECOVER, _EMERGENCY_STOP, _WATCHDOG = 1, 2, 3, 4
_OLD_EMERGENCY_STOP, _OLD_WATCHDOG = 3, 4


class Spoken(Protocol):
    """A vehicle that is spoken to.

    Attributes:
        body, battery, params, commander, supervisor, poses: its parts.
        packets_in: how many packets it has been sent.
        ignore_commands, deny_arming: faults.
    """

    body: Body
    battery: Battery
    params: ParamSet
    supervisor: Supervisor
    poses: Poses
    packets_in: int
    commander: Commander
    ignore_commands: bool
    deny_arming: bool


class Desk:
    """One vehicle's.

    Args:
        vehicle: whose.

    Attributes:
        logs: its log blocks.
    """

    def __init__(self, vehicle: Spoken) -> None:
        self._vehicle = vehicle
        self._params, self.logs = ParamPort(vehicle.params), LogPort(vehicle)

    def answer(self, packet: Packet) -> bytes | None:
        """What one packet is answered with; None: with nothing."""
        port, channel, data = packet
        now_ns, senses = self._vehicle.body.now_ns, self._vehicle.body.senses
        if port == PARAM:
            return self._params.answer(channel, data)
        if port == LOG:
            return self.logs.answer(channel, data, now_ns)
        if port == LINK:
            return self._link(channel, data)
        if port == MEMORY:
            return bytes((1, 0)) if (channel, data[:1]) == (0, b"\x01") else None  # how many: none
        if port == LOCALISATION:
            self._localise(channel, data)
        elif port == SUPERVISOR:
            return self._supervise(channel, data)
        elif port == PLATFORM:
            return self._platform(channel, data)
        elif self._vehicle.ignore_commands:
            return None
        elif port == GENERIC:
            self._vehicle.commander.generic(channel, data, now_ns, senses.yaw_enu_rad)
        elif port == COMMANDER:
            self._vehicle.commander.thrust(data, now_ns)
        elif port == HIGH_LEVEL and data:
            error = self._vehicle.commander.high_level(data, now_ns, senses.pos_enu_m, senses.yaw_enu_rad)
            return data[:3].ljust(3, b"\0") + bytes((error,))
        return None

    def _link(self, channel: int, data: bytes) -> bytes | None:
        if channel == _ECHO:
            return data
        return b"Bitcraze Crazyflie" if channel == _SOURCE else None

    def _localise(self, channel: int, data: bytes) -> None:
        if (channel, data[:1]) == (1, bytes((_OLD_EMERGENCY_STOP,))):
            self._vehicle.supervisor.emergency_stop(self._vehicle.body.now_ns)
        elif (channel, data[:1]) == (1, bytes((_OLD_WATCHDOG,))):
            self._vehicle.supervisor.feed_watchdog(self._vehicle.body.now_ns)
        else:
            self._vehicle.poses.read(channel, data)

    def _supervise(self, channel: int, data: bytes) -> bytes | None:
        now_ns = self._vehicle.body.now_ns
        if channel == 0 and data[:1] == bytes((_GET_STATE,)):
            return bytes((_GET_STATE | _ANSWER,)) + self._vehicle.supervisor.bits().to_bytes(2, "little")
        if channel != 1 or not data or self._vehicle.ignore_commands:
            return None
        if data[0] == _ARM and len(data) > 1:
            done = self.ask_arm(bool(data[1]))
            return bytes((_ARM | _ANSWER, done, self._vehicle.supervisor.armed))
        if data[0] == _RECOVER:
            done = self._vehicle.supervisor.ask_recovery(now_ns)
            return bytes((_RECOVER | _ANSWER, done, not self._vehicle.supervisor.tumbled))
        if data[0] == _EMERGENCY_STOP:
            self._vehicle.supervisor.emergency_stop(now_ns)
        elif data[0] == _WATCHDOG:
            self._vehicle.supervisor.feed_watchdog(now_ns)
        return None

    def _platform(self, channel: int, data: bytes) -> bytes | None:
        if channel == _VERSION_CHANNEL and data[:1] == bytes((_GET_PROTOCOL,)):
            return bytes((_GET_PROTOCOL, _PROTOCOL_VERSION))
        if channel == _VERSION_CHANNEL and data[:1] == bytes((_GET_FIRMWARE,)):
            return bytes((_GET_FIRMWARE,)) + b"gs sitl\0"
        if channel != 0 or len(data) < 1 or self._vehicle.ignore_commands:
            return None
        if data[0] == _PLATFORM_ARM and len(data) > 1:
            return bytes((_PLATFORM_ARM, self.ask_arm(bool(data[1])), self._vehicle.supervisor.armed))
        if data[0] == _PLATFORM_RECOVER:
            return bytes((_PLATFORM_RECOVER, self._vehicle.supervisor.ask_recovery(self._vehicle.body.now_ns)))
        return None

    def ask_arm(self, arm: bool) -> bool:
        """Arms or disarms on request; returns whether that is so now."""
        if arm and self._vehicle.deny_arming:
            return False
        return self._vehicle.supervisor.ask_arm(arm, self._vehicle.body.now_ns)
