"""What every link can do, whatever carries its bytes.

A link never blocks, never raises into a flight and never waits: its owner waits on ``sources``, says what time it is,
and the link takes, sends, and finds its way back when the other end has gone.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Protocol

RETRY_NS = 1_000_000_000
"""Time between two attempts to open what has gone away."""
BACKLOG_BYTES = 4_096
"""What a stream keeps for an other end that does not take it now; more than that is old news and is left out."""
RECEIVE_BYTES = 4_096
"""What ``receive`` takes at a time, so that its owner looks at the clock in between: a link may be flooded."""
STRANGERS_BYTES = 1_024
"""What strangers get of that at most, once somebody is known, and only when those that are known have no more."""
LONGEST_OF_STRANGERS = 4_096
"""A longer datagram of a stranger is left out before anybody looks into it. Vehicles stay below 1,500 bytes, and a
router that joins frames has room for thirteen of the longest here."""
LONGEST_OF_A_ROOM = 24_576
"""The same where a motion capture system speaks: one instant is one datagram, and there may be five hundred bodies."""


class Link(Protocol):
    """One way to one or many vehicles.

    Attributes:
        url: as the mission writes it.
        errors: datagrams that could not be sent or taken, and those that were left out.
    """

    url: str
    errors: int

    def sources(self) -> Sequence[int]:
        """File descriptors to wait on for bytes; they change when a connection comes or goes."""

    def service(self, now_ns: int) -> None:
        """Does what is due: opens again what has gone away, sends what could not be sent before.

        Args:
            now_ns: monotonic time; not necessarily that of other links.
        """

    @property
    def behind(self) -> bool:
        """Whether something was taken from the system that ``receive`` has not handed out yet."""

    def know(self, peers: Collection[str]) -> None:
        """Says whom the vehicles were heard from: they come before strangers."""

    def receive(self, most: int = RECEIVE_BYTES) -> list[tuple[str, bytes]]:
        """Takes what has arrived: (peer, bytes) each, in order of arrival, those that are known first.

        Strangers get a share of what those that are known leave, and nothing while those have more.

        Args:
            most: bytes; a piece that begins within them is taken whole.
        """

    def send(self, peer: str, data: bytes) -> None:
        """Sends whole frames to a peer that was heard from (or to ``peers``); what cannot be sent is counted."""

    def peers(self) -> Sequence[str]:
        """Whom one may speak to before having heard anything: who connects rather than listens."""

    @property
    def state(self) -> str:
        """What is wrong with the link, for people; empty while it works."""

    @property
    def left_out(self) -> str:
        """What was left out of what came for its length, for people; empty while nothing was."""

    def close(self) -> None:
        """Gives everything back."""


class Backlog:
    """Bytes that a stream could not take yet; whole pieces or nothing, so that no frame is cut in the middle."""

    def __init__(self) -> None:
        self._waiting = bytearray()

    def add(self, data: bytes) -> bool:
        """Appends a piece; returns False, leaving it out, when too much waits already."""
        if self._waiting and len(self._waiting) + len(data) > BACKLOG_BYTES:
            return False
        self._waiting += data
        return True

    def __bool__(self) -> bool:
        """Whether anything waits."""
        return bool(self._waiting)

    def head(self) -> bytes:
        """What waits."""
        return bytes(self._waiting)

    def taken(self, count: int) -> None:
        """Forgets the first bytes: they are on their way."""
        del self._waiting[:count]

    def clear(self) -> None:
        """Forgets everything: the connection has gone."""
        self._waiting.clear()
