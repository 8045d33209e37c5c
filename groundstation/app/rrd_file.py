"""A flight as a Rerun recording: poses, velocities, setpoints, distances, phases and events, on the flight's own time.

Every report has its own time; nothing is interpolated. The team's frame is ENU; bodies are x forward, y left, z up.
"""

from __future__ import annotations

import numpy as np
import rerun as rr

from groundstation.app.body_axes import enu_from_flu
from groundstation.core.frames import quat_ned_from_frd_of_euler
from groundstation.core.types import FloatArray, IntArray
from groundstation.records.replay import Flight
from groundstation.records.tracks import VehicleTrack
from groundstation.records.wide import Cells

_TIME = "flight"
_SIZE_M = 0.1  # half of what stands for a vehicle


def write(flight: Flight, table: dict[str, Cells], made_by: str) -> tuple[bytes, dict[str, object]]:
    """The file, and what is told of it; ``table`` is ``records.wide.wide`` of the flight."""
    recording = rr.RecordingStream(made_by, send_properties=False)
    kept = recording.memory_recording()
    pages = _Pages(recording, flight.start_ns)
    rr.log("team", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True, recording=recording)
    for track in flight.vehicles:
        pages.vehicle(track)
    for name in ("min_distance_m", "formation_error_m", *(name for name in table if name.startswith("distance_"))):
        pages.figures(f"figures/{name}", np.asarray(table["t_s"], dtype=np.float64), table[name])
    for event in flight.events:
        level = rr.TextLogLevel.WARN if event.text.startswith("alarm") else rr.TextLogLevel.INFO
        rr.set_time(_TIME, duration=(event.t_ns - flight.start_ns) / 1e9, recording=recording)
        rr.log("events", rr.TextLog(event.text, level=level), recording=recording)
        pages.entities.add("events")
    recording.flush()
    return kept.drain_as_bytes(), {"entities": len(pages.entities), "rows": pages.rows}


class _Pages:
    """Columns on their way into a recording.

    Attributes:
        entities: paths that have got any.
        rows: how many, all together.
    """

    def __init__(self, recording: rr.RecordingStream, start_ns: int) -> None:
        self._recording, self._start_ns = recording, start_ns
        self.entities: set[str] = set()
        self.rows = 0

    def _send(self, entity: str, t_s: FloatArray, columns: object) -> None:
        if len(t_s):
            times = [rr.TimeColumn(_TIME, duration=t_s)]
            rr.send_columns(entity, indexes=times, columns=columns, recording=self._recording)
            self.entities.add(entity)
            self.rows += len(t_s)

    def _seconds(self, t_ns: IntArray) -> FloatArray:
        return np.asarray((t_ns - self._start_ns) / 1e9, dtype=np.float64)

    def vehicle(self, track: VehicleTrack) -> None:
        """One vehicle: where it is, how it lies, and what it was told."""
        entity = f"team/v{track.id}" if track.in_team_frame else f"own_frames/v{track.id}"
        known = np.all(np.isfinite(track.pos_team_enu_m), axis=1)
        level = np.array([1.0, 0.0, 0.0, 0.0])
        turned = [enu_from_flu(quat) for quat in quat_ned_from_frd_of_euler(*track.rpy_ned_rad.T)]
        last = np.searchsorted(track.attitude_t_ns, track.t_ns, side="right") - 1
        wxyz = np.array([level if row < 0 else turned[row] for row in last.tolist()]).reshape(-1, 4)
        self._send(
            entity,
            self._seconds(track.t_ns[known]),
            rr.Transform3D.columns(
                translation=track.pos_team_enu_m[known].astype(np.float32),
                quaternion=np.roll(wxyz[known], -1, axis=1).astype(np.float32),
            ),
        )
        size = [[2.0 * _SIZE_M, _SIZE_M, 0.4 * _SIZE_M]]
        body = rr.Boxes3D(half_sizes=size, labels=[str(track.id)])
        rr.log(entity, body, static=True, recording=self._recording)
        for what, t_ns, values in (
            ("velocity", track.t_ns, track.vel_enu_m_s),
            ("setpoint", track.setpoint_t_ns, track.setpoint_vel_enu_m_s),
        ):
            there = np.all(np.isfinite(values), axis=1)
            for axis, name in enumerate("xyz"):
                path = f"figures/v{track.id}/{what}_{name}_enu_m_s"
                self._send(path, self._seconds(t_ns[there]), rr.Scalars.columns(scalars=values[there, axis]))

    def figures(self, entity: str, t_s: FloatArray, cells: Cells) -> None:
        """Figures over time; what is not known is left out."""
        values = np.asarray(cells, dtype=np.float64)
        known = np.isfinite(values)
        self._send(entity, t_s[known], rr.Scalars.columns(scalars=values[known]))
