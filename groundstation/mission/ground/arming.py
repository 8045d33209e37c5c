"""From standing still to armed in the mode that follows us, all together or not at all.

Autopilots disarm by themselves ten seconds after arming without a takeoff, so nobody is armed for long before the last
one is: whoever has refused is asked alone first, and who waits armed for it is disarmed again. What counts is the
heartbeat; an acknowledgement is only words.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from groundstation.core.types import BoolArray
from groundstation.mavlink.commands import CommandQueue, Outcome
from groundstation.mavlink.vehicle import Fleet
from groundstation.mission.flight.standing import Standing
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.roster import Duties
from groundstation.mission.timing import SECOND_NS, AskAgain, HeldEach

_ASK_AGAIN_NS = SECOND_NS  # heartbeats tell the mode once a second; asking faster would ask in the dark
_WAITS_ARMED_NS = 4 * SECOND_NS


class Arming:
    """One attempt to arm the team.

    Args:
        plan: autopilots.
        fleet: their state.
        commands: what is asked goes out by it.
        standing: who stands on the ground.
        roster: who is ours.
    """

    def __init__(
        self, plan: MissionPlan, fleet: Fleet, commands: CommandQueue, standing: Standing, roster: Duties
    ) -> None:
        n = plan.size
        self._roster = roster
        self._plan, self._fleet, self._commands = plan, fleet, commands
        self._standing = standing
        self._asking = AskAgain(n, _ASK_AGAIN_NS)
        self._armed = HeldEach(n)
        self._reluctant: BoolArray = np.zeros(n, dtype=np.bool_)
        self._said_yes: dict[int, set[str]] = {}
        self._restarts = fleet.restarts.copy()

    def heard(self, outcome: Outcome) -> None:
        """Takes how a command ended."""
        if outcome.accepted:
            self._said_yes.setdefault(outcome.vehicle, set()).add(outcome.command.name)
        elif outcome.command == self._plan.autopilots[outcome.vehicle].arm():
            self._reluctant[outcome.vehicle] = True

    def in_mode(self) -> BoolArray:
        """Vehicles whose heartbeat shows the mode that follows us, shape (n,)."""
        modes = self._fleet.custom_mode.tolist()
        return np.array([a.is_streaming_mode(mode) for a, mode in zip(self._plan.autopilots, modes, strict=True)])

    def step(self, now_ns: int) -> bool:
        """Asks for what is missing; returns whether everybody is armed and in the mode."""
        fleet = self._fleet
        in_mode = self.in_mode()
        ready = in_mode & fleet.armed
        if ready.all():
            return True
        waited_armed = self._armed(fleet.armed, now_ns, _WAITS_ARMED_NS)
        self._reluctant &= ~ready
        may_arm = bool(in_mode.all())
        stands = self._standing.at(now_ns)
        for vehicle in np.flatnonzero(self._asking.all_due(now_ns)).tolist():
            if self._commands.pending(vehicle):
                continue
            autopilot = self._plan.autopilots[vehicle]
            if ready[vehicle]:
                waits = self._reluctant.any() and waited_armed[vehicle]
                if not waits:
                    continue
                if not stands[vehicle]:
                    continue
                self._commands.request(vehicle, autopilot.disarm())
            elif not in_mode[vehicle]:
                self._commands.request(vehicle, autopilot.streaming_mode())
            elif may_arm and (self._reluctant[vehicle] or not self._reluctant.any()):
                self._commands.request(vehicle, autopilot.arm())
            else:
                continue
            self._asking.asked(vehicle, now_ns)
        return False

    def started_anew(self) -> str | None:
        """Words for the vehicles of ours that have started anew since the attempt began, None where none has."""
        anew = self._fleet.ids[(self._fleet.restarts != self._restarts) & self._roster.ours]
        words = "has started anew while the team was arming; see to its power"
        return "; ".join(f"vehicle {sysid}: {words}" for sysid in anew) or None

    def two_senders(self, now_ns: int) -> str | None:
        """Words for those in whose name two speak, so that nobody knows whether they are armed; None for none."""
        if not self._fleet.senders.in_doubt(now_ns).any():
            return None
        told = (self._fleet.twin_behind_one_address(row, now_ns) for row in np.flatnonzero(self._roster.ours).tolist())
        names = self._fleet.ids[self._roster.ours]
        return "; ".join(f"vehicle {sysid}: {words}" for sysid, words in zip(names, told, strict=True) if words) or None

    def why_not(self, waited_s: float, said: Mapping[int, str]) -> str:
        """Words for an attempt that took too long: who, in what state, and what it said."""
        fleet, reasons = self._fleet, []
        in_mode = self.in_mode()
        late = ~in_mode if not in_mode.all() else ~fleet.armed & (self._reluctant | (not self._reluctant.any()))
        for vehicle in np.flatnonzero(late).tolist():
            autopilot = self._plan.autopilots[vehicle]
            mode = autopilot.mode_name(int(fleet.custom_mode[vehicle]))
            missing = (autopilot.arm() if in_mode[vehicle] else autopilot.streaming_mode()).name
            yes = missing in self._said_yes.get(vehicle, ())
            silence = f"it acknowledged {missing} and did not do it" if yes else "the autopilot gave no reason"
            silence += "; see what QGroundControl or Mission Planner show of its checks"
            reasons.append(
                f"vehicle {fleet.ids[vehicle]}: {'armed' if fleet.armed[vehicle] else 'not armed'} in mode {mode}"
                f" after {waited_s:g} s: {said.get(vehicle, silence)}"
            )
        return "; ".join(reasons)
