"""Frames of a motion capture system as MAVLink: ATT_POS_MOCAP, one for each body, together in a datagram.

A body that is named after a vehicle goes under system id 253 and that vehicle's id as component; one without such a
name under system id 252 and its number in the frame, from 1 on; one that the mission names as an obstacle under 251 and
its number there, from 1 on. All of one instant have the system's own time stamp. So
they are in the log, as they came.

What a vehicle is told of its own pose is a VISION_POSITION_ESTIMATE of the ground station; a gateway, behind which are
several, is told of all of them by TUNNEL with a payload type of our own.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from groundstation.core import frames
from groundstation.core.types import FloatArray, IntArray
from groundstation.mavlink.codec import Encoder, Frame, decode, message_id
from groundstation.mocap.bodies import RoomFrame
from groundstation.mocap.others import FIRST_ROW
from groundstation.mocap.room import Room

BODY_SYSID, UNNAMED_SYSID, OTHER_SYSID = 253, 252, 251
ROOM_SYSIDS = (BODY_SYSID, UNNAMED_SYSID, OTHER_SYSID)
PACKED_TYPE = 0xA000
_PACKED = struct.Struct("<Bfffffff")
_PACKED_MAX = 4
_DIAGONAL = (0, 6, 11, 15, 18, 20)  # of an upper triangle, row by row
_ANGLE_RAD = 0.02
_SAYS_COMPID = 255
_MESSAGE = message_id("ATT_POS_MOCAP")
_TEXT = message_id("STATUSTEXT")
_UNNAMED_MAX = 250


class RoomEncoder:
    """Turns frames into datagrams, with a sequence number for each body."""

    def __init__(self) -> None:
        self._encoders: dict[tuple[int, int], Encoder] = {}

    def _encoder(self, sysid: int, compid: int) -> Encoder:
        return self._encoders.setdefault((sysid, compid), Encoder(sysid, compid))

    def datagram(
        self, stamp_us: int, sysids: Sequence[int | None], pos_ned_m: FloatArray, quat_ned_from_frd: FloatArray
    ) -> bytes:
        """One instant.

        Args:
            stamp_us: by the system's own clock, > 0; 0 where it has none.
            sysids: vehicle that each body is named after, -k for the k-th obstacle, None for those without such a name.
            pos_ned_m: shape (k, 3).
            quat_ned_from_frd: shape (k, 4), NaN where only a place is known.
        """
        made = []
        for k, sysid in enumerate(sysids):
            if sysid is None and k >= _UNNAMED_MAX:
                continue
            if sysid is None:
                encoder = self._encoder(UNNAMED_SYSID, k + 1)
            else:
                encoder = self._encoder(BODY_SYSID, sysid) if sysid > 0 else self._encoder(OTHER_SYSID, -sysid)
            north, east, down = pos_ned_m[k].tolist()
            quat = quat_ned_from_frd[k].tolist()
            made.append(encoder.encode("ATT_POS_MOCAP", time_usec=stamp_us, q=quat, x=north, y=east, z=down))
        return b"".join(made)

    def words(self, text: str) -> bytes:
        """What the system has to say to people."""
        return self._encoder(BODY_SYSID, _SAYS_COMPID).encode(
            "STATUSTEXT", severity=4, text=text.encode("ascii", "replace")[:50]
        )


def own_pose(room: Room, row: int, error_m: float) -> dict[str, float | list[float]]:
    """Fields of the VISION_POSITION_ESTIMATE that tells a vehicle where it is.

    Args:
        room: what was seen.
        row: the vehicle.
        error_m: standard deviation of a place on one axis.
    """
    quat = room.quat_ned_from_frd[row]
    roll, pitch, yaw = (math.nan,) * 3
    if np.isfinite(quat).all():
        w, x, y, z = quat.tolist()
        roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
        pitch = math.asin(min(1.0, max(-1.0, 2.0 * (w * y - z * x))))
        yaw = float(frames.yaw_ned_from_quat(quat))
    covariance = [0.0] * 21
    for place, value in zip(_DIAGONAL, (error_m**2,) * 3 + (_ANGLE_RAD**2,) * 3, strict=True):
        covariance[place] = value
    north, east, down = room.pos_ned_m[row].tolist()
    return {
        "usec": max(0, int(room.measured_ns[row])) // 1000, "x": north, "y": east, "z": down,
        "roll": roll, "pitch": pitch, "yaw": yaw, "covariance": covariance,
        "reset_counter": int(room.resets[row]) & 0xFF,
    }  # fmt: skip


def packed_poses(room: Room, rows: Sequence[int]) -> Iterator[dict[str, int | bytes]]:
    """Fields of TUNNEL messages that tell a gateway where its vehicles are, four to a message."""
    for first in range(0, len(rows), _PACKED_MAX):
        part = rows[first : first + _PACKED_MAX]
        payload = b"".join(
            _PACKED.pack(room.config.ids[row], *room.pos_ned_m[row], *room.quat_ned_from_frd[row]) for row in part
        )
        yield {
            "target_system": 0, "target_component": 0, "payload_type": PACKED_TYPE, "payload_length": len(payload),
            "payload": payload,
        }  # fmt: skip


def unpacked_poses(payload: bytes) -> Iterator[tuple[int, tuple[float, ...]]]:
    """System ids, and north, east, down, quaternion w x y z (FRD to NED) of each, of a TUNNEL message's payload."""
    for at in range(0, len(payload) - _PACKED.size + 1, _PACKED.size):
        sysid, *values = _PACKED.unpack_from(payload, at)
        yield sysid, tuple(values)


