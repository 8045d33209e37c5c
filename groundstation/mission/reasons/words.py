"""What the vehicles refuse and say, kept for the reasons that people are given."""

from __future__ import annotations

from collections import deque

from groundstation.mavlink.commands import Outcome
from groundstation.mavlink.texts import Text
from groundstation.mavlink.vehicle import NEVER

_KEPT = 3
_WARNING = 4  # MAV_SEVERITY; what is less severe is no reason


class Words:
    """The last refusal and the last few words of each vehicle."""

    def __init__(self) -> None:
        self._refused: dict[int, str] = {}
        self._said: dict[int, deque[Text]] = {}

    def forget(self) -> None:
        """What was refused and said so far is no reason any more."""
        self._refused.clear()
        self._said.clear()

    def refused(self, outcome: Outcome) -> bool:
        """Takes how a command ended; returns whether it is a refusal that was not known yet."""
        if outcome.accepted or outcome.command.asks:
            return False
        new = self._refused.get(outcome.vehicle) != outcome.words()
        self._refused[outcome.vehicle] = outcome.words()
        return new

    def said(self, text: Text) -> None:
        """Takes a vehicle's own words; what is said again counts as the newest."""
        if text.severity > _WARNING:
            return
        kept = self._said.setdefault(text.vehicle, deque(maxlen=_KEPT))
        for item in kept:
            if item.text == text.text:
                kept.remove(item)
                break
        kept.append(text)

    def by_vehicle(self, since_ns: int = NEVER) -> dict[int, str]:
        """What each vehicle refused and said of late.

        Args:
            since_ns: what was said before counts only where nothing was said since.
        """
        reasons = {vehicle: [words] for vehicle, words in self._refused.items()}
        for vehicle, texts in self._said.items():
            late = [text for text in texts if text.t_rx_ns >= since_ns] or texts
            if texts:
                reasons.setdefault(vehicle, []).extend(f"it says: {text.text}" for text in late)
        return {vehicle: ", ".join(parts) for vehicle, parts in reasons.items()}
