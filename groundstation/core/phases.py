"""What the team may be doing. Every log names its phases, so that all who fly, show and read flights know them."""

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


FORMATION_PHASES = (Phase.FORM, Phase.HOLD, Phase.MOVE, Phase.LEAD)
"""Steps of the mission, each of which is a phase of its own or is flown in one of these."""
STEERED_PHASES = frozenset({*FORMATION_PHASES, Phase.STOP, Phase.RETURN})
"""Everybody flies what the ground station works out anew in every tick."""
AIRBORNE_PHASES = STEERED_PHASES | {Phase.TAKEOFF, Phase.PAUSE, Phase.LAND}
UNWATCHED_PHASES = frozenset({Phase.TAKEOVER, Phase.SILENT})
"""In the air perhaps, and nobody can be told anything by what monitors find."""