def room_frames(received: Sequence[tuple[Frame, int]], row_of: Mapping[int, int]) -> Iterator[RoomFrame]:
    """Puts what came on the room's link together again, instant by instant.

    Args:
        received: frames and their arrivals, in order.
        row_of: vehicles by system id.
    """
    bodies = [(frame, t_ns) for frame, t_ns in received if frame.msgid == _MESSAGE and frame.sysid in ROOM_SYSIDS]
    if not bodies:
        return
    values = decode([frame for frame, _ in bodies])[0].values
    stamp_us = values["time_usec"].astype(np.int64)
    t_ns = np.array([t for _, t in bodies], dtype=np.int64)
    row: IntArray = np.array([_row(frame, row_of) for frame, _ in bodies], dtype=np.int64)
    place = np.stack([values["x"], values["y"], values["z"]], axis=1).astype(np.float64)
    quat = values["q"].astype(np.float64)
    norm = np.linalg.norm(quat, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        quat = np.where((np.abs(norm - 1.0) < _ROTATION_OFF)[:, None], quat / norm[:, None], np.nan)
    edges = (np.diff(stamp_us) != 0) | (np.diff(t_ns) != 0)
    for part in np.split(np.arange(len(bodies)), edges.nonzero()[0] + 1):
        first = int(part[0])
        stamp_ns = int(stamp_us[first]) * 1000 if stamp_us[first] > 0 else -1
        yield RoomFrame(stamp_ns, int(t_ns[first]), row[part], place[part], quat[part])


def _row(frame: Frame, row_of: Mapping[int, int]) -> int:
    """Whose body it is, as ``RoomFrame`` has it."""
    if frame.sysid == OTHER_SYSID:
        return FIRST_ROW + 1 - frame.compid if frame.compid else -1
    return row_of.get(frame.compid, -1) if frame.sysid == BODY_SYSID else -1


def room_words(received: Sequence[tuple[Frame, int]]) -> list[str]:
    """What the system has to say to people."""
    texts = [frame for frame, _ in received if frame.msgid == _TEXT and frame.sysid == BODY_SYSID]
    return [
        bytes(values["text"]).rstrip(b"\0").decode("ascii", "replace")
        for batch in (decode(texts) if texts else ())
        for values in batch.values
    ]


_ROTATION_OFF = 0.05
