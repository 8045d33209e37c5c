"""A system that cannot tell senders apart."""

from __future__ import annotations

import socket


def alone_on_a_port(family: int, where: tuple[str, int]) -> tuple[socket.socket, None]:
    """Stands in for ``steering.open_pair``: one socket for all."""
    item = socket.socket(family, socket.SOCK_DGRAM)
    item.bind(where)
    return item, None
