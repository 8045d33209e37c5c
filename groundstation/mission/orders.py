"""Does what the operator says, or says why not."""

from __future__ import annotations

import math

import numpy as np

from groundstation.core.motion import MovePlan
from groundstation.core.phases import Phase
from groundstation.core.types import FloatArray
from groundstation.mission.flight.poses import Poses
from groundstation.mission.operator import LEADING, OperatorCommand, Order, parse_command
from groundstation.mission.phases.come_down import SilentPhase
from groundstation.mission.phases.machine import Machine
from groundstation.mission.phases.on_the_ground import ConnectPhase
from groundstation.mission.phases.table import Event
from groundstation.mission.team import Team
from groundstation.mission.timing import vehicle_list


class Orders:
    """The operator's orders to one team.

    Args:
        team: whom they concern.
        machine: which phase it is in.
    """

    def __init__(self, team: Team, machine: Machine) -> None:
        self._team, self._machine = team, machine

    def obey(self, line: str, poses: Poses, now_ns: int, *, sightless: bool) -> None:
        """Does what a line says.

        Args:
            line: see ``operator.parse_command``.
            poses: of the team.
            now_ns: time of the tick.
            sightless: where the vehicles are cannot be worked out at the moment.
        """
        team, machine = self._team, self._machine
        note = team.verdict.note
        try:
            command = parse_command(line, team.fleet.ids.tolist())
        except ValueError as error:
            note("alarm", str(error))
            return
        order = command.order
        why = machine.refusal(order)
        if order is Order.HOLD and why is None:
            why = team.too_low_to_hold(now_ns)
        if why is None and sightless and order in (Order.HOLD, Order.LAND, Order.MOVE, Order.TURN, Order.SCALE):
            why = "where the vehicles are cannot be worked out at the moment"
        told = ""
        if why is None and order in LEADING:
            taken, told = self._lead(command, poses, now_ns)
            why = None if taken else told
        if why is not None:
            note("alarm", f"operator: {command.text} refused: {why}")
            return
        note("info", f"operator: {command.text}")
        if told:
            note("info", told)
        if order is Order.KILL:
            self._kill(command, now_ns)
        elif order is Order.SILENCE:
            note("alarm", "operator: setpoints stop, the autopilots' own failsafe takes over")
            machine.give_up("stopped by the operator, setpoints ended", now_ns, Event.SILENCE)
        elif order is Order.FIX:
            team.preflight.checks.fix()
        elif order is Order.START and isinstance(machine.state, ConnectPhase):
            machine.state.start()
        elif order is Order.RESUME:
            machine.happen(Event.ORDER_RESUME, now_ns)
        elif order is Order.RETURN or machine.phase in (Phase.CONNECT, Phase.ARM):
            machine.give_up("stopped by the operator", now_ns, Event.ORDER_RETURN)
        elif order is Order.HOLD:
            machine.happen(Event.ORDER_HOLD, now_ns, poses)
        elif order is Order.LAND:
            self._land(command, poses, now_ns)

    def _lead(self, command: OperatorCommand, poses: Poses, now_ns: int) -> tuple[bool, str]:
        """The formation goes where it is told; returns whether it does, and what there is to say."""
        led, order = self._team.formation.led, command.order
        if led is None:
            return False, "no `lead` step is under way"
        if order is Order.STAY:
            led.stay()
        elif order is Order.NEXT:
            led.end("by the operator")
        else:
            by: FloatArray = np.array(command.numbers if order is Order.MOVE else (0.0, 0.0, 0.0))
            turn = math.radians(command.numbers[0]) if order is Order.TURN else 0.0
            scale = command.numbers[0] if order is Order.SCALE else 1.0
            return led.steer(command.text, MovePlan(by, turn, scale, 1.0), poses.pos_team_ned_m, now_ns)
        return True, ""

    def _land(self, command: OperatorCommand, poses: Poses, now_ns: int) -> None:
        """Some, or all, come down where they are."""
        team, state = self._team, self._machine.state
        if isinstance(state, SilentPhase):
            state.land(command.vehicles, now_ns)
        elif command.everybody:
            self._land_all(poses, now_ns)
        else:
            ours = [vehicle for vehicle in command.vehicles if team.roster.ours[vehicle]]
            for vehicle in command.vehicles:
                if vehicle not in ours:
                    fate = team.roster.duty(vehicle).name.lower()
                    team.verdict.note("alarm", f"operator: {team.name(vehicle)} was {fate} and is not ours to land")
            team.landing.want_here(ours, team.rest_ned_m(poses), now_ns)
            if ours:
                self._machine.drop_out(f"{self._names(ours)}: landed by the operator", now_ns)

    def _land_all(self, poses: Poses, now_ns: int) -> None:
        """Everybody lands in place; whoever has somebody below moves aside first."""
        team = self._team
        team.verdict.abort("landed by the operator")
        ours = team.roster.waited_for & ~team.board.blind & team.standing.airborne(now_ns)
        for news in team.landing.spots.everybody_here(team.rest_ned_m(poses), ours):
            team.verdict.note("alarm" if news.elsewhere else "info", news.text)
        team.roster.end_climb(team.roster.climbing)
        self._machine.happen(Event.ORDER_LAND, now_ns)

    def _kill(self, command: OperatorCommand, now_ns: int) -> None:
        """Motors stop; whoever is killed is no longer ours."""
        names = "everybody" if command.everybody else self._names(command.vehicles)
        self._team.killing.want(command.vehicles, now_ns)
        reason = f"{names}: killed by the operator"
        if command.everybody or self._machine.phase is Phase.CONNECT:
            self._machine.give_up(reason, now_ns, Event.KILL_ALL)
        else:
            self._machine.drop_out(reason, now_ns)

    def _names(self, vehicles: list[int] | tuple[int, ...]) -> str:
        return vehicle_list(self._team.fleet.ids[list(vehicles)].tolist())
