"""What stands between the links and the mission: signs all that goes out, lets in only what is signed as it has to be.

The mission behind it needs no key, so that a log can be flown again without one: what was let in is in the log as
received, what was refused is there as refused. Links without a key are let through as they are.

Frames are refused, never raised about, and counted by the system id that they claim. Decides nothing else.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import NamedTuple

from groundstation.mavlink.codec import Encoder, Frame, Splitters, message_id
from groundstation.mavlink.signing import MINUTE, Signing, Times, Verdict, is_radio_status, timestamp_at
from groundstation.mavlink.station import (
    GROUND_STATION_COMPID,
    GROUND_STATION_SYSID,
    Outgoing,
    ground_station_heartbeat,
)

SETUP_SIGNING = message_id("SETUP_SIGNING")
_GREETED_MAX = 256
_GREETING_NS = 1_000_000_000
_REMEDIES = {
    Verdict.UNSIGNED: "it does not sign: give it the key of this mission (gs signing setup)",
    Verdict.WRONG: "it has another key: give it that of this mission (gs signing setup)",
    Verdict.OLD: "its time is behind: it is greeted until it has ours; does it hear us?",
}
_SOMEBODY = {
    Verdict.UNSIGNED: "somebody else speaks in its name, or it sends some frames unsigned",
    Verdict.WRONG: "somebody else speaks in its name, with another key",
    Verdict.OLD: "frames are repeated, by a router or by somebody who recorded them",
}


class SignedLink(NamedTuple):
    """How one link is signed."""

    signing: Signing
    link_id: int


class Refused(NamedTuple):
    """A frame that was not let in, and why."""

    frame: Frame
    verdict: Verdict


class Gate:
    """Signs and checks on all links of a flight.

    Args:
        links: in the order of the mission's links; None for one that is not signed.
        epoch_unix_us: date of time 0, microseconds of unix time.
        streams: links on which a frame may arrive in two pieces.
        store: called with the times of a key (by its place among ``keys``) before they are used; None to keep none.

    Attributes:
        counts: refused frames by (link, claimed system id, verdict).
        accepted: frames let in by their signature, by (link, system id).
        radio_status: frames of radios about themselves, which come without a signature.
        keys: the keys in use, each once.
    """

    def __init__(
        self,
        links: Sequence[SignedLink | None],
        epoch_unix_us: int,
        *,
        streams: Collection[int] = (),
        store: Callable[[int, Times], None] | None = None,
    ) -> None:
        self.counts: Counter[tuple[int, int, Verdict]] = Counter()
        self.accepted: Counter[tuple[int, int]] = Counter()
        self.radio_status = 0
        self._links = tuple(links)
        self.keys: tuple[Signing, ...] = tuple(dict.fromkeys(link.signing for link in links if link is not None))
        self._epoch_unix_us = epoch_unix_us
        self._streams = frozenset(streams)
        self._store = store
        self._stored = [-1] * len(self.keys)
        self._splitters = Splitters()
        self._encoder = Encoder(GROUND_STATION_SYSID, GROUND_STATION_COMPID)
        self._behind: dict[tuple[int, str], None] = {}
        self._next_greeting_ns = 0

    def signed(self, link: int) -> bool:
        """Whether a link is signed."""
        return self._links[link] is not None

    def receive(self, link: int, peer: str, data: bytes, t_rx_ns: int) -> Iterator[Frame | Refused | bytes]:
        """Takes what a link brought.

        Returns:
            In the order of arrival: frames that are let in, frames that are not, and bytes that were no frame.
        """
        how, clock = self._links[link], self._clock(t_rx_ns)
        for piece in self._splitters.feed((link, peer), data, stream=link in self._streams):
            if how is None or not isinstance(piece, Frame):
                yield piece
                continue
            verdict = how.signing.check(piece, clock, link)
            if verdict is Verdict.GOOD:
                self.accepted[link, piece.sysid] += 1
                self._behind.pop((link, peer), None)
                yield piece
            elif verdict is Verdict.UNSIGNED and is_radio_status(piece):
                self.radio_status += 1
                yield piece
            else:
                self.counts[link, piece.sysid, verdict] += 1
                if verdict is Verdict.OLD and len(self._behind) < _GREETED_MAX:
                    self._behind[link, peer] = None
                yield Refused(piece, verdict)

    def let_in(self, link: int, peer: str, data: bytes, t_rx_ns: int) -> Iterator[bytes]:
        """The same for those who do not want to know what was refused: the bytes that are let in."""
        for piece in self.receive(link, peer, data, t_rx_ns):
            if not isinstance(piece, Refused):
                yield piece.raw if isinstance(piece, Frame) else piece

    def sign(self, outgoing: Sequence[Outgoing], now_ns: int) -> list[Outgoing]:
        """Signs what is sent now, and has the times stored before anybody can hear of them."""
        clock = self._clock(now_ns)
        signed = [self._signed(item, clock) for item in outgoing]
        if self._store is not None:
            for number, key in enumerate(self.keys):
                if key.times.sent + MINUTE // 2 > self._stored[number]:
                    self._stored[number] = key.times.sent + MINUTE
                    self._store(number, key.times)
        return signed

    def greetings(self, now_ns: int) -> list[Outgoing]:
        """Heartbeats, signed, for those whose signature is right and whose time is behind: hearing us sets it right.

        Without them a vehicle that has no clock of its own would never be heard where it has to speak first.
        """
        if not self._behind or now_ns < self._next_greeting_ns:
            return []
        self._next_greeting_ns = now_ns + _GREETING_NS
        hello = ground_station_heartbeat(self._encoder)
        behind, self._behind = self._behind, {}
        return self.sign([Outgoing(link, peer, (hello,)) for link, peer in behind], now_ns)

    def words(self, links: Sequence[str], id_of: Mapping[tuple[int, int], int]) -> list[str]:
        """What was refused, a line for each sender and reason, worst first.

        Args:
            links: names of the links.
            id_of: the mission's vehicles by link and system id; the others are strangers.
        """
        lines = []
        for (link, sysid, verdict), count in sorted(self.counts.items(), key=lambda item: (-item[1], item[0])):
            ours = (link, sysid) in id_of
            name = f"vehicle {id_of[link, sysid]}" if ours else f"system {sysid} on {links[link]}"
            frames = "1 frame" if count == 1 else f"{count} frames"
            taken = self.accepted[link, sysid]
            line = f"{name}: {frames} {verdict.words} ignored"
            if ours:
                line += f", {taken} good ones taken; {_SOMEBODY[verdict]}" if taken else f"; {_REMEDIES[verdict]}"
            lines.append(line)
        return lines

    def totals(self) -> dict[str, int]:
        """Refused frames by reason, for the record."""
        totals: Counter[str] = Counter()
        for (_, _, verdict), count in self.counts.items():
            totals[f"frames {verdict.words}"] += count
        if self.radio_status:
            totals["RADIO_STATUS without a signature, let in"] = self.radio_status
        return dict(totals)

    def _signed(self, item: Outgoing, clock: int) -> Outgoing:
        how = self._links[item.link]
        if how is None:
            return item
        return item._replace(frames=tuple(how.signing.sign(frame, how.link_id, clock) for frame in item.frames))

    def _clock(self, t_ns: int) -> int:
        return timestamp_at(self._epoch_unix_us + t_ns // 1_000)
