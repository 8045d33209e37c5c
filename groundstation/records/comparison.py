"""Several flights side by side: figures of each, and how far they deviate from each other.

Flights are laid over each other at the moment at which they began to form, or to fly anything else than up. What a log
does not tell (a common frame, a formation, setpoints) is NaN and not made up. Draws nothing.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from groundstation.core.phases import FORMATION_PHASES
from groundstation.core.types import FloatArray, IntArray
from groundstation.records.replay import Flight

_STEPS = frozenset(phase.value for phase in FORMATION_PHASES)
_GRID_S = 0.05
_WAY_S = 0.2  # positions nearer in time than that would add their noise to the way
_GAP_S = 1.0  # a setpoint counts until the next one, and no longer than that
_MOST_INSTANTS = 20_000


@dataclass(frozen=True)
class Summary:
    """What one flight came to; NaN where its log does not tell.

    Attributes:
        label: names it among the others.
        outcome: completed, aborted, or "" where no manifest tells.
        vehicles: how many.
        time_to_form_s: until the first formation stood.
        hold_error_m: largest formation error while it was held, as reported.
        min_distance_m: smallest distance in the air: the true one where the manifest tells it, else as reported.
        safety_radius_m: r.
        flight_s: from takeoff to the end.
        way_m: how far a vehicle flew, mean of all.
        effort_m: integral of the length of the setpoints of a vehicle, mean of all: what it was asked to fly.
        effort_m2_s: the same of their squares.
    """

    label: str
    outcome: str
    vehicles: int
    time_to_form_s: float
    hold_error_m: float
    min_distance_m: float
    safety_radius_m: float
    flight_s: float
    way_m: float
    effort_m: float
    effort_m2_s: float


@dataclass(frozen=True)
class Deviation:
    """How far two flights are from each other, where both tell positions in the team's frame.

    Attributes:
        first: label.
        second: label.
        vehicles: those that are in both.
        seconds: how long they are compared, from when both begin to form.
        rms_m: of the distances between a vehicle's places in both, all vehicles and instants.
        max_m: the largest of these.
        vehicle: whose that is; 0 where nothing is known.
        at_s: when, from the common begin.
        distance_max_m: largest difference of a distance between two vehicles.
    """

    first: str
    second: str
    vehicles: int
    seconds: float
    rms_m: float
    max_m: float
    vehicle: int
    at_s: float
    distance_max_m: float


def begin_ns(flight: Flight) -> int:
    """When a flight began to form, or to fly its other steps; its first record where it tells no phases."""
    return next((phase.start_ns for phase in flight.phases if phase.name in _STEPS), flight.start_ns)


def labels(flights: Sequence[Flight], names: Sequence[str]) -> list[str]:
    """Names for flights: those of their files, numbered where several are the same.

    Args:
        flights: as read.
        names: of their files.
    """
    counts = {name: names.count(name) for name in names}
    return [f"{number + 1} {name}" if counts[name] > 1 else name for number, name in enumerate(names[: len(flights)])]


def summary(flight: Flight, label: str) -> Summary:
    """Figures of one flight."""
    result = (flight.manifest.result if flight.manifest is not None else None) or {}

    def told(key: str) -> float:
        value = result.get(key)
        return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan

    holds = [phase for phase in flight.phases if phase.name == "hold"]
    instants = flight.instants_ns()
    held = np.concatenate([_within(instants, phase.start_ns, phase.stop_ns) for phase in holds] or [instants[:0]])
    error = flight.formation_error_at(np.unique(held))
    takeoff = next((phase.start_ns for phase in flight.phases if phase.name == "takeoff"), flight.start_ns)
    distance_m = told("min_distance_m")
    if not math.isfinite(distance_m):
        reported = flight.min_distance_m()
        distance_m = math.nan if reported is None else reported
    flown_s = told("duration_s")
    way_m, asked_m, asked_m2_s = _ways(flight)
    return Summary(
        label=label,
        outcome=str(result.get("outcome") or ""),
        vehicles=len(flight.vehicles),
        time_to_form_s=told("time_to_form_s"),
        hold_error_m=float(np.nanmax(error)) if np.isfinite(error).any() else math.nan,
        min_distance_m=distance_m,
        safety_radius_m=math.nan if flight.safety_radius_m is None else flight.safety_radius_m,
        flight_s=flown_s if math.isfinite(flown_s) else (flight.stop_ns - takeoff) / 1e9,
        way_m=way_m,
        effort_m=asked_m,
        effort_m2_s=asked_m2_s,
    )


def _within(instants: IntArray, start_ns: int, stop_ns: int) -> IntArray:
    return instants[(instants >= start_ns) & (instants < stop_ns)]


def _ways(flight: Flight) -> tuple[float, float, float]:
    """How far a vehicle flew, and what it was asked to fly: length, and its square over time; means of all."""
    ways, lengths, squares = [], [], []
    for track in flight.vehicles:
        if len(track.t_ns) > 1:
            grid = np.arange(track.t_ns[0], track.t_ns[-1] + 1, round(_WAY_S * 1e9))
            path = np.stack([np.interp(grid, track.t_ns, track.pos_team_enu_m[:, axis]) for axis in range(3)], axis=1)
            ways.append(float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()))
        if len(track.setpoint_t_ns):
            speed = np.linalg.norm(track.setpoint_vel_enu_m_s, axis=1)
            last_s = np.append(np.minimum(np.diff(track.setpoint_t_ns) / 1e9, _GAP_S), 0.0)
            lengths.append(float((speed * last_s).sum()))
            squares.append(float((speed**2 * last_s).sum()))
    return _mean(ways), _mean(lengths), _mean(squares)


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else math.nan


def placed(flight: Flight, since_s: FloatArray, vehicles: Sequence[int]) -> FloatArray:
    """Places of some vehicles at times from the common begin, shape (t, k, 3); NaN where not known in the team's frame.

    Args:
        flight: as read.
        since_s: times, shape (t,).
        vehicles: system ids.
    """
    column = {track.id: number for number, track in enumerate(flight.vehicles)}
    pos_m = flight.positions_at(begin_ns(flight) + np.round(since_s * 1e9).astype(np.int64))
    chosen = pos_m[:, [column[sysid] for sysid in vehicles]].copy()
    for number, sysid in enumerate(vehicles):
        if not flight.vehicles[column[sysid]].in_team_frame:
            chosen[:, number] = np.nan
    return chosen


def common(first: Flight, second: Flight) -> tuple[FloatArray, list[int]]:
    """Times from the common begin at which both flights last, and the vehicles that are in both."""
    last_s = min((flight.stop_ns - begin_ns(flight)) / 1e9 for flight in (first, second))
    step_s = max(_GRID_S, last_s / _MOST_INSTANTS)
    theirs = {track.id for track in second.vehicles}
    return np.arange(0.0, max(last_s, 0.0), step_s), [t.id for t in first.vehicles if t.id in theirs]


def deviation(first: Flight, second: Flight, names: tuple[str, str]) -> Deviation:
    """How far two flights are from each other."""
    since_s, vehicles = common(first, second)
    here, there = placed(first, since_s, vehicles), placed(second, since_s, vehicles)
    off_m = np.linalg.norm(here - there, axis=2)
    known = np.isfinite(off_m)
    apart = np.full(1, np.nan)
    if len(vehicles) > 1:
        i, j = np.triu_indices(len(vehicles), 1)
        apart = np.abs(
            np.linalg.norm(here[:, i] - here[:, j], axis=2) - np.linalg.norm(there[:, i] - there[:, j], axis=2)
        )
    if not known.any():
        return Deviation(*names, len(vehicles), 0.0, math.nan, math.nan, 0, math.nan, math.nan)
    row, column = np.unravel_index(int(np.nanargmax(np.where(known, off_m, -1.0))), off_m.shape)
    return Deviation(
        *names,
        vehicles=len(vehicles),
        seconds=float(since_s[known.any(axis=1)][-1]),
        rms_m=float(np.sqrt(np.mean(off_m[known] ** 2))),
        max_m=float(off_m[row, column]),
        vehicle=vehicles[int(column)],
        at_s=float(since_s[row]),
        distance_max_m=float(np.nanmax(apart)) if np.isfinite(apart).any() else math.nan,
    )


def deviations(flights: Sequence[Flight], names: Sequence[str]) -> list[Deviation]:
    """Of every two flights."""
    return [
        deviation(flights[i], flights[j], (names[i], names[j]))
        for i, j in itertools.combinations(range(len(flights)), 2)
    ]
