"""Parameters: a believable set with the firmware's names and defaults, and the port on which clients read and write it.

Defaults from the firmware's documentation of its parameter groups. Refuses to give them a meaning: whoever uses a
parameter reads it by name.
"""

from __future__ import annotations

import struct

from sitl.params import INT8, REAL32, ParamSet
from sitl.personalities.crazyflie.tables import Table

UINT8, UINT16, UINT32 = 1, 3, 5
_TABLE, _READ, _WRITE, _MISC = range(4)
_BY_NAME, _STORE, _STATE, _CLEAR, _EXTENDED, _DEFAULT = 0, 3, 4, 5, 7, 8
_NO_ENTRY = 2
_KINDS = {UINT8: (0x08, "<B"), UINT16: (0x09, "<H"), UINT32: (0x0A, "<I"), INT8: (0x00, "<b"), REAL32: (0x06, "<f")}
_READ_ONLY = 0x40
_FIXED = frozenset(
    {"cpu.flash", "firmware.revision0", "firmware.revision1", "firmware.modified", "system.selftestPassed", "imu_tests.MPU6500", "deck.bcFlow2", "deck.bcLighthouse4"}  # noqa: E501
)  # fmt: skip


def crazyflie_params(_sysid: int) -> ParamSet:
    """The set as the firmware begins with it."""
    return ParamSet(
        {
            "commander.enHighLevel": (1, UINT8),
            "cpu.flash": (1024, UINT16),
            "deck.bcFlow2": (0, UINT8),
            "deck.bcLighthouse4": (0, UINT8),
            "firmware.modified": (0, UINT8),
            "firmware.revision0": (0, UINT32),
            "firmware.revision1": (0, UINT16),
            "hlCommander.vland": (0.5, REAL32),
            "hlCommander.vtoff": (0.5, REAL32),
            "imu_tests.MPU6500": (1, UINT8),
            "kalman.resetEstimation": (0, UINT8),
            "led.bitmask": (0, UINT8),
            "locSrv.extPosStdDev": (0.01, REAL32),
            "locSrv.extQuatStdDev": (0.0045, REAL32),
            "pm.criticalLowVoltage": (3.0, REAL32),
            "pm.lowVoltage": (3.2, REAL32),
            "posCtlPid.xVelMax": (1.0, REAL32),
            "posCtlPid.yVelMax": (1.0, REAL32),
            "posCtlPid.zVelMax": (1.0, REAL32),
            "ring.effect": (0, UINT8),
            "stabilizer.controller": (1, UINT8),
            "stabilizer.estimator": (2, UINT8),
            "stabilizer.stop": (0, UINT8),
            "supervisor.landedTimeout": (3000, UINT16),
            "supervisor.prefltTimeout": (30000, UINT16),
            "supervisor.tmblChckEn": (1, UINT8),
            "system.autoArm": (1, UINT8),
            "system.selftestPassed": (1, INT8),
        }
    )


class ParamPort:
    """One vehicle's parameters as clients see them.

    Args:
        params: the values.
    """

    def __init__(self, params: ParamSet) -> None:
        self._params, self._defaults = params, crazyflie_params(0)
        self._rows = [params.at(k) for k in range(len(params))]
        self.table = Table(
            [(_KINDS[kind][0] | (_READ_ONLY if name in _FIXED else 0), name) for name, _, kind in self._rows]
        )

    def answer(self, channel: int, data: bytes) -> bytes | None:
        """The answer to a packet on the parameters' port; None to what asks for nothing."""
        if channel == _TABLE:
            return self.table.answer(data)
        if channel == _MISC:
            return self._other(data)
        if len(data) < 2:
            return None
        number = struct.unpack_from("<H", data)[0]
        if number >= len(self._rows):
            return data[:2] + bytes((_NO_ENTRY,))
        if channel == _READ:
            return data[:2] + b"\0" + self._value(number)
        self._set(number, data[2:])
        return data[:2] + self._value(number)

    def _value(self, number: int, of: ParamSet | None = None) -> bytes:
        name, _, kind = self._rows[number]
        value = (of or self._params)[name]
        shape = _KINDS[kind][1]
        return struct.pack(shape, value if kind == REAL32 else int(value))

    def _set(self, number: int, data: bytes) -> bool:
        name, _, kind = self._rows[number]
        shape = _KINDS[kind][1]
        if name in _FIXED or len(data) != struct.calcsize(shape):
            return False
        self._params.set_value(name, float(struct.unpack(shape, data)[0]))
        return True

    def _other(self, data: bytes) -> bytes | None:
        if data[:1] == bytes((_BY_NAME,)):
            group, name, rest = [*data[1:].split(b"\0", 2), b"", b""][:3]
            number = self.table.number(f"{group.decode('latin-1')}.{name.decode('latin-1')}")
            known = number is not None and self._set(number, rest[1:])
            return data[: 3 + len(group) + len(name)] + bytes((0 if known else _NO_ENTRY,))
        if len(data) < 3 or data[0] not in (_STORE, _STATE, _CLEAR, _EXTENDED, _DEFAULT):
            return None
        number = struct.unpack_from("<H", data, 1)[0]
        if data[0] == _DEFAULT and number < len(self._rows):
            return data[:3] + b"\0" + self._value(number, self._defaults)
        return data[:3] + bytes((_NO_ENTRY,))  # none of them is kept over a restart
