"""What ground stations ask to be told: streams at a rate, single messages."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Protocol

from groundstation.mavlink.codec import Frame, message_name
from sitl.body import Link
from sitl.mavlink_ids import ACCEPTED, DENIED, FAILED
from sitl.voice import Voice
from sitl.wire import Fields, whole


class Asked(Protocol):
    """An autopilot that is asked.

    Attributes:
        version_fields: of AUTOPILOT_VERSION.
        accepts_unready: what it knows and cannot tell yet is accepted, and not sent.
    """

    voice: Voice
    version_fields: ClassVar[Fields]
    accepts_unready: bool


class Requests:
    """One vehicle's; ``rates_hz`` are the streams that run unasked."""

    def __init__(self, pilot: Asked, link: Link, rates_hz: Mapping[str, float]) -> None:
        self._pilot, self._link, self._rates_hz = pilot, link, rates_hz

    def set_interval(self, params: tuple[float, ...], _frame: Frame) -> int:
        """Sets a stream."""
        if whole(params[2]) or whole(params[3]):
            return FAILED
        name = message_name(whole(params[0])) or ""
        interval_us = min(whole(params[1]), 10**12)
        if interval_us == 0:  # the default rate
            rate = self._rates_hz.get(name, 0.0)
            interval_ns = round(1e9 / rate) if rate else 0
        else:
            interval_ns = max(interval_us, 0) * 1000
        return ACCEPTED if self._link.set_interval(name, interval_ns) else DENIED

    def get_interval(self, params: tuple[float, ...], _frame: Frame) -> int:
        """Tells at which interval a stream runs."""
        name = message_name(whole(params[0])) or ""
        interval = self._link.interval(name)
        interval_us = 0 if interval is None else (interval // 1000 or -1)
        self._pilot.voice.send("MESSAGE_INTERVAL", message_id=whole(params[0]) & 0xFFFF, interval_us=interval_us)
        return ACCEPTED

    def send_one(self, msgid: int) -> int:
        """Sends one message on request."""
        name = message_name(msgid) or ""
        if name == "AUTOPILOT_VERSION":
            self._pilot.voice.send(name, uid=0x5117000000000000 + self._pilot.voice.sysid, **self._pilot.version_fields)
        elif name == "PROTOCOL_VERSION":
            self._pilot.voice.send(name, version=200, min_version=100, max_version=200)
        elif self._link.can_stream(name):
            return ACCEPTED if self._link.send_now(name) or self._pilot.accepts_unready else DENIED
        else:
            return DENIED
        return ACCEPTED
