"""What the room is like and what comes out of it, as values.

Frames: the team's, NED inside, metres; attitudes as quaternions w x y z that take FRD to NED. What a system sends in
other axes or units is turned at the edge, as the mission says (``turned``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from groundstation.core import frames
from groundstation.core.types import BoolArray, FloatArray, IntArray

MM = 0.001
LINK = "udpin://127.0.0.1:14595"
"""Where frames are taken in when a mission says nothing else."""
_RELAY_PORTS = 1_000


def relay_port(port: int) -> int:
    """Where frames go as well, for the gateway of a flight that listens on a port, should the flight be killed."""
    return port + (_RELAY_PORTS if port + _RELAY_PORTS < 65_536 else -_RELAY_PORTS)


@dataclass(frozen=True)
class RoomConfig:
    """Whom to look for, and how fast they may be.

    Attributes:
        link: number of the link that frames come by.
        url: its address, for messages.
        ids: of the vehicles, for messages.
        pads_ned_m: where they stand before takeoff, shape (n, 3).
        by_place: bodies are told apart by where they stand and fly, not by their names.
        speed_m_s: no vehicle is faster.
        others: names of bodies that are no vehicles and are looked for as well.
    """

    link: int
    url: str
    ids: tuple[int, ...]
    pads_ned_m: FloatArray
    by_place: bool
    speed_m_s: float
    others: tuple[str, ...] = ()


@dataclass(frozen=True)
class RoomFrame:
    """All bodies of one instant.

    Attributes:
        stamp_ns: by the system's own clock; -1 where it has none.
        t_rx_ns: arrival, on our clock.
        row: vehicle that each body is named after, -1 for those that have no such name, -2 for the first of the
            ``others``, -3 for the second and so on, shape (k,).
        pos_ned_m: shape (k, 3).
        quat_ned_from_frd: shape (k, 4); NaN where only a place is known.
    """

    stamp_ns: int
    t_rx_ns: int
    row: IntArray
    pos_ned_m: FloatArray
    quat_ned_from_frd: FloatArray

    def only(self, rows: BoolArray) -> RoomFrame:
        """Some of its bodies, shape (k,)."""
        return RoomFrame(
            self.stamp_ns, self.t_rx_ns, self.row[rows], self.pos_ned_m[rows], self.quat_ned_from_frd[rows]
        )


def room_config(mission: Mapping[str, object], url: str | None, links: int) -> RoomConfig | None:
    """The room of a mission, as its file or its manifest has it; None where positions come from the vehicles alone.

    Flights and whoever reads their logs come here, so that both believe the same.

    Args:
        mission: its keys and values, read and judged.
        url: where frames come in, for messages.
        links: how many links the vehicles have; the room's comes after them.
    """
    given = mission.get("positioning")
    if not isinstance(given, Mapping):
        return None
    vehicles = cast("Sequence[Mapping[str, object]]", mission["vehicles"])
    pads = np.array([vehicle["pad_m"] for vehicle in vehicles], dtype=np.float64)
    return RoomConfig(
        link=links,
        url=url or str(given.get("link") or LINK),
        ids=tuple(int(str(vehicle["id"])) for vehicle in vehicles),
        pads_ned_m=frames.ned_from_enu(pads),
        by_place=given.get("bodies") == "place",
        speed_m_s=max(1.0, 3.0 * float(str(mission.get("speed_limit_m_s", 0.5)))),
        others=tuple(
            str(item["body"]) for item in cast("Sequence[Mapping[str, object]]", given.get("obstacles") or ())
        ),
    )


def turned(pos: FloatArray, quat_wxyz: FloatArray, *, up: str, unit: str) -> tuple[FloatArray, FloatArray]:
    """Turns what a system tells into NED metres.

    Args:
        pos: places in the system's axes, shape (k, 3).
        quat_wxyz: takes the body's axes (x forward, and up as the system has it) to the system's, shape (k, 4).
        up: z, or y: then x forward or east stays, and z points to the right or south.
        unit: m or mm.

    Returns:
        Places in NED, m, and quaternions that take FRD to NED.
    """
    place, quat = np.asarray(pos, dtype=np.float64), np.asarray(quat_wxyz, dtype=np.float64)
    if up == "y":
        place = np.stack([place[:, 0], -place[:, 2], place[:, 1]], axis=1)
        quat = np.stack([quat[:, 0], quat[:, 1], -quat[:, 3], quat[:, 2]], axis=1)
    place = place * (MM if unit == "mm" else 1.0)
    # ENU to NED exchanges x and y and turns z; FLU to FRD turns y and z: q = q(NED from ENU) q q(FLU from FRD).
    w, x, y, z = quat.T
    half = np.sqrt(0.5)
    ned = np.stack([half * (w + z), half * (x + y), half * (x - y), half * (w - z)], axis=1)
    return frames.ned_from_enu(place), ned
