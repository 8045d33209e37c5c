"""Turns flights that other programs recorded into logs of this one.

Crazyswarm: the CSV folder of the formation-control experiment by the paper's authors. Its rows are in the order of
roles, whatever the headings say: the program permuted the measured positions with E before it logged them, so that
the columns jump between places when two vehicles swap roles. Here they are put back in the order of vehicles.
Refuses to guess: a value that is missing or cannot be is an error with file, row and remedy.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Any

import numpy as np

from groundstation.core.errors import UserError
from groundstation.core.files import require_regular
from groundstation.core.types import FloatArray, IntArray
from groundstation.mavlink.codec import Encoder, blank, encode_batch
from groundstation.records.manifest import Manifest, manifest_path
from groundstation.records.recording import recording
from groundstation.records.spans import LATEST_UNIX_US
from groundstation.records.tlog import GROUND_COMPID, GROUND_SYSID, TlogWriter

_LOCAL_NED = 1  # MAV_FRAME_LOCAL_NED
_VELOCITY_ONLY = 0x0DC7  # type_mask: position, acceleration, yaw and yaw rate are to be ignored
_MAX_VEHICLES = 250
_PEER = "crazyswarm"
_CSV_MAX = 1 << 30  # bytes of one file


@dataclass(frozen=True)
class CrazyswarmFlight:
    """One flight of the authors' program, in the order of vehicles.

    Attributes:
        unix_us: time of each row, shape (t,), microseconds, strictly increasing.
        pos_team_enu_m: measured positions, shape (t, n, 3), motion-capture world frame, z up.
        control_enu_m_s: control vectors after collision avoidance, before their gain, stop flags and saturation,
            shape (t, n, 3).
        role_of_vehicle: shape (t, n), from 0.
        stopped: roles without a free direction after swapping, shape (t, n), 0 or 1, by role.
        stopped_before: the same before swapping.
    """

    unix_us: IntArray
    pos_team_enu_m: FloatArray
    control_enu_m_s: FloatArray
    role_of_vehicle: IntArray
    stopped: IntArray
    stopped_before: IntArray


def read_crazyswarm(folder: Path) -> CrazyswarmFlight:
    """Reads the six CSV files of one flight.

    Raises:
        UserError: a file is missing, or a value in it cannot be used.
    """
    if not folder.is_dir():
        raise UserError(f"{folder}: no such folder; give the one that holds positions.csv and time_stamp.csv")
    unix_us = _times(folder / "time_stamp.csv")
    rows = len(unix_us)
    by_role = _table(folder / "positions.csv", rows)
    n, rest = divmod(by_role.shape[1], 3)
    if rest or not 1 <= n <= _MAX_VEHICLES:
        raise UserError(
            f"{folder / 'positions.csv'}: {by_role.shape[1]} columns, expected x, y, z for each of 1 to "
            f"{_MAX_VEHICLES} vehicles"
        )
    control = _table(folder / "control_velocity.csv", rows, 3 * n)
    matrices = _table(folder / "permutations.csv", rows, n * n).reshape(rows, n, n)
    _check_permutations(folder / "permutations.csv", matrices)
    role_of_vehicle = matrices.argmax(axis=1)
    row = np.arange(rows)[:, None]
    positions = by_role.reshape(rows, n, 3)[row, role_of_vehicle]
    return CrazyswarmFlight(
        unix_us=unix_us,
        pos_team_enu_m=positions,
        control_enu_m_s=control.reshape(rows, n, 3)[row, role_of_vehicle],
        role_of_vehicle=role_of_vehicle,
        stopped=_flags(folder / "stopFlag.csv", rows, n),
        stopped_before=_flags(folder / "stopFlag_old.csv", rows, n),
    )


def import_crazyswarm(
    folder: Path,
    log: Path,
    versions: Mapping[str, str],
    formation: Mapping[str, Any] | None = None,
    radius_m: float | None = None,
) -> Manifest:
    """Writes a flight of the authors' program as a log with its manifest.

    Positions become LOCAL_POSITION_NED of systems 1 to n at the times of the rows, with velocities NaN: they were not
    logged, and 0 would be a claim. Control vectors become SET_POSITION_TARGET_LOCAL_NED from the ground station.
    Changes of roles and of stop flags become notes.

    Args:
        folder: the CSV files.
        log: .tlog file to write; its manifest goes beside it.
        versions: for the manifest.
        formation: what was to be formed (``name``, ``points``, ``edges`` from 1), which the CSV files do not say.
        radius_m: r, which they do not say either.

    Returns:
        The manifest, as written.

    Raises:
        UserError: the folder cannot be used, or a file cannot be written; then no log is left behind.
    """
    flight = read_crazyswarm(folder)
    n = flight.pos_team_enu_m.shape[1]
    if formation is not None and len(formation["points"]) != n:
        raise UserError(
            f"{folder}: {n} vehicles, the formation {formation['name']} has {len(formation['points'])} points; "
            "name the formation that was flown"
        )
    epoch_unix_us = int(flight.unix_us[0])
    mission: dict[str, Any] = {
        "name": folder.resolve().name,
        "source": "crazyswarm",
        "vehicles": [{"id": k + 1, "origin": "team"} for k in range(n)],
    }
    if formation is not None:
        mission["formation"] = dict(formation)
    if radius_m is not None:
        mission["avoidance"] = {"radius_m": radius_m}
    manifest = Manifest(mission=mission, epoch_unix_us=epoch_unix_us, versions=versions)
    with recording(log, manifest, replace=True) as writer:
        _write_flight(writer, flight)
    if writer.problem is not None:
        for path in (log, manifest_path(log)):
            path.unlink(missing_ok=True)
        raise UserError(f"{writer.problem}; make room or give another place")
    return manifest


def _write_flight(writer: TlogWriter, flight: CrazyswarmFlight) -> None:
    n = flight.pos_team_enu_m.shape[1]
    vehicles = [Encoder(k + 1) for k in range(n)]
    ground = Encoder(GROUND_SYSID, GROUND_COMPID)
    roles: tuple[int, ...] = ()
    stopped: tuple[int, ...] = ()
    for row, unix_us in enumerate(flight.unix_us):
        since_us = int(unix_us - flight.unix_us[0])
        t_ns = since_us * 1000
        boot_ms = since_us // 1000
        for frame in encode_batch("LOCAL_POSITION_NED", _positions(flight.pos_team_enu_m[row], boot_ms), vehicles):
            writer.received(0, _PEER, frame, t_ns)
        now = tuple(int(role) for role in flight.role_of_vehicle[row])
        if now != roles:
            roles = now
            writer.roles(roles, t_ns)
        halted = tuple(int(role) + 1 for role in np.flatnonzero(flight.stopped[row]))
        swapped = tuple(int(role) + 1 for role in np.flatnonzero(flight.stopped_before[row] > flight.stopped[row]))
        if swapped:
            writer.event(f"info: gridlock: {_roles(swapped)} swap", t_ns)
        if halted != stopped:
            stopped = halted
            writer.event(f"info: no free direction: {_roles(stopped)}", t_ns)
        control = _setpoints(flight.control_enu_m_s[row], boot_ms)
        for frame in encode_batch("SET_POSITION_TARGET_LOCAL_NED", control, [ground] * n):
            writer.sent(frame, t_ns)


def _positions(pos_team_enu_m: FloatArray, boot_ms: int) -> Any:
    values = blank("LOCAL_POSITION_NED", len(pos_team_enu_m))
    values["time_boot_ms"] = boot_ms
    values["x"], values["y"], values["z"] = pos_team_enu_m[:, 1], pos_team_enu_m[:, 0], -pos_team_enu_m[:, 2]
    for name in ("vx", "vy", "vz"):
        values[name] = np.nan
    return values


def _setpoints(vel_enu_m_s: FloatArray, boot_ms: int) -> Any:
    values = blank("SET_POSITION_TARGET_LOCAL_NED", len(vel_enu_m_s))
    values["time_boot_ms"] = boot_ms
    values["target_system"] = np.arange(1, len(vel_enu_m_s) + 1)
    values["target_component"] = 1
    values["coordinate_frame"] = _LOCAL_NED
    values["type_mask"] = _VELOCITY_ONLY
    values["vx"], values["vy"], values["vz"] = vel_enu_m_s[:, 1], vel_enu_m_s[:, 0], -vel_enu_m_s[:, 2]
    return values


def _roles(roles: tuple[int, ...]) -> str:
    return f"roles {', '.join(map(str, roles))}" if roles else "none"


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    """Rows below the heading, with their line numbers from 1."""
    try:
        require_regular(path, _CSV_MAX, "CSV")
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.reader(file)
            next(reader, None)
            rows = [(reader.line_num, row) for row in reader]
    except FileNotFoundError as error:
        raise UserError(f"{path}: no such file; copy all six CSV files of the flight into the folder") from error
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UserError(f"{path}: cannot be read as CSV: {error}; copy it again from the original") from error
    while rows and not rows[-1][1]:
        rows.pop()
    if not rows:
        raise UserError(f"{path}: no rows below the heading; copy it again from the original")
    return rows


def _times(path: Path) -> IntArray:
    times: list[int] = []
    for line, row in _rows(path):
        try:
            unix_s = Decimal(row[0])  # judged before it is written out: 1e999999999 would take all memory
            unix_us = int((unix_s * 1_000_000).to_integral_value()) if 0 < unix_s < LATEST_UNIX_US // 1_000_000 else -1
        except (InvalidOperation, ValueError, OverflowError, IndexError):
            unix_us = -1
        if len(row) != 1 or not 0 < unix_us < LATEST_UNIX_US:
            raise UserError(
                f"{path}: line {line}: {','.join(row)!r} is not one time in unix seconds before 2100; "
                "remove the row from all six files"
            )
        if times and unix_us <= times[-1]:
            raise UserError(f"{path}: line {line}: {row[0]} is not later than the line before; put the rows in order")
        times.append(unix_us)
    return np.array(times, dtype=np.int64)


def _table(path: Path, rows: int, columns: int | None = None) -> FloatArray:
    table: list[list[float]] = []
    for line, row in _rows(path):
        columns = len(row) if columns is None else columns
        if len(row) != columns:
            raise UserError(f"{path}: line {line}: {len(row)} values, expected {columns}; the row is damaged")
        values = []
        for number, text in enumerate(row, start=1):
            try:
                value = float(text)
            except ValueError:
                value = math.nan
            if not math.isfinite(value):
                raise UserError(
                    f"{path}: line {line}, column {number}: {text!r} is not a finite number; remove the row from all "
                    "six files"
                )
            values.append(value)
        table.append(values)
    if len(table) != rows:
        raise UserError(
            f"{path}: {len(table)} rows, time_stamp.csv has {rows}; the files belong to different flights or one was "
            "cut off"
        )
    return np.array(table, dtype=np.float64)


def _flags(path: Path, rows: int, n: int) -> IntArray:
    table = _table(path, rows, n)
    bad = np.argwhere((table != 0) & (table != 1))
    if len(bad):
        row, column = bad[0]
        raise UserError(
            f"{path}: line {row + 2}, column {column + 1}: {table[row, column]:g}: expected 0 or 1; is this the stop "
            "flags' file?"
        )
    return table.astype(np.int64)


def _check_permutations(path: Path, matrices: FloatArray) -> None:
    good = np.all((matrices == 0) | (matrices == 1), axis=(1, 2))
    good &= np.all(matrices.sum(axis=1) == 1, axis=1) & np.all(matrices.sum(axis=2) == 1, axis=1)
    if not good.all():
        row = int(np.flatnonzero(~good)[0])
        raise UserError(
            f"{path}: line {row + 2}: not a permutation matrix (one 1 in each row and column, else 0); remove the row "
            "from all six files"
        )
