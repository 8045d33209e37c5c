"""Positions from outside: external position and pose, single and packed, as motion capture sends them.

Without a positioning deck (``--no-gps``) a vehicle knows where it is by these alone. When they stop it goes on by its
own accelerometer, whose error grows with the square of time; how fast (0.2 m/s^2) is our guess, not a measurement.
Refuses to be a filter: the belief follows the samples with a short lag.
"""

from __future__ import annotations

import math
import struct

from sitl.body import Body, Place
from sitl.config import SECOND

_POSITION, _GENERIC, _PACKED = 0, 1, 2
_POSE, _POSE_PACKED = 8, 9
_FOLLOW = 0.2
_STALE_NS = SECOND // 10
_DRIFT_M_S2 = 0.2
_VARIANCE_M2, _LOST_M2 = 1e-5, 1.0


class Poses:
    """One vehicle's.

    Args:
        body: whose belief follows.
        number: last byte of its radio address, by which packets for several name it.

    Attributes:
        received: how many samples were its own.
    """

    def __init__(self, body: Body, number: int) -> None:
        self._body, self._number = body, number
        self._heard_ns: int | None = None
        self.received = 0
        self._drifts = False

    def read(self, channel: int, data: bytes) -> None:
        """Takes a packet of the localisation port."""
        if channel == _POSITION and len(data) == 12:
            self._take(struct.unpack("<fff", data))
        elif channel == _GENERIC and data[:1] == bytes((_POSE,)) and len(data) == 29:
            self._take(struct.unpack_from("<fff", data, 1))
        elif channel == _GENERIC and data[:1] == bytes((_POSE_PACKED,)):
            self._packed(data[1:], 11)
        elif channel == _PACKED:
            self._packed(data, 7)

    def _packed(self, data: bytes, size: int) -> None:
        for at in range(0, len(data) - size + 1, size):
            if data[at] == self._number:
                x, y, z = struct.unpack_from("<hhh", data, at + 1)
                self._take((x / 1000.0, y / 1000.0, z / 1000.0))

    def _take(self, place: Place) -> None:
        if not all(math.isfinite(v) and abs(v) < 1e4 for v in place):
            return
        body, senses = self._body, self._body.senses
        first = not senses.has_position
        self.received += 1
        self._heard_ns = body.now_ns
        if senses.has_gps:
            return
        if not senses.has_origin:
            senses.set_origin((0.0, 0.0, 0.0))
        believed = senses.pos_enu_m
        if self._drifts:
            self._drifts = False
            senses.mislead((0.0, 0.0, 0.0))
        share = 1.0 if first else _FOLLOW
        senses.correct([share * (place[axis] - believed[axis]) for axis in range(3)])
        senses.has_position = True

    @property
    def variance_m2(self) -> float:
        """What the estimator thinks of its position's error on each axis."""
        senses = self._body.senses
        if senses.has_gps and senses.has_position:
            return _VARIANCE_M2
        if not senses.has_position or self._heard_ns is None:
            return _LOST_M2
        age_s = max(0, self._body.now_ns - self._heard_ns - _STALE_NS) / SECOND
        return _VARIANCE_M2 + float((0.5 * _DRIFT_M_S2 * age_s**2) ** 2)

    def tick(self, now_ns: int, dt_s: float) -> None:
        """Lets the belief, position and velocity, drift while nobody says where it is."""
        senses = self._body.senses
        if senses.has_gps or self._heard_ns is None:
            return
        if senses.on_ground:
            if self._drifts:
                self._drifts = False
                senses.mislead((0.0, 0.0, 0.0))
            return
        age_s = (now_ns - self._heard_ns - _STALE_NS) / SECOND
        if age_s > 0.0:
            step = _DRIFT_M_S2 * age_s * dt_s
            way = 2.4 * self._number
            senses.correct((step * math.cos(way), step * math.sin(way), 0.0))
            speed = _DRIFT_M_S2 * age_s
            senses.mislead((speed * math.cos(way), speed * math.sin(way), 0.0))
            self._drifts = True
