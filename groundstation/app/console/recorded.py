"""A recorded flight as the console shows one: a snapshot for every moment, and what can be jumped to.

Reads arrays (``records.replay``) and runs no mission: what a log does not tell is unknown here too. Pure: no files, no
clock.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

from groundstation.app.console.feed import PAIRS_TEAM_MAX
from groundstation.app.console.snapshot import AIRBORNE, FIGURES, Snapshot, Words
from groundstation.core import frames
from groundstation.core.types import FloatArray, IntArray
from groundstation.mission.roster import Duty
from groundstation.mission.timing import SECOND_NS
from groundstation.records.replay import MAX_GAP_NS, Flight, Phase
from groundstation.records.tracks import VehicleTrack

_ROWS, _PAIR_ROWS = 800, 300
_MARGIN_M, _MARGIN = 0.5, 0.3  # around what was flown, where a log tells no fence; at the sides by its width too
_KINDS = ("phase", "alarm", "info", "roles")

Mark = tuple[float, str, str]
"""Seconds since the first record, kind, text."""


class Recorded:
    """One log, ready to be shown.

    Args:
        flight: what was read.
        log: the file that it was read from, where that stays; None where it does not.

    Attributes:
        flight, log: the same.
        duration_s: from the first record to the last.
        marks: events, orders and the nearest approach, in order of time.
        history: seconds, smallest distance, largest error of the formation: the nearest moment of each short span, so
            that no approach is thinned away.
        pairs: seconds, then every pair's distance; no rows for large teams.
    """

    def __init__(self, flight: Flight, log: Path | None = None) -> None:
        self.flight, self.log = flight, log
        self.duration_s = flight.duration_s
        # One alone is shown in its own frame; of several, frames that nobody knows the place of mean nothing.
        self._placed = [track.in_team_frame or len(flight.vehicles) == 1 for track in flight.vehicles]
        blocks = [(t_ns, distance_m, pair) for t_ns, distance_m, pair in flight.nearest()]
        self._near_ns: IntArray = np.concatenate([np.zeros(0, np.int64), *(block[0] for block in blocks)])
        self._near_m: FloatArray = np.concatenate([np.zeros(0), *(block[1] for block in blocks)])
        pairs: IntArray = np.concatenate([np.zeros(0, np.int64), *(block[2] for block in blocks)])
        self._so_far_m = np.minimum.accumulate(self._near_m)
        self.history = self._history()
        self.pairs = self._pairs()
        self.marks = sorted([*self._events(), *self._nearest(pairs)])
        self._pads_m = np.array(
            [_first(track) if placed else np.full(3, np.nan) for track, placed in self._shown()]
        ).reshape(-1, 3)
        self._fence_m = self._fence()

    def phases(self) -> list[tuple[str, float, float]]:
        """Name, begin and end of each phase, s."""
        return [(phase.name, self._s(phase.start_ns), self._s(phase.stop_ns)) for phase in self.flight.phases]

    def begin_of(self, phase: str) -> float | None:
        """When a phase begins for the first time, s; None where it does not."""
        return next((begin_s for name, begin_s, _ in self.phases() if name == phase), None)

    def at(self, t_s: float) -> Snapshot:
        """The flight at a moment, which may lie before its begin or after its end."""
        flight, t_ns = self.flight, self.flight.start_ns + round(t_s * SECOND_NS)
        n = len(flight.vehicles)
        pos_m = flight.positions_at(np.array([t_ns]))[0]
        pos_m[[not placed for placed in self._placed]] = np.nan
        known = np.isfinite(pos_m).all(axis=1)
        given = flight.roles_at(t_ns)
        role = np.array([-1 if item is None else item for item in given or (None,) * n], dtype=np.int64)
        goal_m, edges = self._wished(t_ns, role)
        unknown = np.full(n, np.nan)
        return Snapshot(
            words=self._words(t_ns),
            t_s=t_s,
            ids=np.array([track.id for track in flight.vehicles], dtype=np.int64),
            role=role,
            duty=np.full(n, int(Duty.FORMATION)),
            state=known * AIRBORNE,  # a log does not always tell: everybody counts, as in gs replay
            pos_team_enu_m=pos_m,
            quat_ned_from_frd=np.array([_attitude(track, t_ns) for track in flight.vehicles]).reshape(-1, 4),
            setpoint_enu_m_s=np.array([_setpoint(track, t_ns) for track in flight.vehicles]).reshape(-1, 3),
            battery=unknown,
            pose_age_s=np.array([_age_s(track, t_ns) for track in flight.vehicles]),
            silent_s=unknown,
            lost_share=unknown,
            link_heard=unknown,
            link_trip_s=unknown,
            extra_radius_m=np.zeros(n),
            pads_enu_m=self._pads_m,
            goal_enu_m=goal_m,
            fence_enu_m=self._fence_m,
            edges=edges,
            figures=self._figures(t_ns),
            anchor_deg_m=np.full(3, np.nan) if flight.anchor_deg_m is None else flight.anchor_deg_m,
        )

    def _shown(self) -> list[tuple[VehicleTrack, bool]]:
        """Each vehicle, and whether it is shown where it was."""
        return list(zip(self.flight.vehicles, self._placed, strict=True))

    def _s(self, t_ns: int) -> float:
        return (t_ns - self.flight.start_ns) / SECOND_NS

    def _events(self) -> list[Mark]:
        marks = []
        for event in self.flight.events:
            kind, colon, text = event.text.partition(": ")
            known = bool(colon) and kind in _KINDS
            marks.append((self._s(event.t_ns), kind if known else "info", text if known else event.text))
        return [*marks, *((self._s(order.t_ns), "order", order.text) for order in self.flight.operator)]

    def _nearest(self, pairs: IntArray) -> list[Mark]:
        """The nearest approach, with who it was."""
        if not np.isfinite(self._near_m).any():
            return []
        at = int(self._near_m.argmin())
        first, second = (side[pairs[at]] for side in np.triu_indices(len(self.flight.vehicles), 1))
        one, other = (self.flight.vehicles[int(row)].id for row in (first, second))
        text = f"smallest distance of the flight: {self._near_m[at]:.4f} m, vehicles {one} and {other}"
        return [(self._s(int(self._near_ns[at])), "near", text)]

    def _history(self) -> FloatArray:
        if not len(self._near_ns):
            return np.zeros((0, 3))
        span = np.linspace(0, len(self._near_ns), min(_ROWS, len(self._near_ns)) + 1).astype(np.int64)
        rows = np.array([begin + int(self._near_m[begin:end].argmin()) for begin, end in pairwise(span.tolist())])
        t_ns, near_m = self._near_ns[rows], self._near_m[rows]
        error_m = self.flight.formation_error_at(t_ns)
        t_s = (t_ns - self.flight.start_ns) / SECOND_NS
        return np.column_stack([t_s, np.where(np.isfinite(near_m), near_m, np.nan), error_m])

    def _pairs(self) -> FloatArray:
        if len(self.flight.vehicles) > PAIRS_TEAM_MAX:
            return np.zeros((0, 1))
        t_ns = np.linspace(self.flight.start_ns, self.flight.stop_ns, _PAIR_ROWS).astype(np.int64)
        return np.column_stack([(t_ns - self.flight.start_ns) / SECOND_NS, self.flight.distances_at(t_ns)])

    def _words(self, t_ns: int) -> Words:
        flight = self.flight
        over = t_ns >= flight.stop_ns
        manifest = flight.manifest
        result = (manifest.result if manifest is not None else None) or {}
        said = {track.id: "" for track in flight.vehicles}
        for event in flight.events:
            who, says, text = event.text.removeprefix("info: ").partition(" says: ")
            number = who.removeprefix("vehicle ")
            if says and event.t_ns <= t_ns and number.isdecimal() and int(number) in said:
                said[int(number)] = text
        return Words(
            mission=flight.name,
            phase=_phase_at(flight.phases, t_ns),
            outcome=str(result.get("outcome") or "") if over else "",
            reason=str(result.get("reason") or "") if over else "",
            modes=("",) * len(said),
            said=tuple(said.values()),
            notes=(),
            radius_m=np.nan if flight.safety_radius_m is None else flight.safety_radius_m,
        )

    def _wished(self, t_ns: int, role: IntArray) -> tuple[FloatArray, IntArray]:
        """The point of each one's role, NaN for who has none, and neighbours in the sensing graph, by row."""
        n, formation = len(role), self.flight.formation_at(t_ns)
        goal_m = np.full((n, 3), np.nan)
        if formation is None:
            return goal_m, np.zeros((0, 2), dtype=np.int64)
        has = (role >= 0) & (role < len(formation.points_enu_m))
        if formation.sized:
            goal_m[has] = formation.points_enu_m[role[has]]
        row_of = {int(role[row]): row for row in np.flatnonzero(has).tolist()}
        edges = [(row_of[i], row_of[j]) for i, j in formation.edges if i in row_of and j in row_of]
        return goal_m, np.array(edges, dtype=np.int64).reshape(-1, 2)

    def _figures(self, t_ns: int) -> FloatArray:
        before = int(np.searchsorted(self._near_ns, t_ns, side="right"))
        least_m = float(self._so_far_m[before - 1]) if before else np.inf
        sent = sum(int(np.searchsorted(track.setpoint_t_ns, t_ns, "right")) for track in self.flight.vehicles)
        known = {"min_distance_m": least_m, "setpoints": float(sent)}
        return np.array([known.get(name, np.nan) for name in FIGURES])

    def _fence(self) -> FloatArray:
        """The mission's, or a box around all that was flown."""
        mission = {} if self.flight.manifest is None else self.flight.manifest.mission
        fence = mission.get("fence")
        if isinstance(fence, dict):
            try:
                corners = np.array([fence["min_m"], fence["max_m"]], dtype=np.float64).reshape(2, 3)
            except (KeyError, TypeError, ValueError):
                corners = np.full((2, 3), np.nan)
            if np.isfinite(corners).all():
                return corners
        placed = [track.pos_team_enu_m for track, known in self._shown() if known and len(track.t_ns)]
        if not placed:
            return np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 1.0]])
        every = np.concatenate(placed)
        low_m, high_m = every.min(axis=0), every.max(axis=0)
        beside_m = max(_MARGIN_M, _MARGIN * float(np.max((high_m - low_m)[:2])))  # so that a page sees all of it
        margin_m = np.array([beside_m, beside_m, _MARGIN_M])
        return np.array([low_m - margin_m, high_m + margin_m])


