"""The board of monitors: asks each of them once per tick and puts together what they want.

The monitors themselves, with their limits and words, are in ``monitors``; docs/safety.md has the table. Decides how a
finding reads and whom it concerns when the mission goes on without a vehicle; the runner acts on it. Knows who has
become an obstacle, and how large.
"""

from __future__ import annotations

import math

import numpy as np

from groundstation.core.quick import some
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.mavlink.vehicle import Fleet
from groundstation.mission.flight.poses import Poses, changed
from groundstation.mission.monitors.contradictions import Contradictions
from groundstation.mission.monitors.descents import Descents
from groundstation.mission.monitors.findings import Finding, Findings, Monitor, Reaction, Sight
from groundstation.mission.monitors.fixes import GpsFix
from groundstation.mission.monitors.flight import BeyondFence, Distance, Following, LateTicks, bounded_growth_m
from groundstation.mission.monitors.headings import Headings
from groundstation.mission.monitors.losses import Losses
from groundstation.mission.monitors.positions import Frames, Frozen, LinkSilence, PoseAge, PoseJump, RoomSilence, Tilt
from groundstation.mission.monitors.restarts import Restarts
from groundstation.mission.monitors.resting import Resting
from groundstation.mission.monitors.sinking import Sinking
from groundstation.mission.monitors.speeds import PoorSpeeds
from groundstation.mission.monitors.touchdowns import Touchdowns
from groundstation.mission.monitors.traffic import TrafficNear
from groundstation.mission.monitors.vehicles import Battery, BatteryAge, Heartbeats, Modes
from groundstation.mission.monitors.wind import Wind
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.roster import Duties
from groundstation.mission.timing import SECOND_NS

_FIRST_SHARE = 0.25  # of r: how much larger an obstacle is at once
_CONSEQUENCES = {
    Reaction.SAY: "",
    Reaction.HOLD: "holding",
    Reaction.HOME: "everybody comes back",
    Reaction.LAND: "it lands where it is when nobody is below",
    Reaction.RELEASE: "it is released and not fought over",
    Reaction.ALL_HOME: "everybody comes back",
    Reaction.FAILED: "",
    Reaction.SILENCE: "setpoints end, the autopilots' own failsafe takes over",
}
_STAYS = "it stays where it lies"
_SEVERAL_LAND = "they land where they are when nobody is below"


