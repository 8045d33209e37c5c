"""Crazyflies by cflib: its threads put what they hear into an inbox, a thread for each vehicle sends what it is told.

A radio takes one packet at a time and may make whoever sends wait: so no vehicle's sending holds up another's, and what
waits meanwhile is in an outbox of its own. Refuses to decide anything. Of cflib's ``close_link`` it makes no use in the
air: that sends a setpoint with which motors stop.
"""

from __future__ import annotations

import logging
import os
import struct
import threading
import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import cflib.crtp
from cflib.crazyflie import Crazyflie
from cflib.crazyflie.log import LogConfig
from cflib.crazyflie.toc import Toc
from cflib.crtp.crtpstack import CRTPPacket

from groundstation.gateway.measured import POSE_VARIABLES, STATUS_MS, STATUS_VARIABLES
from groundstation.gateway.orders import LogRate, Order, SetParam
from groundstation.gateway.outbox import Outbox
from groundstation.gateway.packets import ANSWER_BYTES, HIGH_LEVEL, LINK, echo_number, packet_of

_KINDS = {
    "uint8_t": 1, "int8_t": 2, "uint16_t": 3, "int16_t": 4, "uint32_t": 5, "int32_t": 6, "float": 9, "FP16": 9,
    "double": 9, "uint64_t": 9, "int64_t": 9,
}  # fmt: skip
_FIRST_TIMES = 3  # what a vehicle in the air is told first, on a link that is just beginning
logging.getLogger("cflib.crazyflie").setLevel(
    logging.ERROR
)  # links that fail are told in our words, without tracebacks


@dataclass(frozen=True)
class Heard:
    """What a thread of cflib has to tell.

    Attributes:
        vehicle: number of the vehicle.
        kind: log, param, echo, answer, connected, lost.
        values: log variables by full name; of a parameter, its one value; of an answer the error.
        stamp_ms: of a log packet; of an echo or an answer its number.
        protocol: version of CRTP, when connected.
        params: full name: value, MAV_PARAM_TYPE, when connected.
        words: why it is lost.
    """

    vehicle: int
    kind: str
    values: dict[str, float] = field(default_factory=dict)
    stamp_ms: int = 0
    protocol: int = 0
    params: dict[str, tuple[float, int]] = field(default_factory=dict)
    words: str = ""


class Inbox:
    """What threads have heard, for the one loop that waits; it may be waited on like a link."""

    def __init__(self) -> None:
        self._waiting: deque[Heard] = deque()
        self._read, self._write = os.pipe()
        os.set_blocking(self._read, False)
        os.set_blocking(self._write, False)

    def sources(self) -> Sequence[int]:
        """A descriptor that can be read when something has come."""
        return (self._read,)

    def put(self, heard: Heard) -> None:
        """Takes something, in any thread."""
        self._waiting.append(heard)
        with suppress(OSError):  # full: the loop will look anyway; closed: nobody will
            os.write(self._write, b".")

    def take(self) -> list[Heard]:
        """Hands out what has come."""
        with suppress(BlockingIOError):
            os.read(self._read, 65536)
        return [self._waiting.popleft() for _ in range(len(self._waiting))]

    def close(self) -> None:
        """Gives the descriptors back."""
        os.close(self._read)
        os.close(self._write)