def _phase_at(phases: tuple[Phase, ...], t_ns: int) -> str:
    return next((phase.name for phase in reversed(phases) if phase.start_ns <= t_ns), "")


def _first(track: VehicleTrack) -> FloatArray:
    """Where it was first, NaN where that is not known."""
    return track.pos_team_enu_m[0] if len(track.t_ns) else np.full(3, np.nan)


def _attitude(track: VehicleTrack, t_ns: int) -> FloatArray:
    """The last one reported, quaternion w x y z; NaN where it is old."""
    at = int(np.searchsorted(track.attitude_t_ns, t_ns, side="right")) - 1
    if at < 0 or t_ns - track.attitude_t_ns[at] > MAX_GAP_NS:
        return np.full(4, np.nan)
    roll, pitch, yaw = (np.asarray(angle) for angle in track.rpy_ned_rad[at])
    return frames.quat_ned_from_frd_of_euler(roll, pitch, yaw)


def _setpoint(track: VehicleTrack, t_ns: int) -> FloatArray:
    """The last one sent; NaN where it is old."""
    at = int(np.searchsorted(track.setpoint_t_ns, t_ns, side="right")) - 1
    old = at < 0 or t_ns - track.setpoint_t_ns[at] > MAX_GAP_NS
    return np.full(3, np.nan) if old else track.setpoint_vel_enu_m_s[at]


def _age_s(track: VehicleTrack, t_ns: int) -> float:
    """Since the last report of a position; NaN before the first."""
    at = int(np.searchsorted(track.t_ns, t_ns, side="right")) - 1
    return np.nan if at < 0 else (t_ns - int(track.t_ns[at])) / SECOND_NS
