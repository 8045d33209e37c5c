"""What the team may be doing."""

from __future__ import annotations

from enum import Enum


class Phase(Enum):
    """What the team is doing; HOLD is a step of the mission, PAUSE what the operator's ``hold`` leads to."""

    CONNECT = "connect"
    TAKEOVER = "take-over"
    ARM = "arm"
    TAKEOFF = "takeoff"
    FORM = "form"
    HOLD = "hold"
    MOVE = "move"
    LEAD = "lead"
    STOP = "stop"
    PAUSE = "pause"
    RETURN = "return"
    LAND = "land"
    SILENT = "silent"
    DONE = "done"


AIRBORNE_PHASES = frozenset(
    {Phase.TAKEOFF, Phase.FORM, Phase.HOLD, Phase.MOVE, Phase.LEAD, Phase.STOP, Phase.PAUSE, Phase.RETURN, Phase.LAND}
)
UNWATCHED_PHASES = frozenset({Phase.TAKEOVER, Phase.SILENT})
"""In the air perhaps, and nobody can be told anything by what monitors find."""
FORMATION_PHASES = frozenset({Phase.FORM, Phase.HOLD, Phase.MOVE, Phase.LEAD})
