"""Positions from outside (motion capture, cameras) for vehicles that fly without GPS.

Samples have to come often enough and with growing time stamps, else they are dropped without a word, as the real
estimators do. The first good ones fix where the local frame lies: LOCAL_POSITION_NED then is what vision says.
Refuses to be a filter: the belief follows the samples with a short lag.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

from groundstation.mavlink.codec import Frame
from sitl.body import Body
from sitl.config import SECOND, Boot
from sitl.mavlink_ids import MSG_ATT_POS_MOCAP, MSG_ODOMETRY, MSG_VICON_POSITION_ESTIMATE, MSG_VISION_POSITION_ESTIMATE
from sitl.wire import Fields

_WINDOW_NS = SECOND // 2
_SAMPLES_MIN = 10  # in half a second: 20 Hz; 30 to 50 Hz are asked for
_LOST_NS = SECOND
_FOLLOW = 0.2
LOCAL_NED, LOCAL_FRD, BODY_FRD = 1, 20, 12


class Sighted(Protocol):
    """An autopilot whose estimator takes positions from outside."""

    body: Body
    boot: Boot
    messages: dict[int, Callable[[Fields, Frame], None]]

    @property
    def age_ns(self) -> int:
        """Time since power-up."""

    def vision_enabled(self) -> bool:
        """Whether its parameters let it."""

    def vision_has_origin(self) -> bool:
        """Whether it may before somebody has set an origin."""

    def position_found(self) -> None:
        """Called when the estimator has found its position."""


class Vision:
    """External positions of one vehicle.

    Args:
        pilot: whose.
        messages: ids that its estimator takes.
        odometry_frames: values of ODOMETRY.frame_id that it takes.
    """

    def __init__(self, pilot: Sighted, messages: tuple[int, ...], odometry_frames: tuple[int, ...]) -> None:
        self._pilot = pilot
        self._odometry_frames = odometry_frames
        self._arrivals: list[int] = []
        self._stamp_us = -1
        self._north_east_down = (0.0, 0.0, 0.0)
        for msgid in (
            MSG_VISION_POSITION_ESTIMATE,
            MSG_VICON_POSITION_ESTIMATE,
            MSG_ATT_POS_MOCAP,
            MSG_ODOMETRY,
        ):
            if msgid in messages:
                pilot.messages[msgid] = self._on_sample

    def _on_sample(self, fields: Fields, frame: Frame) -> None:
        pilot = self._pilot
        if not pilot.vision_enabled():
            return
        if frame.msgid == MSG_ODOMETRY and fields["frame_id"] not in self._odometry_frames:
            return
        stamp_us = int(fields["time_usec"] if "time_usec" in fields else fields["usec"])
        place = (fields["x"], fields["y"], fields["z"])
        if stamp_us <= self._stamp_us or not all(math.isfinite(v) and abs(v) < 1e5 for v in place):
            return
        self._stamp_us = stamp_us
        self._north_east_down = place
        self._arrivals.append(pilot.body.now_ns)
        body = pilot.body
        if body.senses.has_position and not body.senses.has_gps:
            north, east, down = place
            origin = body.senses.origin_enu_m
            believed = body.senses.pos_enu_m
            seen = (origin[0] + east, origin[1] + north, origin[2] - down)
            body.senses.correct([_FOLLOW * (seen[axis] - believed[axis]) for axis in range(3)])

    def tick(self, now_ns: int) -> None:
        """Finds and loses the position."""
        pilot = self._pilot
        body = pilot.body
        while self._arrivals and now_ns - self._arrivals[0] > _WINDOW_NS and len(self._arrivals) > 1:
            self._arrivals.pop(0)
        if body.senses.has_gps:
            return
        if body.senses.has_position:
            if now_ns - self._arrivals[-1] > _LOST_NS:
                body.senses.has_position = False
                self._arrivals.clear()
            return
        settled = pilot.age_ns >= pilot.boot.position_ns and pilot.vision_has_origin()
        if settled and len(self._arrivals) > _SAMPLES_MIN:
            north, east, down = self._north_east_down
            x, y, z = body.senses.pos_enu_m
            body.senses.set_origin((x - east, y - north, z + down))
            pilot.position_found()
