"""Serial links: a port or a telemetry radio, opened again when it was unplugged and comes back.

pyserial opens and sets the port up; the bytes go through the descriptor, which never blocks. What the port does not
take now waits, as long as it is little; whole datagrams are left out then, never halves of frames.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Collection

import serial

from groundstation.core.errors import UserError
from groundstation.links.link import RECEIVE_BYTES, Backlog
from groundstation.mavlink.addresses import LinkAddress

_RETRY_NS = 200_000_000  # looking costs nothing, and an autopilot waits for setpoints no longer than a second


class SerialLink:
    """``serial:///dev/ttyUSB0:57600``; see ``Link``. Its only peer is the device.

    Args:
        address: device and speed.

    Raises:
        UserError: there is such a device, and it cannot be opened.
    """

    left_out = ""

    def __init__(self, address: LinkAddress) -> None:
        self.url = address.url
        self.errors = 0
        self.state = ""
        self._device, self._baud = address.device, address.baud
        self._port: serial.Serial | None = None
        self._backlog = Backlog()
        self._next_ns: int | None = None
        if os.path.exists(self._device) and not self._open():
            raise UserError(f"link {self.url}: {self.state}; is another program using it, and may you?")

    def _open(self) -> bool:
        try:
            self._port = serial.Serial(self._device, self._baud, timeout=0, write_timeout=0, exclusive=True)
            os.set_blocking(self._port.fileno(), False)
        except (OSError, ValueError) as error:  # SerialException is an OSError
            self._port = None
            words = os.strerror(error.errno) if isinstance(error, OSError) and error.errno else str(error)
            self.state = f"cannot open {self._device}: {words}"
            return False
        self.state = ""
        self._backlog.clear()
        return True

    def sources(self) -> tuple[int, ...]:
        """The port, while it is there."""
        return () if self._port is None else (self._port.fileno(),)

    def peers(self) -> tuple[str, ...]:
        """The device."""
        return (self._device,)

    def service(self, now_ns: int) -> None:
        """Opens the port again as soon as it is there; sends what waits."""
        if self._port is not None:
            self._flush()
        elif self._next_ns is None or now_ns >= self._next_ns:
            self._next_ns = now_ns + _RETRY_NS
            self._open()

    @property
    def behind(self) -> bool:
        """Nothing is kept."""
        return False

    def know(self, peers: Collection[str]) -> None:
        """There is nobody else."""

    def receive(self, most: int = RECEIVE_BYTES) -> list[tuple[str, bytes]]:
        """Takes what has arrived; notices that the port is gone."""
        if self._port is None:
            return []
        try:
            data = os.read(self._port.fileno(), most)
        except BlockingIOError:
            return []
        except OSError:
            data = b""
        if not data:  # readable and empty: unplugged
            self._lose()
            return []
        return [(self._device, data)]

    def send(self, peer: str, data: bytes) -> None:
        """Sends whole frames."""
        if self._port is None or not self._backlog.add(data):
            self.errors += 1
            return
        self._flush()

    def _flush(self) -> None:
        if self._port is None or not self._backlog:
            return
        try:
            self._backlog.taken(os.write(self._port.fileno(), self._backlog.head()))
        except BlockingIOError:
            pass
        except OSError:
            self._lose()

    def _lose(self) -> None:
        self.errors += 1
        self.state = f"{self._device} is gone; waiting for it to come back"
        self._backlog.clear()
        self._next_ns = None
        port, self._port = self._port, None
        if port is not None:
            with contextlib.suppress(OSError):
                port.close()

    def close(self) -> None:
        """Closes the port."""
        if self._port is not None:
            with contextlib.suppress(OSError):
                self._port.close()
            self._port = None
