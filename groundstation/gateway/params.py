"""A vehicle's parameters and the gateway's own, as MAVLink has them: cast to the float they travel in."""

from __future__ import annotations

from collections.abc import Mapping

from groundstation.gateway.names import short_names
from groundstation.gateway.orders import SetParam
from groundstation.gateway.settings import LIMITS, Settings
from groundstation.mavlink.codec import Encoder, StructuredArray

_REAL32 = 9


class ParamServer:
    """One vehicle's.

    Args:
        settings: the gateway's own.
        encoder: makes the frames.
    """

    def __init__(self, settings: Settings, encoder: Encoder) -> None:
        self._settings, self._encoder = settings, encoder
        self._values: dict[str, tuple[float, int]] = {}
        self._full: dict[str, str] = {}
        self._order: list[str] = list(LIMITS)
        self._queue: list[int] = []

    def know(self, params: Mapping[str, tuple[float, int]]) -> None:
        """Takes all of a vehicle: full name: value, MAV_PARAM_TYPE."""
        self._values = dict(params)
        self._full = short_names(sorted(params))
        self._order = [*LIMITS, *self._full]

    def value(self, full: str) -> float | None:
        """A value of the vehicle's, None where it has none of that name."""
        known = self._values.get(full)
        return None if known is None else known[0]

    def told(self, full: str, value: float) -> list[bytes]:
        """Takes a value that the vehicle told; returns frames."""
        if full not in self._values:
            return []
        self._values[full] = (value, self._values[full][1])
        return [self._frame(self._order.index(short)) for short, name in self._full.items() if name == full]

    def answer(self, name: str, values: StructuredArray) -> tuple[list[bytes], SetParam | None]:
        """Answers a message about parameters: frames to send now, and what the vehicle is to be told."""
        if name == "PARAM_REQUEST_LIST":
            self._queue = list(range(len(self._order)))
            return [], None
        if name not in ("PARAM_REQUEST_READ", "PARAM_SET"):
            return [], None
        number = int(values["param_index"]) if name == "PARAM_REQUEST_READ" else -1
        short = bytes(values["param_id"]).rstrip(b"\0").decode("ascii", "replace")
        if number < 0:
            number = self._order.index(short) if short in self._order else -1
        if not 0 <= number < len(self._order):
            return [], None
        short = self._order[number]
        if name == "PARAM_SET":
            value = float(values["param_value"])
            if short not in LIMITS:
                return [], SetParam(self._full[short], value)
            self._settings.set_value(short, value)
        return [self._frame(number)], None

    def due(self) -> list[bytes]:
        """The next of a list that was asked for."""
        return [self._frame(self._queue.pop(0))] if self._queue else []

    def _frame(self, number: int) -> bytes:
        short = self._order[number]
        value, kind = (self._settings[short], _REAL32) if short in LIMITS else self._values[self._full[short]]
        return self._encoder.encode(
            "PARAM_VALUE", param_id=short, param_value=value, param_type=kind, param_count=len(self._order),
            param_index=number,
        )  # fmt: skip
