"""Reads flights out of logs as arrays: reported positions in the team's frame, setpoints, roles, events.

Positions in files and pictures are ENU metres; what MAVLink says in NED is turned here. Where the place of a
vehicle's own origin is not known, its team position is not known either, and distances are not made up. Does not run
the mission object again (that needs more than a log) and draws nothing.
"""

from __future__ import annotations

import contextlib
import itertools
import re
import reprlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from groundstation.core.errors import UserError
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.mavlink.vehicle import AUTOPILOT_COMPID
from groundstation.records.admission import Admission, of_mission
from groundstation.records.manifest import Manifest, Values, manifest_beside
from groundstation.records.notes import PHASE_PREFIX, Event, Noise, Operator, Received, Roles, Sent, Tick
from groundstation.records.spans import Span
from groundstation.records.tlog import TlogReader, read_tlog
from groundstation.records.tracks import Setpoints, VehicleTrack, anchor_of, tracks_of, vectors

_FORMATION_EVENT = re.compile(r"info: formation of step (\d{1,6}): .+, scale (changing|free|[0-9.e+-]+)$")
"""Tells from which step the formation is from then on, and by how much it has grown since."""

MAX_GAP_NS = 1_000_000_000
"""Between two samples further apart than this a position is not interpolated but unknown."""

_POINTS_MAX = 2_000
_SCALE_MAX = 1e9
_BLOCK = 1 << 18  # pairs of vehicles times instants that are held in memory at once


@dataclass(frozen=True)
class FlightFormation:
    """The formation that the manifest names.

    Attributes:
        name: for titles.
        points_enu_m: desired points, shape (n, 3), scale applied.
        edges: pairs of neighbouring roles, from 0.
        start_ns: from when on it was flown.
        sized: its distances are what the team was to keep; False while its size changes or is free.
    """

    name: str
    points_enu_m: FloatArray
    edges: tuple[tuple[int, int], ...]
    start_ns: int = 0
    sized: bool = True


@dataclass(frozen=True)
class Phase:
    """A span of the flight that an event named."""

    name: str
    start_ns: int
    stop_ns: int


