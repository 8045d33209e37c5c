"""What a mission has come to, as it goes: its notes, its outcome and its figures. Judges nothing by itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Note:
    """Something that happened, for the log and for people: ``kind`` is phase, alarm, info or roles."""

    kind: str
    text: str
    roles: tuple[int, ...] = ()


@dataclass
class Figures:
    """What the mission came to, from what the vehicles reported. Entered by its methods alone.

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
        wind_mean_m_s, wind_gust_m_s: strongest wind that the vehicles felt, and gusts, NaN before it is known.
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
    wind_mean_m_s: float = np.nan
    wind_gust_m_s: float = np.nan
    flight_time_s: float = np.nan
    ticks: int = 0
    deadline_misses: int = 0

    def ticked(self, *, late: bool) -> None:
        """Another tick; ``late``: it came more than a whole period late."""
        self.ticks += 1
        self.deadline_misses += late

    def flown(self, seconds: float) -> None:
        """So long after takeoff the team still flies."""
        self.flight_time_s = seconds

    def came_near(self, distance_m: float, clearance: float) -> None:
        """Two came as near to each other as this."""
        self.min_distance_m = min(self.min_distance_m, distance_m)
        self.min_clearance = min(self.min_clearance, clearance)

    def formed(self, took_s: float, *, last: bool) -> None:
        """A formation stands; the first time counts, and ``last`` says that no other is to follow."""
        if np.isnan(self.time_to_form_s):
            self.time_to_form_s = took_s
        self.converged = last

    def lost(self) -> None:
        """A formation that stood is lost."""
        self.converged = False

    def held_within(self, error_m: float) -> None:
        """While a formation was held it was off by this."""
        self.formation_error_m = float(np.fmax(self.formation_error_m, error_m))

    def moved_within(self, error_m: float) -> None:
        """While it moved it was off by this."""
        self.move_error_m = float(np.fmax(self.move_error_m, error_m))

    def locked_in(self, *, gridlocks: int = 0, swaps: int = 0, detours: int = 0) -> None:
        """So many more were locked in, exchanged their roles, or went round others."""
        self.gridlocks += gridlocks
        self.role_swaps += swaps
        self.detours += detours

    def felt(self, mean_m_s: float, gust_m_s: float) -> None:
        """A wind as strong as this, and gusts."""
        self.wind_mean_m_s = float(np.fmax(self.wind_mean_m_s, mean_m_s))
        self.wind_gust_m_s = float(np.fmax(self.wind_gust_m_s, gust_m_s))


class Verdict:
    """Notes for people, and how the mission ends.

    Attributes:
        outcome: None until done; then completed, aborted or refused.
        reason: why it was aborted or refused, "" otherwise.
        figures: see ``Figures``.
        problems: what stands between the team and arming, a line for each.
    """

    def __init__(self) -> None:
        self.outcome: str | None = None
        self.reason = ""
        self.figures = Figures()
        self.problems: list[str] = []
        self._notes: list[Note] = []

    def note(self, kind: str, text: str, roles: tuple[int, ...] = ()) -> None:
        """Takes what is worth the log."""
        self._notes.append(Note(kind, text, roles))

    def take_notes(self) -> list[Note]:
        """Hands out what happened since the last call."""
        notes, self._notes = self._notes, []
        return notes

    def trouble(self, problems: list[str]) -> None:
        """Takes what is not well at the moment."""
        self.problems = problems

    def abort(self, reason: str, *, instead_of: str = "") -> None:
        """Notes why the mission is not completed; a later reason is added to the first.

        Args:
            reason: in words.
            instead_of: words told before that it takes the place of.
        """
        if reason in self.reason:
            return
        if instead_of:
            self.reason = self.reason.replace(f"; {instead_of}", "", 1)
        self.outcome = "aborted"
        self.reason = f"{self.reason}; {reason}" if self.reason else reason
        self.note("alarm", f"aborted: {reason}")

    def refuse(self, reasons: list[str]) -> None:
        """Nothing is armed, or taken over, for these reasons."""
        self.outcome = "refused"
        self.reason = "; ".join(reasons)
        self.problems = reasons

    def complete(self) -> None:
        """It is over; completed unless something was said against it."""
        if self.outcome is None:
            self.outcome = "completed"
