"""Setpoints and velocities of each vehicle out of a log, side by side on one grid of times.

Velocities are dated by the vehicle's own clock, shifted so that the quickest message arrives at once: jitter of the
link drops out, and the delay that is left is the whole loop's, both ways of the link included.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from groundstation.core.types import FloatArray, IntArray
from groundstation.mavlink.codec import Frame, decode, message_id
from groundstation.records.manifest import manifest_beside
from groundstation.records.notes import PHASE_PREFIX, Event, Received, Sent
from groundstation.records.tlog import read_tlog

_IGNORE_VELOCITY = 0x0038
_STEERED = frozenset({"form", "hold", "move", "stop", "return"})
_GAP_NS = 400_000_000  # longer ones between two reports leave the velocity unknown
_PAUSE_NS = 1_000_000_000  # without setpoints for that long the vehicle does not follow them


@dataclass(frozen=True)
class Motion:
    """What one vehicle was told and what it did.

    Attributes:
        sysid: MAVLink system id.
        asked_enu_m_s: setpoint in effect at each time, shape (t, 3).
        done_enu_m_s: reported velocity, NaN where unknown, shape (t, 3).
    """

    sysid: int
    asked_enu_m_s: FloatArray
    done_enu_m_s: FloatArray


def load_motions(path: Path, step_s: float) -> list[Motion]:
    """Reads a log of ``gs fly``.

    Args:
        path: the .tlog file.
        step_s: of the grid of times.

    Returns:
        One for each vehicle that was given velocity setpoints, by system id; while the team was steered, where the
        log names its phases.

    Raises:
        UserError: the log or its manifest cannot be used.
    """
    manifest = manifest_beside(path)
    setpoint_id, position_id = message_id("SET_POSITION_TARGET_LOCAL_NED"), message_id("LOCAL_POSITION_NED")
    asked: list[tuple[int, Frame]] = []
    done: list[tuple[int, Frame]] = []
    phases: list[tuple[int, str]] = []
    for record in read_tlog(path, None if manifest is None else manifest.epoch_unix_us):
        match record:
            case Received(t_ns, _, _, frame) if frame.msgid == position_id:
                done.append((t_ns, frame))
            case Sent(t_ns, frame) if frame.msgid == setpoint_id:
                asked.append((t_ns, frame))
            case Event(t_ns, text) if text.startswith(PHASE_PREFIX):
                phases.append((t_ns, text.removeprefix(PHASE_PREFIX).strip()))
    if not asked or not done:
        return []
    set_t, set_id, set_vel, _ = _columns(asked, sender=False)
    pos_t, pos_id, pos_vel, boot_ms = _columns(done, sender=True)
    start_ns, stop_ns = _steered(phases, int(set_t[0]), int(set_t[-1]))
    motions = []
    for sysid in np.unique(set_id).tolist():
        told = (set_id == sysid) & (set_t >= start_ns) & (set_t <= stop_ns)
        said = pos_id == sysid
        if told.sum() < 2 or said.sum() < 2:
            continue
        measured = _measured_ns(pos_t[said], boot_ms[said])
        motions.append(_on_grid(sysid, (set_t[told], set_vel[told]), (measured, pos_vel[said]), step_s))
    return motions


def _columns(timed: list[tuple[int, Frame]], *, sender: bool) -> tuple[IntArray, IntArray, FloatArray, IntArray]:
    """Times, vehicle, ENU velocity and time since boot of frames of one type, those that are numbers."""
    (batch,) = decode([frame for _, frame in timed])
    north, east, down = (batch.values[name].astype(np.float64) for name in ("vx", "vy", "vz"))
    velocity = np.stack([east, north, -down], axis=-1)
    good = np.isfinite(velocity).all(axis=1)
    if not sender:
        good &= (batch.values["type_mask"] & _IGNORE_VELOCITY) == 0
    times = np.array([t for t, _ in timed], dtype=np.int64)
    ids = batch.sysid if sender else batch.values["target_system"]
    boot = batch.values["time_boot_ms"].astype(np.int64)
    return times[good], ids[good].astype(np.int64), velocity[good], boot[good]


def _steered(phases: list[tuple[int, str]], first_ns: int, last_ns: int) -> tuple[int, int]:
    """From the first phase in which velocities are asked for to the end of the last one; all without phases."""
    starts = [t for t, name in phases if name in _STEERED]
    if not starts:
        return first_ns, last_ns
    ends = [t for t, name in phases if t > starts[-1] and name not in _STEERED]
    return starts[0], min(ends, default=last_ns)


def _measured_ns(t_rx_ns: IntArray, boot_ms: IntArray) -> IntArray:
    if not (np.diff(boot_ms) >= 0).all() or not boot_ms[0]:
        return t_rx_ns  # no clock, or one that has jumped
    boot_ns = boot_ms * 1_000_000 + 500_000
    return np.asarray(boot_ns + (t_rx_ns - boot_ns).min())


def _on_grid(
    sysid: int, asked: tuple[IntArray, FloatArray], done: tuple[IntArray, FloatArray], step_s: float
) -> Motion:
    grid = np.arange(int(asked[0][0]), int(asked[0][-1]), round(step_s * 1e9))
    last = np.searchsorted(asked[0], grid, side="right") - 1
    told = asked[1][last]
    times, velocity = done
    after = np.clip(np.searchsorted(times, grid), 1, len(times) - 1)
    known = (grid >= times[after - 1]) & (grid <= times[after]) & (times[after] - times[after - 1] <= _GAP_NS)
    known &= grid - asked[0][last] <= _PAUSE_NS
    seen = np.stack([np.interp(grid, times, velocity[:, axis]) for axis in range(3)], axis=-1)
    return Motion(sysid, told, np.where(known[:, None], seen, np.nan))
