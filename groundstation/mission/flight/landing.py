"""Brings vehicles down, each on a place that is free (``spots``), and knows when the whole team is down.

A vehicle that nobody has heard from for a while cannot be waited for: it is given up as lost, by name, so that the
ground station ends and says so. One that reports to stand on the ground and sends no heartbeats is named as well:
whether it is disarmed is not known.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from groundstation.core import frames
from groundstation.core.limits import Fence
from groundstation.core.quick import some
from groundstation.core.types import BoolArray, FloatArray
from groundstation.mavlink.commands import CommandQueue, Outcome
from groundstation.mavlink.vehicle import LANDED_ON_GROUND, NEVER, UNKNOWN, Fleet
from groundstation.mission.flight.columns import Columns, Distances, Scene
from groundstation.mission.flight.dark import Dark
from groundstation.mission.flight.places import Box
from groundstation.mission.flight.poses import Poses
from groundstation.mission.flight.spots import Spots
from groundstation.mission.flight.standing import Standing
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.roster import Roster
from groundstation.mission.timing import SECOND_NS, AskAgain, HeldEach

_ASK_AGAIN_NS = SECOND_NS  # heartbeats tell the mode once a second; asking faster would ask in the dark
_STILL_ARMED_NS = 5 * SECOND_NS  # autopilots disarm by themselves two seconds after landing
LOST_S = 10.0
"""Who has said nothing for so long is not waited for."""
_MISSED_M = 0.2  # by which a place to come down on may be missed, where an obstacle is beside it
_DEAF_NS = 5 * SECOND_NS // 2  # two heartbeats after it was told
_HURRY = 0.5  # of the battery at which a vehicle lands where it is: it waits for no place any more


@dataclass(frozen=True)
class Around:
    """What landing has to know of a tick, shape (n,) where nothing else is said.

    Attributes:
        poses: where everybody is, or was last seen.
        home_ned_m: where everybody gathers before it lands, shape (n, 3).
        blind: nobody knows where it is any more.
        unheard: since nothing is heard of it, which may end.
        foreign: armed, and does not follow our setpoints at the moment.
        led: follows them, so that it can be led to another place.
        coming: on its way home.
    """

    poses: Poses
    home_ned_m: FloatArray
    blind: BoolArray
    unheard: BoolArray
    foreign: BoolArray
    led: BoolArray
    coming: BoolArray


def landing_distances(plan: MissionPlan, beside_m: float, tolerance_m: float) -> Distances:
    """Distances that landing keeps in a mission."""
    radius_m = plan.spec.avoidance.radius_m
    return Distances(
        radius_m=radius_m,
        beside_m=beside_m,
        margin_m=plan.margin_m,
        wish_m=max(plan.spec.avoidance.activation_m + plan.margin_m, beside_m) + tolerance_m,
        lost_m=plan.limits.lost_radius_m,
        tolerance_m=tolerance_m,
        height_m=beside_m + tolerance_m,
    )


def fence_box(plan: MissionPlan) -> Box:
    """The inside of a mission's fence, north and east."""
    fence = Fence.from_enu(np.array(plan.spec.fence.min_m), np.array(plan.spec.fence.max_m))
    obstacles = plan.obstacles if len(plan.obstacles) else None
    return Box(fence.min_team_ned_m[:2], fence.max_team_ned_m[:2], obstacles, spare_m=_MISSED_M)


