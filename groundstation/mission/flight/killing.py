"""Stops motors, in the air too, because the operator says so; repeated until the vehicle shows that it has obeyed.

Never decides this by itself. An acknowledgement alone is not believed: it may be that of another arming command. The
end is a heartbeat, newer than the order, that says disarmed.
"""

from __future__ import annotations

from collections.abc import Iterable

from groundstation.core.quick import some
from groundstation.core.types import BoolArray
from groundstation.mavlink.commands import CommandQueue
from groundstation.mavlink.vehicle import NEVER, Fleet
from groundstation.mission.flight.landing import LOST_S
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.roster import Roster
from groundstation.mission.timing import SECOND_NS, AskAgain

_ASK_AGAIN_NS = SECOND_NS // 2
_NEWER_NS = SECOND_NS // 2  # a heartbeat that was under way when the order came shows nothing
_FALLS_NS = 5 * SECOND_NS  # so long after its motors have stopped a vehicle may still be falling


class Killing:
    """Vehicles whose motors are to stop: they get no setpoints and no other commands from then on."""

    def __init__(self, plan: MissionPlan, fleet: Fleet, commands: CommandQueue, roster: Roster) -> None:
        self._plan, self._fleet, self._commands, self._roster = plan, fleet, commands, roster
        self._asking = AskAgain(plan.size, _ASK_AGAIN_NS)
        self._looked_ns, self._not_shown = NEVER, roster.killed

    def want(self, vehicles: Iterable[int], now_ns: int) -> None:
        """Puts the command before everything else that waits for a vehicle."""
        vehicles = list(vehicles)
        self._roster.kill(vehicles, now_ns)
        self._looked_ns = NEVER
        for vehicle in vehicles:
            self._commands.clear(vehicle)
            self._fleet.expect_disarm(vehicle)
            self._asking.at_once(vehicle)

    def step(self, now_ns: int) -> None:
        """Asks again, without end, as long as the vehicle has not shown that it is disarmed."""
        not_shown = self.not_shown(now_ns)
        if not some(not_shown):
            return
        for vehicle in (not_shown & self._asking.all_due(now_ns)).nonzero()[0].tolist():
            self._commands.request(vehicle, self._plan.autopilots[vehicle].kill())
            self._asking.asked(vehicle, now_ns)

    def not_shown(self, now_ns: int) -> BoolArray:
        """Vehicles that shall be dead and have not shown it yet, shape (n,); worked out once a tick."""
        if not some(self._roster.killed):
            return self._roster.killed
        if self._looked_ns != now_ns:
            shown: BoolArray = ~self._fleet.armed & (self._fleet.heartbeat_ns > self._roster.killed_ns + _NEWER_NS)
            self._looked_ns, self._not_shown = now_ns, self._roster.killed & ~shown
        return self._not_shown

    def unheard(self, now_ns: int) -> BoolArray:
        """Vehicles that have not shown it, and are not heard any more, shape (n,): nobody waits for these."""
        return self.not_shown(now_ns) & self._fleet.silent(now_ns, LOST_S)

    def falling(self, now_ns: int) -> BoolArray:
        """Vehicles that may be on their way down, shape (n,)."""
        if not some(self._roster.killed):
            return self._roster.killed
        return self._roster.killed & (self.not_shown(now_ns) | (now_ns - self._roster.killed_ns < _FALLS_NS))
