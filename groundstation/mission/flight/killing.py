"""Stops motors, in the air too, because the operator says so; repeated until the vehicle shows that it has obeyed.

Never decides this by itself. An acknowledgement alone is not believed: it may be that of another arming command. The
end is a heartbeat, newer than the order, that says disarmed.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from groundstation.core.types import BoolArray, IntArray
from groundstation.mavlink.commands import CommandQueue
from groundstation.mavlink.vehicle import NEVER, Fleet
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.roster import Roster

_SECOND_NS = 1_000_000_000
_ASK_AGAIN_NS = _SECOND_NS // 2
_NEWER_NS = _SECOND_NS // 2  # a heartbeat that was under way when the order came shows nothing
_FALLS_NS = 5 * _SECOND_NS  # so long after its motors have stopped a vehicle may still be falling


class Killing:
    """Vehicles whose motors are to stop: they get no setpoints and no other commands from then on."""

    def __init__(self, plan: MissionPlan, fleet: Fleet, commands: CommandQueue, roster: Roster) -> None:
        self._plan, self._fleet, self._commands, self._roster = plan, fleet, commands, roster
        self._sent_ns: IntArray = np.full(plan.size, NEVER, dtype=np.int64)

    def want(self, vehicles: Iterable[int], now_ns: int) -> None:
        """Puts the command before everything else that waits for a vehicle."""
        vehicles = list(vehicles)
        self._roster.kill(vehicles, now_ns)
        for vehicle in vehicles:
            self._commands.clear(vehicle)
            self._fleet.disarm_expected[vehicle] = True
            self._sent_ns[vehicle] = NEVER

    def step(self, now_ns: int) -> None:
        """Asks again, without end, as long as the vehicle has not shown that it is disarmed."""
        for vehicle in np.flatnonzero(self.not_shown() & (now_ns - self._sent_ns >= _ASK_AGAIN_NS)).tolist():
            self._commands.request(vehicle, self._plan.autopilots[vehicle].kill())
            self._sent_ns[vehicle] = now_ns

    def not_shown(self) -> BoolArray:
        """Vehicles that shall be dead and have not shown it yet, shape (n,)."""
        shown: BoolArray = ~self._fleet.armed & (self._fleet.heartbeat_ns > self._roster.killed_ns + _NEWER_NS)
        return self._roster.killed & ~shown

    def falling(self, now_ns: int) -> BoolArray:
        """Vehicles that may be on their way down, shape (n,)."""
        return self._roster.killed & (self.not_shown() | (now_ns - self._roster.killed_ns < _FALLS_NS))
