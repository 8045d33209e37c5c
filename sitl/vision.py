"""Positions from outside (motion capture, cameras) for vehicles that fly without GPS.

Samples have to come often enough and with growing time stamps, else they are dropped without a word, as the real
estimators do. The first good ones fix where the local frame lies: LOCAL_POSITION_NED then is what vision says.
Refuses to be a filter: the belief follows the samples with a short lag.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from groundstation.mavlink.codec import Frame
from sitl.protocol import MSG_ATT_POS_MOCAP, MSG_ODOMETRY, MSG_VICON_POSITION_ESTIMATE, MSG_VISION_POSITION_ESTIMATE
from sitl.wire import Fields

if TYPE_CHECKING:
    from sitl.autopilot import Autopilot

SECOND = 1_000_000_000
_WINDOW_NS = SECOND // 2
_SAMPLES_MIN = 10  # in half a second: 20 Hz; 30 to 50 Hz are asked for
_LOST_NS = SECOND
_FOLLOW = 0.2
LOCAL_NED, LOCAL_FRD, BODY_FRD = 1, 20, 12


class Vision:
    """External positions of one vehicle.

    Args:
        pilot: whose.
        messages: ids that its estimator takes.
        odometry_frames: values of ODOMETRY.frame_id that it takes.
    """

    def __init__(self, pilot: Autopilot, messages: tuple[int, ...], odometry_frames: tuple[int, ...]) -> None:
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
        self._arrivals.append(pilot.world.now_ns)
        world, i = pilot.world, pilot.index
        if world.has_position[i] and not world.has_gps[i]:
            north, east, down = place
            origin = world.origin_enu_m[:, i]
            believed = pilot.pos_est()
            for axis, seen in enumerate((origin[0] + east, origin[1] + north, origin[2] - down)):
                world.estimator.offset_enu_m[axis, i] += _FOLLOW * (seen - believed[axis])
            world.estimator.refresh()

    def tick(self, now_ns: int) -> None:
        """Finds and loses the position."""
        pilot = self._pilot
        world, i = pilot.world, pilot.index
        while self._arrivals and now_ns - self._arrivals[0] > _WINDOW_NS and len(self._arrivals) > 1:
            self._arrivals.pop(0)
        if world.has_gps[i]:
            return
        if world.has_position[i]:
            if now_ns - self._arrivals[-1] > _LOST_NS:
                world.has_position[i] = False
                self._arrivals.clear()
            return
        settled = pilot.age_ns >= pilot.boot.position_ns and pilot.vision_has_origin()
        if settled and len(self._arrivals) > _SAMPLES_MIN:
            north, east, down = self._north_east_down
            x, y, z = pilot.pos_est()
            world.origin_enu_m[:, i] = (x - east, y - north, z + down)
            world.has_origin[i] = True
            pilot.position_found()
