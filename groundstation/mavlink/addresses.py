"""Link addresses as MAVSDK writes them, read and judged without opening anything.

``udpin://HOST:PORT`` listens, ``udpout://HOST:PORT`` speaks first; ``tcpout://`` and ``tcpin://`` likewise for streams;
``serial:///dev/ttyUSB0:57600`` is a serial port or a telemetry radio; ``mavsdk://`` before any of the others lets
MAVSDK do the talking. Refuses to know whether anybody is at the other end.
"""

from __future__ import annotations

from dataclasses import dataclass
from urllib.parse import urlsplit

from groundstation.core.errors import UserError

EXAMPLES = (
    "udpin://HOST:PORT, udpout://HOST:PORT, tcpout://HOST:PORT, tcpin://HOST:PORT, serial:///dev/ttyUSB0:57600,"
    " or mavsdk:// before one of them"
)
GATEWAY_LINK = "udpout://127.0.0.1:14588"
"""Between a flight and its gateway when a mission says nothing else: the gateway listens there."""
RADIO_RATES = ("250K", "1M", "2M")
_SOCKETS = ("udpin", "udpout", "tcpout", "tcpin")
_BITS_PER_BYTE = 10  # start bit, eight bits, stop bit
_BAUD_MIN, _BAUD_MAX = 1_200, 12_000_000


@dataclass(frozen=True)
class LinkAddress:
    """Where a link leads.

    Attributes:
        url: as written.
        kind: udpin, udpout, tcpout, tcpin or serial.
        host: of the socket, "" for serial.
        port: of the socket, 0 for serial.
        device: of the serial port, "" for sockets.
        baud: of the serial port, 0 for sockets.
        through_mavsdk: MAVSDK opens it and repeats the setpoints.
    """

    url: str
    kind: str
    host: str = ""
    port: int = 0
    device: str = ""
    baud: int = 0
    through_mavsdk: bool = False

    @property
    def is_stream(self) -> bool:
        """Whether a frame may arrive in two pieces."""
        return self.kind in ("tcpout", "tcpin", "serial") and not self.through_mavsdk

    @property
    def peer(self) -> str:
        """Name of the other end where it is known before it speaks, "" on a listening link; MAVSDK is always there."""
        if self.through_mavsdk or self.kind == "serial":
            return self.device or f"{self.host}:{self.port}"
        return f"{self.host}:{self.port}" if self.kind in ("udpout", "tcpout") else ""

    @property
    def bytes_per_s(self) -> float:
        """What the wire carries each way; infinite where the address does not say."""
        return self.baud / _BITS_PER_BYTE if self.kind == "serial" else float("inf")


def parse_address(url: str) -> LinkAddress:
    """Reads a link address.

    Raises:
        UserError: another form, with those that there are.
    """
    inner = url.removeprefix("mavsdk://")
    through_mavsdk = inner != url
    try:
        parts = urlsplit(inner)
        if parts.scheme == "serial":
            device, _, baud = (parts.netloc + parts.path).rpartition(":")
            if device and _BAUD_MIN <= int(baud) <= _BAUD_MAX:
                return LinkAddress(url, "serial", device=device, baud=int(baud), through_mavsdk=through_mavsdk)
        elif parts.scheme in _SOCKETS and parts.hostname and parts.port is not None and not parts.path.strip("/"):
            return LinkAddress(url, parts.scheme, host=parts.hostname, port=parts.port, through_mavsdk=through_mavsdk)
    except ValueError:
        pass
    raise UserError(f"link {url}: expected {EXAMPLES}")


def is_crtp(url: str) -> bool:
    """Whether an address is one of cflib's, behind which a vehicle speaks CRTP: radio://..., udp://HOST:PORT."""
    return url.startswith(("radio://", "udp://"))


def mavlink_url(url: str, gateway: str | None) -> str:
    """By which link a vehicle's MAVLink comes: its own, or that of the flight's gateway; flights and logs agree on it.

    Args:
        url: as the mission has it.
        gateway: the key gateway.link of a mission; None for the usual one.
    """
    return (gateway or GATEWAY_LINK) if is_crtp(url) else url


def radio_of(url: str) -> tuple[str, str] | None:
    """Number of the radio and data rate of a cflib address; None for one that is not by radio.

    Raises:
        UserError: an address of another form.
    """
    parts = urlsplit(url)
    if parts.scheme == "udp" and parts.hostname and parts.port is not None:
        return None
    words = [parts.netloc, *parts.path.strip("/").split("/")]
    if parts.scheme != "radio" or len(words) < 3 or words[2] not in RADIO_RATES or not words[1].isdigit():
        raise UserError(f"{url}: expected radio://RADIO/CHANNEL/RATE/ADDRESS, for example radio://0/80/2M/E7E7E7E701")
    return words[0], words[2]
