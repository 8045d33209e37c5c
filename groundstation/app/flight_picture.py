"""One picture of a flight, and the words beside it: of the report's page, or at the width of a paper's column."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from groundstation.records.replay import Flight

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Picture:
    """One of them.

    Attributes:
        stem: of its files in the report's folder.
        title: heading on the page.
        text: what it shows.
        size_in: width and height in inches.
        draw: draws the flight into an empty figure.
    """

    stem: str
    title: str
    text: str
    size_in: tuple[float, float]
    draw: Callable[[Figure, Flight], None]

    @property
    def file(self) -> str:
        """The one that a page shows."""
        return f"{self.stem}.png"
