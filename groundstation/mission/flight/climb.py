"""Takeoffs by command, for autopilots that do not lift off by velocity.

Such a vehicle gets no setpoints until its climb is over: they would end it. From then on it gets them without a break,
like all others. Until then nothing keeps it clear of anybody: it is not asked to climb before whoever has a pad above
its own is ahead: has left the ground, if it climbs by command as well (those that wait are armed, and disarm by
themselves after ten seconds), or has most of its climb behind it. Who climbs by velocity does not come here.
"""

from __future__ import annotations

import numpy as np

from groundstation.core.quick import every
from groundstation.core.types import FloatArray
from groundstation.mavlink.commands import CommandQueue
from groundstation.mavlink.vehicle import LANDED_ON_GROUND, LANDED_TAKEOFF, Fleet
from groundstation.mission.flight.standing import Standing
from groundstation.mission.plan.pads import pads_above
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.roster import Roster, by_command
from groundstation.mission.timing import SECOND_NS, AskAgain, Since

_ASK_AGAIN_NS = 2 * SECOND_NS
_THERE = 0.85  # of the height: from here on setpoints do the rest
_AHEAD = 0.6  # of its height: one that climbs by velocity is ahead by then; the next takes seconds to lift off
_STAYS_NS = 2 * SECOND_NS  # at that height, whatever the landed state says


class Climb:
    """Climbs of those that need a command.

    Args:
        plan: autopilots, pads.
        roster: who climbs by command.
        beside_m: horizontal distance from which on two vehicles are clear of each other at any heights.
        standing: who stands on the ground.
    """

    def __init__(self, plan: MissionPlan, roster: Roster, beside_m: float, standing: Standing) -> None:
        self._plan = plan
        self._roster = roster
        self._standing = standing
        self._pads_above = pads_above(plan.pads_enu_m, beside_m)
        self._by_command = by_command(plan)
        self._asking = AskAgain(plan.size, _ASK_AGAIN_NS)
        self._high = Since(plan.size)

    def step(
        self, now_ns: int, fleet: Fleet, commands: CommandQueue, height_m: FloatArray, target_m: FloatArray
    ) -> None:
        """Asks those that still stand, and lets go of those that have arrived.

        Args:
            now_ns: time of this tick.
            fleet: their state.
            commands: what is asked goes out by it.
            height_m: above the pads, shape (n,).
            target_m: of the climbs, shape (n,).
        """
        high = height_m >= _THERE * target_m
        stands = self._standing.at(now_ns)
        left = np.where(self._by_command, fleet.landed_state != LANDED_ON_GROUND, height_m >= _AHEAD * target_m)
        ahead = np.asarray(high | left, dtype=np.bool_)
        for vehicle in self._roster.climbing.nonzero()[0].tolist():
            if high[vehicle]:
                self._high.note(vehicle, now_ns)
                climbing = fleet.landed_state[vehicle] in (LANDED_TAKEOFF, LANDED_ON_GROUND)
                if not climbing or self._high.held(vehicle, now_ns, _STAYS_NS):
                    self._roster.end_climb(np.arange(self._plan.size) == vehicle)
            elif (
                stands[vehicle]
                and not commands.pending(vehicle)
                and self._asking.due(vehicle, now_ns)
                and every(ahead[self._pads_above[vehicle]])
            ):
                command = self._plan.autopilots[vehicle].takeoff(float(target_m[vehicle]))
                if command is not None:
                    commands.request(vehicle, command)
                    self._asking.asked(vehicle, now_ns)
