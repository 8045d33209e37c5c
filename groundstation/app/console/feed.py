"""What the console knows of the flight: its snapshots as they come, and figures worked out of them. Decides nothing."""

from __future__ import annotations

import contextlib
import os
import select
import socket
from collections import deque
from pathlib import Path

import numpy as np

from groundstation.app.console.snapshot import AIRBORNE, BYTES_MAX, Snapshot, decode
from groundstation.app.order_socket import prepare_folder
from groundstation.core.errors import UserError
from groundstation.core.metrics import min_distance_m, pair_distances_m
from groundstation.core.types import FloatArray
from groundstation.mission.flight.keeping import heading_of

HISTORY = "t_s", "min_distance_m", "error_m", "tick_ms", "most_lost_percent"
_KEPT = 2_400
PAIRS_TEAM_MAX = 8
"""Teams up to which every pair's distance is a line of the chart; of larger ones it would be a blot."""
_PAIRS_EVERY_S, _PAIRS_KEPT = 0.4, 600
_NOTES_KEPT = 10_000
_TAKEN_MAX = 32  # of those that wait, at once


def distances_m(snapshot: Snapshot) -> FloatArray:
    """Distances between all vehicles, shape (n, n), NaN where unknown."""
    return pair_distances_m(snapshot.pos_team_enu_m)


def pairs_m(snapshot: Snapshot) -> FloatArray:
    """Distances of all pairs of whom one at least is in the air, NaN of the others, shape (n (n - 1) / 2,)."""
    first, second = np.triu_indices(len(snapshot.ids), 1)
    flies = (snapshot.state & AIRBORNE) != 0
    return np.where(flies[first] | flies[second], distances_m(snapshot)[first, second], np.nan)


def smallest_distance_m(snapshot: Snapshot) -> float:
    """Between two of whom one at least is in the air, as the monitors count; NaN while there are no two."""
    least_m = min_distance_m(snapshot.pos_team_enu_m, flying=(snapshot.state & AIRBORNE) != 0)
    return least_m if np.isfinite(least_m) else np.nan


def most_lost_percent(snapshot: Snapshot) -> float:
    """Share of frames that was lost of the vehicle of which most were; NaN before anything was counted."""
    known = np.isfinite(snapshot.lost_share)
    return 100.0 * float(snapshot.lost_share[known].max()) if known.any() else np.nan


def wished_m(snapshot: Snapshot) -> FloatArray:
    """Distances of the formation under way, by vehicle, shape (n, n)."""
    return pair_distances_m(snapshot.goal_enu_m)


def largest_error_m(snapshot: Snapshot) -> float:
    """Largest |d_ij - d*_ij| over all pairs; NaN where no distance is known."""
    off_m = np.abs(distances_m(snapshot) - wished_m(snapshot))[np.triu_indices(len(snapshot.ids), 1)]
    return float(np.nanmax(off_m)) if np.isfinite(off_m).any() else np.nan


def ghost_enu_m(snapshot: Snapshot) -> FloatArray | None:
    """The formation where it fits the vehicles best, turned about the vertical and shifted, shape (n, 3)."""
    pos_m, goal_m = snapshot.pos_team_enu_m, snapshot.goal_enu_m
    known = np.isfinite(pos_m).all(axis=1)
    if not known.any() or not np.isfinite(goal_m).all() or np.allclose(goal_m, goal_m[0]):
        return None
    middle_m, goal_middle_m = pos_m[known].mean(axis=0), goal_m[known].mean(axis=0)
    angle_rad = heading_of(pos_m[known], goal_m[known])
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    rot = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray((goal_m - goal_middle_m) @ rot.T + middle_m)


class Feed:
    """The listening end of the one-way stream.

    Args:
        folder: where the socket goes; the user's alone.
        pid: of the flight.

    Attributes:
        last: newest snapshot, None before the first.
        history: a row of ``HISTORY`` a tenth of a second.
        pairs: seconds, then every pair's distance, four tenths of a second apart; empty for large teams.
        notes: what happened: seconds, kind, text; each once, though every snapshot tells the newest again.
        checks: preflight's table as it was last told.
        problem: why the newest datagram could not be read.
    """

    def __init__(self, folder: Path, pid: int) -> None:
        self.last: Snapshot | None = None
        self.history: deque[tuple[float, ...]] = deque(maxlen=_KEPT)
        self.pairs: deque[tuple[float, ...]] = deque(maxlen=_PAIRS_KEPT)
        self.notes: list[tuple[float, str, str]] = []
        self.checks: tuple[tuple[str, ...], ...] = ()
        self.problem = ""
        self._path = folder / f"{pid}-{os.getpid()}.view"
        try:
            prepare_folder(folder)
            self._path.unlink(missing_ok=True)
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            self._socket.setblocking(False)
            self._socket.bind(str(self._path))
            self._path.chmod(0o600)
        except OSError as error:
            raise UserError(f"gs console: cannot listen at {self._path}: {error.strerror or error}") from error

    def close(self) -> None:
        """Stops listening."""
        self._socket.close()
        self._path.unlink(missing_ok=True)

    def wait(self, timeout_s: float) -> None:
        """Until something has come, or for so long."""
        select.select([self._socket], [], [], timeout_s)

    def read(self) -> None:
        """Takes what has come."""
        for _ in range(_TAKEN_MAX):
            try:
                data = self._socket.recv(BYTES_MAX)
            except OSError:
                return
            try:
                self.take(decode(data))
                self.problem = ""
            except ValueError as error:
                self.problem = str(error)

    def take(self, snapshot: Snapshot) -> None:
        """Takes a snapshot."""
        self.last = snapshot
        self._keep(snapshot.words.notes)
        self.checks = snapshot.words.checks or self.checks
        if not self.history or snapshot.t_s - self.history[-1][0] >= 0.1:
            self.history.append(
                (
                    snapshot.t_s,
                    smallest_distance_m(snapshot),
                    largest_error_m(snapshot),
                    snapshot.tick_ms,
                    most_lost_percent(snapshot),
                )
            )

        few = len(snapshot.ids) <= PAIRS_TEAM_MAX
        if few and (not self.pairs or snapshot.t_s - self.pairs[-1][0] >= _PAIRS_EVERY_S):
            self.pairs.append((snapshot.t_s, *pairs_m(snapshot).tolist()))

    def _keep(self, told: tuple[tuple[float, str, str], ...]) -> None:
        known = self.notes[-1:]
        since = max((at + 1 for at, note in enumerate(told) if [note] == known), default=0)
        self.notes += told[since : since + max(0, _NOTES_KEPT - len(self.notes))]


def remove_dead(folder: Path) -> None:
    """Removes the sockets of consoles that ended without cleaning up."""
    for path in folder.glob("*.view"):
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as probe:
            try:
                probe.connect(str(path))
            except ConnectionRefusedError:
                path.unlink(missing_ok=True)
