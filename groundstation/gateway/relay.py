"""Poses from the room when the flight has fallen silent: whoever holds the vehicles then tells them where they are.

A flight that was killed tells nobody where it is any more, and without that a Crazyflie's own estimate drifts away
within seconds: neither holding nor returning is worth anything then. The gateway hears the same frames, and follows the
same bodies by the same rules, from where the flight saw each last. While the flight speaks, frames are let go unread.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from groundstation.core import frames
from groundstation.gateway.measured import external_pose
from groundstation.gateway.orders import ExternalPose
from groundstation.gateway.pilot import SECOND_NS
from groundstation.mavlink.codec import Frame, Splitters
from groundstation.mavlink.mocap_frames import room_frames
from groundstation.mocap.bodies import RoomConfig
from groundstation.mocap.room import Room

_QUIET_NS = 150_000_000
"""Without a pose of the flight for so long, to anybody, it is silent."""


class Relay:
    """The room of a gateway's vehicles.

    Args:
        config: whom to look for.
        hz: poses a second that each is told at most.

    Attributes:
        speaks: poses come from here at the moment.
    """

    def __init__(self, config: RoomConfig, hz: float) -> None:
        self._config, self._period_ns = config, round(SECOND_NS / hz)
        self._row_of = {sysid: row for row, sysid in enumerate(config.ids)}
        self._splitters = Splitters()
        self._room: Room | None = None
        self._told_ns: dict[int, int] = {}

    @property
    def speaks(self) -> bool:
        """Whether poses come from here at the moment."""
        return self._room is not None

    def poses(
        self, data: list[bytes], told: Mapping[int, tuple[int, ExternalPose]], now_ns: int
    ) -> dict[int, ExternalPose]:
        """Takes datagrams of the room; returns what vehicles are to be told, by system id.

        Args:
            data: that have come since the last call.
            told: the last pose that each was told by the flight, and when; who never was is not looked for.
            now_ns: time.
        """
        if not told or now_ns - max(when for when, _ in told.values()) <= _QUIET_NS:
            self._room = None
            return {}
        if self._room is None:
            self._room = self._begun(told)
        found: dict[int, ExternalPose] = {}
        for piece in data:
            received = [(item, now_ns) for item in self._splitters.feed((0, ""), piece, stream=False)]
            for frame in room_frames([(item, t) for item, t in received if isinstance(item, Frame)], self._row_of):
                seen = self._room.take(frame)
                for row in () if seen is None else seen.row.tolist():
                    sysid = self._config.ids[row]
                    if now_ns - self._told_ns.get(sysid, -SECOND_NS) >= 0.9 * self._period_ns:
                        self._told_ns[sysid] = now_ns
                        found[sysid] = external_pose(*self._room.pos_ned_m[row], *self._room.quat_ned_from_frd[row])
        return found

    def _begun(self, told: Mapping[int, tuple[int, ExternalPose]]) -> Room:
        """Everybody flies from where the flight saw it last."""
        room = Room(self._config)
        for sysid, (when_ns, pose) in told.items():
            room.flies_from(self._row_of[sysid], frames.ned_from_enu(np.array(pose.pos_enu_m)), when_ns)
        room.hold()
        return room
