"""What the commands print, and how they end.

Human-readable by default; with ``--json`` the last line of stdout is one JSON object and all else goes to stderr.
No command prints in any other way. A terminal or pipe that has gone away costs what would have been printed, never the
command: a flight goes on, its log is finished, its exit code is its own.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import sys
from collections.abc import Mapping
from typing import Any, TextIO

from rich.console import Console

_UNBOUNDED = 1_000  # columns


class SteadyConsole(Console):
    """A console that says no more once nobody can hear it."""

    def print(self, *objects: Any, **options: Any) -> None:
        """Prints, see ``rich.console.Console.print``."""
        try:
            super().print(*objects, **options)
        except OSError:
            self.on_broken_pipe()

    def on_broken_pipe(self) -> None:
        """Falls silent, and leaves nothing behind that could fail again when the program ends."""
        self.quiet = True
        let_go_of(sys.stderr if self.stderr else sys.stdout)


def hold_streams() -> None:
    """Makes standard streams that were closed before the program began lead nowhere.

    Their descriptors would otherwise be given to the next files that are opened, a log among them.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115 - for good


def let_go_of(stream: TextIO | None) -> None:
    """Makes a standard stream whose other end is gone lead nowhere."""
    if stream is None:
        return
    with contextlib.suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


def flush_streams() -> None:
    """Writes out what the standard streams hold back; what cannot be written any more is forgotten."""
    for stream in (sys.stdout, sys.stderr):
        if stream is None:
            continue
        try:
            stream.flush()
        except (OSError, ValueError):
            let_go_of(stream)


class Output:
    """The two streams of one command.

    Attributes:
        console: where progress, tables and messages go; stderr when the command answers in JSON.
        json: whether the command answers in JSON.
    """

    def __init__(self, *, as_json: bool) -> None:
        self.json = as_json
        self.console = SteadyConsole(stderr=as_json, highlight=False, soft_wrap=True)
        if not self.console.is_terminal:  # a pipe or a file has no edge that a table would have to fit into
            self.console.width = _UNBOUNDED

    def result(self, values: Mapping[str, object]) -> None:
        """Prints the JSON object, where one was asked for."""
        if self.json:
            print_text(to_json(values))


def print_text(text: str) -> None:
    """Prints text for another program: as it is, without marks or line breaks of our own."""
    SteadyConsole(highlight=False, soft_wrap=True, markup=False, emoji=False).print(text)


def to_json(values: Mapping[str, object]) -> str:
    """Encodes a result as one line of strict JSON; NaN and infinities become null, numpy values plain ones."""
    return json.dumps(_plain(values), allow_nan=False, ensure_ascii=False)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):  # numpy's arrays and numbers, told without loading numpy
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
