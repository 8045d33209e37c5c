"""Orders from the keyboard of a flight: one key for what is harmless, a confirmation for what is not.

``KeyDialogue`` turns bytes into lines of orders and knows what to show; ``Keyboard`` is the terminal that the bytes
come from. Nothing here waits: the loop reads when there is something to read. Refuses anything but a terminal in whose
foreground the program is, and leaves the terminal as it was, however the flight ends.

Why no library reads the keys: those that there are (prompt_toolkit, textual) switch off the keys that send signals, and
Ctrl-C, which brings everybody home, would be one more byte that waits for the loop. It has to work when nothing else
does.
"""

from __future__ import annotations

import contextlib
import os
import select
import termios
from collections.abc import Sequence
from types import TracebackType
from typing import Any

from groundstation.app.session import Session
from groundstation.mission.operator import parse_command

HELP = "s start  h hold  r resume  b back to the pads  l land here  k kill  Ctrl-C back, again: end setpoints"
KILL_WORD = "kill"
_AT_ONCE = {"s": "start", "h": "hold", "r": "resume", "b": "return"}
_ASKS = {"l": "land", "k": "kill"}
_ESCAPE, _ENTER, _ERASE = "\x1b", "\r\n", "\x7f\x08"
_TYPED_MAX = 60
_READ_BYTES = 256


class KeyDialogue:
    """What was typed so far, and what it comes to.

    Args:
        ids: system ids of the vehicles.

    Attributes:
        problems: why something typed was no order, since the caller last looked.
    """

    def __init__(self, ids: Sequence[int]) -> None:
        self._ids = list(ids)
        self._verb = ""
        self._order = ""
        self._typed = ""
        self._sequence = 0
        self.problems: list[str] = []

    @property
    def prompt(self) -> str:
        """One line for people."""
        if self._order:
            whom = self._order.removeprefix(KILL_WORD).strip()
            what = "everybody falls" if whom == "all" else f"vehicle {whom} falls"
            return f"{what}: type the word {KILL_WORD} and Enter, Esc leaves: {self._typed}"
        if self._verb:
            return f"{self._verb} whom? number, or a for all, then Enter, Esc leaves: {self._typed}"
        return HELP

    @property
    def open(self) -> bool:
        """Whether a question is open."""
        return bool(self._verb or self._order)

    def feed(self, data: bytes) -> list[str]:
        """Takes what was typed.

        Returns:
            Lines of orders, in the order typed; each is one that can be read.
        """
        lines = []
        for key in data.decode("latin-1"):
            line = self._key(key)
            if line:
                lines.append(line)
        if self._sequence == 1:  # an escape with nothing behind it is the key itself
            self._sequence = 0
            self._leave()
        return lines

    def _key(self, key: str) -> str | None:
        if self._sequence == 2:  # arrows and the like: ESC [ ... letter
            self._sequence = 0 if key.isalpha() or key == "~" else 2
            return None
        if self._sequence == 1:
            self._sequence = 2 if key in "[O" else 0
            if self._sequence:
                return None
            self._leave()
        if key == _ESCAPE:
            self._sequence = 1
            return None
        if not self.open:
            return self._first(key.lower())
        if key in _ENTER:
            return self._finished()
        if key in _ERASE:
            self._typed = self._typed[:-1]
        elif key.isprintable() and len(self._typed) < _TYPED_MAX:
            self._typed += key
        return None

    def _first(self, key: str) -> str | None:
        self._verb = _ASKS.get(key, "")
        return _AT_ONCE.get(key)

    def _finished(self) -> str | None:
        typed, self._typed = self._typed.strip().lower(), ""
        if self._order:
            order = self._order
            self._leave()
            if typed == KILL_WORD:
                return order
            self.problems.append(f"{order}: not confirmed, nothing was done")
            return None
        line = f"{self._verb} {'all' if typed in ('a', 'all') else typed}".strip()
        kill = self._verb == KILL_WORD
        self._leave()
        try:
            line = parse_command(line, self._ids).text
        except ValueError as error:
            self.problems.append(str(error))
            return None
        if kill:
            self._order = line
            return None
        return line

    def _leave(self) -> None:
        self._verb = self._order = self._typed = ""


class Keyboard:
    """The terminal as one of the loop's controls, see ``loop.Control``.

    Args:
        descriptor: of the terminal, usually 0.
        ids: system ids of the vehicles.
    """

    def __init__(self, descriptor: int, ids: Sequence[int]) -> None:
        self.dialogue = KeyDialogue(ids)
        self._descriptor = descriptor
        self._before: list[Any] | None = None
        self._lines: list[str] = []

    @staticmethod
    def usable(descriptor: int) -> bool:
        """Whether a descriptor is a terminal that we are in the foreground of."""
        try:
            return os.isatty(descriptor) and os.tcgetpgrp(descriptor) == os.getpgrp()
        except OSError:
            return False

    def __enter__(self) -> Keyboard:
        """Takes keys one by one and unechoed; what was typed before the flight is forgotten.

        Ctrl-C stays what it is. Ctrl-Z, Ctrl-S and Ctrl-backslash would stop the setpoints and do nothing here.
        """
        try:
            self._before = termios.tcgetattr(self._descriptor)
            ours = termios.tcgetattr(self._descriptor)
            ours[0] &= ~(termios.IXON | termios.ICRNL)
            ours[3] &= ~(termios.ICANON | termios.ECHO)
            off = os.fpathconf(self._descriptor, "PC_VDISABLE").to_bytes(1, "little")
            for key in (termios.VSUSP, termios.VQUIT):
                ours[6][key] = off
            ours[6][termios.VMIN], ours[6][termios.VTIME] = 0, 0  # a read never waits
            termios.tcsetattr(self._descriptor, termios.TCSANOW, ours)
            termios.tcflush(self._descriptor, termios.TCIFLUSH)
        except (OSError, termios.error):
            self._restore()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leaves the terminal as it was."""
        self._restore()

    def _restore(self) -> None:
        before, self._before = self._before, None
        if before is not None:
            # Keys that were meant for the flight must not reach the shell.
            with contextlib.suppress(OSError, termios.error):
                termios.tcflush(self._descriptor, termios.TCIFLUSH)
            with contextlib.suppress(OSError, termios.error):
                termios.tcsetattr(self._descriptor, termios.TCSANOW, before)

    def prompt(self) -> str:
        """What to show below the flight; "" when no keys are taken."""
        return "" if self._before is None else self.dialogue.prompt

    def sources(self) -> tuple[int, ...]:
        """The terminal, as long as keys are taken from it."""
        return () if self._before is None else (self._descriptor,)

    def read(self) -> None:
        """Takes what was typed, if anything was; a terminal that has gone ends it."""
        if self._before is None:
            return
        try:
            # An empty read says that the terminal has gone only where there was something to be read.
            if not select.select([self._descriptor], [], [], 0.0)[0]:
                return
            data = os.read(self._descriptor, _READ_BYTES)
        except BlockingIOError:
            return
        except (OSError, ValueError):
            data = b""
        if not data:
            self._restore()
            return
        self._lines += self.dialogue.feed(data)

    def apply(self, session: Session, now_ns: int) -> None:
        """Hands orders over."""
        lines, self._lines = self._lines, []
        for line in lines:
            try:
                session.operator(line, now_ns)
            except ValueError as error:
                self.dialogue.problems.append(str(error))
        problems, self.dialogue.problems = self.dialogue.problems, []
        for problem in problems:
            session.remark("alarm", problem, now_ns)

    def answer(self, session: Session) -> None:
        """The screen shows what became of an order."""
