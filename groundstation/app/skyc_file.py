"""Points of a moment of a drone show: .skyc files, as Skybrush Studio and others export them.

The format: a zip file with ``show.json``; ``swarm.drones[i].settings.trajectory`` is a trajectory, or ``{"$ref":
"./drones/NAME/trajectory.json#"}``. A trajectory (version 1) has ``points``, each ``[t, [x, y, z], [control points]]``,
t in seconds from its ``takeoffTime`` on, metres, z up; the control points are those of the Bézier curve that leads
there from the point before. Nothing is unpacked to a disk; lights, yaw and all else is left alone.
"""

from __future__ import annotations

import itertools
import json
import math
import posixpath
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from groundstation.core.errors import UserError
from groundstation.core.files import require_regular
from groundstation.core.types import FloatArray

_FILE_MAX = 256 << 20
_MEMBER_MAX = 32 << 20  # bytes, unpacked
_TOTAL_MAX = 512 << 20
_DRONES = 2, 2_000
_CURVE_MAX = 20  # control points of one segment
_FAR_M = 1e6


def read_skyc(path: Path, at_s: float) -> FloatArray:
    """Where every drone of a show is at a time.

    Args:
        path: the .skyc file.
        at_s: time of the show, s; who has not taken off yet is where it begins, who is done where it ended.

    Returns:
        Shape (n, 3), m, in the show's own axes, z up, in the order of the show.

    Raises:
        UserError: it cannot be read, or is no such show; names what is wrong in it.
    """
    try:
        require_regular(path, _FILE_MAX, "a .skyc file")
        with zipfile.ZipFile(path) as archive:
            return _Show(path, archive).positions(at_s)
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as error:
        raise UserError(f"{path}: is no .skyc file: {error}") from None


class _Show:
    def __init__(self, path: Path, archive: zipfile.ZipFile) -> None:
        self._path, self._archive = path, archive
        self._left = _TOTAL_MAX

    def positions(self, at_s: float) -> FloatArray:
        show = self._json("show.json")
        drones = self._at(show, "show.json", "swarm", "drones")
        if not isinstance(drones, list) or not _DRONES[0] <= len(drones) <= _DRONES[1]:
            count = len(drones) if isinstance(drones, list) else "no"
            raise self._wrong(
                f"show.json: swarm.drones: has {count} drones, a formation has {_DRONES[0]} to {_DRONES[1]}"
            )
        return np.array([self._position(drone, f"swarm.drones[{number}]", at_s) for number, drone in enumerate(drones)])

    def _position(self, drone: object, where: str, at_s: float) -> Sequence[float]:
        trajectory = self._at(drone, f"show.json: {where}", "settings", "trajectory")
        if isinstance(trajectory, dict) and "$ref" in trajectory:
            name, _, inside = str(trajectory["$ref"]).partition("#")
            where = name
            trajectory = self._at(self._json(name), name, *filter(None, inside.split("/")))
        if not isinstance(trajectory, dict) or trajectory.get("version") != 1:
            raise self._wrong(f"{where}: is no trajectory of version 1")
        points, takeoff = trajectory.get("points"), trajectory.get("takeoffTime", 0.0)
        if not isinstance(points, list) or not points or not _finite([takeoff]):
            raise self._wrong(f"{where}: points, takeoffTime: expected a list that is not empty, and a number")
        before_s, before = -math.inf, list[float]()
        for number, item in enumerate(points):
            time_s, place, controls = self._point(item, f"{where}: points[{number}]")
            time_s += takeoff
            if time_s <= before_s:
                raise self._wrong(f"{where}: points[{number}]: time does not go on")
            if at_s <= time_s:
                if not before:
                    return place
                return _bezier([before, *controls, place], (at_s - before_s) / (time_s - before_s))
            before_s, before = time_s, place
        return before

    def _point(self, item: object, where: str) -> tuple[float, list[float], list[list[float]]]:
        """Time, place and control points of one entry; a fourth coordinate is the yaw, and is left out."""
        if isinstance(item, list) and len(item) in (2, 3) and _finite(item[:1]):
            curve = [item[1], *(item[2] if len(item) == 3 and isinstance(item[2], list) else ())]
            if len(curve) <= _CURVE_MAX and all(
                isinstance(place, list) and len(place) in (3, 4) and _finite(place) for place in curve
            ):
                place, *controls = ([float(value) for value in place[:3]] for place in curve)
                return float(item[0]), place, controls
        raise self._wrong(f"{where}: expected [t, [x, y, z], [control points]], finite numbers")

    def _json(self, name: str) -> object:
        """A member of the archive; names lead nowhere else."""
        inside = posixpath.normpath(name)
        try:
            size = self._archive.getinfo(inside).file_size
        except KeyError:
            raise self._wrong(f"has no {name}") from None
        self._left -= size
        if size > _MEMBER_MAX or self._left < 0:
            raise self._wrong(
                f"{name}: {size >> 20} MB unpacked, limits {_MEMBER_MAX >> 20} MB, {_TOTAL_MAX >> 20} MB in all"
            )
        try:
            with self._archive.open(inside) as member:
                return json.loads(member.read(_MEMBER_MAX))
        except (ValueError, RecursionError) as error:
            raise self._wrong(f"{name}: is not JSON: {error}") from None

    def _at(self, value: object, where: str, *keys: str) -> object:
        for key in keys:
            if not isinstance(value, dict) or key not in value:
                raise self._wrong(f"{where}: {'.'.join(keys)} is missing")
            value = value[key]
        return value

    def _wrong(self, words: str) -> UserError:
        return UserError(f"{self._path}: {words}; is it a .skyc file of a show?")


def _finite(values: Sequence[object]) -> bool:
    """Whether all are numbers of a place or a time."""
    return all(isinstance(value, int | float) and abs(value) <= _FAR_M for value in values)


def _bezier(points: Sequence[Sequence[float]], share: float) -> list[float]:
    """The point of a Bézier curve, by de Casteljau's construction."""
    row = [list(point) for point in points]
    while len(row) > 1:
        row = [[a + share * (b - a) for a, b in zip(*pair, strict=True)] for pair in itertools.pairwise(row)]
    return row[0]
