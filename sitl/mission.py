"""Flies stored missions: takeoff, waypoints with a waiting time, land, return; other items are passed over.

Refuses to know modes: what an autopilot does when a mission asks to land, to return, or is over, it does itself.
"""

from __future__ import annotations

import math
from enum import Enum
from typing import Protocol

from sitl.body import Body
from sitl.frames import is_place
from sitl.mission_store import MissionStore
from sitl.setpoints import NOTHING
from sitl.voice import Voice
from sitl.wire import Fields

WAYPOINT, LOITER_TIME, RETURN, LAND, TAKEOFF = 16, 19, 20, 21, 22
_GLOBAL_AMSL = (0, 5)
_REACHED_M = 0.5

Point = tuple[float, float, float]


class MissionEnd(Enum):
    """How a mission ends."""

    OVER, LANDS, RETURNS = range(3)


class Flown(Protocol):
    """An autopilot that flies missions."""

    body: Body
    voice: Voice
    mission: MissionStore
    first_item_is_home: bool

    def mission_ends(self, end: MissionEnd) -> None:
        """Called when the mission asks for it, and every tick after the last item."""


class MissionFlight:
    """Progress of one vehicle through its mission; the item under way is ``pilot.mission.seq``."""

    def __init__(self, pilot: Flown) -> None:
        self._pilot = pilot
        self._target: Point | None = None
        self._reached_ns: int | None = None
        self._seq = 0  # the item that the target belongs to

    def act(self, entering: bool) -> None:
        """Moves on; called every tick while the mission mode acts."""
        pilot = self._pilot
        if entering or pilot.mission.seq != self._seq:
            self._target, self._seq = None, pilot.mission.seq
        if entering:
            pilot.body.motors.limit_speed()
        if pilot.mission.seq >= len(pilot.mission):
            pilot.mission_ends(MissionEnd.OVER)
            return
        item = pilot.mission.items[pilot.mission.seq]
        command = int(item["command"])
        if pilot.mission.seq == 0 and pilot.first_item_is_home:
            self._next()
        elif command in (WAYPOINT, LOITER_TIME, TAKEOFF):
            self._fly(item)
        elif command == LAND:
            pilot.mission_ends(MissionEnd.LANDS)
        elif command == RETURN:
            pilot.mission_ends(MissionEnd.RETURNS)
        else:
            self._next()

    def _fly(self, item: Fields) -> None:
        pilot = self._pilot
        now_ns = pilot.body.now_ns
        if self._target is None:
            self._target, self._reached_ns = self._place(item), None
            pilot.body.motors.command(self._target, NOTHING)
            pilot.voice.send("MISSION_CURRENT", seq=pilot.mission.seq, total=len(pilot.mission))
        if math.dist(self._target, pilot.body.senses.pos_enu_m) > _REACHED_M:
            return
        if self._reached_ns is None:
            self._reached_ns = now_ns
            pilot.voice.send("MISSION_ITEM_REACHED", seq=pilot.mission.seq)
        wait_s = item["param1"] if item["command"] in (WAYPOINT, LOITER_TIME) else 0.0
        if now_ns - self._reached_ns >= (wait_s if math.isfinite(wait_s) else 0.0) * 1e9:
            self._next()

    def _next(self) -> None:
        self._pilot.mission.seq += 1
        self._target = None

    def _place(self, item: Fields) -> Point:
        """Where an item is, ENU; without a place of its own it is above or below here."""
        pilot = self._pilot
        body = pilot.body
        x, y, _ = body.senses.pos_enu_m
        lat, lon = item["x"] * 1e-7, item["y"] * 1e-7
        if is_place(lat, lon, 0.0) and (item["x"], item["y"]) != (0, 0):
            x, y, _ = body.geodesy.enu_from_geodetic(lat, lon, body.home_alt_m).tolist()
        height = item["z"] if is_place(0.0, 0.0, item["z"]) else 0.0
        if item["frame"] in _GLOBAL_AMSL:
            return x, y, height - body.home_alt_m
        return x, y, body.senses.home_enu_m[2] + height
