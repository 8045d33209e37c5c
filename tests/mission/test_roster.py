"""One owner for every vehicle's fate: whatever happens, in whatever order, a duty is never softened by accident."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from groundstation.core.types import FloatArray
from groundstation.mavlink.vehicle import LANDED_IN_AIR, LANDED_LANDING, NEVER, Fleet
from groundstation.mission.monitors.board import Board
from groundstation.mission.monitors.findings import Findings, Reaction, Sight
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.roster import Duty, Roster
from tests.app.flights import four
from tests.mission.accuser import Accuser

N = 4
SECOND_NS = 1_000_000_000
OFFBOARD, LOITER = 393216, 50593792
MASKS = (
    "ours", "killed", "climbing", "in_formation", "homeward", "steered", "follows", "waited_for", "lands", "lands_here",
    "told_to_land",
)  # fmt: skip
ROWS = st.lists(st.integers(0, N - 1), max_size=N, unique=True)
WRONG = ("silent", "empty", "mode", "anew", "tilted", "astray", "near", "comes down")
PLACES = st.tuples(*[st.floats(-5.0, 5.0)] * 3)


@cache
def plan() -> MissionPlan:
    return four()


class Eyes:
    """Monitors that look at four vehicles, of which anything may go wrong."""

    def __init__(self, now_ns: int) -> None:
        self.fleet = Fleet(range(1, N + 1), plan().link_of_vehicle)
        self.fleet.armed[:] = True
        self.fleet.custom_mode[:] = OFFBOARD
        self.fleet.landed_state[:] = LANDED_IN_AIR
        self.fleet.quat_ned_from_frd[:] = [1.0, 0.0, 0.0, 0.0]
        self.pos_ned_m = plan().pads_enu_m[:, [1, 0, 2]] - [0.0, 0.0, 1.0]
        self.vel_ned_m_s = np.zeros((N, 3))
        self.silent: set[int] = set()
        self.board = Board(plan())
        self.board.begin(self.fleet)
        self.hear(now_ns)

    def hear(self, now_ns: int) -> None:
        """Everybody says something, but those that are silent."""
        heard = [row for row in range(N) if row not in self.silent]
        for times in (self.fleet.heard_ns, self.fleet.heartbeat_ns, self.fleet.pose_ns, self.fleet.status_ns):
            times[heard] = now_ns

    def spoil(self, row: int, what: str) -> None:
        fleet = self.fleet
        if what == "silent":
            self.silent.add(row)
        elif what == "empty":
            fleet.battery_remaining[row] = 0.01
        elif what == "mode":
            fleet.custom_mode[row] = LOITER
        elif what == "anew":
            fleet.restarts[row] += 1
        elif what == "tilted":
            fleet.quat_ned_from_frd[row] = [0.5, np.sqrt(0.75), 0.0, 0.0]
        elif what == "astray":
            self.pos_ned_m[row] += [50.0, 0.0, 0.0]
        elif what == "near":
            self.pos_ned_m[row] = self.pos_ned_m[(row + 1) % N] - [0.0, 0.0, 0.2]
        else:
            fleet.landed_state[row], self.vel_ned_m_s[row, 2] = LANDED_LANDING, 0.5

    def look(self, roster: Roster, now_ns: int, board: Board | None = None) -> Findings:
        return (board or self.board).look(
            Sight(
                fleet=self.fleet,
                now_ns=now_ns,
                pos_team_ned_m=self.pos_ned_m,
                vel_ned_m_s=self.vel_ned_m_s,
                pose_ns=self.fleet.pose_ns,
                drift_m=np.full(N, np.nan),
                sent_ned_m_s=np.zeros((N, 3)),
                ours=roster.ours,
                steered=roster.steered,
                lands_here=roster.lands_here,
                excused=roster.told_to_land,
                blind=self.board.blind,
                airborne=self.fleet.armed.copy(),
            )
        )


def judged(findings: Findings) -> set[int]:
    """Rows of the vehicles that findings begin with, or want something of."""
    texts = [*findings.alarms, *findings.failed, *findings.gone, *findings.aborts, *findings.aborts.values()]
    names = [text.split(": ")[0] for text in texts if text.startswith("vehicle")]
    told = {int(word) - 1 for name in names for word in name.split() if word.isdigit()}
    return told | {*findings.home, *findings.land, *findings.release}


class Fates(RuleBasedStateMachine):
    """Everything that may become of four vehicles, at random, and what the monitors say of them."""

    def __init__(self) -> None:
        super().__init__()
        self.now_ns = 0
        self.begin(untaken=False)

    def begin(self, *, untaken: bool) -> None:
        self.roster = Roster(np.array([True, True, False, False]), np.zeros((N, 3)), untaken=untaken)
        self.before = self.duties()
        self.told: set[int] = set()
        self.softened: set[int] = set()
        self.moved: set[int] = set()
        self.places = np.zeros((N, 3))
        self.eyes = Eyes(self.now_ns)

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
        self.put_here(rows, np.full((N, 3), float(self.now_ns)))

    def put_here(self, rows: list[int], places_ned_m: FloatArray) -> None:
        for row in rows:
            if self.roster.ours[row]:
                self.places[row] = places_ned_m[row]
        self.roster.land_here(rows, places_ned_m, self.now_ns)

    @rule(row=st.integers(0, N - 1), place=PLACES)
    def give_place(self, row: int, place: tuple[float, float, float]) -> None:
        self.roster.give_place(row, place)
        self.places[row] = place
        self.moved.add(row)

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

    @rule(row=st.integers(0, N - 1), what=st.sampled_from(WRONG))
    def something_goes_wrong(self, row: int, what: str) -> None:
        self.eyes.spoil(row, what)

    @rule(ticks=st.integers(1, 12))
    def time_goes_by(self, ticks: int) -> None:
        """The monitors look, and what they want is done, as in flight."""
        for _ in range(ticks):
            self.now_ns += SECOND_NS // 2
            self.eyes.hear(self.now_ns)
            away = {row for row in range(N) if not self.roster.ours[row]}
            findings = self.eyes.look(self.roster, self.now_ns)
            assert not judged(findings) & away, findings
            self.roster.release(findings.release)
            self.put_here(findings.land, self.eyes.pos_ned_m)
            self.roster.go_home(findings.home)

    @rule(reaction=st.sampled_from(Reaction))
    def somebody_accuses_everybody(self, reaction: Reaction) -> None:
        board = Board(plan())
        board._monitors = (Accuser(reaction), *board._monitors)
        findings = self.eyes.look(self.roster, self.now_ns, board)
        assert judged(findings) == {row for row in range(N) if self.roster.ours[row]}
        assert not (board.blind & ~self.roster.ours).any()

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
    def a_place_is_kept_by_whom_it_was_given_and_makes_nobody_land_or_fly(self) -> None:
        roster, others = self.roster, np.full((N, 3), 7.0)
        assert set(np.flatnonzero(roster.elsewhere).tolist()) == self.moved
        assert (roster.place_ned_m == self.places).all()
        own = [row for row in range(N) if row in self.moved or self.duties()[row] is Duty.LANDS_HERE]
        expected = others.copy()
        expected[own] = self.places[own]
        assert (roster.places_ned_m(others) == expected).all()

    @invariant()
    def nobody_else_writes(self) -> None:
        for name in (*MASKS, "lands_since_ns", "told_ns", "killed_ns", "place_ned_m", "elsewhere"):
            with pytest.raises(ValueError, match="read-only"):
                getattr(self.roster, name)[:] = 0
        assert self.duties() == self.before


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
