"""The log of a flight on its way to the disk: a thread writes and syncs, so that no tick waits for a disk.

Every second the recorder hands over what it has; the thread writes it, brings it to the disk with fsync, and takes what
has come in the meantime. A power cut so costs what was recorded since the last fsync ended: a second, and what the disk
takes to do it. A disk that takes nothing more ends the recording and never the flight.
"""

from __future__ import annotations

import errno
import os
import threading
import time
from collections.abc import Callable

from groundstation.app.session import Session
from groundstation.records.log_file import LogFile

_WAITING_MAX = 64 << 20  # bytes that a disk may be behind
_SETTLE_S = 0.2
_CLOSE_S = 20.0
LATE_S = 5.0
"""So far behind, the disk is worth a word."""


class SteadyFile:
    """A file that is written by a thread of its own. Errors of the thread are raised at the next call.

    Args:
        file: where to write.
        sync: brings a descriptor's content to the disk; fsync where it is not given.
        clock: seconds, for telling how far the disk is behind.

    Attributes:
        path: of the file.
        syncs: how often it was brought to the disk.
    """

    def __init__(
        self,
        file: LogFile,
        sync: Callable[[int], None] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.path = file.path
        self.syncs = 0
        self._file = file
        self._sync, self._clock = sync or os.fsync, clock
        self._waiting = bytearray()
        self._since: float | None = None  # when the oldest byte came that is not on the disk
        self._error: OSError | None = None
        self._ended = False
        self._change = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="log", daemon=True)
        self._thread.start()

    def write(self, data: bytes, /) -> int:
        """Takes bytes; never waits for the disk."""
        with self._change:
            self._raise()
            if len(self._waiting) + len(data) > _WAITING_MAX:
                raise OSError(errno.EIO, f"the disk is {_WAITING_MAX >> 20} MB behind")
            self._waiting += data
            self._since = self._clock() if self._since is None else self._since
            self._change.notify_all()
        return len(data)

    def flush(self) -> None:
        """Tells of what has gone wrong by now; writing needs no push."""
        with self._change:
            self._raise()

    def settle(self) -> None:
        """Waits for the disk, a fifth of a second at most: for before a flight, when nobody is in the air."""
        with self._change:
            self._change.wait_for(lambda: self._since is None or self._error is not None, _SETTLE_S)
            self._raise()
            if self._waiting:
                raise OSError(errno.EIO, f"the disk has taken nothing for {_SETTLE_S} s")

    def late_s(self) -> float:
        """How old the oldest byte is that is not on the disk yet."""
        since = self._since
        return 0.0 if since is None else self._clock() - since

    def close(self) -> None:
        """Waits until everything is on the disk, and ends the file.

        Raises:
            OSError: something is not on the disk.
        """
        with self._change:
            self._ended = True
            self._change.notify_all()
        self._thread.join(_CLOSE_S)
        if self._thread.is_alive():  # it hangs in the disk, and the file with it
            raise OSError(errno.EIO, f"the disk has not taken all of it for {_CLOSE_S:.0f} s")
        self._file.close()
        self._raise()

    def _raise(self) -> None:
        if self._error is not None:
            raise self._error

    def _run(self) -> None:
        try:
            while True:
                with self._change:
                    self._change.wait_for(lambda: self._waiting or self._ended)
                    if not self._waiting:
                        return
                    data, self._waiting = bytes(self._waiting), bytearray()
                    began = self._clock()
                view = memoryview(data)
                while view:
                    view = view[self._file.write(view) :]
                self._file.flush()
                self._sync(self._file.descriptor)
                with self._change:
                    self.syncs += 1
                    self._since = began if self._waiting else None
                    self._change.notify_all()
        except OSError as error:
            with self._change:
                self._error = error
                self._change.notify_all()


class Disk:
    """Looks on after every tick whether the log reaches the disk in time, and says so once when it does not."""

    def __init__(self) -> None:
        self.file: SteadyFile | None = None
        self._told = False

    def through(self, file: LogFile) -> SteadyFile:
        """Has a log written through a thread, which is looked at from then on."""
        self.file = SteadyFile(file)
        return self.file

    def __call__(self, session: Session, now_ns: int) -> None:
        """Looks on after a tick; see ``loop.Watcher``."""
        if self.file is not None and not self._told and self.file.late_s() > LATE_S:
            self._told = True
            text = f"{self.file.path}: the disk is {LATE_S:.0f} s behind; what is not on it is lost if the power fails"
            session.remark("alarm", text, now_ns)
