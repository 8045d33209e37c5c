"""Points that people bring along in CSV and show files, how they are scaled, and files that are made new."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from groundstation.app.skyc_file import read_skyc
from groundstation.core.errors import UserError
from groundstation.core.files import read_text
from groundstation.core.own_files import claim, write_whole
from groundstation.core.types import FloatArray
from groundstation.design.common_shapes import shortest_m

_BYTES_MAX = 1 << 20
_SHOW_MAX_S = 86_400.0


def scale_to(points_m: FloatArray, spacing_m: float | None) -> float:
    """What the points are multiplied by, so that the two nearest are so far apart; points as they are where None."""
    if spacing_m is None:
        return 1.0
    return spacing_m / shortest_m(points_m)


def read_points(path: Path) -> FloatArray:
    """Points of a CSV file: x, y, z in metres, one agent a line; a heading is passed over.

    Raises:
        UserError: cannot be read, or a line that is not three numbers; two points in one place.
    """
    points: list[list[float]] = []
    for number, row in enumerate(csv.reader(read_text(path, _BYTES_MAX, "utf-8-sig").splitlines()), start=1):
        if not row or (number == 1 and not _is_number(row[0])):
            continue
        if len(row) != 3 or not all(map(_is_number, row)):
            raise UserError(
                f"{path}: line {number}: expected three finite numbers x,y,z in metres, got {','.join(row)!r}"
            )
        points.append([float(value) for value in row])
    if not 2 <= len(points) <= 2_000:
        raise UserError(f"{path}: has {len(points)} points; a formation has 2 to 2000")
    array = np.array(points)
    if not shortest_m(array) > 0.0:
        raise UserError(f"{path}: two points are in one place; move one of them")
    return array


def show_points(path: Path, at_s: float) -> FloatArray:
    """Points of a moment of a .skyc show, m.

    Raises:
        UserError: a time that no show has, as ``skyc_file.read_skyc``, or two drones in one place at that time.
    """
    if not 0.0 <= at_s <= _SHOW_MAX_S:
        raise UserError(f"--at {at_s:g}: must be 0 to {_SHOW_MAX_S:.0f} s")
    points = read_skyc(path, at_s)
    if not shortest_m(points) > 0.0:
        raise UserError(f"{path}: two drones are in one place at {at_s:g} s; choose another time with --at")
    return points


def _is_number(text: str) -> bool:
    try:
        return bool(abs(float(text)) <= 1e6)
    except ValueError:
        return False


def write_new(path: Path, text: str, *, force: bool) -> bool:
    """Writes a file that people go on with: one that is there, they have changed perhaps.

    Args:
        path: the file.
        text: what is in it.
        force: replace what is there.

    Returns:
        Whether a file was replaced.

    Raises:
        UserError: it is there, or cannot be written.
    """
    replaced = claim(path, "the new one", "another file with -o", ours=lambda: False, force=force)
    try:
        write_whole(path, text.encode(), durable=False)
    except OSError as error:
        raise UserError(f"{path}: cannot be written: {error.strerror or error}; choose another file with -o") from None
    return replaced
