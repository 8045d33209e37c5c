"""Waits on real descriptors, each with a limit; nothing here sleeps."""

from __future__ import annotations

import selectors

from groundstation.links.link import Link

LIMIT_S = 5.0


def arrived_on(link: Link, now_ns: int = 0) -> list[tuple[str, bytes]]:
    """What comes over a link next; fails when nothing does."""
    link.service(now_ns)
    with selectors.DefaultSelector() as selector:
        for source in link.sources():
            selector.register(source, selectors.EVENT_READ)
        assert selector.select(LIMIT_S), f"nothing came over {link.url}"
    return link.receive()


def writable(descriptor: int) -> None:
    """Waits until a descriptor takes bytes: a connection that is being made has been made then."""
    with selectors.DefaultSelector() as selector:
        selector.register(descriptor, selectors.EVENT_WRITE)
        assert selector.select(LIMIT_S), "not connected"
