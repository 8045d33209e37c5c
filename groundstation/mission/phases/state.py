"""What every phase of a mission is: a small object with its own state, created when it is entered."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from groundstation.core.phases import Phase
from groundstation.core.types import FloatArray
from groundstation.mavlink.commands import Outcome
from groundstation.mission.flight.poses import Poses
from groundstation.mission.operator import Order
from groundstation.mission.phases.table import Event
from groundstation.mission.team import Team


@dataclass(frozen=True)
class Entry:
    """How a phase comes to be entered.

    Attributes:
        now_ns: when.
        event: what led there; None for the first phase.
        before: the phase that ends; None for the first.
        poses: of the team, where an order led there.
    """

    now_ns: int
    event: Event | None = None
    before: PhaseState | None = None
    poses: Poses | None = None


@dataclass(frozen=True)
class Step:
    """What one tick of a phase came to.

    Attributes:
        vel_ned_m_s: setpoints, shape (n, 3); None for standing still.
        event: what has come about, None to go on.
    """

    vel_ned_m_s: FloatArray | None = None
    event: Event | None = None


class PhaseState:
    """One phase under way.

    Args:
        team: what it works with.
        entry: how it was entered.

    Attributes:
        since_ns: when it was entered; later by as long as the operator held it.
    """

    phase: Phase
    steers: ClassVar[bool] = False
    """It flies by poses: where those cannot be worked out it is not stepped."""
    streams: ClassVar[bool] = False
    """Vehicles get setpoints."""

    def __init__(self, team: Team, entry: Entry) -> None:
        self._team = team
        self.since_ns = entry.now_ns

    @property
    def speaks(self) -> bool:
        """Whether anything is sent at all, heartbeats too."""
        return True

    def locate(self, now_ns: int) -> None:
        """Before poses are worked out: takes what the vehicles tell of their own frames, where that is not settled."""

    def step(self, now_ns: int, poses: Poses) -> Step:
        """One tick.

        Args:
            now_ns: its time.
            poses: of the team.
        """
        raise NotImplementedError

    def refusal(self, order: Order) -> str | None:
        """Why an order that the phase allows is refused at this moment, None when it is obeyed."""
        return None

    def heard(self, outcome: Outcome) -> None:
        """Takes how a command ended."""

    def leave(self, to: Phase) -> None:
        """It ends, and another one follows."""

    def stood_still(self, held_ns: int) -> None:
        """The operator held it for a while: its clock did not run."""
        self.since_ns += held_ns
