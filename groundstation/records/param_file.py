"""Files of parameters, as QGroundControl writes and reads them: vehicle, component, name, value and type in each line.

One file holds a whole team. Values are written so that the same 32 bits come back. Refuses lines that say anything
else.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from groundstation.core.errors import UserError
from groundstation.core.files import read_text
from groundstation.core.own_files import claim, write_whole
from groundstation.mavlink.params import REAL32, bits_of_value
from groundstation.mavlink.vehicle import AUTOPILOT_COMPID

_BYTES_MAX = 1 << 26
_MARK = "# kept by gs, the ground station"
_KINDS = range(1, 11)  # MAV_PARAM_TYPE
_VEHICLES = range(1, 10_000)
_NAME_MAX = 16


@dataclass(frozen=True)
class Param:
    """One parameter.

    Attributes:
        value: in the parameter's own unit.
        kind: MAV_PARAM_TYPE.
    """

    value: float
    kind: int

    def same(self, other: Param) -> bool:
        """Whether a vehicle would hold the same bits."""
        if self.kind < REAL32:
            return self.value == other.value
        return bool(np.float32(self.value) == np.float32(other.value))

    def text(self) -> str:
        """As it stands in a file: integers whole, others with as many digits as bring back the same float."""
        if self.kind < REAL32 and float(self.value).is_integer():
            return str(int(self.value))
        return str(np.float32(self.value)) if self.kind == REAL32 else repr(float(self.value))


Team = dict[int, dict[str, Param]]
"""Parameters by system id and name."""


def claim_params(path: Path, *, force: bool | None) -> bool:
    """Makes sure that parameters may be written to a file; returns whether one that is there will be replaced.

    Raises:
        UserError: it is not ours to replace.
    """

    def ours() -> bool:
        with path.open("rb") as file:
            return file.read(len(_MARK)) == _MARK.encode()

    return claim(path, "the parameters", "another file with --file", ours=ours, force=force)


def write_params(path: Path, team: Mapping[int, Mapping[str, Param]], words: str, *, force: bool | None = None) -> bool:
    """Writes a file; returns whether one that was there was replaced.

    Args:
        path: the file; one that this program kept is replaced, another one only with ``force``.
        team: what to write.
        words: what the file is, for people; one line.
        force: replace it whatever it is; None where there is no --force.

    Raises:
        UserError: it cannot be written, or is not ours to replace.
    """
    replaced = claim_params(path, force=force)
    lines = [_MARK, f"# {words}", "# Vehicle-Id\tComponent-Id\tName\tValue\tType"]
    for sysid, params in sorted(team.items()):
        lines += [
            f"{sysid}\t{AUTOPILOT_COMPID}\t{name}\t{item.text()}\t{item.kind}" for name, item in sorted(params.items())
        ]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, "".join(f"{line}\n" for line in lines).encode())
    except OSError as error:
        raise UserError(f"{path}: cannot be written: {error.strerror or error}; name another file") from error
    return replaced


def read_params(path: Path) -> Team:
    """Reads a file: one of ours, or of QGroundControl.

    Raises:
        UserError: unreadable, or a line that is none of a parameter; names file, line and what is wrong.
    """
    team: Team = {}
    for number, line in enumerate(read_text(path, _BYTES_MAX).splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        sysid, compid, name, param = _read(line, f"{path}: line {number}")
        if compid == AUTOPILOT_COMPID:
            team.setdefault(sysid, {})[name] = param
    if not team:
        raise UserError(f"{path}: holds no parameter; expected lines of vehicle, component, name, value and type")
    return team


def _read(line: str, where: str) -> tuple[int, int, str, Param]:
    parts = line.split()
    try:
        if len(parts) != 5:
            raise ValueError(f"has {len(parts)} columns, expected 5: vehicle, component, name, value, type")
        sysid, compid, kind, value = int(parts[0]), int(parts[1]), int(parts[4]), float(parts[3])
        name = parts[2]
        if sysid not in _VEHICLES or not 0 <= compid < 256:
            raise ValueError(f"vehicle {sysid}, component {compid}: must be 1 to {_VEHICLES[-1]} and 0 to 255")
        if not name.isascii() or len(name) > _NAME_MAX:
            raise ValueError(f"{name}: no name that MAVLink carries, {_NAME_MAX} letters at most")
        if kind not in _KINDS or not math.isfinite(value):
            raise ValueError(f"{name}: value {parts[3]} of type {parts[4]}: no number, or no MAV_PARAM_TYPE")
        bits_of_value(value, kind, bytewise=True)
    except ValueError as error:
        raise UserError(f"{where}: {error}") from None
    return sysid, compid, name, Param(value, kind)
