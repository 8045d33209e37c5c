"""One look at a flight, as bytes and back: what a console shows.

A datagram is ``GSVIEW``, the version, the length of a header, the header (JSON: words, and which arrays follow) and the
arrays, little endian. Pure: no sockets, no clock. Refuses whatever does not add up; unknown is NaN, which JSON has not,
so that figures stand in an array.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from groundstation.core.types import FloatArray, IntArray

VERSION = 3
BYTES_MAX = 150_000
"""Longest snapshot; what a local datagram holds by the kernel's default."""
NOTES_MAX = 40
FIGURES = ("min_distance_m", "formation_error_m", "time_to_form_s", "setpoints", "ticks", "deadline_misses")
"""Figures of the flight, by the names that the answer of ``gs fly --json`` has for them."""
HELD, LOST, FOREIGN, AIRBORNE, ARMED, AVOIDS, BLOCKED = 1, 2, 4, 8, 16, 32, 64
"""Bits of ``state``: stands still by a monitor, position lost for good, does not follow, in the air, armed,
makes way for somebody or something, finds no way."""
_HEAD = struct.Struct("<6sHI")
_MAGIC = b"GSVIEW"
_ROWS_MAX = 1_000
_WIDTHS = {
    "ids": 0,
    "role": 0,
    "duty": 0,
    "state": 0,
    "pos_team_enu_m": 3,
    "quat_ned_from_frd": 4,
    "setpoint_enu_m_s": 3,
    "battery": 0,
    "pose_age_s": 0,
    "silent_s": 0,
    "lost_share": 0,
    "link_heard": 0,
    "link_trip_s": 0,
    "extra_radius_m": 0,
    "pads_enu_m": 3,
    "goal_enu_m": 3,
}
_WHOLE = frozenset({"ids", "role", "duty", "state", "edges"})


@dataclass(frozen=True)
class Words:
    """What of a snapshot is text, or holds for the whole flight.

    Attributes:
        mission: its name.
        phase: what the team is doing.
        outcome: "" until the end, then completed, aborted or refused.
        reason: why it was aborted or refused.
        modes: of each vehicle, as its autopilot names it.
        said: last text of each vehicle.
        notes: newest things that happened: seconds, kind, text.
        radius_m: r of the mission.
        problems: what stands between the team and arming, with its remedy, before that.
        checks: what preflight found, a row for each vehicle: ``check_screen.COLUMNS``, then what is wrong and what to
            do; empty where it is not told anew, or is over.
        refused: orders that the flight would refuse at this moment, and why.
    """

    mission: str
    phase: str
    outcome: str
    reason: str
    modes: tuple[str, ...]
    said: tuple[str, ...]
    notes: tuple[tuple[float, str, str], ...]
    radius_m: float
    problems: tuple[str, ...] = ()
    checks: tuple[tuple[str, ...], ...] = ()
    refused: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Snapshot:
    """A flight at one instant; n vehicles.

    Attributes:
        words: what is text.
        t_s: time of the tick.
        ids: MAVLink system ids, shape (n,).
        role: point of the formation that each one flies, shape (n,).
        duty: ``roster.Duty``, shape (n,).
        state: bits, see ``HELD`` and on, shape (n,).
        pos_team_enu_m: NaN where unknown, shape (n, 3).
        quat_ned_from_frd: w x y z, shape (n, 4).
        setpoint_enu_m_s: velocities of the last tick, shape (n, 3).
        battery: 0 to 1, shape (n,).
        pose_age_s: shape (n,).
        silent_s: since when nothing was heard, shape (n,).
        lost_share: of its frames in the last second, 0 to 1, shape (n,).
        link_heard: share of what its radio sends that comes, by its gateway, 0 to 1, shape (n,).
        link_trip_s: there and back by that radio, shape (n,).
        extra_radius_m: what is added to r around whom nobody steers, shape (n,).
        pads_enu_m: shape (n, 3).
        goal_enu_m: the point of each one's role, at the formation's present size, anywhere, shape (n, 3).
        fence_enu_m: its two corners, shape (2, 3).
        edges: neighbours in the sensing graph, rows counted from 0, shape (m, 2).
        figures: in the order of ``FIGURES``, shape (6,).
        anchor_deg_m: where on earth the team's frame begins: latitude, longitude, height; NaN where that is not known,
            shape (3,).
        tick_ms: longest from when a tick was due to when it had sent, since the snapshot before; NaN in virtual time.
    """

    words: Words
    t_s: float
    ids: IntArray
    role: IntArray
    duty: IntArray
    state: IntArray
    pos_team_enu_m: FloatArray
    quat_ned_from_frd: FloatArray
    setpoint_enu_m_s: FloatArray
    battery: FloatArray
    pose_age_s: FloatArray
    silent_s: FloatArray
    lost_share: FloatArray
    link_heard: FloatArray
    link_trip_s: FloatArray
    extra_radius_m: FloatArray
    pads_enu_m: FloatArray
    goal_enu_m: FloatArray
    fence_enu_m: FloatArray
    edges: IntArray
    figures: FloatArray
    anchor_deg_m: FloatArray
    tick_ms: float = math.nan

    def figure(self, name: str) -> float:
        """One of ``FIGURES``."""
        return float(self.figures[FIGURES.index(name)])


