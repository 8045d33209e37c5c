"""Parameters of n vehicles: asked for by name, set, read back, sans-IO.

PARAM_REQUEST_READ and PARAM_SET are not acknowledged but by the PARAM_VALUE that they ask for; silence is met with the
same question again. Firmware says nothing to a name that it does not know, so silence ends in "unknown" after as many
tries as the losses on this vehicle's link ask for. Questions are paced to what the link has left. Refuses to know what
a parameter means, and how an autopilot packs integers into the float that they travel in: values are kept as they came.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from enum import Enum

REAL32 = 9  # MAV_PARAM_TYPE
_INTEGERS = {1: "B", 2: "b", 3: "H", 4: "h", 5: "I", 6: "i"}
_REPEAT_NS = 500_000_000
_TRIES_MIN, _TRIES_MAX = 4, 12
_SAME_TWICE = 1e-4  # how likely a name that is there may be taken for one that is not
_LOSS_MIN, _LOSS_MAX = 0.1, 0.5
_AT_ONCE = 8  # questions under way to one vehicle
_NAME_BYTES = 16
_OTHERS = 2  # answers with another value than the one set, after which it counts as refused


class ParamState(Enum):
    """What is known of one parameter."""

    ASKED = "asked"
    KNOWN = "known"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class ParamValue:
    """A PARAM_VALUE: ``bits`` are the 32 bits of its float, ``kind`` is its MAV_PARAM_TYPE."""

    vehicle: int
    name: str
    bits: int
    kind: int
    t_rx_ns: int


@dataclass(frozen=True)
class ParamQuestion:
    """A frame to be sent now: PARAM_REQUEST_READ where ``bits`` is None, else PARAM_SET."""

    vehicle: int
    name: str
    bits: int | None = None
    kind: int = REAL32

    @property
    def as_float(self) -> float:
        """The float that has these bits."""
        value: float = struct.unpack("<f", struct.pack("<I", self.bits or 0))[0]
        return value


@dataclass
class _Entry:
    state: ParamState = ParamState.ASKED
    value: ParamValue | None = None
    write: tuple[int, int] | None = None
    tries: int = 0
    next_ns: int = 0
    others: int = 0


def value_of_bits(bits: int, kind: int, *, bytewise: bool) -> float:
    """What 32 bits of a PARAM_VALUE mean.

    Args:
        bits: of the float.
        kind: MAV_PARAM_TYPE.
        bytewise: integers lie in the float's bytes (PX4); else they were cast to it (ArduPilot).
    """
    code = _INTEGERS.get(kind) if bytewise else None
    value: float = struct.unpack_from(f"<{code or 'f'}", struct.pack("<I", bits))[0]
    return float(value)


def bits_of_value(value: float, kind: int, *, bytewise: bool) -> int:
    """The reverse of ``value_of_bits``.

    Raises:
        ValueError: the type does not hold the value.
    """
    code = _INTEGERS.get(kind)
    try:
        if code is not None:
            packed = struct.pack(f"<{code}", round(value))
            if not bytewise:
                packed = struct.pack("<f", float(round(value)))
        else:
            packed = struct.pack("<f", value)
    except (struct.error, OverflowError) as error:
        raise ValueError(f"{value:g} does not fit a parameter of type {kind}") from error
    return int.from_bytes(packed.ljust(4, b"\0"), "little")


class ParamDesk:
    """What is asked of the parameters of n vehicles, and what was answered.

    Args:
        n: number of vehicles.

    Attributes:
        changes: how often what is known of each vehicle's has changed.
    """

    def __init__(self, n: int) -> None:
        self._entries: list[dict[str, _Entry]] = [{} for _ in range(n)]
        self._spacing_ns = [0] * n
        self._repeat_ns = [_REPEAT_NS] * n
        self._next_ns = [0] * n
        self._sent = [0] * n
        self._answered = [0] * n
        self.changes = [0] * n
        self._settled = [False] * n  # nothing is asked for, and nothing has changed since that was seen

    def pace(self, vehicle: int, *, spacing_ns: int, delay_ns: int = 0) -> None:
        """Says how far apart questions to a vehicle are to be, and how much longer than usual an answer takes."""
        self._spacing_ns[vehicle] = spacing_ns
        self._repeat_ns[vehicle] = max(_REPEAT_NS, spacing_ns) + delay_ns

    def read(self, vehicle: int, name: str) -> None:
        """Asks for a parameter, unless it was asked for already.

        Raises:
            ValueError: the name is longer than MAVLink carries.
        """
        if len(name.encode()) > _NAME_BYTES:
            raise ValueError(f"parameter {name}: longer than {_NAME_BYTES} bytes")
        self._entries[vehicle].setdefault(name, _Entry())
        self._changed(vehicle)

    def write(self, vehicle: int, name: str, bits: int, kind: int) -> None:
        """Sets a parameter; until the vehicle has told its value again, it counts as asked for."""
        self._entries[vehicle][name] = _Entry(write=(bits, kind), value=self.value(vehicle, name))
        self._changed(vehicle)

    def drop(self, vehicle: int, name: str) -> None:
        """Takes a question back; what is known stays."""
        entry = self._entries[vehicle].get(name)
        if entry is not None and entry.state is ParamState.ASKED:
            del self._entries[vehicle][name]
            self._changed(vehicle)

    def forget(self, vehicle: int) -> None:
        """Forgets all of a vehicle: it has started anew, or nothing may be asked of it any more."""
        self._entries[vehicle].clear()
        self._changed(vehicle)

    def state(self, vehicle: int, name: str) -> ParamState | None:
        """What is known of a parameter; None where nobody asked."""
        entry = self._entries[vehicle].get(name)
        return None if entry is None else entry.state

    def value(self, vehicle: int, name: str) -> ParamValue | None:
        """The last value told; None before."""
        entry = self._entries[vehicle].get(name)
        return None if entry is None else entry.value

    def take(self, value: ParamValue) -> None:
        """Takes a PARAM_VALUE; values of parameters that nobody asked for are left alone."""
        entry = self._entries[value.vehicle].get(value.name)
        if entry is None:
            return
        self._changed(value.vehicle)
        if entry.write is not None and entry.write[0] != value.bits:
            entry.others += 1
            if entry.others < _OTHERS:  # may be the late answer to a question from before
                return
        if entry.state is ParamState.ASKED and entry.tries:
            self._answered[value.vehicle] += 1
            self._sent[value.vehicle] += entry.tries
        entry.state, entry.value, entry.write = ParamState.KNOWN, value, None

    def due(self, now_ns: int) -> list[ParamQuestion]:
        """Says what has to be sent now."""
        questions = []
        for vehicle, entries in enumerate(self._entries):
            if self._settled[vehicle]:
                continue
            under_way = 0
            if not self._answered[vehicle] and any(e.state is ParamState.UNKNOWN for e in entries.values()):
                for entry in entries.values():  # it answers no such question at all
                    entry.state = ParamState.UNKNOWN
                self.changes[vehicle] += 1
            self._settled[vehicle] = not any(entry.state is ParamState.ASKED for entry in entries.values())
            for name, entry in entries.items():
                if entry.state is not ParamState.ASKED:
                    continue
                if entry.tries and now_ns < entry.next_ns:
                    under_way += 1
                    continue
                if entry.tries >= self._enough(vehicle):
                    entry.state, entry.write = ParamState.UNKNOWN, None
                    self.changes[vehicle] += 1
                    continue
                if under_way >= _AT_ONCE or now_ns < self._next_ns[vehicle]:
                    continue
                under_way += 1
                entry.tries += 1
                entry.next_ns = now_ns + self._repeat_ns[vehicle]
                self._next_ns[vehicle] = now_ns + self._spacing_ns[vehicle]
                bits, kind = entry.write or (None, REAL32)
                questions.append(ParamQuestion(vehicle, name, bits, kind))
        return questions

    def _changed(self, vehicle: int) -> None:
        self.changes[vehicle] += 1
        self._settled[vehicle] = False

    def _enough(self, vehicle: int) -> int:
        """Tries after which silence means that there is no such parameter."""
        if not self._answered[vehicle]:
            return _TRIES_MAX
        lost = 1.0 - self._answered[vehicle] / self._sent[vehicle]
        lost = min(max(lost, _LOSS_MIN), _LOSS_MAX)
        return min(max(math.ceil(math.log(_SAME_TWICE) / math.log(lost)), _TRIES_MIN), _TRIES_MAX)
