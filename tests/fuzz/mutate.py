"""Bytes to be thrown at parsers: random ones, and real ones that were bent, cut, doubled and spliced. Seeded."""

from __future__ import annotations

import json
from collections.abc import Sequence
from random import Random
from typing import Any

_CASE_MAX = 4_096
_BYTES = (0x00, 0x01, 0x7F, 0x80, 0xFD, 0xFE, 0xFF)


class Mutator:
    """Makes cases out of samples.

    Args:
        samples: real input.
        words: pieces that mean something to the parser.
        random: source of all chance.
    """

    def __init__(self, samples: Sequence[bytes], words: Sequence[bytes], random: Random) -> None:
        self._samples, self._words, self._random = tuple(samples), tuple(words), random

    def case(self) -> bytes:
        """One case: every eighth is random bytes alone, the others are mutated."""
        random = self._random
        if not self._samples or random.random() < 1 / 8:
            return random.randbytes(random.randrange(1, 600))
        data = bytearray(random.choice(self._samples))
        if len(data) > _CASE_MAX:
            start = random.randrange(len(data) - _CASE_MAX) if random.random() < 0.5 else 0
            data = data[start : start + _CASE_MAX]
        for _ in range(random.choice((1, 1, 2, 3, 8, 20))):
            self._mutate(data)
        return bytes(data)

    def _mutate(self, data: bytearray) -> None:
        random = self._random
        at = random.randrange(len(data) + 1)
        stop = min(at + random.choice((1, 2, 4, 8, 30, 300)), len(data))
        kind = random.randrange(8)
        if kind == 0 and at < len(data):
            data[at] ^= 1 << random.randrange(8)
        elif kind == 1 and at < len(data):
            data[at] = random.choice(_BYTES)
        elif kind == 2:
            del data[at:stop]
        elif kind == 3:
            data[at:at] = data[at:stop]
        elif kind == 4:
            data[at:at] = random.randbytes(random.randrange(1, 40))
        elif kind == 5:
            other = random.choice(self._samples)
            cut = random.randrange(len(other) + 1)
            data[at:stop] = other[cut : cut + random.choice((1, 10, 100, 1000))]
        elif kind == 6 and self._words:
            data[at : random.choice((at, stop))] = random.choice(self._words)
        elif kind == 7 and len(data) > 1:
            del data[at:]
        del data[4 * _CASE_MAX :]


def bend(values: Any, random: Random) -> Any:
    """Replaces, removes or moves some of the values of a nested structure; it stays what YAML and JSON can say."""
    places: list[tuple[Any, Any]] = []

    def collect(item: Any) -> None:
        inside = item.items() if isinstance(item, dict) else enumerate(item) if isinstance(item, list) else ()
        for key, value in inside:
            places.append((item, key))
            collect(value)

    collect(values)
    for _ in range(random.choice((1, 1, 2, 5))):
        parent, key = random.choice(places)
        other, other_key = random.choice(places)
        try:
            old = other[other_key]
            if random.random() < 0.1:
                del parent[key]
            elif random.random() < 0.2:
                parent[key] = json.loads(json.dumps(old))
            else:
                parent[key] = random.choice(_VALUES)
        except (KeyError, IndexError):  # it went with what was removed before
            continue
    return values


_VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2, 255, 256, 1 << 31, 1 << 63, 10**30, 0.0, -0.0, 0.5, 1e-308, 1e308, -1e308,
    float("nan"), float("inf"), "", "x", "0", "pad", "gps", "team", "global", "px4", "auto", "free", [], {}, [0, 0, 0],
    [1e308] * 3, [[]], ["a", "b", "c"], {"a": 1}, [[1, 2]], "complete", "udpin://h:1", "\x00", "\ud7ff", "\ud800",
    "x" * 500,
)  # fmt: skip
