"""Sends what vehicles tell on to another ground station, which watches along: QGroundControl, for example.

One way only: the socket is never read, so that nothing from there reaches a vehicle, or this program. The tick hands
over bytes and goes on; a thread of its own sends them. An address that does not exist, a network that is slow or gone,
and a flood cost what would have been forwarded, the oldest first, and nothing else.
"""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from types import TracebackType

from groundstation.mavlink.addresses import LinkAddress

_WAITING_MAX = 2_000  # datagrams; about a second of eight vehicles that stream all they have
_RETRY_S = 2.0
_LAST_S = 0.5
Send = Callable[[bytes], object]


def open_socket(address: LinkAddress) -> tuple[socket.socket, Send]:
    """A UDP socket, and what sends to an address by it.

    Raises:
        OSError: the address cannot be found.
    """
    family, kind, protocol, _, place = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)[0]
    opened = socket.socket(family, kind, protocol)
    return opened, lambda data: opened.sendto(data, place)


class Forward:
    """One other ground station that watches along.

    Args:
        address: where it listens.
        connect: opens a socket; a test may stand in.

    Attributes:
        sent: datagrams that were sent.
        lost: datagrams that were not: there were too many, or they could not be sent.
    """

    def __init__(
        self, address: LinkAddress, connect: Callable[[LinkAddress], tuple[socket.socket, Send]] = open_socket
    ) -> None:
        self.sent = self.lost = 0
        self._address, self._connect = address, connect
        self._waiting: deque[bytes] = deque()
        self._news = threading.Event()
        self._end = False
        self._why = ""
        self._thread = threading.Thread(target=self._run, name="forward", daemon=True)

    def put(self, data: bytes) -> None:
        """Takes one datagram; never waits and never raises."""
        if len(self._waiting) >= _WAITING_MAX:
            with contextlib.suppress(IndexError):  # the thread may have taken it in between
                self._waiting.popleft()
            self.lost += 1
        self._waiting.append(data)
        self._news.set()

    def words(self) -> str:
        """What was not forwarded and why, empty when all was."""
        if not self.lost:
            return ""
        why = f": {self._why}" if self._why else ""
        return f"forward {self._address.url}: {self.lost} of {self.lost + self.sent} datagrams were not sent{why}"

    def __enter__(self) -> Forward:
        """Begins to send."""
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Sends what is left, for half a second at most, and ends."""
        self._end = True
        self._news.set()
        self._thread.join(_LAST_S)

    def _run(self) -> None:
        opened: socket.socket | None = None
        send: Send | None = None
        next_try = 0.0
        while True:
            self._news.wait()
            self._news.clear()
            if send is None and time.monotonic() >= next_try:
                try:
                    opened, send = self._connect(self._address)
                except OSError as error:
                    self._why, next_try = error.strerror or str(error), time.monotonic() + _RETRY_S
            self._send_all(send)
            if self._end and not self._waiting:
                break
        if opened is not None:
            opened.close()

    def _send_all(self, send: Send | None) -> None:
        while self._waiting:
            try:
                data = self._waiting.popleft()
            except IndexError:  # the tick has left it out in between
                return
            if send is None:
                self.lost += 1
                continue
            try:
                send(data)
                self.sent += 1
            except OSError as error:
                self._why = error.strerror or str(error)
                self.lost += 1
