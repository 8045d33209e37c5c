"""The frames of one link of a log as a log for other ground stations, which know vehicles by their system ids alone."""

from __future__ import annotations

import struct
from pathlib import Path

from groundstation.core.errors import UserError
from groundstation.core.own_files import write_whole
from groundstation.mavlink.codec import Encoder
from groundstation.records.notes import Received, Sent
from groundstation.records.tlog import GROUND_COMPID, GROUND_SYSID, read_tlog

_STAMP = struct.Struct(">Q")


def write_link(log: Path, link: int, path: Path, made_by: str) -> dict[str, object]:
    """Writes what went over one link, in both directions, with its stamps and without notes.

    Its first record is a STATUSTEXT that says whence it is. Where a log does not tell the links of what was sent, which
    is where no system id stands on two, all that was sent is in it.

    Args:
        log: of a flight.
        link: number of the link, from 0 as the mission names them.
        path: the file.
        made_by: for the first record.

    Returns:
        How many frames, for people and programs.

    Raises:
        UserError: the log cannot be read, nothing came over that link, or the file cannot be written.
    """
    reader = read_tlog(log)
    content = bytearray()
    links: set[int] = set()
    frames = received = 0
    for record in reader:
        if isinstance(record, Received):
            links.add(record.link)
            received += record.link == link
        if isinstance(record, Received | Sent) and record.link in (link, None):
            stamp = _STAMP.pack(reader.epoch_unix_us + record.t_ns // 1000)
            if not frames:
                text = f"{made_by}: link {link} of {log.name}"[:50]
                first = Encoder(GROUND_SYSID, GROUND_COMPID).encode("STATUSTEXT", severity=6, text=text)
                content += stamp + first
            content += stamp + record.frame.raw
            frames += 1
    if not received:
        known = ", ".join(map(str, sorted(links))) or "none"
        raise UserError(f"{log}: --link {link}: nothing came over it; links in the log: {known}")
    try:
        write_whole(path, bytes(content))
    except OSError as error:
        raise UserError(f"{path}: cannot be written: {error.strerror or error}; name another file with -o") from error
    return {"frames": frames, "bytes": len(content)}
