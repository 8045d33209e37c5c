"""Writes flights for other programs: Parquet and CSV as one wide table, MCAP for Foxglove, recordings for Rerun.

Each file says by whom it was made, so that it is replaced by the same command alone.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from groundstation.core.errors import UserError
from groundstation.core.extras import need
from groundstation.core.own_files import claim, write_whole
from groundstation.records.replay import Flight
from groundstation.records.wide import wide

MADE_BY = "gs export"
KINDS: dict[str, tuple[str, str | None]] = {
    "parquet": ("groundstation.app.parquet_file", "export"),
    "csv": ("groundstation.app.csv_file", None),
    "mcap": ("groundstation.app.mcap_file", "export"),
    "rrd": ("groundstation.app.rrd_file", "rerun"),
    "tlog": ("groundstation.app.link_log", None),
}
"""What ``--to`` names: the module that writes it, and the extra that it needs."""

_PARQUET, _PARQUET_END = b"PAR1", 8  # a file ends with its footer, the footer's length (4 bytes), and this
_STAMP_BYTES, _FRAME = 8, b"\xfd"  # a log begins with a stamp and a frame of MAVLink 2
_MCAP, _RERUN, _HEAD = b"\x89MCAP0\r\n", b"RRF", 256


def claim_export(to: str, path: Path, *, force: bool) -> bool:
    """Makes sure that what is needed is installed, and that the file may be written.

    Returns:
        Whether a file that is there will be replaced.

    Raises:
        UserError: a package is missing, or the file is somebody else's.
    """
    if (extra := KINDS[to][1]) is not None:
        need(extra, f"gs export --to {to}")

    def ours() -> bool:
        return MADE_BY.encode() in _where_named(path.read_bytes())

    return claim(path, "the export", "another file with -o", ours=ours, force=force)


def _where_named(content: bytes) -> bytes:
    """Where a file names its maker: a Parquet file's footer, the head of an MCAP or Rerun file, a CSV's first line."""
    if content.endswith(_PARQUET):
        return content[-_PARQUET_END - int.from_bytes(content[-_PARQUET_END:-4], "little") :]
    if content.startswith((_MCAP, _RERUN)) or content[_STAMP_BYTES : _STAMP_BYTES + 1] == _FRAME:
        return content[:_HEAD]
    return content.partition(b"\n")[0]


def export(flight: Flight, to: str, path: Path, rate_hz: float) -> dict[str, object]:
    """Writes a flight; the file is whole or not there.

    Args:
        flight: as read.
        to: a key of ``KINDS``.
        path: the file.
        rate_hz: rows in a second, 0 for one whenever a vehicle told its position.

    Returns:
        What was written, for people and programs: rows or messages, columns or topics, bytes.

    Raises:
        UserError: there would be too many rows, or the file cannot be written.
    """
    content, told = import_module(KINDS[to][0]).write(flight, wide(flight, rate_hz), MADE_BY)
    try:
        write_whole(path, content)
    except OSError as error:
        raise UserError(f"{path}: cannot be written: {error.strerror or error}; name another file with -o") from error
    return {**told, "bytes": len(content)}
