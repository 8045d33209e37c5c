"""A monitor that keeps to nothing: what it finds shows what the board lets through."""

from __future__ import annotations

from collections.abc import Iterator

from groundstation.core.types import BoolArray
from groundstation.mission.monitors.findings import Finding, Reaction, Sight


class Accuser:
    """Judges everybody, every two and all together, whoever they are."""

    def __init__(self, reaction: Reaction) -> None:
        self._reaction = reaction

    def look(self, sight: Sight, ours: BoolArray) -> Iterator[Finding]:
        """Finds something wrong with each, and would have all others do the same."""
        ours[:] = True
        n = len(sight.fleet)
        for row in range(n):
            yield Finding(self._reaction, "accused", (row,), lost=True)
            if (
                self._reaction is not Reaction.SAY
            ):  # what has become of somebody may be told of all, and no more than told
                yield Finding(self._reaction, "accused as if told", (row,), fate=True)
            yield Finding(Reaction.SAY, "accused as if told", (row,), lost=True, fate=True)
            yield Finding(self._reaction, "accused beside", (row, (row + 1) % n), pair=True)
        yield Finding(self._reaction, "accused all", tuple(range(n)), lost=True)
