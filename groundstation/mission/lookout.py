"""Lets the monitors look, and acts on what they find."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from groundstation.core.metrics import min_clearance, min_distance_m
from groundstation.core.phases import Phase
from groundstation.core.quick import some
from groundstation.core.types import FloatArray, IntArray
from groundstation.mission.flight.intruders import intruders, with_bodies
from groundstation.mission.flight.poses import Poses, changed
from groundstation.mission.monitors.findings import Findings, Sight
from groundstation.mission.monitors.sinking import OntoHeld
from groundstation.mission.phases.machine import Machine
from groundstation.mission.phases.table import Event
from groundstation.mission.reasons.blame import Blame
from groundstation.mission.team import Team

_STANDS_M = 1e-3  # by which somebody who stands counts as larger than r: an obstacle


class Lookout:
    """Watches one team in the air.

    Args:
        team: whom.
        machine: the phase it is in.
    """

    def __init__(self, team: Team, machine: Machine) -> None:
        self._team, self._machine = team, machine
        self._blame = Blame()
        self._onto_held = OntoHeld(team.plan)

    def watch(self, poses: Poses, sent_ned_m_s: FloatArray, now_ns: int) -> Poses:
        """Acts on what the monitors find; returns the poses to steer by, with obstacles marked.

        Args:
            poses: of the team.
            sent_ned_m_s: the velocities that were sent last, shape (n, 3).
            now_ns: time of the tick.
        """
        team, board, roster = self._team, self._team.board, self._team.roster
        fleet, pose_ns = team.fleet, team.frame.pose_ns(team.fleet)
        plan, others = team.plan, None if fleet.room is None else fleet.room.others
        flying = intruders(plan.spec.traffic, team.frame.placement, fleet.traffic, now_ns)
        flying = with_bodies(flying, plan.moving_bodies, others, plan.limits.lost_radius_m, now_ns)
        poses = poses if poses.intruders is flying else changed(poses, intruders=flying)
        poses = board.trusted(poses, pose_ns, team.standing.airborne(now_ns), now_ns)
        findings = board.look(self._sight(poses, pose_ns, sent_ned_m_s, now_ns))
        board.doubt(fleet, now_ns)
        self._act(findings, poses, now_ns)
        board.wind.enter(team.figures)
        poses = board.obstacles(board.steady(poses), fleet, pose_ns, roster, now_ns)
        # Nobody stays under a vehicle that comes down.
        sinking = poses.sinking | team.landing.columns() | team.killing.falling(now_ns)
        # Who stands makes room for nobody.
        stands = team.landing.standing(now_ns) & (poses.extra_radius_m == 0.0)
        return changed(poses, sinking=sinking, extra_radius_m=np.where(stands, _STANDS_M, poses.extra_radius_m))

    def watch_the_ground(self, poses: Poses, now_ns: int) -> None:
        """While nobody can be told anything: tells of those that come to the ground hard.

        While vehicles are taken over, also of those that come down onto others, which stand still as they are told.

        Args:
            poses: of the team.
            now_ns: time of the tick.
        """
        team = self._team
        sight = self._sight(poses, team.frame.pose_ns(team.fleet), np.zeros_like(poses.vel_ned_m_s), now_ns)
        findings = team.board.look(replace(sight, excused=np.ones_like(sight.excused)), only_the_ground=True)
        for text in findings.alarms:
            team.verdict.note("alarm", text)
        for text in findings.failed:
            team.verdict.abort(text)
        if self._machine.phase is Phase.TAKEOVER:
            nobody = np.zeros_like(sight.steered)
            for text in self._onto_held.words(replace(sight, steered=nobody, lands_here=nobody)):
                team.verdict.note("alarm", text)

    def _sight(self, poses: Poses, pose_ns: IntArray, sent_ned_m_s: FloatArray, now_ns: int) -> Sight:
        team, board, roster = self._team, self._team.board, self._team.roster
        fleet = team.fleet
        return Sight(
            fleet=fleet,
            now_ns=now_ns,
            pos_team_ned_m=poses.pos_team_ned_m,
            vel_ned_m_s=poses.vel_ned_m_s,
            pose_ns=pose_ns,
            drift_m=team.frame.drift_m(fleet, now_ns),
            sent_ned_m_s=sent_ned_m_s,
            ours=roster.ours,
            steered=roster.steered & ~(roster.lands_here | board.foreign | board.hold),
            lands_here=roster.lands_here,
            excused=roster.told_to_land & ~team.landing.taken,
            blind=board.blind,
            airborne=team.standing.airborne(now_ns),
            going_on=self._machine.going_on,
            vel_error_ned_m_s=board.speeds.known_error_ned_m_s,
        )

    def _act(self, findings: Findings, poses: Poses, now_ns: int) -> None:
        """Gives vehicles other duties, and the mission another phase."""
        team, machine, roster = self._team, self._machine, self._team.roster
        were = roster.in_formation
        for text in findings.alarms:
            team.verdict.note("alarm", text)
        for text in findings.failed:
            team.verdict.abort(text)
        roster.release(findings.release)
        for vehicle in findings.release:
            team.station.commands.clear(vehicle)
        team.landing.want_here(findings.land, poses.pos_team_ned_m, now_ns)
        if findings.gone:
            roster.go_home(findings.home)
            if some(were & ~roster.in_formation):
                machine.drop_out("; ".join(findings.gone), now_ns)
        if findings.aborts:
            reason = self._blame.of(findings.aborts, team.verdict.reason)
            if reason:  # otherwise it only follows from one that was given before
                team.verdict.abort(reason, instead_of=self._blame.outdated)
            machine.happen(Event.GIVE_UP_NOW if findings.urgent else Event.GIVE_UP, now_ns)
        if findings.silence:
            machine.give_up(findings.silence, now_ns, Event.SILENCE)

    def measure(self, poses: Poses, now_ns: int) -> None:
        """Enters how near to each other they come, by their own reports."""
        team, figures, region = self._team, self._team.figures, self._team.plan.region
        counted, flying = np.asarray(~team.board.blind, dtype=np.bool_), team.standing.airborne(now_ns)
        distance_m = min_distance_m(poses.pos_team_ned_m, counted, flying=flying)
        if region.by_distance:
            clearance = distance_m / region.radius_m
        else:
            clearance = min_clearance(poses.pos_team_ned_m, region, counted, flying=flying)
        figures.came_near(distance_m, clearance)
