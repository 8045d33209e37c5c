"""Where a replay stands: plays, pauses, jumps. Pure: whoever shows it says how much time has passed."""

from __future__ import annotations

from collections.abc import Sequence

from groundstation.app.console.recorded import Mark

SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
_SAME_S = 1e-6


class Player:
    """A place in a flight.

    Args:
        duration_s: of the flight.

    Attributes:
        t_s: where it stands, 0 to ``duration_s``.
        playing: whether time goes on.
        speed: against the recorded pace.
    """

    def __init__(self, duration_s: float) -> None:
        self._duration_s = duration_s
        self.t_s, self.playing, self.speed = 0.0, False, 1.0

    def seek(self, t_s: float) -> None:
        """Goes to a moment, or to the nearest that there is."""
        self.t_s = min(max(0.0, t_s), self._duration_s)

    def toggle(self) -> None:
        """Plays, from the begin where the end was reached; or pauses."""
        self.playing = not self.playing
        if self.playing and self.t_s >= self._duration_s:
            self.t_s = 0.0

    def passed(self, seconds: float) -> None:
        """Time has passed at the desk; at the end of the flight it pauses."""
        if self.playing:
            self.seek(self.t_s + seconds * self.speed)
            self.playing = self.t_s < self._duration_s

    def step(self, marks: Sequence[Mark], *, onward: bool) -> Mark | None:
        """Goes to the next mark, or the one before; None, and stays, where there is none."""
        if onward:
            found = next((mark for mark in marks if mark[0] > self.t_s + _SAME_S), None)
        else:
            found = next((mark for mark in reversed(marks) if mark[0] < self.t_s - _SAME_S), None)
        if found is not None:
            self.seek(found[0])
        return found
