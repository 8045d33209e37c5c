"""What a log is written to: a locked file without buffers, or anything that takes bytes."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Protocol, runtime_checkable

from groundstation.core.own_files import open_alone


class Sink(Protocol):
    """What the writer needs of a binary file."""

    def write(self, data: bytes, /) -> int | None:
        """Takes bytes; may take fewer than it is given, and says how many."""

    def flush(self) -> None:
        """Hands over what it holds back."""

    def close(self) -> None:
        """Ends the file."""


@runtime_checkable
class Settling(Protocol):
    """A file that is written by somebody else, later, and can be waited for."""

    def settle(self) -> None:
        """Waits, not for long, until what it was given is written; raises OSError when it is not."""


class LogFile:
    """A file of a log, locked and without buffers.

    Args:
        path: where it is.
        descriptor: as ``own_files.open_alone`` opened it; it is emptied.
    """

    def __init__(self, path: Path, descriptor: int) -> None:
        self.path = path
        self.descriptor = descriptor
        self._identity = os.fstat(descriptor)
        os.ftruncate(descriptor, 0)

    def write(self, data: bytes | memoryview, /) -> int:
        """Writes as much as the system takes at once."""
        return os.write(self.descriptor, data)

    def flush(self) -> None:
        """Raises when the file has lost its name: what is written to it then is gone when it is closed."""
        try:
            there = os.path.samestat(self.path.lstat(), self._identity)
        except FileNotFoundError:
            raise FileNotFoundError(0, "the file was deleted or moved while it was written") from None
        if not there:
            raise FileNotFoundError(0, "the file was replaced while it was written")

    def close(self) -> None:
        """Ends it, and its lock."""
        os.close(self.descriptor)


def opened(path: Path) -> Sink:
    """A file for a log without a manifest; one that is there is replaced.

    Raises:
        UserError: it cannot be written by this program alone.
    """
    descriptor, _ = open_alone(path, "the log", new=False)
    return LogFile(path, descriptor)
