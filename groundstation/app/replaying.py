"""What ``gs replay`` does besides reading: sends a log's frames to another program, and says what a log lacks."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from rich.table import Table
from rich.text import Text

from groundstation.app.loop import wall_clock_pace
from groundstation.app.output import Output
from groundstation.core.errors import CheckFailed, UserError
from groundstation.mavlink.codec import Frame
from groundstation.records.manifest import manifest_beside
from groundstation.records.notes import Received, Record
from groundstation.records.replay import Flight, load_flight
from groundstation.records.resend import Passing
from groundstation.records.tlog import read_tlog


def useful_flight(out: Output, log: Path, what: str) -> Flight:
    """Reads a log, and prints what people have to know of its figures.

    Args:
        out: where that goes.
        log: the file.
        what: is not done when nothing of use is in it, for the message: "no report was written".

    Raises:
        UserError: the log or its manifest cannot be used.
        CheckFailed: nothing of use is in it.
    """
    flight = load_flight(log)
    for line in (flight.message, *flight.notes, *flight.contents):
        if line is not None:
            out.console.print(Text(line))
    if not flight.useful:
        raise CheckFailed(f"{nothing_in(log)}; {what}")
    return flight


def nothing_in(log: Path) -> str:
    """Words for a log that holds nothing of use; what it holds was printed before."""
    return (
        f"{log}: no vehicle tells a position in it that counts (LOCAL_POSITION_NED, or GLOBAL_POSITION_INT with a place"
        " on earth) and no velocity setpoint was sent; what there is, is listed above"
    )


def parse_target(url: str) -> tuple[str, int]:
    """Reads ``udpout://HOST:PORT``.

    Raises:
        UserError: another kind of link, or no host or port.
    """
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError:
        parts, host, port = urlsplit(""), None, None
    if parts.scheme != "udpout" or not host or not port:
        raise UserError(f"--to {url}: expected udpout://HOST:PORT, for example udpout://127.0.0.1:14550")
    return host, port


def stream(
    records: Iterable[Record],
    passing: Callable[[Frame], bool],
    send: Callable[[bytes], None],
    pace: Callable[[int], None],
    speed: float = 1.0,
) -> int:
    """Sends what vehicles told, in the order of the log.

    Args:
        records: of the log.
        passing: whether a received frame is sent, see ``records.resend``.
        send: takes one frame.
        pace: waits until that many ns have passed since the first frame.
        speed: pace against the recorded one, > 0.

    Returns:
        Number of frames sent.
    """
    frames = 0
    first_ns = None
    for record in records:
        if isinstance(record, Received) and passing(record.frame):
            first_ns = record.t_ns if first_ns is None else first_ns
            pace(int((record.t_ns - first_ns) / speed))
            send(record.frame.raw)
            frames += 1
    return frames


def send_log(log: Path, target: tuple[str, int], speed: float, out: Output) -> dict[str, int]:
    """Sends what the vehicles of a log told to another program, at the pace of the log times ``speed``.

    Raises:
        UserError: nothing can be sent there.
    """
    host, port = target
    manifest = manifest_beside(log)
    reader = read_tlog(log, None if manifest is None else manifest.epoch_unix_us)
    passing = Passing(reader.survey())
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        with socket.socket(family, kind, protocol) as peer, out.console.status(f"sending to {host}:{port}"):

            def send(frame: bytes) -> None:
                # Not connected: a program that is not listening yet must not end the replay.
                peer.sendto(frame, address)

            frames = stream(reader, passing, send, wall_clock_pace(), speed)
    except OSError as error:
        raise UserError(f"--to {host}:{port}: {error.strerror or error}; name a host that can be reached") from error
    for line in passing.words():
        out.console.print(Text(line))
    return {"frames": frames, "frames_not_sent": passing.kept_back.total()}


def figures_table(values: dict[str, Any]) -> Table:
    """The figures of a log for people."""
    table = Table(show_header=False, box=None)
    units = {"duration_s": "s", "min_distance_m": "m", "max_error_m_s": "m/s", "whatif_max_m_s": "m/s"}
    units |= {"whatif_max_at_s": "s", "whatif_rms_m_s": "m/s"}
    for name, value in values.items():
        if isinstance(value, list):  # told below the table
            continue
        words = name.removesuffix("_m_s").removesuffix("_s").removesuffix("_m").replace("_", " ")
        text = f"{value:.4g}" if isinstance(value, float) else "unknown" if value is None else str(value)
        table.add_row(
            words.replace("whatif", "what if:"), f"{text} {units.get(name, '') if value is not None else ''}".strip()
        )
    return table
