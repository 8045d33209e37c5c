"""Two UDP sockets on one port, one for senders that are known: the kernel sorts datagrams, each has a queue of its own.

Linux lets a classic BPF program choose among sockets that share a port (SO_ATTACH_REUSEPORT_CBPF). Ours compares the
sender's address and port, of IPv4 alone. Where that does not work there is one socket for all.
"""

from __future__ import annotations

import contextlib
import ctypes
import ipaddress
import socket
import struct
import sys
from collections.abc import Sequence

_SO_ATTACH_REUSEPORT_CBPF = 51  # asm-generic/socket.h
_NETWORK_HEADER = 0xFFF00000  # SKF_NET_OFF of linux/filter.h: offsets from there on are into the IP header
_LOAD_BYTE, _LOAD_HALF, _LOAD_WORD = 0x30, 0x28, 0x20  # BPF_LD | BPF_ABS with the size
_JUMP, _JUMP_EQUAL, _RETURN = 0x05, 0x15, 0x06
_INSTRUCTIONS_MAX = 4_096  # BPF_MAXINSNS
_PLAIN_HEADER = 0x45  # version 4, no options: the UDP header begins 20 bytes on

Instruction = tuple[int, int, int, int]
"""Code, jump if true, jump if false, operand."""


def open_pair(family: int, where: tuple[str, int]) -> tuple[socket.socket, socket.socket | None]:
    """Binds a port that nobody else has.

    Returns:
        The socket of strangers, and that of senders that ``steer`` is told; or everybody's, and None.

    Raises:
        OSError: as ``bind`` does; also when somebody has the port and would share it.
    """
    if family != socket.AF_INET or not sys.platform.startswith("linux"):
        return _bound(family, where, shared=False), None
    if where[1]:
        _bound(family, where, shared=False).close()  # shared ports would be ours and another program's
    first = _bound(family, where, shared=True)
    second: socket.socket | None = None
    try:
        second = _bound(family, (where[0], first.getsockname()[1]), shared=True)
        _attach(first, [(_RETURN, 0, 0, 0)])
    except OSError:  # an old kernel, or one that does not allow it
        if second is not None:
            second.close()
        first.close()
        return _bound(family, where, shared=False), None
    return first, second


def steer(first: socket.socket, known: Sequence[tuple[str, int]]) -> None:
    """Sends what comes from these addresses to the second socket of a pair from now on; a failure changes nothing."""
    with contextlib.suppress(OSError):
        _attach(first, program(known))


def program(known: Sequence[tuple[str, int]]) -> list[Instruction]:
    """A classic BPF program that gives 1 for datagrams from one of these IPv4 addresses and ports, else 0.

    As many senders as fit into a program are told apart; those that do not fit are strangers.
    """
    ports: dict[int, list[int]] = {}
    for host, port in sorted(known):
        with contextlib.suppress(ValueError):
            ports.setdefault(int(ipaddress.IPv4Address(host)), []).append(port)
    steps: list[Instruction] = [
        (_LOAD_BYTE, 0, 0, _NETWORK_HEADER),
        (_JUMP_EQUAL, 1, 0, _PLAIN_HEADER),
        (_RETURN, 0, 0, 0),
    ]
    for host_number, listed in ports.items():
        room = (_INSTRUCTIONS_MAX - len(steps) - 6) // 2
        if room <= 0:
            break
        checks = [step for port in listed[:room] for step in ((_JUMP_EQUAL, 0, 1, port), (_RETURN, 0, 0, 1))]
        steps += [
            (_LOAD_WORD, 0, 0, _NETWORK_HEADER + 12),
            (_JUMP_EQUAL, 1, 0, host_number),
            (_JUMP, 0, 0, len(checks) + 2),
            (_LOAD_HALF, 0, 0, _NETWORK_HEADER + 20),
            *checks,
            (_RETURN, 0, 0, 0),
        ]
    return [*steps, (_RETURN, 0, 0, 0)]


def _attach(first: socket.socket, steps: Sequence[Instruction]) -> None:
    code = ctypes.create_string_buffer(b"".join(struct.pack("=HBBI", *step) for step in steps))
    first.setsockopt(
        socket.SOL_SOCKET, _SO_ATTACH_REUSEPORT_CBPF, struct.pack("@HP", len(steps), ctypes.addressof(code))
    )


def _bound(family: int, where: tuple[str, int], *, shared: bool) -> socket.socket:
    item = socket.socket(family, socket.SOCK_DGRAM)
    try:
        if shared:
            item.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        item.bind(where)
    except BaseException:
        item.close()
        raise
    return item
