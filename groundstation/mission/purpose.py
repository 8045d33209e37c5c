"""What a flight is opened for."""

from __future__ import annotations

from enum import Enum


class Purpose(Enum):
    """What the mission's vehicles are wanted for."""

    FLY = "fly"
    """Preflight, then the mission."""
    TAKE_OVER = "take over"
    """They are in the air already: hold them, bring them home, see ``ground.take_over``."""
    LOOK = "look"
    """Preflight alone; nothing is set, whatever the mission says, and it is told what a flight would set."""
    PREPARE = "prepare"
    """Preflight alone; parameters are set where the mission says so."""

    @property
    def only_checks(self) -> bool:
        """Nothing is armed."""
        return self in (Purpose.LOOK, Purpose.PREPARE)

    @property
    def only_looks(self) -> bool:
        """No parameter is set."""
        return self is Purpose.LOOK

    @property
    def in_the_air(self) -> bool:
        """The vehicles fly when it begins."""
        return self is Purpose.TAKE_OVER
