"""From above the pads to disarmed: each vehicle when nobody is below it, and nobody is waited for without end."""

from __future__ import annotations

import numpy as np

from groundstation.core.types import BoolArray
from groundstation.mavlink.commands import CommandQueue
from groundstation.mavlink.vehicle import LANDED_ON_GROUND, NEVER, Fleet
from groundstation.mission.guidance import Poses
from groundstation.mission.plan import MissionPlan

_SECOND_NS = 1_000_000_000
_ASK_AGAIN_NS = _SECOND_NS
_STILL_ARMED_NS = 5 * _SECOND_NS


class Landing:
    """Landings of one team.

    Args:
        plan: autopilots, r.
        fleet: their state.
        commands: what is asked goes out by it.

    Attributes:
        asked: was told to land, shape (n,).
    """

    def __init__(self, plan: MissionPlan, fleet: Fleet, commands: CommandQueue) -> None:
        self._plan, self._fleet, self._commands = plan, fleet, commands
        self.asked: BoolArray = np.zeros(plan.size, dtype=np.bool_)
        self._asked_ns = np.full(plan.size, NEVER, dtype=np.int64)
        self._on_ground_since_ns = np.full(plan.size, NEVER, dtype=np.int64)

    def ask(self, vehicle: int, now_ns: int) -> None:
        """Tells a vehicle to land where it is."""
        self._commands.request(vehicle, self._plan.autopilots[vehicle].land())
        self.asked[vehicle] = True
        self._asked_ns[vehicle] = now_ns

    def step(self, now_ns: int, poses: Poses, released: BoolArray) -> bool:
        """Asks those that may come down; returns whether nobody of ours is armed any more.

        Args:
            now_ns: time of this tick.
            poses: where everybody is.
            released: vehicles that are no longer ours, shape (n,).
        """
        fleet = self._fleet
        on_ground = fleet.landed_state == LANDED_ON_GROUND
        self._on_ground_since_ns = np.where(
            on_ground, np.where(self._on_ground_since_ns == NEVER, now_ns, self._on_ground_since_ns), NEVER
        )
        if not fleet.armed[~released].any():
            return True
        for vehicle in np.flatnonzero(fleet.armed & ~released).tolist():
            if self._commands.pending(vehicle) or now_ns - self._asked_ns[vehicle] < _ASK_AGAIN_NS:
                continue
            autopilot = self._plan.autopilots[vehicle]
            if on_ground[vehicle]:
                if now_ns - self._on_ground_since_ns[vehicle] >= _STILL_ARMED_NS:
                    self._commands.request(vehicle, autopilot.disarm())
                    self._asked_ns[vehicle] = now_ns
            elif not autopilot.is_landing_mode(int(fleet.custom_mode[vehicle])) and self._clear_below(vehicle, poses):
                self.ask(vehicle, now_ns)
        return False

    def still_armed(self, waited_s: float, released: BoolArray) -> str:
        """Words for vehicles that were told to land and are armed all the same."""
        fleet = self._fleet
        rows = np.flatnonzero(fleet.armed & ~released)
        modes = [self._plan.autopilots[i].mode_name(int(fleet.custom_mode[i])) for i in rows]
        return "; ".join(
            f"vehicle {fleet.sysid[i]}: told to land, and armed in mode {mode} after {waited_s:.0f} s; take it over"
            for i, mode in zip(rows, modes, strict=True)
        )

    def _clear_below(self, vehicle: int, poses: Poses) -> bool:
        """Whether nobody else stands or hovers where this vehicle would come down."""
        radius = self._plan.spec.avoidance.radius_m
        away = poses.pos_team_ned_m - poses.pos_team_ned_m[vehicle]
        beside = np.hypot(away[:, 0], away[:, 1]) >= radius
        above = away[:, 2] < -radius
        beside[vehicle] = True
        return bool((beside | above).all())