@dataclass(frozen=True)
class Flight:
    """One log, read.

    Attributes:
        name: of the mission, or of the file.
        manifest: None when there is none beside the log.
        vehicles: in the order of the mission, or by system id without a manifest.
        formations: one after the other, at their sizes; empty when the manifest names none.
        safety_radius_m: r of Algorithm 2; None when not known.
        roles: changes of the vehicles' roles, in order of time.
        events: in order of time.
        operator: the operator's commands, in order of time.
        phases: spans named by events, in order of time.
        start_ns: time of the first record.
        stop_ns: time of the last record.
        ticks: ticks of the mission object.
        noise_bytes: received bytes that were no good frame.
        message: what of the log could not be read, None when all could.
        notes: what people have to know of the figures: clocks that were set, positions by GPS.
        contents: what is in the log instead, a line for each sender; where no vehicle tells positions.
        anchor_deg_m: where on earth the team's frame begins: latitude, longitude, height, shape (3,); None where that
            is not known.
    """

    name: str
    manifest: Manifest | None
    vehicles: tuple[VehicleTrack, ...]
    formations: tuple[FlightFormation, ...]
    safety_radius_m: float | None
    roles: tuple[Roles, ...]
    events: tuple[Event, ...]
    operator: tuple[Operator, ...]
    phases: tuple[Phase, ...]
    start_ns: int
    stop_ns: int
    ticks: int
    noise_bytes: int
    message: str | None
    notes: tuple[str, ...] = ()
    contents: tuple[str, ...] = ()
    anchor_deg_m: FloatArray | None = None

    @property
    def useful(self) -> bool:
        """Whether there is anything to show: positions, setpoints, or ticks of a flight that came to nothing."""
        return bool(self.samples or self.setpoints or self.ticks)

    @property
    def duration_s(self) -> float:
        """Time from the first record to the last."""
        return (self.stop_ns - self.start_ns) / 1e9

    @property
    def samples(self) -> int:
        """Reported positions of the vehicle that reported most of them."""
        return max((len(track.t_ns) for track in self.vehicles), default=0)

    @property
    def setpoints(self) -> int:
        """Velocity setpoints sent to all vehicles together."""
        return sum(len(track.setpoint_t_ns) for track in self.vehicles)

    @property
    def role_changes(self) -> int:
        """How often a vehicle's role changed after the first assignment, all vehicles together."""
        pairs = zip(self.roles, self.roles[1:], strict=False)
        return sum(a != b for old, new in pairs for a, b in zip(old.roles, new.roles, strict=False))

    @property
    def formation(self) -> FlightFormation | None:
        """The formation that the flight began with; None when it is not known."""
        return self.formations[0] if self.formations else None

    def formation_at(self, t_ns: int) -> FlightFormation | None:
        """The formation under way at a time, the first one before any."""
        before = [item for item in self.formations if item.start_ns <= t_ns]
        return before[-1] if before else self.formation

    @property
    def distances_known(self) -> bool:
        """Whether at least two vehicles reported positions in one frame."""
        placed = [track for track in self.vehicles if len(track.t_ns)]
        return len(placed) > 1 and all(track.in_team_frame for track in placed)

    def instants_ns(self) -> IntArray:
        """All times at which any vehicle reported a position, sorted, each once."""
        times = [track.t_ns for track in self.vehicles]
        return np.unique(np.concatenate(times)) if times else np.zeros(0, dtype=np.int64)

    def positions_at(self, t_ns: IntArray) -> FloatArray:
        """Positions of all vehicles at common instants, interpolated on the straight line between two reports.

        Args:
            t_ns: instants, shape (t,).

        Returns:
            Shape (t, n, 3), team frame, ENU; NaN before the first and after the last report of a vehicle, and
            between two reports more than MAX_GAP_NS apart.
        """
        positions = np.full((len(t_ns), len(self.vehicles), 3), np.nan)
        for index, track in enumerate(self.vehicles):
            if len(track.t_ns):
                positions[:, index] = _interpolate(track, t_ns)
        return positions

    def distances_at(self, t_ns: IntArray) -> FloatArray:
        """Distances of all pairs i < j at common instants.

        Args:
            t_ns: instants, shape (t,).

        Returns:
            Shape (t, n (n - 1) / 2), columns as in ``numpy.triu_indices(n, 1)``; NaN where a position is unknown.
        """
        first, second = np.triu_indices(len(self.vehicles), 1)
        if not self.distances_known:
            return np.full((len(t_ns), len(first)), np.nan)
        positions = self.positions_at(t_ns)
        return np.asarray(np.linalg.norm(positions[:, first] - positions[:, second], axis=-1), dtype=np.float64)

    def nearest(self) -> Iterator[tuple[IntArray, FloatArray, IntArray]]:
        """The two that are nearest at every instant at which any vehicle reported, in blocks of instants.

        The others' positions are interpolated to it. Nothing comes where distances are not known.

        Yields:
            Instants, distances (infinite where no pair is known), and the pairs' columns, as in ``distances_at``, each
            of shape (t,).
        """
        if not self.distances_known:
            return
        instants = self.instants_ns()
        step = max(1, _BLOCK // max(1, len(self.vehicles) ** 2))
        for start in range(0, len(instants), step):
            block = instants[start : start + step]
            distances = self.distances_at(block)
            distances[np.isnan(distances)] = np.inf
            pair = distances.argmin(axis=1)
            yield block, distances[np.arange(len(block)), pair], pair

    def min_distance_m(self) -> float | None:
        """Smallest distance between reported positions, see ``nearest``; None when it is not known."""
        smallest = min((float(distances.min()) for _, distances, _ in self.nearest()), default=np.inf)
        return smallest if np.isfinite(smallest) else None

    def roles_at(self, t_ns: int) -> tuple[int | None, ...] | None:
        """Role of each vehicle at a time; None before any was assigned."""
        before = [change for change in self.roles if change.t_ns <= t_ns]
        return before[-1].roles if before else None

    def formation_error_at(self, t_ns: IntArray) -> FloatArray:
        """Largest |d_ij - d*_ij| over all pairs of vehicles with a role.

        Args:
            t_ns: instants, sorted, shape (t,).

        Returns:
            Shape (t,), metres; NaN where a position or the formation is unknown, or fewer than two have a role.
        """
        error = np.full(len(t_ns), np.nan)
        if not self.formations or not self.distances_known:
            return error
        first, second = np.triu_indices(len(self.vehicles), 1)
        distances = self.distances_at(t_ns)
        starts = sorted({item.t_ns for item in self.roles} | {item.start_ns for item in self.formations})
        for start, stop in itertools.pairwise([*starts, np.iinfo(np.int64).max]):
            span = (t_ns >= start) & (t_ns < stop)
            roles, formation = self.roles_at(start), self.formation_at(start)
            if roles is None or len(roles) != len(self.vehicles) or not span.any():
                continue
            if formation is None or not formation.sized:
                continue
            points = formation.points_enu_m
            wanted = np.linalg.norm(points[:, None] - points[None], axis=-1)
            role = np.array([-1 if item is None or item >= len(points) else item for item in roles])
            pairs = (role[first] >= 0) & (role[second] >= 0)
            if pairs.any():
                target = wanted[role[first[pairs]], role[second[pairs]]]
                error[span] = np.abs(distances[np.ix_(span, pairs)] - target).max(axis=1)
        return error


def load_flight(path: Path) -> Flight:
    """Reads a log and the manifest beside it.

    Args:
        path: the .tlog file; without a manifest the flight has no formation, no r and no team frame.

    Raises:
        UserError: the log or its manifest cannot be used.
    """
    manifest = manifest_beside(path)
    reader = read_tlog(path, None if manifest is None else manifest.epoch_unix_us)
    return _collect(path, reader, manifest)


def _collect(path: Path, reader: TlogReader, manifest: Manifest | None) -> Flight:
    mission: Values = {} if manifest is None else manifest.mission
    result: Values = (None if manifest is None else manifest.result) or {}
    _check_kinds(path, mission, result)
    ids, admission = admission_of(reader, mission)
    setpoints = Setpoints()
    roles: list[Roles] = []
    events: list[Event] = []
    operator: list[Operator] = []
    start_ns = stop_ns = ticks = noise_bytes = 0
    first = True
    for record in reader.spans():
        if first:
            start_ns, first = record.first_ns if isinstance(record, Span) else record.t_ns, False
        stop_ns = max(stop_ns, record.last_ns if isinstance(record, Span) else record.t_ns)
        match record:
            case Span():
                admission.take_block(record.received)
                setpoints.take_span(record)
                ticks += record.ticks
            case Received():
                admission.take(record)
            case Sent():
                setpoints.take(record)
            case Tick():
                ticks += 1
            case Roles():
                roles.append(record)
            case Event():
                events.append(record)
                admission.event(record)
            case Operator():
                operator.append(record)
            case Noise():
                noise_bytes += len(record.data)
    vehicles, by_place = tracks_of(
        path, mission, result, ids=ids, admission=admission, setpoints=setpoints.columns(), start_ns=start_ns
    )
    notes = [f"{path}: {note}" for note in reader.notes]
    if by_place and len(vehicles) > 1:
        notes.append(f"{path}: positions are those of GPS (GLOBAL_POSITION_INT), and distances are no better than it")
    return Flight(
        name=_printable(str(mission.get("name") or path.stem)),
        manifest=manifest,
        vehicles=vehicles,
        formations=_formations(path, mission, events),
        safety_radius_m=_radius(path, mission),
        roles=tuple(roles),
        events=tuple(events),
        operator=tuple(operator),
        phases=_phases(events, stop_ns),
        start_ns=start_ns,
        stop_ns=stop_ns,
        ticks=ticks,
        noise_bytes=noise_bytes,
        message=reader.message,
        notes=tuple(notes),
        contents=() if any(len(item.t_ns) for item in vehicles) else tuple(reader.survey().words()),
        anchor_deg_m=anchor_of(path, mission, vehicles, admission.places()),
    )


def admission_of(reader: TlogReader, mission: Values) -> tuple[list[int], Admission]:
    """Who is a vehicle in a log, by the id that names it, and the rule by which its frames are let in.

    Args:
        reader: of the log.
        mission: as its manifest has it; empty without one: then whoever told positions as an autopilot is a vehicle.
    """
    if mission.get("vehicles"):
        return [vehicle["id"] for vehicle in mission["vehicles"]], of_mission(mission)
    survey = reader.survey()
    placed = set(survey.placed("LOCAL_POSITION_NED")) | set(survey.placed("GLOBAL_POSITION_INT"))
    components = survey.autopilots
    if reader.native:  # flights of this program listen to this component alone
        placed = {sysid for sysid in placed if components[sysid] == AUTOPILOT_COMPID}
    sysids = sorted(placed)
    return sysids, Admission(sysids, [None] * len(sysids), components=components)


def _printable(name: str) -> str:
    """A name as a terminal and a page can show it; JSON can hold halves of letters."""
    return name.encode(errors="replace").decode()[:200]


def _check_kinds(path: Path, mission: Values, result: Values) -> None:
    """Looks whether what is read here has the kinds of values that it is read as.

    Raises:
        UserError: a manifest of another program, or a damaged one.
    """
    for where, values, key, kinds in (
        ("mission", mission, "vehicles", list),
        ("mission", mission, "formation", Mapping),
        ("mission", mission, "shapes", list),
        ("mission", mission, "avoidance", Mapping),
        ("result", result, "local_origins_enu_m", list),
    ):
        if not isinstance(values.get(key), kinds | None):
            raise UserError(f"{path}: manifest: {where}.{key}: {reprlib.repr(values[key])}; the manifest is damaged")
    for index, vehicle in enumerate(mission.get("vehicles") or ()):
        own = vehicle if isinstance(vehicle, Mapping) else {}
        sysid = own.get("sysid") or own.get("id")
        if type(own.get("id")) is not int or type(sysid) is not int or own["id"] < 0 or not 0 <= sysid <= 255:
            raise UserError(f"{path}: manifest: mission.vehicles[{index}]: no usable id; the manifest is damaged")
    for index, shape in enumerate(mission.get("shapes") or ()):
        if not isinstance(shape, Mapping) or type(shape.get("step")) is not int:
            raise UserError(f"{path}: manifest: mission.shapes[{index}]: has no step; the manifest is damaged")
    for index, origin in enumerate(result.get("local_origins_enu_m") or ()):
        if not isinstance(origin, list | None):
            raise UserError(
                f"{path}: manifest: result.local_origins_enu_m[{index}]: {reprlib.repr(origin)}; the manifest is"
                " damaged"
            )


def _interpolate(track: VehicleTrack, t_ns: IntArray) -> FloatArray:
    # Of several reports with one time stamp the last one counts.
    latest: BoolArray = np.append(np.diff(track.t_ns) > 0, True)
    times, points = track.t_ns[latest], track.pos_team_enu_m[latest]
    after = np.searchsorted(times, t_ns)
    inside = np.minimum(after, len(times) - 1)
    exact = times[inside] == t_ns
    left, right = times[np.maximum(after - 1, 0)], times[inside]
    gap = right - left
    between = (after > 0) & (after < len(times)) & (gap <= MAX_GAP_NS)
    fraction = np.where(gap > 0, (t_ns - left) / np.maximum(gap, 1), 0.0)[:, None]
    before = points[np.maximum(after - 1, 0)]
    line = before + fraction * (points[inside] - before)
    return np.where(exact[:, None], points[inside], np.where(between[:, None], line, np.nan))


def _formations(path: Path, mission: Values, events: Sequence[Event]) -> tuple[FlightFormation, ...]:
    """The formations of a flight, each from when on it was flown, as its events tell."""
    where = f"{path}: manifest: mission"
    first = _formation(f"{where}.formation", mission.get("formation"))
    if first is None:
        return ()
    own: dict[int, FlightFormation] = {}
    for index, item in enumerate(mission.get("shapes") or ()):
        shape = _formation(f"{where}.shapes[{index}].formation", item.get("formation"))
        if shape is not None:
            own[item["step"] + 1] = shape
    found = []
    for event in events:
        told = _FORMATION_EVENT.match(event.text)
        if told is None:
            continue
        shape, scale = own.get(int(told[1]), first), told[2]
        number = None
        with contextlib.suppress(ValueError):  # no number: it is changing, or free
            number = float(scale)
        if number is not None and not 0.0 < number < _SCALE_MAX:
            continue
        points = shape.points_enu_m * (1.0 if number is None else number)
        found.append(replace(shape, points_enu_m=points, start_ns=event.t_ns, sized=number is not None))
    return tuple(found) if found else (first,)


def _formation(where: str, given: object) -> FlightFormation | None:
    if not isinstance(given, Mapping):
        return None
    scale = vectors(f"{where}.scale", given.get("scale", 1.0), ())
    with np.errstate(over="ignore"):
        points = vectors(f"{where}.points", given.get("points"), (-1, 3)) * scale
    if not np.all(np.isfinite(points)):
        raise UserError(f"{where}.scale: {scale:g} takes points beyond all bounds; the manifest is damaged")
    edges = given.get("edges", ())
    n = len(points)
    if n > _POINTS_MAX:
        raise UserError(f"{where}.points: {n} points, limit {_POINTS_MAX}; the manifest is damaged")
    if edges == "complete":
        pairs = [(i, j) for i in range(n) for j in range(i + 1, n)]
    else:
        try:
            pairs = [(int(i) - 1, int(j) - 1) for i, j in edges]
        except (TypeError, ValueError, OverflowError) as error:
            raise UserError(f"{where}.edges: expected pairs of agents; the manifest is damaged") from error
    if any(not 0 <= k < n for pair in pairs for k in pair):
        raise UserError(f"{where}.edges: an agent is not in 1 to {n}; the manifest is damaged")
    return FlightFormation(_printable(str(given.get("name", "formation"))), points, tuple(pairs))


def _radius(path: Path, mission: Values) -> float | None:
    avoidance = mission.get("avoidance")
    radius = avoidance.get("radius_m") if isinstance(avoidance, Mapping) else None
    if radius is None:
        return None
    return float(vectors(f"{path}: manifest: mission.avoidance.radius_m", [radius], (1,))[0])


def _phases(events: Sequence[Event], stop_ns: int) -> tuple[Phase, ...]:
    starts = [event for event in events if event.text.startswith(PHASE_PREFIX)]
    ends = [*(event.t_ns for event in starts[1:]), stop_ns][: len(starts)]
    return tuple(
        Phase(event.text.removeprefix(PHASE_PREFIX).strip(), event.t_ns, end)
        for event, end in zip(starts, ends, strict=True)
    )