class Board:
    """Watches the vehicles in the air.

    Attributes:
        wind: what is known of the wind.
        speeds: what is known of the errors of velocities.
        resting: who says to move while it stands.
    """

    def __init__(self, plan: MissionPlan) -> None:
        self._plan = plan
        self._jumps, self._ages, self._frames = PoseJump(plan), PoseAge(plan), Frames(plan)
        self.speeds, self.resting = PoorSpeeds(plan), Resting(plan)
        self.wind = Wind(plan, self.speeds)
        self._headings = Headings(plan, self.wind, self.speeds)
        self._modes, self._following = Modes(plan), Following(plan, self.wind, self._headings)
        self._contradictions, self._touchdowns = Contradictions(plan), Touchdowns(plan)
        self._traffic = TrafficNear(plan)
        self._monitors: tuple[Monitor, ...] = (
            self.resting, self._jumps, LinkSilence(plan), RoomSilence(plan), self._ages, Frozen(plan), GpsFix(plan),
            Heartbeats(plan), Battery(plan), BatteryAge(plan), self.speeds, BeyondFence(plan), self._frames, Tilt(plan),
            self.wind, self._headings, self._following, Distance(plan), Descents(plan, self.wind, self.speeds),
            Restarts(plan), self._touchdowns, self._modes, Sinking(plan, self._modes), LateTicks(plan),
            self._contradictions, self._traffic,
        )  # fmt: skip
        self._losses = Losses(plan)

    @property
    def blind(self) -> BoolArray:
        """Vehicles whose position is lost: nobody knows where they are now, shape (n,)."""
        return self._losses.blind

    @property
    def unheard(self) -> BoolArray:
        """Those of them that are lost since nothing is heard, and may be heard again, shape (n,)."""
        return self._losses.unheard

    @property
    def hold(self) -> BoolArray:
        """Vehicles whose pose cannot be steered by at this moment; they are told to stand still, shape (n,)."""
        return self._ages.hold | self._jumps.suspect | self.resting.moves

    @property
    def foreign(self) -> BoolArray:
        """Armed vehicles that do not follow our setpoints at this moment, for whatever reason, shape (n,)."""
        return self._modes.foreign

    @property
    def strays(self) -> BoolArray:
        """Vehicles that do not do what they are told at the moment, shape (n,)."""
        return self._following.strays

    @property
    def waits(self) -> BoolArray:
        """Who stands still by its own failsafe until it hears setpoints again, shape (n,)."""
        return self._modes.waits

    def doubt(self, fleet: Fleet, now_ns: int) -> None:
        """Has words doubted that what is seen contradicts: to stand on the ground, to be disarmed."""
        fleet.doubt_the_ground(self._contradictions.flies)
        fleet.see_above(self._contradictions.above, now_ns)

    def begin(self, fleet: Fleet) -> None:
        """Takes what is so now for what should stay so: origins, starts of the autopilots."""
        self._frames.begin(fleet.origin_moved_ns, fleet.restarts)

    @property
    def sway_m(self) -> float:
        """How far distances may sway at the moment, in gusts and by poor velocities."""
        return math.hypot(self.wind.sway_m, self.speeds.sway_m)

    def trusted(self, poses: Poses, pose_ns: IntArray, airborne: BoolArray, now_ns: int) -> Poses:
        """Puts trusted positions in place of those that have jumped; once per tick, before ``look``.

        Args:
            poses: as reported.
            pose_ns: when each was measured, shape (n,).
            airborne: who flies, shape (n,).
            now_ns: time of the tick.
        """
        led_astray_m_s = np.where(self._jumps.drifting, 0.0, self.speeds.rms_m_s)
        self.resting.take(poses.pos_team_ned_m, airborne, led_astray_m_s)
        self._traffic.take(poses.intruders)
        trusted = self._jumps.take(
            poses, pose_ns, self.speeds.rms_m_s, now_ns, airborne=airborne, good=self.speeds.good, calm=self.speeds.calm
        )
        self.speeds.take(poses, pose_ns, airborne & ~(self._jumps.suspect | self._jumps.drifting | self.blind), now_ns)
        return self.resting.trusted(trusted)

    def may_stand_off_m(self, vehicle: int) -> tuple[float, float] | None:
        """How far from its pad one may stand whose position is not to be trusted, and how far that has gone astray.

        None for one whose position is as good as ever, or whose position is lost for another reason.
        """
        return self._jumps.may_stand_off_m(vehicle)

    def steady(self, poses: Poses) -> Poses:
        """Poses to steer by: with velocities of which is known what they are worth."""
        return self.speeds.steady(poses, self._jumps.suspect)

    def told(self, velocity_ned_m_s: FloatArray) -> FloatArray:
        """What vehicles are told so that they move as wanted, shape (n, 3), by all that is known to be off."""
        return self._headings.told(self.speeds.told(velocity_ned_m_s))

    def look(self, sight: Sight, *, only_the_ground: bool = False) -> Findings:
        """Looks at the fleet once per tick.

        Args:
            sight: what is to be seen.
            only_the_ground: nobody can be told anything: only how vehicles come to the ground is looked at.

        Returns:
            What should happen.
        """
        findings = Findings()
        found: list[tuple[Finding, Reaction]] = []
        ours, lands = sight.ours.copy(), sight.lands_here.copy()
        if not only_the_ground:
            suspect = self._jumps.suspect | self._jumps.drifting | self.resting.moves
            found += [(finding, finding.reaction) for finding in self._losses.find(sight, suspect)]
        for monitor in (self._touchdowns,) if only_the_ground else self._monitors:
            # Here, and nowhere else, it is settled that nobody is judged who is not ours, whatever a monitor finds.
            seen = list(monitor.look(sight, ours.copy()))
            if not seen:
                continue
            judged = [finding.of(ours) for finding in seen]
            found += [(finding, self._take(finding, findings, sight)) for finding in judged if finding is not None]
            ours[findings.release] = False  # whoever is released in this tick is judged no more by the next monitor
        lands[findings.land] = True
        # Words come last: whether others are left to come back is known when everything is found.
        others = some(ours & ~(lands | self.blind | sight.excused))
        for finding, reaction in found:
            self._tell(finding, reaction, findings, sight, others=others)
        return findings

    def obstacles(self, poses: Poses, fleet: Fleet, pose_ns: IntArray, roster: Duties, now_ns: int) -> Poses:
        """Marks whoever is not steered by us: as one that may come down, and as larger than it is.

        The radius grows with the time since a vehicle was last seen, as fast as the team may fly, up to a bound.

        Args:
            poses: of this tick.
            fleet: what the vehicles report.
            pose_ns: when each pose was measured, shape (n,).
            roster: whose word they follow; that those who land at ours left the streaming mode is no wonder.
            now_ns: time of the tick.
        """
        up, landing = fleet.armed, roster.told_to_land
        unsteered = self.blind | ~roster.ours | (self.foreign & ~landing)
        spec = self._plan.spec
        larger = (unsteered | (self._following.strays & ~landing)) & up
        extra_m: FloatArray = np.zeros(len(larger))
        if some(larger):
            seen_ns = np.where(self.blind, np.minimum(pose_ns, self._losses.since_ns), pose_ns)
            growing_m = bounded_growth_m(
                _FIRST_SHARE * spec.avoidance.radius_m,
                spec.speed_limit_m_s,
                (now_ns - seen_ns) / SECOND_NS - spec.limits.pose_age_s,
                self._plan.limits.lost_radius_m,
            )
            extra_m = np.where(larger, growing_m, 0.0)
        may_sink = self.blind | (self.foreign & ~self.waits)  # PX4 in Hold stood within 0.4 m for 3 s
        return changed(poses, sinking=may_sink & up, extra_radius_m=extra_m)

    def _take(self, finding: Finding, findings: Findings, sight: Sight) -> Reaction:
        """Puts whom a finding concerns into lists; returns what is done about it."""
        rows, reaction = list(finding.vehicles), finding.reaction
        known = bool(rows) and bool(self.blind[rows].all())
        if finding.lost:
            self._losses.lose(rows, sight, unheard=finding.unheard)
        if known and reaction is not Reaction.FAILED and (finding.lost or reaction is Reaction.HOME):
            reaction = Reaction.SAY  # it cannot be brought back, and what can be done was done
        findings.concern(rows, reaction)
        return reaction

    def _tell(self, finding: Finding, reaction: Reaction, findings: Findings, sight: Sight, *, others: bool) -> None:
        """Puts a finding into words, and says what they are for: an alarm, or a reason too."""
        rows, ids = finding.vehicles, sight.fleet.ids[list(finding.vehicles)].tolist()
        names = f"vehicle {ids[0]}" if len(ids) == 1 else ""
        if finding.pair and len(ids) > 1:
            names = f"vehicles {ids[0]} and {ids[1]}"
        consequence = _consequence(reaction, several=len(rows) > 1, going_on=sight.going_on, others=others)
        if finding.lies and reaction is Reaction.LAND:
            consequence = consequence.replace(_CONSEQUENCES[Reaction.LAND], _STAYS)
        what = (f"{names}: " if names else "") + finding.what
        subject = names if len(ids) == 1 else what
        text = what + (f"; {consequence}" if consequence else "")
        findings.tell(text, subject, reaction, going_on=sight.going_on, urgent=finding.urgent, remedy=finding.remedy)


def _consequence(reaction: Reaction, *, several: bool, going_on: bool, others: bool) -> str:
    """What follows, in words.

    Args:
        reaction: what is done.
        several: it concerns more than one vehicle.
        going_on: the mission goes on without whom it concerns.
        others: somebody is left who comes back, or goes on.
    """
    if reaction is Reaction.HOME and going_on:
        return "it comes back, the others go on" if others else "it comes back"
    words = _SEVERAL_LAND if several and reaction is Reaction.LAND else _CONSEQUENCES[reaction]
    if others and reaction in (Reaction.LAND, Reaction.RELEASE):
        return f"{words}, the others {'go on' if going_on else 'come back'}"
    return words
