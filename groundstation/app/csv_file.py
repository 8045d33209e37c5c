"""A flight as CSV: the wide table, numbers to be read as the same ones again, nothing where none is known."""

from __future__ import annotations

import csv
import io

import numpy as np

from groundstation.records.replay import Flight
from groundstation.records.wide import Cells


def write(_flight: Flight, table: dict[str, Cells], made_by: str) -> tuple[bytes, dict[str, object]]:
    """The file, and what is told of it; ``table`` is ``records.wide.wide`` of the flight."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    # The maker's name is the head of an empty last column: most readers stop at a line of comment.
    writer.writerow([*table, made_by])
    writer.writerows([*row, ""] for row in zip(*map(_as_text, table.values()), strict=True))
    return text.getvalue().encode(), {"rows": len(table["t_s"]), "columns": len(table)}


def _as_text(column: Cells) -> list[str]:
    if isinstance(column, list):
        return column
    return ["" if np.isnan(value) else repr(float(value)) for value in column]
