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

import numpy as np
from rich.console import Console


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


def let_go_of(stream: TextIO) -> None:
    """Makes a standard stream whose other end is gone lead nowhere."""
    with contextlib.suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


def flush_streams() -> None:
    """Writes out what the standard streams hold back; what cannot be written any more is forgotten."""
    for stream in (sys.stdout, sys.stderr):
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

    def result(self, values: Mapping[str, object]) -> None:
        """Prints the JSON object, where one was asked for."""
        if self.json:
            SteadyConsole(highlight=False, soft_wrap=True, markup=False, emoji=False).print(to_json(values))


def to_json(values: Mapping[str, object]) -> str:
    """Encodes a result as one line of strict JSON; NaN and infinities become null, numpy values plain ones."""
    return json.dumps(_plain(values), allow_nan=False, ensure_ascii=False)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
