"""MAVLink 2 message signing: signatures made and checked, time stamps that never go back. Sans-IO, time is passed in.

As the MAVLink guide defines it (https://mavlink.io/en/guide/message_signing.html): 13 bytes follow the checksum of a
frame whose incompatibility flag says so: a link id, a time stamp of 48 bits (units of 10 us since 2015-01-01 UTC) and
the first 48 bits of SHA-256 over the secret key and everything before. A frame is refused when it bears no signature,
or a wrong one, or when its time stamp is not later than the last one of the same stream (system, component, link id),
or, for a stream not heard before, more than a minute behind the newest time that we know.

We sign with the latest of the clock, of what we sent, and of what we accepted: a clock that runs behind cannot make us
repeat a time stamp, and a vehicle whose time is ahead still takes our frames. The minute is asked of new streams only,
as the reference implementations do: else one vehicle whose clock jumps ahead would silence all others in the air.

Refuses to show a key, to read files or a clock, and to know what frames mean.
"""

from __future__ import annotations

import hmac
import struct
from dataclasses import dataclass, field
from enum import IntEnum
from hashlib import sha256

from groundstation.mavlink.codec import Frame, flagged, message_id

KEY_BYTES = 32
EPOCH_UNIX_US = 1_420_070_400_000_000
"""2015-01-01T00:00:00Z: time stamp 0."""
LATEST = (1 << 48) - 1
ADOPTED_MAX = LATEST - (1 << 40)
"""Time stamps of others up to this one (the year 2103) are taken over: the last ones would leave us none to send."""
MINUTE = 6_000_000
"""A minute, in time stamps."""
RADIO_COMPID = 68  # MAV_COMP_ID_TELEMETRY_RADIO
_STREAMS_MAX = 2_000  # only who has the key can make new ones
_RADIO_STATUS = message_id("RADIO_STATUS")
_TAIL = 13
_SIGNATURE = 6

Stream = tuple[int, int, int]
"""System id, component id and link id of a sender."""


class Verdict(IntEnum):
    """What a signature check found. The numbers stand in logs."""

    GOOD = 0
    UNSIGNED = 1
    WRONG = 2
    OLD = 3
    """The signature is right; the time stamp was there before, or is too old for a stream not heard before."""

    @property
    def words(self) -> str:
        """For people, after a number of frames."""
        return {
            Verdict.GOOD: "accepted",
            Verdict.UNSIGNED: "without a signature",
            Verdict.WRONG: "with a wrong signature",
            Verdict.OLD: "with an old time stamp",
        }[self]


class SecretKey:
    """32 secret bytes; neither ``repr`` nor an error shows them."""

    __slots__ = ("_secret",)

    def __init__(self, secret: bytes) -> None:
        if len(secret) != KEY_BYTES:
            raise ValueError(f"a signing key has {KEY_BYTES} bytes, not {len(secret)}")
        self._secret = bytes(secret)

    def __repr__(self) -> str:
        """Says that there is one."""
        return "SecretKey(...)"

    def __eq__(self, other: object) -> bool:
        """Whether both are the same key."""
        return isinstance(other, SecretKey) and hmac.compare_digest(self._secret, other._secret)

    def __hash__(self) -> int:
        """Equal keys have equal hashes."""
        return hash(self._secret)

    def __reduce__(self) -> str:
        """Refuses to be copied into a file or another process."""
        raise TypeError("a secret key is not written anywhere")

    def signature(self, signed_part: bytes) -> bytes:
        """The first 48 bits of SHA-256 over the key and all of a frame but the signature itself."""
        return sha256(self._secret + signed_part).digest()[:_SIGNATURE]

    def setup_bytes(self) -> bytes:
        """The key itself, for SETUP_SIGNING and for emulated vehicles: never for anything that is kept or shown."""
        return self._secret


def timestamp_at(unix_us: int) -> int:
    """Time stamp of a date given in microseconds of unix time; 0 before 2015."""
    return min(max((unix_us - EPOCH_UNIX_US) // 10, 0), LATEST)


def timestamp_of(frame: Frame) -> int:
    """Time stamp of a signed frame."""
    return int.from_bytes(frame.raw[-12:-6], "little")


@dataclass
class Times:
    """What has to be remembered from flight to flight, so that no time stamp is ever used or believed twice.

    Attributes:
        sent: no time stamp up to this one is used again.
        newest: latest time stamp known to have been, by the clock or an accepted frame.
        streams: last accepted time stamp of each stream.
    """

    sent: int = 0
    newest: int = 0
    streams: dict[Stream, int] = field(default_factory=dict)


class Signing:
    """One key in use: signs what goes out, judges what comes in, on any number of links.

    Args:
        key: shared with the vehicles.
        times: what earlier flights left; kept up to date.
    """

    def __init__(self, key: SecretKey, times: Times | None = None) -> None:
        self._key = key
        self.times = Times() if times is None else times
        self._before = dict(self.times.streams)
        self._last: dict[tuple[int, Stream], int] = {}

    def sign(self, frame: bytes, link_id: int, clock: int) -> bytes:
        """Signs one frame.

        Args:
            frame: whole MAVLink 2 frame of a known id; a signature on it is replaced.
            link_id: of the way that it goes, 0 to 255.
            clock: what the clock says, as a time stamp.

        Raises:
            ValueError: a MAVLink 1 frame, which cannot be signed, or the end of time (the year 2104).
        """
        if frame[0] != 0xFD:
            raise ValueError("a MAVLink 1 frame cannot be signed")
        times = self.times
        stamp = max(clock, times.newest, times.sent + 1)
        if stamp > LATEST:
            raise ValueError(f"time stamp {stamp} is beyond the last one, {LATEST}")
        times.sent = stamp
        body = flagged(frame, signed=True) + struct.pack("<BQ", link_id, stamp)[:7]
        return body + self._key.signature(body)

    def check(self, frame: Frame, clock: int, link: int = 0) -> Verdict:
        """Judges one received frame, and remembers the time stamp of a good one.

        Args:
            frame: as received.
            clock: what the clock says, as a time stamp.
            link: where it came in. The same frame may come over two links (a router): each has its own order.
        """
        if not frame.signed:
            return Verdict.UNSIGNED
        if not hmac.compare_digest(self._key.signature(frame.raw[:-_SIGNATURE]), frame.raw[-_SIGNATURE:]):
            return Verdict.WRONG
        times, stamp = self.times, timestamp_of(frame)
        times.newest = max(times.newest, clock)
        stream = (frame.sysid, frame.compid, frame.raw[-_TAIL])
        last = self._last.get((link, stream), self._before.get(stream))
        if last is not None:
            if stamp <= last:
                return Verdict.OLD
        elif stamp + MINUTE < times.newest or len(self._last) >= _STREAMS_MAX:
            return Verdict.OLD
        self._last[link, stream] = stamp
        times.streams[stream] = max(stamp, times.streams.get(stream, 0))
        if stamp <= ADOPTED_MAX:
            times.newest = max(times.newest, stamp)
        return Verdict.GOOD


def is_radio_status(frame: Frame) -> bool:
    """Whether a frame is what a telemetry radio says of itself, which it cannot sign: the guide's one exception.

    Only from the component id of radios: no vehicle's autopilot can be meant by it.
    """
    return frame.msgid == _RADIO_STATUS and frame.compid == RADIO_COMPID
