"""Crazyflies that are there, by cflib: on all channels of a radio, at addresses that are named, over UDP.

Asks with the empty packet that anybody answers, and moves nobody. Refuses to connect.
"""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterable
from urllib.parse import urlsplit

from groundstation.core.errors import UserError

_PORTS = range(19850, 19860)
_WAIT_S = 0.2
_PREFIX_DIGITS = 8
_ADDRESSES = range(1, 17)
DEFAULT = "E7E7E7E7E7"
Scan = Callable[[int], list[str]]
"""Addresses (cflib's) at which a radio address is heard, on any channel and rate."""


def found(wishes: Iterable[str], scan: Scan) -> list[str]:
    """Cflib addresses of those that answer.

    Args:
        wishes: ``radio://`` (the address that they are sold with, and the first sixteen of the same beginning),
            ``radio://N/CHANNEL/RATE/ADDRESS`` (that radio address, on any channel), ``udp://`` and ``udp://HOST:PORT``.
        scan: asks by radio.

    Raises:
        UserError: an address of another form, or no radio.
    """
    heard: list[str] = []
    for wish in wishes:
        parts = urlsplit(wish)
        if parts.scheme == "udp":
            host = parts.hostname or "127.0.0.1"
            ports = [parts.port] if parts.port is not None else list(_PORTS)
            heard += [f"udp://{host}:{port}" for port in ports if _answers(host, port)]
            continue
        words = parts.path.strip("/").split("/")
        if len(words) >= 3:
            addresses = [words[2]]
        else:
            addresses = [DEFAULT, *(f"{DEFAULT[:_PREFIX_DIGITS]}{number:02X}" for number in _ADDRESSES)]
        for address in addresses:
            try:
                number = int(address, 16)
            except ValueError:
                raise UserError(f"{wish}: {address}: expected up to ten hexadecimal digits, as {DEFAULT}") from None
            heard += [full(uri) for uri in scan(number)]
    return list(dict.fromkeys(heard))


def full(uri: str) -> str:
    """An address with all its parts: cflib leaves out the one that vehicles are sold with."""
    return uri if len(uri.split("/")) >= 6 else f"{uri}/{DEFAULT}"


def radio_scan(number: int) -> list[str]:
    """Asks for one radio address on all channels and rates.

    Raises:
        UserError: there is no radio, or it does not answer.
    """
    from cflib.crtp.radiodriver import RadioDriver  # noqa: PLC0415 - an extra
    from cflib.drivers.crazyradio import get_serials  # noqa: PLC0415

    try:
        if not get_serials():
            raise UserError(
                "radio://: no Crazyradio is plugged in, or it may not be opened (on Linux see to udev rules)"
            )
        return [str(uri) for uri, _ in RadioDriver().scan_interface(number)]
    except UserError:
        raise
    except Exception as error:  # cflib raises whatever its drivers raise
        raise UserError(f"radio://: {type(error).__name__}: {error}; plug the Crazyradio in anew") from error


def _answers(host: str, port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.settimeout(_WAIT_S)
        try:
            probe.connect((host, port))
            probe.send(b"\xff")
            return bool(probe.recv(64))
        except OSError:
            return False


def block(uris: Iterable[str]) -> str:
    """The ``vehicles:`` block of a mission; ids by the last byte of radio addresses where these differ."""
    uris = list(uris)
    last = [int(uri.rsplit("/", 1)[1][-2:], 16) if uri.startswith("radio://") else 0 for uri in uris]
    own = len(set(last)) == len(last) and all(1 <= number <= 250 for number in last)
    lines = [
        f'  - {{id: {last[k] if own else k + 1}, link: "{uri}", autopilot: crazyflie, origin: team,'
        f" pad_m: [{k % 4}.0, {k // 4}.0, 0.0]}}\n"
        for k, uri in enumerate(uris)
    ]
    return "vehicles:  # pads are made up: say where each stands in the room\n" + "".join(lines)
