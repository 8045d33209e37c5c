"""What the commands print, and how they end.

Human-readable by default; with ``--json`` the last line of stdout is one JSON object and all else goes to stderr.
No command prints in any other way.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from rich.console import Console


class Output:
    """The two streams of one command.

    Attributes:
        console: where progress, tables and messages go; stderr when the command answers in JSON.
        json: whether the command answers in JSON.
    """

    def __init__(self, *, as_json: bool) -> None:
        self.json = as_json
        self.console = Console(stderr=as_json, highlight=False, soft_wrap=True)

    def result(self, values: Mapping[str, object]) -> None:
        """Prints the JSON object, where one was asked for."""
        if self.json:
            Console(highlight=False, soft_wrap=True, markup=False, emoji=False).print(to_json(values))


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
