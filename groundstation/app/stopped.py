"""What Ctrl-C does while no command looks after it itself: it ends the program with a word. Loads next to nothing."""

import os
import signal
import sys

TYPE_CHECKING = False  # as in groundstation/__init__.py; and __future__ would be one more to load
if TYPE_CHECKING:
    from types import FrameType
    from typing import NoReturn

STOPPED = 130
"""What shells report of a program that Ctrl-C has ended."""
STOPPED_WORDS = "gs: stopped by Ctrl-C\n"
STOPPED_JSON = '{"error": "stopped by Ctrl-C", "exit_code": 130}\n'
_IMPORTING = "<frozen importlib._bootstrap"
_SOON_S = 0.02


class CtrlC:
    """Raises KeyboardInterrupt where that can be raised, and waits for such a place elsewhere.

    Raised while a module loads it comes out as something else or not at all: compiled modules make an ImportError of
    it, and whoever can do without a module goes on without. Raised in what the garbage collector calls it is printed
    and forgotten. So it waits until modules are loaded, and is raised again where it was forgotten. A second Ctrl-C
    while one waits ends the program at once, and so does one before a command begins: nothing has been done then.

    Attributes:
        raised: it was; whatever comes out of the program since then comes of it.
        over: set to True where a command has ended, without a call in which one could still come: it counts no more.
    """

    def __init__(self) -> None:
        self.raised = False
        self.over = False
        self._working = False
        self._waits = False

    def listen(self) -> None:
        """Takes SIGINT from now on, where Python does; a program that is to ignore it goes on ignoring it."""
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            signal.signal(signal.SIGINT, self._take)
            sys.unraisablehook = self._forgotten

    def begin(self) -> None:
        """A command begins: what it has opened has to be closed from now on."""
        self._working = True

    def end(self) -> None:
        """All is told: from here on SIGINT ends the process without a word, while Python takes itself apart."""
        signal.setitimer(signal.ITIMER_REAL, 0)
        if signal.getsignal(signal.SIGINT) in (self._take, signal.default_int_handler):
            signal.signal(signal.SIGINT, signal.SIG_DFL)

    def _take(self, _number: int, frame: "FrameType | None") -> None:
        if self.over:
            return
        if not self._working or self._waits:
            _leave()
        loads = _who_loads(frame)
        if loads is None:
            self._raise()
        else:
            self._waits = True
            loads.f_trace = self._loaded
            sys.settrace(_watch_nobody)  # without one Python does not look at f_trace

    def _loaded(self, _frame: "FrameType", _event: str, _argument: object) -> None:
        """The next line of whoever loads a module, or its end."""
        sys.settrace(None)
        self._raise()

    def _raise(self) -> "NoReturn":
        self._waits, self.raised = False, True
        raise KeyboardInterrupt

    def _forgotten(self, unraisable: "sys.UnraisableHookArgs") -> None:
        """What Python would print, and forget, of an exception that nobody can catch."""
        if issubclass(unraisable.exc_type, KeyboardInterrupt):
            signal.signal(signal.SIGALRM, _press)
            signal.setitimer(signal.ITIMER_REAL, _SOON_S)
        else:
            sys.__unraisablehook__(unraisable)


def _who_loads(frame: "FrameType | None") -> "FrameType | None":
    """Who has begun to load the module that is being loaded, further out than a frame; None where there is none."""
    found = None
    while frame is not None:
        if frame.f_code.co_filename.startswith(_IMPORTING):
            found = frame.f_back
        frame = frame.f_back
    return found


def _watch_nobody(_frame: "FrameType", _event: str, _argument: object) -> None:
    """Traces no call."""


def _press(_number: int, _frame: "FrameType | None") -> None:
    """For whoever looks after Ctrl-C by now."""
    signal.raise_signal(signal.SIGINT)


def _leave() -> "NoReturn":
    """Ends the program at once."""
    if "--json" in sys.argv:
        os.write(1, STOPPED_JSON.encode())
    os.write(2, STOPPED_WORDS.encode())
    os._exit(STOPPED)
