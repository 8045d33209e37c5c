"""The parameter protocol: lists, single values, changes."""

from __future__ import annotations

import struct
from typing import Protocol

from groundstation.mavlink.codec import Frame
from sitl.params import ParamSet
from sitl.voice import Voice
from sitl.wire import Fields

_PARAMS_PER_TICK = 20  # about 1000 a second, as PX4 was seen to send them


class Parametrised(Protocol):
    """An autopilot with parameters.

    Attributes:
        params: they may be another set after a start.
        param_bytewise: integers lie in the bytes of the float that they travel in; else they are cast to it.
    """

    params: ParamSet
    voice: Voice
    param_bytewise: bool

    def unknown_param(self, name: str) -> None:
        """Reacts to a parameter that does not exist."""


class ParamServer:
    """One vehicle's."""

    def __init__(self, pilot: Parametrised) -> None:
        self._pilot = pilot
        self._queue: list[int] = []

    def send_queued(self) -> None:
        """Sends the next parameters of a list that was asked for."""
        for position in self._queue[:_PARAMS_PER_TICK]:
            self._send(position)
        del self._queue[:_PARAMS_PER_TICK]

    @property
    def waiting(self) -> bool:
        """Whether a parameter list is being sent."""
        return bool(self._queue)

    def _send(self, position: int) -> None:
        params = self._pilot.params
        name, value, kind = params.at(position)
        if self._pilot.param_bytewise and params.is_integer(kind):
            value = struct.unpack("<f", struct.pack("<i", int(value)))[0]
        self._pilot.voice.send(
            "PARAM_VALUE",
            param_id=name.encode(),
            param_value=value,
            param_type=kind,
            param_count=len(params),
            param_index=position,
        )

    def on_list(self, _fields: Fields, _frame: Frame) -> None:
        """Queues all of them."""
        self._queue = list(range(len(self._pilot.params)))

    def on_read(self, fields: Fields, _frame: Frame) -> None:
        """Sends one, by its name or its place."""
        position: int | None = fields["param_index"]
        if position == -1:
            position = self._pilot.params.position(fields["param_id"].decode(errors="replace"))
        if position is not None and 0 <= position < len(self._pilot.params):
            self._send(position)

    def on_set(self, fields: Fields, _frame: Frame) -> None:
        """Changes one, and tells what it is then."""
        name = fields["param_id"].decode(errors="replace")
        position = self._pilot.params.position(name)
        if position is None:
            self._pilot.unknown_param(name)
            return
        value: float = fields["param_value"]
        _, _, kind = self._pilot.params.at(position)
        if self._pilot.param_bytewise and self._pilot.params.is_integer(kind):
            value = struct.unpack("<i", struct.pack("<f", value))[0]
        # sent bytewise, a value of another type means another number: it is refused and the old one told
        refused = self._pilot.param_bytewise and fields["param_type"] != kind
        if not refused:
            self._pilot.params.set_value(name, value)
        self._send(position)