class Landing:
    """Landings of one team.

    Args:
        plan: autopilots, limits, pads.
        fleet: their state.
        commands: what is asked goes out by it.
        roster: who lands.
        distances: what is kept; ``landing_distances``.
        standing: who stands on the ground.

    Attributes:
        spots: where everybody comes down.
        dark: parts the team when nobody knows where it is.
        taken: whom a pilot flies, or has taken over while it landed, shape (n,): nothing is asked of them.
        deaf: who was told to land and goes on following our setpoints in the air, shape (n,). They are kept where they
            should come down: standing still by velocity alone they would drift, over others too, on which their own
            failsafe would land them in the end.
    """

    def __init__(
        self,
        plan: MissionPlan,
        fleet: Fleet,
        commands: CommandQueue,
        roster: Roster,
        distances: Distances,
        *,
        standing: Standing,
    ) -> None:
        n = plan.size
        self.spots = Spots(fleet.ids, roster, Columns(plan.pads_enu_m, distances), fence_box(plan))
        self._plan = plan
        self._roster = roster
        self._fleet = fleet
        self._commands = commands
        self._standing = standing
        # Of these nobody else knows where they are: one that is not seen drifts, and does not wait to be seen again.
        gateway = np.array([autopilot.behind_a_gateway for autopilot in plan.autopilots])
        self._drifts: BoolArray = gateway & (plan.room_link is not None)
        self.dark = Dark(frames.ned_from_enu(plan.pads_enu_m))
        self._asking = AskAgain(n, _ASK_AGAIN_NS)
        self.deaf: BoolArray = np.zeros(n, dtype=np.bool_)
        self.taken: BoolArray = np.zeros(n, dtype=np.bool_)
        self._began: BoolArray = np.zeros(n, dtype=np.bool_)  # to land, since it was told to
        self._on_ground = HeldEach(n)
        self._said_yes: set[tuple[int, str]] = set()
        self._told: tuple[tuple[int, ...], BoolArray] = ((), np.zeros(n, dtype=np.bool_))  # modes, and which land

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

    def step(self, now_ns: int, around: Around) -> None:
        """Asks those to land who shall, and those to disarm who have stood on the ground for long.

        Of whom a pilot flies nothing is asked; the monitor of modes lets go of it.

        Args:
            now_ns: time of the tick.
            around: where everybody is, and whom we steer.
        """
        fleet, roster = self._fleet, self._roster
        on_ground = self._standing.at(now_ns)
        self.deaf = self._goes_on_following(now_ns)
        self.taken = self._taken_over(now_ns)
        still_armed = self._on_ground(on_ground, now_ns, _STILL_ARMED_NS)
        anybody = some(roster.lands) or some(around.coming)
        ready = self.spots.step(now_ns, self._scene(around, on_ground) if anybody else None)
        dark = self.in_the_dark and some(roster.lands)
        parting = self.dark.step(dark, self._standing.airborne(now_ns), self._seen_last(around), now_ns)
        for vehicle in (roster.lands & fleet.armed).nonzero()[0].tolist():
            if self._commands.pending(vehicle) or not self._asking.due(vehicle, now_ns):
                continue
            autopilot = self._plan.autopilots[vehicle]
            if on_ground[vehicle]:
                if still_armed[vehicle]:
                    self._commands.request(vehicle, autopilot.disarm())
                    self._asking.asked(vehicle, now_ns)
            elif autopilot.is_landing_mode(int(fleet.custom_mode[vehicle])):
                roster.tell_to_land(vehicle, now_ns)  # it has begun by itself what was wanted of it
            elif self.taken[vehicle]:
                continue
            elif not parting[vehicle] and (ready[vehicle] or roster.told_to_land[vehicle]):
                self._commands.request(vehicle, autopilot.land())
                roster.tell_to_land(vehicle, now_ns)
                self._asking.asked(vehicle, now_ns)

    def _goes_on_following(self, now_ns: int) -> BoolArray:
        """Who was told to land, and by its heartbeats is still in the mode that follows us, shape (n,)."""
        fleet, roster = self._fleet, self._roster
        told = roster.told_to_land & roster.ours
        if not some(told):
            return told
        untaken: BoolArray = told & (fleet.heartbeat_ns - roster.told_ns >= _DEAF_NS) & self._standing.airborne(now_ns)
        for vehicle in untaken.nonzero()[0].tolist():
            mode = int(fleet.custom_mode[vehicle])
            untaken[vehicle] = self._plan.autopilots[vehicle].is_streaming_mode(mode)
        return untaken

    def _taken_over(self, now_ns: int) -> BoolArray:
        """Whom a pilot flies, of those that are to land, shape (n,)."""
        fleet, roster = self._fleet, self._roster
        taken: BoolArray = roster.lands & fleet.armed & (fleet.custom_mode != UNKNOWN) & self._standing.airborne(now_ns)
        for vehicle in taken.nonzero()[0].tolist():
            autopilot, mode = self._plan.autopilots[vehicle], int(fleet.custom_mode[vehicle])
            status = int(fleet.system_status[vehicle])
            self._began[vehicle] |= roster.told_to_land[vehicle] and autopilot.is_landing_mode(mode)
            # Heartbeats tell it up to a second later than its answer, and by then it may be in somebody's hands.
            began = bool(self._began[vehicle]) or (vehicle, autopilot.land().name) in self._said_yes
            taken[vehicle] = autopilot.is_flown_by_pilot(mode, status) or (
                began and autopilot.was_taken_while_landing(mode, status)
            )
        return taken

    def standing(self, now_ns: int) -> BoolArray:
        """Vehicles that stand for good, shape (n,): who flies low keeps clear of them, they of nobody."""
        roster = self._roster
        stands = self._standing.at(now_ns) & (roster.told_to_land | ~roster.ours)
        return np.asarray(stands | ~self._fleet.armed)

    def columns(self) -> BoolArray:
        """Vehicles under which nobody may stay: they come down, or are about to, beside the pads, shape (n,)."""
        roster = self._roster
        return np.asarray((roster.lands_here | (roster.told_to_land & roster.elsewhere)) & self._fleet.armed)

    def _scene(self, around: Around, on_ground: BoolArray) -> Scene:
        """What ``spots`` sees of the team."""
        fleet, roster, autopilots = self._fleet, self._roster, self._plan.autopilots
        modes = tuple(fleet.custom_mode.tolist())
        if modes != self._told[0]:
            pairs = zip(autopilots, modes, strict=True)
            self._told = modes, np.array([autopilot.is_landing_mode(mode) for autopilot, mode in pairs])
        lands = self._told[1]
        down = on_ground | ~fleet.armed
        sinks = (roster.told_to_land | lands) & ~down & ~around.blind
        loose = ~(around.led | down | around.blind | sinks) & (~roster.ours | around.foreign)
        return Scene(
            pos_ned_m=around.poses.pos_team_ned_m,
            home_ned_m=around.home_ned_m,
            down=down,
            sinks=sinks,
            lost=around.blind & ~down,
            unheard=around.unheard & ~down & ~self._drifts,
            loose=loose,
            led=around.led & ~sinks,
            wanted=roster.lands & ~down,
            coming=around.coming & roster.ours,
            hurries=np.asarray(fleet.battery_remaining < _HURRY * self._plan.limits.battery_land) | self.in_the_dark,
        )

    def _seen_last(self, around: Around) -> FloatArray:
        """Where the motion capture saw everybody last, in the team's frame, shape (n, 3)."""
        room = self._fleet.room
        return around.poses.pos_team_ned_m if room is None else room.pos_ned_m

    @property
    def in_the_dark(self) -> bool:
        """Whether the motion capture is gone for everybody: whoever waits in the air then drifts, each its own way."""
        return self._fleet.room is not None and self._fleet.room.gone

    def disarm_on_the_ground(self, now_ns: int) -> None:
        """Tells everybody who stands to disarm, armed or not; for an arming that is broken off before takeoff.

        An arming that is under way shows in a heartbeat up to a second later, so this is called again until
        ``still_up`` has nobody left. Who does not tell that it stands is not asked: nothing has told it to take off,
        and it disarms by itself. Who was killed is asked for that alone.
        """
        for vehicle in (self._standing.at(now_ns) & self._roster.ours).nonzero()[0].tolist():
            if self._asking.due(vehicle, now_ns) and not self._commands.pending(vehicle):
                self._commands.request(vehicle, self._plan.autopilots[vehicle].disarm())
                self._asking.asked(vehicle, now_ns)

    def lost(self, now_ns: int) -> BoolArray:
        """Vehicles of ours of which nothing has been heard for ten seconds, shape (n,)."""
        return self._fleet.silent(now_ns, LOST_S) & self._roster.ours

    def unsure(self, now_ns: int, lost: BoolArray) -> BoolArray:
        """Vehicles of ours that are heard, say that they stand, and whose heartbeats tell nothing, shape (n,).

        There are none any more, or two senders take turns. Whether such a vehicle is disarmed cannot be known; it is
        not waited for longer than this.

        Args:
            now_ns: time of the tick.
            lost: see ``lost``, shape (n,).
        """
        limit_s = self._plan.spec.limits.heartbeat_age_s
        since_ns = self._on_ground.since_ns
        stood = (since_ns != NEVER) & (now_ns - since_ns >= 2 * _STILL_ARMED_NS)
        untold = self._fleet.heartbeat_stale(now_ns, limit_s) | self._fleet.senders.in_doubt(now_ns)
        return np.asarray(untold & stood & ~lost & self._roster.ours)

    def words_of_unsure(self, vehicle: int, now_ns: int) -> str:
        """Says of one that is ``unsure`` why, and what is left to do."""
        fleet = self._fleet
        why = "it sends no heartbeat"
        if fleet.senders.in_doubt(now_ns)[vehicle]:
            why = "of its heartbeats nobody can tell which are its own: " + (
                fleet.senders.alternating(vehicle, now_ns) or "they go to and fro"
            )
        return (
            f"vehicle {fleet.ids[vehicle]}: stands on the ground by its own report, whether it is disarmed is not"
            f" known, since {why}; keep away from it, and disarm it by remote control or take its battery out"
        )

    def still_up(self, since_ns: int, given_up: BoolArray) -> BoolArray:
        """Vehicles that may still be armed, shape (n,); those that are released or given up are not waited for.

        Args:
            since_ns: a heartbeat has to be newer than this to be believed.
            given_up: those that are ``lost`` or ``unsure``, shape (n,).
        """
        perhaps: BoolArray = self._fleet.armed | (self._fleet.heartbeat_ns <= since_ns)
        return perhaps & self._roster.ours & ~given_up

    def words_of_late(self, vehicle: int, height_m: float, waited_s: float, left_alone: str) -> str:
        """Says of one that is still armed when nobody waits any longer where it is, what it does, and what is left.

        Args:
            vehicle: which one.
            height_m: above its pad, NaN where not known.
            waited_s: since landing began.
            left_alone: what its own failsafe does with it when setpoints stop.
        """
        fleet, own_id = self._fleet, self._fleet.ids[vehicle]
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
                f"setpoints stop now: its own failsafe {left_alone}; take it over by remote control, or clear the place"
                f" and fly again with --take-over (there, kill {own_id} stops its motors: it falls)"
            )
        return f"vehicle {own_id}: still armed after {waited_s:g} s of landing, {where}: {does}; {left}"
