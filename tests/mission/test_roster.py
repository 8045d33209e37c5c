"""One owner for every vehicle's fate: whatever happens, in whatever order, a duty is never softened by accident."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from groundstation.mavlink.vehicle import NEVER
from groundstation.mission.roster import Duty, Roster

N = 4
MASKS = (
    "ours", "killed", "climbing", "in_formation", "homeward", "steered", "follows", "waited_for", "lands", "lands_here",
    "told_to_land",
)  # fmt: skip
ROWS = st.lists(st.integers(0, N - 1), max_size=N, unique=True)


class Fates(RuleBasedStateMachine):
    """Everything that may become of four vehicles, at random."""

    def __init__(self) -> None:
        super().__init__()
        self.now_ns = 0
        self.begin(untaken=False)

    def begin(self, *, untaken: bool) -> None:
        self.roster = Roster(np.array([True, True, False, False]), np.zeros((N, 3)), untaken=untaken)
        self.before = self.duties()
        self.told: set[int] = set()
        self.softened: set[int] = set()

    def duties(self) -> list[Duty]:
        return [self.roster.duty(row) for row in range(N)]

    @rule(untaken=st.booleans())
    def another_flight(self, untaken: bool) -> None:
        self.begin(untaken=untaken)

    @rule(row=st.integers(0, N - 1))
    def take(self, row: int) -> None:
        self.roster.take(row)

    @rule(row=st.integers(0, N - 1))
    def let_go(self, row: int) -> None:
        if self.roster.duty(row) is Duty.HOMEWARD:
            self.softened = {row}
        self.roster.let_go(row)

    @rule(rows=ROWS)
    def end_climb(self, rows: list[int]) -> None:
        self.roster.end_climb(np.isin(np.arange(N), rows))

    @rule(rows=ROWS)
    def go_home(self, rows: list[int]) -> None:
        self.roster.go_home(rows)

    @rule(rows=ROWS)
    def land(self, rows: list[int]) -> None:
        self.roster.land(rows, self.now_ns)

    @rule(rows=ROWS)
    def land_here(self, rows: list[int]) -> None:
        self.roster.land_here(rows, np.full((N, 3), float(self.now_ns)), self.now_ns)

    @rule(row=st.integers(0, N - 1))
    def tell(self, row: int) -> None:
        if self.roster.lands[row]:
            self.roster.tell_to_land(row, self.now_ns)
            self.told.add(row)
        else:
            with pytest.raises(ValueError, match="told to land"):
                self.roster.tell_to_land(row, self.now_ns)

    @rule(rows=ROWS)
    def release(self, rows: list[int]) -> None:
        self.roster.release(rows)

    @rule(rows=ROWS)
    def kill(self, rows: list[int]) -> None:
        self.roster.kill(rows, self.now_ns)

    @rule()
    def time_goes_by(self) -> None:
        self.now_ns += 1

    @invariant()
    def no_duty_is_softened_by_accident(self) -> None:
        now = self.duties()
        for row, (was, is_now) in enumerate(zip(self.before, now, strict=True)):
            assert is_now >= was or (row in self.softened and is_now is Duty.UNTAKEN)
        self.before, self.softened = now, set()

    @invariant()
    def nobody_is_judged_steered_or_waited_for_who_is_not_ours(self) -> None:
        roster = self.roster
        away = np.array([duty >= Duty.RELEASED for duty in self.duties()])
        assert (roster.ours == ~away).all()
        for mask in ("steered", "follows", "waited_for", "in_formation", "homeward", "climbing", "lands"):
            assert not (getattr(roster, mask) & away).any(), mask

    @invariant()
    def one_that_comes_down_flies_no_formation_and_times_are_known(self) -> None:
        roster = self.roster
        assert not (roster.in_formation & (roster.lands | roster.homeward | roster.killed)).any()
        assert ((roster.lands_since_ns != NEVER) | ~roster.lands).all()
        assert ((roster.killed_ns != NEVER) == roster.killed).all()
        assert set(np.flatnonzero(roster.told_to_land).tolist()) == self.told
        assert (roster.lands_here <= roster.lands).all()

    @invariant()
    def nobody_else_writes(self) -> None:
        for name in MASKS:  # a mask is a copy
            getattr(self.roster, name)[:] = True
        assert self.duties() == self.before
        for name in ("lands_since_ns", "told_ns", "killed_ns", "place_ned_m"):
            with pytest.raises(ValueError, match="read-only"):
                getattr(self.roster, name)[:] = 0


TestFates = Fates.TestCase
TestFates.settings = settings(max_examples=60, stateful_step_count=25, deadline=None)


def test_the_first_order_to_land_counts_and_the_last_place() -> None:
    roster = Roster(np.zeros(2, dtype=np.bool_), np.zeros((2, 3)))
    roster.land([0], 1)
    roster.land_here([0, 1], np.ones((2, 3)), 2)
    roster.land_here([1], np.full((2, 3), 5.0), 3)
    assert roster.lands_since_ns.tolist() == [1, 2]
    assert roster.place_ned_m[:, 0].tolist() == [1.0, 5.0]
    roster.tell_to_land(1, 4)
    roster.tell_to_land(1, 9)
    assert roster.told_ns.tolist() == [NEVER, 4]
