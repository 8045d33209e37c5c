"""What lives as long as the mission, for the phases to work with: the vehicles, and everything that acts on them."""

from __future__ import annotations

import numpy as np

from groundstation.core import frames
from groundstation.core.types import BoolArray, FloatArray
from groundstation.mavlink.station import Station
from groundstation.mavlink.vehicle import NEVER, Fleet
from groundstation.mission.flight.apart import Apart
from groundstation.mission.flight.formation_flight import FormationFlight
from groundstation.mission.flight.guidance import Guide
from groundstation.mission.flight.helm import Helm
from groundstation.mission.flight.killing import Killing
from groundstation.mission.flight.landing import Around, Landing, landing_distances
from groundstation.mission.flight.poses import Poses
from groundstation.mission.flight.standing import Standing
from groundstation.mission.flight.team_frame import TeamFrame
from groundstation.mission.ground.preflight import Preflight
from groundstation.mission.monitors.board import Board
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.purpose import Purpose
from groundstation.mission.reasons.words import Words
from groundstation.mission.roster import enlist
from groundstation.mission.verdict import Figures, Verdict

PAD_TOLERANCE_M = 0.15
"""So near to its place is there, horizontally and in height."""
_SLOWNESS_MAX = 2.0  # links with a delay make everybody approach more gently, so that errors of velocity show more
_OF_MARGIN = 0.35  # share of the positions' own error that tolerances are widened to


class Stance:
    """What holds for the whole flight and was settled at its beginning.

    Attributes:
        yaw_ned_rad: heading that each vehicle keeps, shape (n,).
        takeoff_ns: since when the team flies, NEVER before.
    """

    def __init__(self, n: int) -> None:
        self.yaw_ned_rad: FloatArray = np.zeros(n)
        self.takeoff_ns = NEVER

    def face(self, yaw_ned_rad: FloatArray) -> None:
        """Everybody keeps this heading."""
        self.yaw_ned_rad = yaw_ned_rad

    def take_off(self, now_ns: int) -> None:
        """The team flies from now on."""
        self.takeoff_ns = now_ns

    @property
    def flies(self) -> bool:
        """Whether it has taken off, or was taken over."""
        return self.takeoff_ns != NEVER


class Team:
    """The vehicles of one mission and all that acts on them.

    Args:
        plan: what to fly.
        start_ns: time at which it begins.
        purpose: what for.
    """

    def __init__(self, plan: MissionPlan, start_ns: int, purpose: Purpose = Purpose.FLY) -> None:
        self.plan = plan
        self.verdict, self.words = Verdict(), Words()
        ids = [vehicle.id for vehicle in plan.spec.vehicles]
        fleet = Fleet(plan.sysids, plan.link_of_vehicle, plan.room(), ids)
        greeted = [(link, address.peer) for link, address in enumerate(plan.addresses) if address.peer]
        behind = [row for row, autopilot in enumerate(plan.autopilots) if autopilot.behind_a_gateway]
        self.station = Station(fleet, start_ns, greeted=greeted, behind_a_gateway=behind)
        self.frame = TeamFrame(plan)
        self.preflight = Preflight(plan, self.station, self.frame, look_only=purpose.only_looks)
        self.roster = enlist(plan, untaken=purpose.in_the_air)
        self.board = Board(plan)
        self.helm = Helm(Guide(plan), plan.size)
        self.formation = FormationFlight(plan, self.roster, self.helm, self.verdict.figures, self.verdict.note)
        commands = self.station.commands
        distances = landing_distances(plan, self.helm.guide.beside_m, self.tolerance_m(PAD_TOLERANCE_M))
        self.standing = Standing(plan, fleet)
        self.landing = Landing(plan, fleet, commands, self.roster, distances, standing=self.standing)
        self.killing = Killing(plan, fleet, commands, self.roster)
        self.apart = Apart(self.helm.guide, plan.size, self.roster, self.landing)
        self.stance = Stance(plan.size)

    @property
    def figures(self) -> Figures:
        """What the mission comes to, see ``Figures``."""
        return self.verdict.figures

    @property
    def fleet(self) -> Fleet:
        """State of the vehicles."""
        return self.station.fleet

    def absent(self) -> BoolArray:
        """Vehicles that do not follow setpoints at the moment, shape (n,)."""
        board = self.board
        return np.asarray(board.hold | board.blind | board.foreign | ~self.roster.follows)

    @property
    def steerable(self) -> BoolArray:
        """Vehicles that should do what setpoints say, or do it though they were told to land, shape (n,)."""
        return np.asarray(self.roster.follows | self.landing.deaf)

    def tolerance_m(self, least_m: float) -> float:
        """How near to a place counts as there: the least, or what positions may be off, and what moves it about."""
        still_m = max(least_m, _OF_MARGIN * self.plan.margin_m * min(self.plan.slowness, _SLOWNESS_MAX))
        return still_m + 0.5 * self.board.sway_m

    def height_m(self, pos_team_ned_m: FloatArray) -> FloatArray:
        """Heights of places, shape (n, 3), above the pads, shape (n,)."""
        pads_ned_m = frames.ned_from_enu(self.plan.pads_enu_m)
        return np.asarray((pads_ned_m - pos_team_ned_m)[:, 2])

    def rest_ned_m(self, poses: Poses) -> FloatArray:
        """Where everybody comes to rest when told to stop now, shape (n, 3)."""
        stopping_s = self.plan.profile.lag_s + self.plan.profile.delay_s
        return np.asarray(poses.pos_team_ned_m + stopping_s * poses.vel_ned_m_s)

    def places_ned_m(self, others_ned_m: FloatArray) -> FloatArray:
        """The places of those that have one of their own, and those given for the others, shape (n, 3)."""
        return self.roster.places_ned_m(others_ned_m)

    def around(self, poses: Poses, *, coming: bool, silent: bool) -> Around:
        """What landing has to know of a tick.

        Args:
            poses: of the team.
            coming: everybody is on its way home, or lands.
            silent: nobody gets setpoints.
        """
        board = self.board
        return Around(
            poses=poses,
            home_ned_m=self.formation.gather_ned_m,
            blind=board.blind,
            unheard=board.unheard,
            foreign=board.foreign | silent,
            led=~(self.absent() | silent),
            coming=self.roster.homeward | coming,
        )

    def too_low_to_hold(self, now_ns: int) -> str | None:
        """Words for a battery that does not allow standing still, None when all do."""
        minimum = self.plan.spec.limits.battery_min
        flying = self.standing.airborne(now_ns) & self.roster.follows
        for vehicle in np.flatnonzero((self.fleet.battery_remaining < minimum) & flying):
            left = self.fleet.battery_remaining[vehicle]
            return f"{self.name(int(vehicle))}: battery at {left:.0%}, minimum is {minimum:.0%}"
        return None

    def name(self, vehicle: int) -> str:
        """``vehicle 3``."""
        return f"vehicle {self.fleet.ids[vehicle]}"

    def forget_commands(self) -> None:
        """What was asked and is not answered yet is not asked again, but of those whose motors are to stop."""
        for vehicle in np.flatnonzero(~self.roster.killed).tolist():
            self.station.commands.clear(vehicle)
