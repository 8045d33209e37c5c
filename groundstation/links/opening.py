"""From an address to an open link: the one place that knows every kind."""

from __future__ import annotations

from groundstation.core.extras import need
from groundstation.links.link import LONGEST_OF_STRANGERS, Link
from groundstation.links.tcp import TcpClientLink, TcpServerLink
from groundstation.links.udp import open_udp
from groundstation.mavlink.addresses import parse_address


def open_link(url: str, longest: int = LONGEST_OF_STRANGERS) -> Link:
    """Opens a link.

    What may come later (a vehicle that connects, a radio that is plugged in) is waited for by the link; what will not
    come right by waiting is refused.

    Args:
        url: see ``addresses``.
        longest: bytes of a datagram of a stranger that is taken.

    Raises:
        UserError: a wrong address, a port in use, a device that may not be opened.
    """
    address = parse_address(url)
    if address.through_mavsdk:
        need("mavsdk", f"link {url}")
        from groundstation.links.mavsdk_link import MavsdkLink  # noqa: PLC0415 - loads a native library

        return MavsdkLink(address)
    if address.kind == "serial":
        from groundstation.links.serial_port import SerialLink  # noqa: PLC0415 - most flights have no serial port

        return SerialLink(address)
    if address.kind == "tcpout":
        return TcpClientLink(address)
    if address.kind == "tcpin":
        return TcpServerLink(address)
    return open_udp(url, longest)
