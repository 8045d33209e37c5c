"""What a mission is doing and what it has come to, as values for displays, logs and reports."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np


class Phase(Enum):
    """What the team is doing; HOLD is a step of the mission, PAUSE what the operator's ``hold`` leads to."""

    CONNECT = "connect"
    TAKEOVER = "take-over"
    ARM = "arm"
    TAKEOFF = "takeoff"
    FORM = "form"
    HOLD = "hold"
    MOVE = "move"
    STOP = "stop"
    PAUSE = "pause"
    RETURN = "return"
    LAND = "land"
    SILENT = "silent"
    DONE = "done"


AIRBORNE_PHASES = frozenset(
    {Phase.TAKEOFF, Phase.FORM, Phase.HOLD, Phase.MOVE, Phase.STOP, Phase.PAUSE, Phase.RETURN, Phase.LAND}
)
FORMATION_PHASES = frozenset({Phase.FORM, Phase.HOLD, Phase.MOVE})


@dataclass(frozen=True)
class Note:
    """Something that happened, for the log and for people: ``kind`` is phase, alarm, info or roles."""

    kind: str
    text: str
    roles: tuple[int, ...] = ()


@dataclass
class Figures:
    """What the mission came to, from what the vehicles reported.

    Attributes:
        converged: every form step was reached.
        time_to_form_s: from the start of the first form step until its formation stood, NaN before.
        formation_error_m: largest |d_ij - d*_ij| over all pairs and over the hold, NaN before.
        min_distance_m: smallest reported distance between two vehicles in the air.
        min_clearance: the same in the norm of the safety region: below 1, somebody was inside of it.
        move_error_m: the same over all moves, against the size that the formation has at the time.
        gridlocks: times an agent found itself locked in by others.
        role_swaps: pairs of vehicles that exchanged their roles to get out of a gridlock.
        detours: times an agent went round others, or backed off, to get out of one.
        flight_time_s: from takeoff to the end, NaN before takeoff.
        ticks: calls of ``step``.
        deadline_misses: ticks that came more than a whole period late.
    """

    converged: bool = False
    time_to_form_s: float = np.nan
    formation_error_m: float = np.nan
    min_distance_m: float = np.inf
    min_clearance: float = np.inf
    move_error_m: float = np.nan
    gridlocks: int = 0
    role_swaps: int = 0
    detours: int = 0
    flight_time_s: float = np.nan
    ticks: int = 0
    deadline_misses: int = 0
