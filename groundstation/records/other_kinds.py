"""Files that are taken for a .tlog and are none, told by what they begin with."""

from __future__ import annotations

from groundstation.core.errors import UserError
from groundstation.mavlink.codec import Frame, FrameSplitter

_TELEMETRY = "give the telemetry log that the ground station wrote (.tlog)"
_KINDS: tuple[tuple[bytes, str, str], ...] = (
    (b"ULog\x01\x12\x35", "a ULog, which PX4 wrote on board", _TELEMETRY),
    (b"\xa3\x95\x80\x80", "a DataFlash log, which ArduPilot wrote on board", _TELEMETRY),
    (b"FMT, 128, 89", "a DataFlash log as text", _TELEMETRY),
    (b"#ROSBAG", "a ROS bag", _TELEMETRY),
    (b"SQLite format 3", "a database (ROS 2 keeps bags so)", _TELEMETRY),
    (b"\xd4\xc3\xb2\xa1", "a capture of network packets", _TELEMETRY),
    (b"\xa1\xb2\xc3\xd4", "a capture of network packets", _TELEMETRY),
    (b"\x0a\x0d\x0d\x0a", "a capture of network packets", _TELEMETRY),
    (b"\x1f\x8b", "packed with gzip", "unpack it first: gzip -d"),
    (b"\xfd7zXZ\x00", "packed with xz", "unpack it first: xz -d"),
    (b"BZh", "packed with bzip2", "unpack it first: bzip2 -d"),
    (b"\x28\xb5\x2f\xfd", "packed with zstd", "unpack it first: zstd -d"),
    (b"PK\x03\x04", "a zip archive", "unpack it first"),
)
BEGINNING_BYTES = 1 << 16
"""Of a file, that are looked at."""
_RAW_FRAMES = 3


def refuse_other_kinds(data: bytes, name: str) -> None:
    """Tells what a file is that is no .tlog, as far as that is seen.

    Args:
        data: how the file begins, ``BEGINNING_BYTES`` or all of it.
        name: for the message.

    Raises:
        UserError: it is of another kind, and which.
    """
    for begin, what, remedy in _KINDS:
        if data.startswith(begin):
            raise UserError(f"{name}: is {what}, expected a log (.tlog); {remedy}")
    frames = joined = 0
    before: Frame | bytes = b""
    for piece in FrameSplitter().feed(data[:BEGINNING_BYTES]):
        if isinstance(piece, Frame):
            frames += 1
            joined += isinstance(before, Frame)
        before = piece
    if joined >= _RAW_FRAMES and 2 * joined > frames:  # in a .tlog eight bytes stand before each
        raise UserError(
            f"{name}: is MAVLink without time stamps ({joined + 1} frames without a byte between them), expected a log"
            " (.tlog) with 8 bytes of time stamp before each frame: nobody can tell when anything happened;"
            f" {_TELEMETRY}"
        )
