"""A recorded flight as tables: numpy columns, and pandas or polars where they are installed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from groundstation.core.choices import unknown
from groundstation.core.errors import UserError
from groundstation.core.types import FloatArray, IntArray
from groundstation.records.manifest import Values
from groundstation.records.replay import Flight

Column = FloatArray | IntArray
"""One column of a table, shape (rows,)."""


class Log:
    """A recorded flight, read.

    Attributes:
        path: of the file.
        flight: everything that was read, see ``records.replay.Flight``.
    """

    def __init__(self, path: Path, flight: Flight) -> None:
        self.path, self.flight = path, flight

    def __repr__(self) -> str:
        flight = self.flight
        return f"<Log {self.path}: {flight.name}, {len(flight.vehicles)} vehicles, {flight.duration_s:.1f} s>"

    @property
    def vehicles(self) -> list[int]:
        """System ids, in the order of the columns of arrays."""
        return [track.id for track in self.flight.vehicles]

    @property
    def result(self) -> Values:
        """How it ended, as the manifest tells; empty where it does not."""
        manifest = self.flight.manifest
        return (manifest.result if manifest is not None else None) or {}

    @property
    def phases(self) -> list[tuple[str, float, float]]:
        """Name, begin and end of each phase, s."""
        return [(phase.name, self._s(phase.start_ns), self._s(phase.stop_ns)) for phase in self.flight.phases]

    @property
    def events(self) -> list[tuple[float, str]]:
        """Time and text of each event, s."""
        return [(self._s(event.t_ns), event.text) for event in self.flight.events]

    def positions(self) -> dict[str, Column]:
        """Reported positions, a row each: ``t_s``, ``vehicle``, ``x_enu_m``, ``y_enu_m``, ``z_enu_m``."""
        tracks = self.flight.vehicles
        return self._columns([track.t_ns for track in tracks], [track.pos_team_enu_m for track in tracks], "{}_enu_m")

    def setpoints(self) -> dict[str, Column]:
        """Velocities that were sent, a row each: ``t_s``, ``vehicle``, ``vx_enu_m_s`` and so on."""
        tracks = self.flight.vehicles
        return self._columns(
            [track.setpoint_t_ns for track in tracks], [track.setpoint_vel_enu_m_s for track in tracks], "v{}_enu_m_s"
        )

    def at(self, t_s: Sequence[float] | FloatArray) -> FloatArray:
        """Positions of everybody at common instants, interpolated; shape (t, n, 3), NaN where not known."""
        instants: IntArray = np.round(np.asarray(t_s, dtype=np.float64) * 1e9).astype(np.int64) + self.flight.start_ns
        return self.flight.positions_at(instants)

    def to_pandas(self, what: str = "positions") -> Any:
        """``positions`` or ``setpoints`` as a pandas DataFrame.

        Raises:
            UserError: pandas is not installed, or there is no such table.
        """
        return _frame("pandas", self._table(what))

    def to_polars(self, what: str = "positions") -> Any:
        """``positions`` or ``setpoints`` as a polars DataFrame.

        Raises:
            UserError: polars is not installed, or there is no such table.
        """
        return _frame("polars", self._table(what))

    def _table(self, what: str) -> dict[str, Column]:
        tables = {"positions": self.positions, "setpoints": self.setpoints}
        if what not in tables:
            raise UserError(f"{what}: {unknown(what, tables)}")
        return tables[what]()

    def _s(self, t_ns: int) -> float:
        return (t_ns - self.flight.start_ns) / 1e9

    def _columns(self, times_ns: Sequence[IntArray], values: Sequence[FloatArray], name: str) -> dict[str, Column]:
        """Tables of the vehicles one below the other, in order of time."""
        ids = [np.full(len(t_ns), sysid, dtype=np.int64) for sysid, t_ns in zip(self.vehicles, times_ns, strict=True)]
        none: list[IntArray] = [np.zeros(0, dtype=np.int64)]
        t_ns = np.concatenate([*times_ns, *none])
        order = np.argsort(t_ns, kind="stable")
        rows = np.concatenate([*values, np.zeros((0, 3))])[order]
        columns = {name.format(axis): rows[:, number] for number, axis in enumerate("xyz")}
        return {
            "t_s": (t_ns[order] - self.flight.start_ns) / 1e9,
            "vehicle": np.concatenate([*ids, *none])[order],
            **columns,
        }


def _frame(package: str, columns: Mapping[str, Column]) -> Any:
    try:
        module = import_module(package)
    except ImportError:
        raise UserError(f"{package} is not installed: pip install {package}, or take the arrays as they are") from None
    return module.DataFrame(dict(columns))
