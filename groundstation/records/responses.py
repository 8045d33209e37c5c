"""Setpoints and velocities of each vehicle out of a log, side by side on one grid of times.

Velocities are dated by the vehicle's own clock, shifted so that the quickest messages arrive at once, and stretched
where it runs at another rate than ours (PX4's simulator: 0.985): jitter of the link drops out, and the delay that is
left is the whole loop's, both ways of the link included.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from groundstation.core.phases import STEERED_PHASES
from groundstation.core.types import FloatArray, IntArray
from groundstation.records.manifest import manifest_beside
from groundstation.records.notes import PHASE_PREFIX, Event, Received, Sent
from groundstation.records.replay import admission_of
from groundstation.records.spans import Span
from groundstation.records.tlog import read_tlog
from groundstation.records.tracks import Setpoints

_STEERED = frozenset(phase.value for phase in STEERED_PHASES)
_GAP_NS = 400_000_000  # longer ones between two reports leave the velocity unknown
_RATE_OVER_S = 10.0
_RATE_MIN, _RATE_MAX = 0.002, 0.03  # less is jitter of the ends, more is no clock
_PAUSE_NS = 1_000_000_000  # without setpoints for that long the vehicle does not follow them


@dataclass(frozen=True)
class Motion:
    """What one vehicle was told and what it did.

    Attributes:
        id: by which the mission names the vehicle.
        asked_enu_m_s: setpoint in effect at each time, shape (t, 3).
        done_enu_m_s: reported velocity, NaN where unknown, shape (t, 3).
    """

    id: int
    asked_enu_m_s: FloatArray
    done_enu_m_s: FloatArray


def load_motions(path: Path, step_s: float) -> list[Motion]:
    """Reads a log of ``gs fly``.

    Args:
        path: the .tlog file.
        step_s: of the grid of times.

    Returns:
        One for each vehicle that was given velocity setpoints, by id; while the team was steered, where the
        log names its phases.

    Raises:
        UserError: the log or its manifest cannot be used.
    """
    manifest = manifest_beside(path)
    reader = read_tlog(path, None if manifest is None else manifest.epoch_unix_us)
    ids, admission = admission_of(reader, {} if manifest is None else manifest.mission)
    collected = Setpoints()
    phases: list[tuple[int, str]] = []
    for record in reader.spans():
        match record:
            case Span():
                admission.take_block(record.received)
                collected.take_span(record)
            case Received():
                admission.take(record)
            case Sent():
                collected.take(record)
            case Event(t_ns, text) if text.startswith(PHASE_PREFIX):
                admission.event(record)
                phases.append((t_ns, text.removeprefix(PHASE_PREFIX).strip()))
    setpoints = collected.columns()
    set_t, set_vel = setpoints.t_ns, setpoints.vel_enu_m_s
    local, places = admission.local(), admission.places()
    motions = []
    for row, (own_id, (link, sysid)) in enumerate(zip(ids, admission.addresses, strict=True)):
        own = local.of(row)
        said = own if len(own.t_ns) else places.of(row)
        said = said.where(np.asarray(np.isfinite(said.vel_ned_m_s).all(axis=1)))  # imported flights have none
        start_ns, stop_ns = _steered(phases, int(set_t[0]), int(set_t[-1])) if len(set_t) else (0, 0)
        told = setpoints.to(link, sysid) & (set_t >= start_ns) & (set_t <= stop_ns)
        if told.sum() < 2 or len(said.t_ns) < 2:
            continue
        north, east, down = said.vel_ned_m_s.T
        done = measured_ns(said.t_ns, said.boot_ms), np.stack([east, north, -down], axis=-1)
        motions.append(_on_grid(own_id, (set_t[told], set_vel[told]), done, step_s))
    return sorted(motions, key=lambda motion: motion.id)


def _steered(phases: list[tuple[int, str]], first_ns: int, last_ns: int) -> tuple[int, int]:
    """From the first phase in which velocities are asked for to the end of the last one; all without phases."""
    starts = [t for t, name in phases if name in _STEERED]
    if not starts:
        return first_ns, last_ns
    ends = [t for t, name in phases if t > starts[-1] and name not in _STEERED]
    return starts[0], min(ends, default=last_ns)


def measured_ns(t_rx_ns: IntArray, boot_ms: IntArray) -> IntArray:
    """When messages were measured, by our clock, shape (t,): the highest line below what their clock is behind ours.

    Args:
        t_rx_ns: when they were received, shape (t,).
        boot_ms: their own time, shape (t,).
    """
    if not (np.diff(boot_ms) >= 0).all() or not boot_ms[0]:
        return t_rx_ns  # no clock, or one that has jumped
    boot_ns = boot_ms * 1_000_000 + 500_000
    behind_ns = t_rx_ns - boot_ns
    since_s = (boot_ns - boot_ns[0]) / 1e9
    rate = _rate(since_s, behind_ns / 1e9) if since_s[-1] > _RATE_OVER_S else 0.0
    if not _RATE_MIN <= abs(rate) <= _RATE_MAX:
        return np.asarray(boot_ns + behind_ns.min())
    drift_ns = np.rint(rate * since_s * 1e9).astype(np.int64)
    return np.asarray(boot_ns + drift_ns + (behind_ns - drift_ns).min())


def _rate(times_s: FloatArray, behind_s: FloatArray) -> float:
    """Slope of the lower hull of points where it passes under their middle: what is above it is delay."""
    hull: list[tuple[float, float]] = []
    for x, y in zip(times_s.tolist(), behind_s.tolist(), strict=True):
        while len(hull) > 1:
            (x0, y0), (x1, y1) = hull[-2:]
            if (x1 - x0) * (y - y0) > (y1 - y0) * (x - x0):
                break
            hull.pop()
        if hull and x == hull[-1][0]:
            continue
        hull.append((x, y))
    middle_s = float(times_s.mean())
    for (x0, y0), (x1, y1) in pairwise(hull):
        if x0 <= middle_s <= x1:
            return (y1 - y0) / (x1 - x0)
    return 0.0


def _on_grid(
    own_id: int, asked: tuple[IntArray, FloatArray], done: tuple[IntArray, FloatArray], step_s: float
) -> Motion:
    grid = np.arange(int(asked[0][0]), int(asked[0][-1]), round(step_s * 1e9))
    last = np.searchsorted(asked[0], grid, side="right") - 1
    told = asked[1][last]
    times, velocity = done
    after = np.clip(np.searchsorted(times, grid), 1, len(times) - 1)
    known = (grid >= times[after - 1]) & (grid <= times[after]) & (times[after] - times[after - 1] <= _GAP_NS)
    known &= grid - asked[0][last] <= _PAUSE_NS
    seen = np.stack([np.interp(grid, times, velocity[:, axis]) for axis in range(3)], axis=-1)
    return Motion(own_id, told, np.where(known[:, None], seen, np.nan))
