"""The table of a campaign: rows go to Parquet as they finish, in part files that are whole or not there.

At the end the parts are merged into one table sorted by run, which is the same, byte for byte, however often the
campaign was killed and resumed and however many workers flew it. Wall times, which are not, stand in a table of their
own.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa  # type: ignore[import-untyped]
import pyarrow.parquet as pq  # type: ignore[import-untyped]

from groundstation.app.campaign.words import KINDS
from groundstation.core.errors import UserError
from groundstation.core.own_files import write_whole

_TEXT, _REAL, _WHOLE, _YES = pa.string(), pa.float64(), pa.int64(), pa.bool_()
SCHEMA = pa.schema(
    [
        ("run", _WHOLE),
        ("seed", _WHOLE),
        ("cell", _TEXT),
        ("drawn", _TEXT),
        ("error", _TEXT),
        ("vehicles", _WHOLE),
        ("safety_radius_m", _REAL),
        ("outcome", _TEXT),
        ("reason", _TEXT),
        ("success", _YES),
        ("formed", _YES),
        ("safe", _YES),
        ("time_to_form_s", _REAL),
        ("kinematic_time_to_form_s", _REAL),
        ("formation_error_m", _REAL),
        ("hold_speed_m_s", _REAL),
        ("min_distance_m", _REAL),
        ("nearest_pair", _TEXT),
        ("min_obedient_m", _REAL),
        ("min_clearance", _REAL),
        ("start_distance_m", _REAL),
        ("gridlocks", _WHOLE),
        ("role_swaps", _WHOLE),
        ("detours", _WHOLE),
        ("setpoints", _WHOLE),
        ("ticks", _WHOLE),
        ("duration_s", _REAL),
        ("phases", _TEXT),
        ("end", _TEXT),
        ("ended_safely", _YES),
        ("alarms", _TEXT),
        ("told", _YES),
        ("faults", _TEXT),
        ("fault_phase", _TEXT),
        ("fault_vehicle", _WHOLE),
        ("fault_at_s", _REAL),
        ("log_mismatches", _WHOLE),
        ("log_complete", _YES),
        ("events", _TEXT),
        ("tracebacks", _WHOLE),
        *((kind, _WHOLE) for kind in KINDS),
        ("disagreements", _WHOLE),
        ("disagreed", _TEXT),
    ]
)
_TIMES = pa.schema([("run", _WHOLE), ("wall_s", _REAL)])
_PART = pa.schema([*SCHEMA, *list(_TIMES)[1:]])


class Table:
    """The rows of one campaign on disk.

    Args:
        folder: of the campaign.

    Attributes:
        runs_path: the merged table.
        times_path: wall time of each run.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.runs_path, self.times_path = folder / "runs.parquet", folder / "wall.parquet"
        self._identity_path, self._parts = folder / "campaign.json", folder / "parts"
        self._next = 0

    def there(self) -> bool:
        """Whether the folder is a campaign's."""
        return self._identity_path.exists()

    def open(self, identity: Mapping[str, Any], *, resume: bool) -> set[int]:
        """Begins a campaign, or goes on with one.

        Args:
            identity: what the rows follow from; ``fingerprint`` and ``versions`` decide whether rows belong together.
            resume: go on with what is there.

        Returns:
            Numbers of the runs that are there already.

        Raises:
            UserError: there is another campaign, or the folder cannot be written.
        """
        try:
            self._parts.mkdir(parents=True, exist_ok=True)
            if self.runs_path.exists() or self._part_paths():
                self._check(identity, resume=resume)
            write_whole(self._identity_path, (json.dumps(dict(identity), indent=1) + "\n").encode())
        except OSError as error:
            raise UserError(
                f"{self.folder}: cannot be written: {error.strerror or error}; give another folder"
            ) from None
        numbers = [int(path.stem.removeprefix("part-")) for path in self._part_paths()]
        self._next = max(numbers, default=-1) + 1
        return {row["run"] for row in self._rows(["run"])}

    def _check(self, identity: Mapping[str, Any], *, resume: bool) -> None:
        """Refuses to put rows to those that are there unless both follow from the same."""
        name = self._identity_path.name
        try:
            there = json.loads(self._identity_path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise UserError(
                f"{self.folder}: holds rows but no {name}, so that nobody can tell what they follow from; "
                f"give another folder, or put {name} back"
            ) from None
        except ValueError:
            there = None
        if not isinstance(there, dict):
            raise UserError(
                f"{self.folder}: {name} cannot be read, so that nobody can tell what the rows follow from; "
                f"give another folder, or put {name} back"
            )
        if not resume:
            raise UserError(f"{self.folder}: holds a campaign already; go on with --resume, or give another folder")
        for key in ("fingerprint", "versions"):
            if there.get(key) != identity[key]:
                what = "other versions" if key == "versions" else "another mission, seed or vary file"
                raise UserError(f"{self.folder}: its runs were made with {what}; rows of both would not go together")

    def append(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Writes rows that have finished; they are on disk when this returns.

        Raises:
            UserError: they cannot be written.
        """
        if not rows:
            return
        path = self._parts / f"part-{self._next:06d}.parquet"
        self._next += 1
        try:
            self._write(path, pa.Table.from_pylist([dict(row) for row in rows], schema=_PART))
        except OSError as error:
            raise UserError(f"{path}: cannot be written: {error.strerror or error}; make room, then --resume") from None

    def merge(self) -> list[dict[str, Any]]:
        """Puts all rows into one table, sorted by run, and returns them; NaN stays NaN.

        Parts are removed once all that they hold is in the tables.

        Raises:
            UserError: the tables cannot be written; the rows are still where they were.
        """
        rows = sorted(self._rows(None), key=lambda row: int(row["run"]))
        unique = list({row["run"]: row for row in rows}.values())
        if unique:
            whole = pa.Table.from_pylist(unique, schema=_PART)
            try:
                self._write(self.runs_path, whole.select(SCHEMA.names).cast(SCHEMA))
                self._write(self.times_path, whole.select(_TIMES.names).cast(_TIMES))
                for path in self._part_paths():
                    path.unlink()
            except OSError as error:
                raise UserError(
                    f"{self.runs_path}: cannot be written: {error.strerror or error}; "
                    f"all rows are in {self.folder}: make room, then --resume"
                ) from None
        return unique

    def _rows(self, columns: list[str] | None) -> list[dict[str, Any]]:
        rows: list[dict[str, Any]] = []
        if self.runs_path.exists():
            merged = _read(self.runs_path, SCHEMA, columns)
            times = self._times() if columns is None else {}
            rows += [{**row, "wall_s": times.get(row["run"], math.nan)} for row in merged]
        for path in self._part_paths():
            rows += _read(path, _PART, columns)
        return rows

    def _times(self) -> dict[int, float]:
        """Wall times by run; none where their table is gone, which costs no run."""
        if not self.times_path.exists():
            return {}
        return {row["run"]: row["wall_s"] for row in _read(self.times_path, _TIMES, None)}

    def _part_paths(self) -> list[Path]:
        return sorted(self._parts.glob("part-*.parquet"))

    def _write(self, path: Path, table: pa.Table) -> None:
        sink = pa.BufferOutputStream()
        pq.write_table(table, sink, compression="zstd")
        write_whole(path, sink.getvalue().to_pybytes())


def _read(path: Path, schema: pa.Schema, columns: list[str] | None) -> list[dict[str, Any]]:
    """Reads a table that has at least the columns of a schema."""
    remedy = "--resume then goes on without its times" if schema is _TIMES else "--resume then flies its runs again"
    try:
        missing = [name for name in schema.names if name not in pq.read_schema(path).names]
        if missing:
            raise UserError(f"{path}: has no column {missing[0]}: not of this version; move it away, {remedy}")
        rows: list[dict[str, Any]] = pq.read_table(path, columns=columns).to_pylist()
    except (OSError, pa.ArrowException) as error:
        raise UserError(f"{path}: cannot be read: {error}; move it away, {remedy}") from None
    return rows
