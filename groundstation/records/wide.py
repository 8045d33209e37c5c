"""A flight as one wide table, a row for each instant, for programs that know nothing of vehicles and pairs.

Names say vehicle, quantity, frame and unit: ``v3_x_enu_m``. What is not known is NaN: nothing is made up between
reports that are far apart. Writes nothing.
"""

from __future__ import annotations

import itertools

import numpy as np

from groundstation.core.errors import UserError
from groundstation.core.types import FloatArray, IntArray
from groundstation.records.replay import MAX_GAP_NS, Flight
from groundstation.records.tracks import VehicleTrack

PAIRS_MOST = 32
"""Of so many vehicles at most every pair has a column; of larger teams the nearest pair alone is told."""

_ROWS_MOST = 5_000_000
_NS = 1_000_000_000

_UNITS = {"m_s": "m/s", "s": "s", "m": "m", "deg": "degrees"}  # what the end of a name stands for, the longest first

Cells = FloatArray | IntArray | list[str]
"""One column, shape (rows,)."""


def unit(name: str) -> str | None:
    """Unit of a column; None for one that has none."""
    return next((of for end, of in _UNITS.items() if name.endswith(f"_{end}")), None)


def instants(flight: Flight, rate_hz: float) -> IntArray:
    """Times of the rows: so many in a second, or, for 0, whenever a vehicle told its position.

    Args:
        flight: at least one record long.
        rate_hz: not negative.

    Returns:
        ns, shape (rows,), rising.

    Raises:
        UserError: that would be too many rows.
    """
    if rate_hz == 0.0:
        return flight.instants_ns()
    rows = flight.duration_s * rate_hz + 1
    if not rows <= _ROWS_MOST:  # so that a rate that is no number is refused too
        raise UserError(
            f"--rate {rate_hz:g}: {rows:.0f} rows for {flight.duration_s:.0f} s, limit {_ROWS_MOST}; give a lower rate"
        )
    return flight.start_ns + np.round(np.arange(int(rows)) * (_NS / rate_hz)).astype(np.int64)


def wide(flight: Flight, rate_hz: float) -> dict[str, Cells]:
    """The table; columns as docs/exports.md names them.

    Args:
        flight: as read.
        rate_hz: rows in a second, see ``instants``.

    Raises:
        UserError: too many rows.
    """
    t_ns = instants(flight, rate_hz)
    columns: dict[str, Cells] = {"t_s": (t_ns - flight.start_ns) / 1e9, "phase": _phases(flight, t_ns)}
    columns["event"] = _events(flight, t_ns)
    positions = flight.positions_at(t_ns)
    for row, track in enumerate(flight.vehicles):
        columns |= _of_vehicle(flight, track, row, positions[:, row], t_ns)
    columns |= _distances(flight, t_ns)
    columns["formation_error_m"] = flight.formation_error_at(t_ns)
    return columns


def _of_vehicle(flight: Flight, track: VehicleTrack, row: int, pos: FloatArray, t_ns: IntArray) -> dict[str, Cells]:
    name, columns = f"v{track.id}", dict[str, Cells]()
    frame = "enu" if track.in_team_frame else "own_enu"
    for axis, label in enumerate("xyz"):
        columns[f"{name}_{label}_{frame}_m"] = pos[:, axis]
    velocity = _latest(track.t_ns, track.vel_enu_m_s, t_ns)
    setpoint = _latest(track.setpoint_t_ns, track.setpoint_vel_enu_m_s, t_ns)
    for axis, label in enumerate("xyz"):
        columns[f"{name}_v{label}_enu_m_s"] = velocity[:, axis]
        columns[f"{name}_setpoint_v{label}_enu_m_s"] = setpoint[:, axis]
    angles = np.degrees(_latest(track.attitude_t_ns, track.rpy_ned_rad, t_ns))
    for axis, label in enumerate(("roll", "pitch", "yaw")):
        columns[f"{name}_{label}_ned_deg"] = angles[:, axis]
    role: FloatArray = np.full(len(t_ns), np.nan)
    for change, after in itertools.pairwise([*flight.roles, None]):
        if change is not None and row < len(change.roles):
            of = change.roles[row]
            span = (t_ns >= change.t_ns) & (t_ns < (np.iinfo(np.int64).max if after is None else after.t_ns))
            role[span] = np.nan if of is None else of + 1
    columns[f"{name}_role"] = role
    return columns


def _latest(told_ns: IntArray, values: FloatArray, t_ns: IntArray) -> FloatArray:
    """What was told last at each instant, shape (rows, ...); NaN before, and when it is too old to stand for now."""
    held: FloatArray = np.full((len(t_ns), values.shape[1]), np.nan)
    if len(told_ns):
        last = np.searchsorted(told_ns, t_ns, side="right") - 1
        good = (last >= 0) & (t_ns - told_ns[np.maximum(last, 0)] <= MAX_GAP_NS)
        held[good] = values[last[good]]
    return held


def _phases(flight: Flight, t_ns: IntArray) -> list[str]:
    names: list[str] = [""] * len(t_ns)
    for phase in flight.phases:
        first, last = np.searchsorted(t_ns, [phase.start_ns, phase.stop_ns])
        names[first:last] = [phase.name] * int(last - first)
    return names


def _events(flight: Flight, t_ns: IntArray) -> list[str]:
    """Each event stands in the first row that is not before it, or in the last one."""
    texts: list[list[str]] = [[] for _ in t_ns]
    for event in flight.events:
        if texts:
            texts[min(int(np.searchsorted(t_ns, event.t_ns)), len(texts) - 1)].append(event.text)
    return ["; ".join(text) for text in texts]


def _distances(flight: Flight, t_ns: IntArray) -> dict[str, Cells]:
    """Distances of pairs at the instants; the smallest of all reports since the row before: rows hide nothing."""
    columns, ids = dict[str, Cells](), [track.id for track in flight.vehicles]
    first, second = np.triu_indices(len(ids), 1)
    if len(ids) <= PAIRS_MOST:
        distances = flight.distances_at(t_ns)
        for pair, (a, b) in enumerate(zip(first, second, strict=True)):
            columns[f"distance_{ids[a]}_{ids[b]}_m"] = distances[:, pair]
    least: FloatArray = np.full(len(t_ns), np.nan)
    nearest: list[str] = [""] * len(t_ns)
    for at_ns, smallest, of_two in flight.nearest():  # between reports, straight lines come nearer than vehicles did
        for instant in np.flatnonzero(np.isfinite(smallest)).tolist():
            row = min(int(np.searchsorted(t_ns, at_ns[instant])), len(t_ns) - 1)
            if not smallest[instant] >= least[row]:
                least[row] = smallest[instant]
                nearest[row] = f"{ids[first[of_two[instant]]]}-{ids[second[of_two[instant]]]}"
    return columns | {"min_distance_m": least, "min_distance_pair": nearest}
