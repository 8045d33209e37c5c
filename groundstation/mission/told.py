"""What a flight tells whoever looks on: displays, logs, reports, the emulator's measurements."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from groundstation.core.formation import Formation
from groundstation.core.phases import Phase
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.mavlink.vehicle import NEVER, Fleet
from groundstation.mission.flight.poses import Poses
from groundstation.mission.ground.check_table import CheckRow
from groundstation.mission.ground.failsafe import FailsafePlan
from groundstation.mission.operator import Order
from groundstation.mission.phases.machine import Machine
from groundstation.mission.team import Team
from groundstation.mission.verdict import Figures, Note


@dataclass(frozen=True)
class Look:
    """The team at one instant, for those who only watch.

    Attributes:
        poses: where everybody is, as the monitors would mark it: with what is added to r around whom nobody steers.
        pose_ns: when each pose was measured, shape (n,).
        duty: ``roster.Duty`` of each vehicle, shape (n,).
        held, lost, foreign: who stands still by a monitor, whose position is lost, who does not follow, shape (n,).
        avoids: whose wish was changed since somebody or something is in its way, shape (n,).
        blocked: who of these finds no way, shape (n,).
        formation: the one under way, at its present size.
        anchor_deg_m: where on earth the team's frame has its origin: latitude, longitude, height; NaN where that is not
            known, shape (3,).
    """

    poses: Poses
    pose_ns: IntArray
    duty: IntArray
    held: BoolArray
    lost: BoolArray
    foreign: BoolArray
    avoids: BoolArray
    blocked: BoolArray
    formation: Formation
    anchor_deg_m: FloatArray


class Told:
    """The side of a mission that is read and not flown.

    Args:
        team: its vehicles.
        machine: its phase.
    """

    def __init__(self, team: Team, machine: Machine) -> None:
        self._team, self._machine = team, machine
        self._last_step_ns = NEVER

    @property
    def phase(self) -> Phase:
        """What the team is doing."""
        return self._machine.phase

    @property
    def outcome(self) -> str | None:
        """None until done; then completed, aborted or refused."""
        return self._team.verdict.outcome

    @property
    def reason(self) -> str:
        """Why it was aborted or refused, "" otherwise."""
        return self._team.verdict.reason

    @property
    def problems(self) -> list[str]:
        """What stands between the team and arming, a line for each."""
        return self._team.verdict.problems

    @property
    def figures(self) -> Figures:
        """What the mission came to, see ``Figures``."""
        return self._team.figures

    @property
    def fleet(self) -> Fleet:
        """State of the vehicles."""
        return self._team.fleet

    @property
    def done(self) -> bool:
        """Whether there is nothing left to do."""
        return self.phase is Phase.DONE

    @property
    def role_of_agent(self) -> IntArray:
        """Role per vehicle, shape (n,)."""
        return self._team.formation.role_of_agent

    @property
    def step_number(self) -> int:
        """Of the mission's step under way, from 1; 0 before the first."""
        return self._team.formation.step_number

    def formation_error_m(self, pos_m: FloatArray) -> float:
        """Largest |d_ij - d*_ij| of the formation under way, of positions in any one frame, shape (n, 3)."""
        return self._team.formation.error_m(pos_m)

    @property
    def setpoints_sent(self) -> int:
        """Number of velocity setpoints sent so far."""
        return self._team.station.setpoints_sent

    @property
    def local_origins_enu_m(self) -> FloatArray:
        """Where the vehicles' own local frames begin in the team frame, see ``TeamFrame.local_origins_enu_m``."""
        return self._team.frame.local_origins_enu_m()

    @property
    def airborne(self) -> BoolArray:
        """Vehicles that are armed and have not told lately that they stand on the ground, shape (n,)."""
        return self._team.standing.airborne(self._last_step_ns)

    def check_rows(self) -> list[CheckRow]:
        """What preflight found, a row for each vehicle."""
        return self._team.preflight.rows(self.problems, self._last_step_ns)

    def refusal(self, order: Order) -> str | None:
        """Why an order would be refused now, as far as that is known without its numbers; None when it is not."""
        return self._machine.refusal(order)

    @property
    def failsafe(self) -> FailsafePlan:
        """What the team does when the ground station is gone."""
        return self._team.preflight.checks.failsafe

    @property
    def parameters_before(self) -> dict[int, dict[str, tuple[float, int]]]:
        """Value and MAV_PARAM_TYPE of parameters that were set, as they were before, by system id and name."""
        before = self._team.preflight.checks.parameters_before
        return {sysid: dict(of) for sysid, of in zip(self.fleet.ids.tolist(), before, strict=True) if of}

    def take_notes(self) -> list[Note]:
        """Hands out what happened since the last call."""
        return self._team.verdict.take_notes()

    def look(self, now_ns: int) -> Look:
        """Looks at the team and changes nothing; who watches along pays for it, a tick does not."""
        team, board = self._team, self._team.board
        pose_ns = team.frame.pose_ns(team.fleet)
        poses = team.frame.poses(team.fleet, now_ns)
        anchor = team.frame.placement.anchor_deg_m
        last = team.helm.last if self._machine.state.steers else None
        avoids: BoolArray = np.zeros(len(pose_ns), dtype=np.bool_)
        blocked = avoids
        if last is not None:
            avoids, blocked = np.any(last.sensed.in_the_way, axis=1), last.blocked
            if last.sensed.walled is not None:
                avoids = np.logical_or(avoids, last.sensed.walled)
        return Look(
            poses=board.obstacles(poses, team.fleet, pose_ns, team.roster, now_ns),
            pose_ns=pose_ns,
            duty=np.array([team.roster.duty(row) for row in range(len(pose_ns))], dtype=np.int64),
            held=board.hold,
            lost=board.blind,
            foreign=board.foreign,
            avoids=avoids,
            blocked=blocked,
            formation=team.formation.formation,
            anchor_deg_m=np.full(3, np.nan) if anchor is None else anchor.copy(),
        )