_ARRAYS = (*_WIDTHS, "fence_enu_m", "edges", "figures", "anchor_deg_m")


def encode(snapshot: Snapshot) -> bytes:
    """Turns a snapshot into one datagram; positions and the like are kept to 32 bits."""
    words = snapshot.words
    header = json.dumps(
        {
            "n": len(snapshot.ids),
            "m": len(snapshot.edges),
            "t_s": snapshot.t_s,
            "mission": words.mission,
            "phase": words.phase,
            "outcome": words.outcome,
            "reason": words.reason,
            "modes": words.modes,
            "said": words.said,
            "notes": words.notes[-NOTES_MAX:],
            "radius_m": words.radius_m,
            "problems": words.problems,
            "checks": words.checks,
            "refused": words.refused,
            "tick_ms": snapshot.tick_ms if math.isfinite(snapshot.tick_ms) else None,
        }
    ).encode()
    body = [np.asarray(getattr(snapshot, name), _kind(name)).tobytes() for name in _ARRAYS]
    return b"".join((_HEAD.pack(_MAGIC, VERSION, len(header)), header, *body))


def _kind(name: str) -> str:
    return "<i4" if name in _WHOLE else "<f8" if name in ("figures", "anchor_deg_m") else "<f4"


def decode(data: bytes) -> Snapshot:
    """Reads a datagram.

    Raises:
        ValueError: it is no snapshot, of another version, or does not add up; in words for people.
    """
    if len(data) < _HEAD.size:
        raise ValueError("snapshot: too short")
    magic, version, length = _HEAD.unpack_from(data)
    if magic != _MAGIC:
        raise ValueError("snapshot: these bytes are none")
    if version != VERSION:
        raise ValueError(f"snapshot: version {version}, expected {VERSION}; use the same gs for flight and console")
    try:
        header = json.loads(data[_HEAD.size : _HEAD.size + length])
        n, m = int(header["n"]), int(header["m"])
        words = Words(
            mission=str(header["mission"]),
            phase=str(header["phase"]),
            outcome=str(header["outcome"]),
            reason=str(header["reason"]),
            modes=tuple(map(str, header["modes"])),
            said=tuple(map(str, header["said"])),
            notes=tuple((float(t_s), str(kind), str(text)) for t_s, kind, text in header["notes"]),
            radius_m=float(header["radius_m"]),
            problems=tuple(map(str, header["problems"])),
            checks=tuple(tuple(map(str, row)) for row in header["checks"]),
            refused={str(order): str(why) for order, why in dict(header["refused"]).items()},
        )
        t_s = float(header["t_s"])
        tick_ms = math.nan if header["tick_ms"] is None else float(header["tick_ms"])
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        raise ValueError(f"snapshot: its header cannot be read: {error}") from error
    if not (0 < n <= _ROWS_MAX and 0 <= m <= n * n and len(words.modes) == len(words.said) == n and math.isfinite(t_s)):
        raise ValueError(f"snapshot: {n} vehicles, {m} edges, {len(words.modes)} modes do not fit")
    shapes = {name: (n, width) if width else (n,) for name, width in _WIDTHS.items()}
    shapes |= {"fence_enu_m": (2, 3), "edges": (m, 2), "figures": (len(FIGURES),), "anchor_deg_m": (3,)}
    arrays: dict[str, FloatArray] = {}
    at = _HEAD.size + length
    for name in _ARRAYS:
        count, kind = math.prod(shapes[name]), np.dtype(_kind(name))
        if at + count * kind.itemsize > len(data):
            raise ValueError(f"snapshot: ends within {name}")
        with np.errstate(invalid="ignore"):  # bytes bent out of shape may be a signalling NaN
            arrays[name] = np.frombuffer(data, kind, count, at).reshape(shapes[name]).astype(np.float64)
        at += count * kind.itemsize
    whole: dict[str, IntArray] = {name: arrays.pop(name).astype(np.int64) for name in sorted(_WHOLE)}
    edges = whole["edges"]
    if at != len(data) or (m and not (edges.min() >= 0 and edges.max() < n)):
        raise ValueError("snapshot: bytes too many, or edges between nobody")
    return Snapshot(
        words=words,
        t_s=t_s,
        ids=whole["ids"],
        role=whole["role"],
        duty=whole["duty"],
        state=whole["state"],
        edges=edges,
        tick_ms=tick_ms,
        **arrays,
    )