class CflibVehicle:
    """One vehicle.

    Args:
        number: by which it is named in the inbox.
        uri: as cflib writes it.
        inbox: where what is heard goes.
        cache: folder in which tables are kept.
        pose_hz: poses a second that are logged.
    """

    def __init__(self, number: int, uri: str, inbox: Inbox, cache: Path, pose_hz: float) -> None:
        self.uri = uri
        self.number, self._inbox, self._cache = number, inbox, cache
        self._period_ms = 10 * max(1, round(100.0 / pose_hz))
        self._cf: Crazyflie | None = None
        self._poses: LogConfig | None = None
        self._answered_ever = False
        self._outbox = Outbox()
        self._news = threading.Condition()
        self._ends = False
        threading.Thread(target=self._send_all, name=f"sends to {uri}", daemon=True).start()

    def connect(self, first: Sequence[Order] = ()) -> None:
        """Begins to connect; how that ends comes by the inbox.

        Args:
            first: what the vehicle is told as soon as its link is open, before the connection is complete.
        """
        threading.Thread(target=self._open, args=(tuple(first),), name=f"connects {self.uri}", daemon=True).start()

    def progress(self) -> tuple[int, str]:
        """How far the connection is: a number that grows, and words."""
        cf = self._cf
        if cf is None or not self._answered_ever:
            return 0, "no answer"
        entries = sum(_entries(part.toc) for part in (cf.log, cf.param) if part.toc is not None)
        values = sum(len(group) for group in list(cf.param.values.values()))
        if not values:
            return 1 + entries, f"answers, {entries} entries of its tables"
        return 1 + entries + values, f"answers, {values} of {_entries(cf.param.toc)} parameters"

    def obey(self, order: Order) -> None:
        """Takes an order, in their sequence; a velocity that waits is replaced by a newer one."""
        with self._news:
            self._outbox.put(order, time.monotonic_ns())
            self._news.notify()

    def close(self, *, flies: bool) -> None:
        """Ends the connection; one that flies gets no last setpoint."""
        with self._news:
            self._ends = True
            self._news.notify()
        cf, self._cf = self._cf, None
        if cf is None:
            return
        with suppress(Exception):  # cflib raises whatever its drivers raise
            if not flies:
                cf.close_link()
            elif cf.link is not None:
                cf.link.close()

    def _open(self, first: Sequence[Order]) -> None:
        old, self._cf = self._cf, None
        if old is not None and old.link is not None:
            with suppress(Exception):
                old.link.close()
        self._answered_ever = False
        cf = Crazyflie(rw_cache=str(self._cache))
        cf.link_established.add_callback(lambda _uri: self._begins(cf))
        cf.connected.add_callback(lambda _uri: self._log(cf))
        cf.fully_connected.add_callback(lambda _uri: self._ready(cf))
        for ended in (cf.connection_failed, cf.connection_lost):
            ended.add_callback(lambda _uri, words: self._lost(cf, str(words)))
        cf.add_port_callback(LINK, self._echoed)
        cf.add_port_callback(HIGH_LEVEL, self._answered)
        self._cf = cf
        cf.open_link(self.uri)
        for order in tuple(first) * _FIRST_TIMES:
            with suppress(Exception):  # cflib raises whatever its drivers raise, and tells of it by its callbacks
                send(cf, order)

    def _begins(self, cf: Crazyflie) -> None:
        self._answered_ever = self._answered_ever or cf is self._cf

    def _echoed(self, packet: CRTPPacket) -> None:
        number = echo_number(bytes(packet.data)) if packet.channel == 0 else None
        if number is not None:
            self._inbox.put(Heard(self.number, "echo", stamp_ms=number))

    def _answered(self, packet: CRTPPacket) -> None:
        data = bytes(packet.data)
        if len(data) >= ANSWER_BYTES:
            self._inbox.put(Heard(self.number, "answer", values={"error": float(data[3])}, stamp_ms=data[0]))

    def _log(self, cf: Crazyflie) -> None:
        for name, period_ms, variables in (
            ("pose", self._period_ms, POSE_VARIABLES),
            ("status", STATUS_MS, STATUS_VARIABLES),
        ):
            block = LogConfig(name, period_ms)
            for variable in variables:
                if cf.log.toc.get_element_by_complete_name(variable) is None:
                    self._lost(cf, f"its firmware has no log variable {variable}; update it")
                    return
                block.add_variable(variable)
            cf.log.add_config(block)
            block.data_received_cb.add_callback(self._logged)
            block.start()
            if name == "pose":
                self._poses = block

    def _logged(self, stamp_ms: int, values: dict[str, float], _block: object) -> None:
        self._inbox.put(Heard(self.number, "log", values=values, stamp_ms=stamp_ms))

    def _ready(self, cf: Crazyflie) -> None:
        params = {}
        for group, names in cf.param.toc.toc.items():
            for name, element in names.items():
                params[f"{group}.{name}"] = (float(cf.param.values[group][name]), _KINDS.get(element.ctype, 9))
        self._inbox.put(Heard(self.number, "connected", protocol=cf.platform.get_protocol_version(), params=params))
        cf.param.add_update_callback(cb=self._param)
        cf.link_statistics.stop()  # its ten echoes a second are not in the budget; ours are

    def _param(self, name: str, value: str) -> None:
        self._inbox.put(Heard(self.number, "param", values={name: float(value)}))

    def _lost(self, cf: Crazyflie, words: str) -> None:
        if cf is self._cf:
            self._inbox.put(Heard(self.number, "lost", words=words.strip().splitlines()[0] if words.strip() else ""))

    def _send_all(self) -> None:
        while True:
            with self._news:
                self._news.wait_for(lambda: self._ends or self._outbox)
                if self._ends:
                    return
                order = self._outbox.take(time.monotonic_ns())
            cf = self._cf
            if cf is None or order is None:
                continue
            try:
                if isinstance(order, LogRate):
                    self._log_at(order.hz)
                else:
                    send(cf, order)
            except Exception as error:  # cflib raises whatever its drivers raise; the others fly on
                self._lost(cf, f"{type(error).__name__}: {error}")

    def _log_at(self, hz: float) -> None:
        """Lets it log its poses at another rate."""
        block = self._poses
        if block is not None:
            block.period = max(1, round(100.0 / hz))
            block.start()


def _entries(toc: Toc) -> int:
    return sum(len(group) for group in list(toc.toc.values()))


def send(cf: Crazyflie, order: Order) -> None:
    """Sends one order: parameters by cflib's table of them, all others as packets that need none."""
    if isinstance(order, SetParam):
        with suppress(KeyError, AttributeError, struct.error, OverflowError, ValueError):
            cf.param.set_value(order.name, order.value)
        return
    data = packet_of(order, {})
    if data is not None:
        cf.send_packet(CRTPPacket(data[0], data[1:]))


def start_drivers() -> None:
    """Loads cflib's drivers, once."""
    if not cflib.crtp.CLASSES:
        cflib.crtp.init_drivers()
