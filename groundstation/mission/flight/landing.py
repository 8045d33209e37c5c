"""Brings vehicles down, each when nobody is below it, and knows when the whole team is down.

Of two over their own pads, one pad above the other, the lower one lands first.

Landing where they are, a team may hover in layers: whoever has somebody below moves aside first (``clear_spots``).

A vehicle that nobody has heard from for a while cannot be waited for: it is given up as lost, by name, so that the
ground station ends and says so. One that reports to stand on the ground and sends no heartbeats is named as well:
whether it is disarmed is not known.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from groundstation.core import frames
from groundstation.core.types import BoolArray, FloatArray
from groundstation.mavlink.commands import CommandQueue, Outcome
from groundstation.mavlink.vehicle import LANDED_ON_GROUND, NEVER, Fleet
from groundstation.mission.flight.poses import Poses
from groundstation.mission.flight.standing import landed_age_s
from groundstation.mission.plan.pads import pads_above
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.roster import Roster
from groundstation.mission.timing import SECOND_NS, AskAgain, HeldEach

_ASK_AGAIN_NS = SECOND_NS  # heartbeats tell the mode once a second; asking faster would ask in the dark
_STILL_ARMED_NS = 5 * SECOND_NS  # autopilots disarm by themselves two seconds after landing
_BLOCKED_MAX_NS = 20 * SECOND_NS
_LOST_S = 10.0
_OVER = 0.5  # over its own pad is who is within this share of r, horizontally


class Landing:
    """Landings of one team.

    Args:
        plan: autopilots, limits, pads.
        fleet: their state.
        commands: what is asked goes out by it.
        roster: who lands.
        beside_m: horizontal distance from which on two vehicles are clear of each other at any heights.
    """

    def __init__(
        self, plan: MissionPlan, fleet: Fleet, commands: CommandQueue, roster: Roster, beside_m: float
    ) -> None:
        n = plan.size
        self._plan = plan
        self._roster = roster
        self._pads_ned_m = frames.ned_from_enu(plan.pads_enu_m)
        self._pads_above = pads_above(plan.pads_enu_m, beside_m)
        self._fleet = fleet
        self._commands = commands
        self._landed_age_s = landed_age_s(plan)
        self._asking = AskAgain(n, _ASK_AGAIN_NS)
        self._on_ground = HeldEach(n)
        self._said_yes: set[tuple[int, str]] = set()

    def heard(self, outcome: Outcome) -> None:
        """Takes how a command ended."""
        if outcome.accepted:
            self._said_yes.add((outcome.vehicle, outcome.command.name))

    def want(self, vehicles: Iterable[int], now_ns: int) -> None:
        """Notes that vehicles shall land where they are, as soon as nobody is below.

        What was asked of them before and is not answered yet is forgotten: a takeoff asked again now would be obeyed.
        """
        for vehicle in self._roster.land(vehicles, now_ns):
            self._commands.clear(vehicle)

    def want_here(self, vehicles: Iterable[int], places_ned_m: FloatArray, now_ns: int) -> None:
        """The same of vehicles that come down while the others fly on: those below are to get out of the way.

        Args:
            vehicles: which.
            places_ned_m: where each stays until it is told to land, of everybody, shape (n, 3).
            now_ns: time of the tick.
        """
        for vehicle in self._roster.land_here(vehicles, places_ned_m, now_ns):
            self._commands.clear(vehicle)

    def step(self, now_ns: int, poses: Poses) -> None:
        """Asks those to land who shall, and those to disarm who have stood on the ground for long.

        Args:
            now_ns: time of the tick.
            poses: where everybody is.
        """
        fleet, roster = self._fleet, self._roster
        on_ground = fleet.stands(now_ns, self._landed_age_s)
        still_armed = self._on_ground(on_ground, now_ns, _STILL_ARMED_NS)
        for vehicle in np.flatnonzero(roster.lands & fleet.armed).tolist():
            if self._commands.pending(vehicle) or not self._asking.due(vehicle, now_ns):
                continue
            autopilot = self._plan.autopilots[vehicle]
            if on_ground[vehicle]:
                if still_armed[vehicle]:
                    self._commands.request(vehicle, autopilot.disarm())
                    self._asking.asked(vehicle, now_ns)
            elif not autopilot.is_landing_mode(int(fleet.custom_mode[vehicle])):
                below = self._below(vehicle, poses)
                # Whoever waits for one that waits itself has its time from when that one is asked.
                since_ns = max(int(roster.lands_since_ns[vehicle]), *roster.told_ns[below].tolist(), NEVER)
                if not below.any() or now_ns - since_ns >= _BLOCKED_MAX_NS:
                    self._commands.request(vehicle, autopilot.land())
                    roster.tell_to_land(vehicle, now_ns)
                    self._asking.asked(vehicle, now_ns)

    def disarm_on_the_ground(self, now_ns: int) -> None:
        """Tells everybody who stands to disarm, armed or not; for an arming that is broken off before takeoff.

        An arming that is under way shows in a heartbeat up to a second later, so this is called again until
        ``still_up`` has nobody left. Who does not tell that it stands is not asked: nothing has told it to take off,
        and it disarms by itself.
        """
        for vehicle in np.flatnonzero(self._fleet.stands(now_ns, self._landed_age_s)).tolist():
            if self._asking.due(vehicle, now_ns) and not self._commands.pending(vehicle):
                self._commands.request(vehicle, self._plan.autopilots[vehicle].disarm())
                self._asking.asked(vehicle, now_ns)

    def lost(self, now_ns: int) -> BoolArray:
        """Vehicles of which nothing has been heard for ten seconds, shape (n,)."""
        return self._fleet.silent(now_ns, _LOST_S)

    def unsure(self, now_ns: int) -> BoolArray:
        """Vehicles that are heard, report to stand on the ground, and send no heartbeat any more, shape (n,).

        Whether they are disarmed cannot be known; they are not waited for longer than this.
        """
        limit_s = self._plan.spec.limits.heartbeat_age_s
        since_ns = self._on_ground.since_ns
        stood = (since_ns != NEVER) & (now_ns - since_ns >= 2 * _STILL_ARMED_NS)
        return np.asarray(self._fleet.heartbeat_stale(now_ns, limit_s) & stood & ~self.lost(now_ns))

    def still_up(self, since_ns: int, now_ns: int) -> BoolArray:
        """Vehicles that may still be armed, shape (n,); those that are released, lost or ``unsure`` are not waited for.

        Args:
            since_ns: a heartbeat has to be newer than this to be believed.
            now_ns: time of the tick.
        """
        perhaps: BoolArray = self._fleet.armed | (self._fleet.heartbeat_ns <= since_ns)
        return perhaps & self._roster.ours & ~self.lost(now_ns) & ~self.unsure(now_ns)

    def words_of_late(self, vehicle: int, height_m: float, waited_s: float) -> str:
        """Says of one that is still armed when nobody waits any longer where it is, what it does, and what is left.

        Args:
            vehicle: which one.
            height_m: above its pad, NaN where not known.
            waited_s: since landing began.
        """
        fleet, sysid = self._fleet, self._fleet.sysid[vehicle]
        autopilot = self._plan.autopilots[vehicle]
        mode = int(fleet.custom_mode[vehicle])
        on_ground = fleet.landed_state[vehicle] == LANDED_ON_GROUND
        command = autopilot.disarm() if on_ground else autopilot.land()
        told = (vehicle, command.name) in self._said_yes
        does = f"it acknowledged {command.name} and does not do it" if told else f"it has not taken {command.name}"
        if on_ground:
            where = "on the ground by its own report"
            left = "its motors may start: keep away from it, and disarm it by remote control or take its battery out"
        else:
            height = f"{height_m:.1f} m above its pad" if np.isfinite(height_m) else "at a height that is not known"
            where = f"in the air, {height}, in mode {autopilot.mode_name(mode)}"
            does = f"it sinks in mode {autopilot.mode_name(mode)}" if autopilot.is_landing_mode(mode) else does
            left = (
                "setpoints stop now, and its own failsafe acts; take it over by remote control, or clear the place and"
                f" fly again with --take-over (there, kill {sysid} stops its motors: it falls)"
            )
        return f"vehicle {sysid}: still armed after {waited_s:g} s of landing, {where}: {does}; {left}"

    def _below(self, vehicle: int, poses: Poses) -> BoolArray:
        """Who stands or hovers where this vehicle would come down, shape (n,).

        Of two over their own pads, one pad above the other, the pads say more than two positions: the upper vehicle
        waits until the lower one stands, the lower one for nobody who is higher than itself.
        """
        radius_m = self._plan.spec.avoidance.radius_m
        away = poses.pos_team_ned_m - poses.pos_team_ned_m[vehicle]
        beside = np.hypot(away[:, 0], away[:, 1]) >= radius_m
        below = ~(beside | (away[:, 2] < -radius_m))
        off_pads = poses.pos_team_ned_m - self._pads_ned_m
        over_pad = np.hypot(off_pads[:, 0], off_pads[:, 1]) < _OVER * radius_m
        if over_pad[vehicle]:
            stands = self._fleet.landed_state == LANDED_ON_GROUND
            below = np.where(over_pad & self._pads_above[:, vehicle], ~stands, below)
            below = np.where(over_pad & self._pads_above[vehicle], ~stands & ~(away[:, 2] < 0.0), below)
        below[vehicle] = False
        return np.asarray(below, dtype=np.bool_)


_RING_SHARE, _RINGS, _BEARINGS = 0.25, 80, 24


def clear_spots(
    pos_team_ned_m: FloatArray, movable: BoolArray, clearance_m: float, low_ned_m: FloatArray, high_ned_m: FloatArray
) -> FloatArray:
    """Where everybody can come straight down at once: nobody above or below anybody.

    The lowest keep their places, those above move sideways at their own height, by as little as is free.

    Args:
        pos_team_ned_m: where the vehicles are, shape (n, 3).
        movable: those that can be told to move, shape (n,); the places of the others are taken.
        clearance_m: horizontal distance that has to be between any two.
        low_ned_m: corner of the fence, shape (3,).
        high_ned_m: the other corner, shape (3,).

    Returns:
        Shape (n, 3). A vehicle for which the fence holds no free place keeps its own.
    """
    spots = pos_team_ned_m.copy()
    taken = [pos_team_ned_m[i, :2] for i in np.flatnonzero(~movable & np.isfinite(pos_team_ned_m).all(axis=1))]
    radii_m = _RING_SHARE * clearance_m * np.arange(1, _RINGS + 1)
    bearings = np.linspace(0.0, 2.0 * np.pi, _BEARINGS, endpoint=False)
    rings = radii_m[:, None, None] * np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
    around = np.concatenate([np.zeros((1, 2)), rings.reshape(-1, 2)])
    lowest_first = sorted(np.flatnonzero(movable).tolist(), key=lambda i: -float(pos_team_ned_m[i, 2]))
    for vehicle in lowest_first:
        places = pos_team_ned_m[vehicle, :2] + around
        inside = ((places >= low_ned_m[:2]) & (places <= high_ned_m[:2])).all(axis=1)
        inside[0] = True  # where it is
        for other in taken:
            inside &= np.hypot(*(places - other).T) >= clearance_m
        free = np.flatnonzero(inside)
        if len(free):
            spots[vehicle, :2] = places[free[0]]
        taken.append(spots[vehicle, :2])
    return spots
