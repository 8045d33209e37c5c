"""Parts that whole flights reach too, each alone: a mistake in one fails here, in milliseconds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from groundstation.mavlink.commands import CommandQueue, Outcome
from groundstation.mavlink.vehicle import LANDED_IN_AIR, LANDED_ON_GROUND, LANDED_TAKEOFF, Fleet
from groundstation.mission.flight.climb import Climb
from groundstation.mission.flight.guidance import Guide
from groundstation.mission.flight.killing import Killing
from groundstation.mission.flight.poses import Poses, changed, out_of_sight
from groundstation.mission.flight.standing import Standing
from groundstation.mission.ground.arming import Arming
from groundstation.mission.monitors.findings import Lasting, LastingOf
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.roster import Duty, Roster, enlist
from groundstation.mission.timing import SECOND_NS, AskAgain, Held, HeldEach, Since, SinceBefore, vehicle_list
from groundstation.mission.verdict import Figures, Note, Verdict
from tests.app.flights import pair

GUIDED = 4


@pytest.fixture(scope="module")
def plan() -> MissionPlan:
    return pair(autopilots=("arducopter", "arducopter"))


class Two:
    """Two vehicles that stand and are well, what is asked of them, and what they are to do."""

    def __init__(self, plan: MissionPlan) -> None:
        self.plan = plan
        self.fleet = Fleet([vehicle.id for vehicle in plan.spec.vehicles], plan.link_of_vehicle)
        self.fleet.landed_state[:] = LANDED_ON_GROUND
        self.commands = CommandQueue(2)
        self.roster: Roster = enlist(plan)
        self.hear(0.0)

    def hear(self, now_s: float) -> int:
        """Everything arrives once more; returns the time in ns."""
        now_ns = round(now_s * SECOND_NS)
        for times in (self.fleet.heartbeat_ns, self.fleet.heard_ns, self.fleet.landed_ns):
            times[:] = now_ns
        return now_ns

    def asked(self, now_ns: int) -> list[tuple[int, str]]:
        """What goes out now; every command is taken at once, so that the next one may be asked."""
        sent = [(item.vehicle, item.command.name) for item in self.commands.due(now_ns)]
        for vehicle in (0, 1):
            self.commands.clear(vehicle)
        return sent


def test_time_since_before_is_nothing_the_first_time() -> None:
    since, from_zero = SinceBefore(), SinceBefore(0)
    assert [since(now_ns) for now_ns in (7_000_000_000, 7_250_000_000, 7_250_000_000)] == [0.0, 0.25, 0.0]
    assert [from_zero(now_ns) for now_ns in (500_000_000, 2_000_000_000)] == [0.5, 1.5]
    since.forget()
    assert [since(now_ns) for now_ns in (9_000_000_000, 9_500_000_000)] == [0.0, 0.5]


def test_what_has_held_without_a_break_is_believed_and_a_break_counts_from_anew() -> None:
    held, each = Held(), HeldEach(2)
    for now, condition, expected in ((0, True, False), (9, True, False), (10, True, True), (11, False, False)):
        assert held(condition, now, 10) == expected
        assert each(np.array([condition, False]), now, 10).tolist() == [expected, False]
    assert not held(True, 12, 10)
    assert held.since_ns == 12
    held.forget()
    assert not held(True, 100, 10)


def test_what_is_asked_again_now_and_then_is_asked_at_once_the_first_time() -> None:
    asking = AskAgain(2, 10)
    assert asking.due(0, 0)
    asking.asked(0, 5)
    assert [asking.due(0, 14), asking.due(0, 15)] == [False, True]
    assert asking.all_due(14).tolist() == [False, True]
    asking.at_once(0)
    assert asking.due(0, 6)
    assert [asking.lately(0, 14, 10), asking.lately(1, 14, 10)] == [False, False]
    asking.asked(0, 5)
    assert [asking.lately(0, 14, 10), asking.lately(0, 15, 10)] == [True, False]
    assert vehicle_list([1, 3]) == "vehicle 1, vehicle 3"


def test_what_is_so_of_one_vehicle_counts_from_the_first_time_until_it_is_forgotten() -> None:
    since = Since(2)
    for now in (5, 8):
        since.note(0, now)
    assert [since.held(0, 14, 10), since.held(0, 15, 10)] == [False, True]
    assert [since.began(0, 14, 10), since.began(0, 15, 10)] == [True, False]
    assert [since.noted(1), since.held(1, 10**12, 10), since.began(1, 0, 10)] == [False, False, False]
    since.again(0, 14)
    assert not since.held(0, 15, 10)
    since.forget(0)
    assert not since.noted(0)


def test_a_verdict_adds_reasons_once_and_is_completed_only_when_nothing_was_said_against_it() -> None:
    verdict = Verdict()
    for reason in ("first", "second", "first"):
        verdict.abort(reason)
    verdict.complete()
    assert (verdict.outcome, verdict.reason) == ("aborted", "first; second")
    assert verdict.take_notes() == [Note("alarm", "aborted: first"), Note("alarm", "aborted: second")]
    assert verdict.take_notes() == []
    well = Verdict()
    well.complete()
    assert well.outcome == "completed"
    refused = Verdict()
    refused.refuse(["a", "b"])
    refused.complete()
    assert (refused.outcome, refused.reason, refused.problems) == ("refused", "a; b", ["a", "b"])


def test_figures_keep_the_first_time_the_nearest_and_the_largest() -> None:
    figures = Figures()
    for took_s, last in ((7.0, False), (3.0, True)):
        figures.formed(took_s, last=last)
    assert (figures.time_to_form_s, figures.converged) == (7.0, True)
    figures.lost()
    assert not figures.converged
    for value in (2.0, 1.0, 3.0, np.nan):
        if np.isfinite(value):
            figures.came_near(value, value / 2.0)
        figures.held_within(value)
        figures.moved_within(value)
        figures.felt(value, 2.0 * value)
    assert (figures.min_distance_m, figures.min_clearance) == (1.0, 0.5)
    assert (figures.formation_error_m, figures.move_error_m) == (3.0, 3.0)
    assert (figures.wind_mean_m_s, figures.wind_gust_m_s) == (3.0, 6.0)
    figures.locked_in(gridlocks=1)
    figures.locked_in(swaps=2, detours=3)
    for late in (False, True, False):
        figures.ticked(late=late)
    assert (figures.gridlocks, figures.role_swaps, figures.detours) == (1, 2, 3)
    assert (figures.ticks, figures.deadline_misses) == (3, 1)


def test_motors_are_stopped_again_and_again_until_a_newer_heartbeat_shows_it(plan: MissionPlan) -> None:
    two = Two(plan)
    two.fleet.armed[:] = True
    killing = Killing(plan, two.fleet, two.commands, two.roster)
    two.commands.request(1, plan.autopilots[1].land())
    killing.want([1], 0)
    assert two.roster.duty(1) is Duty.KILLED
    assert two.fleet.disarm_expected.tolist() == [False, True]
    sent = []
    for k in range(11):
        killing.step(k * SECOND_NS // 10)
        sent += [(k, *item) for item in two.asked(k * SECOND_NS // 10)]
    kill = plan.autopilots[1].kill().name
    assert sent == [(0, 1, kill), (5, 1, kill), (10, 1, kill)]  # and never the landing
    assert killing.falling(SECOND_NS).tolist() == [False, True]
    two.fleet.armed[1] = False
    for heard_s in (0.0, 0.4):
        assert killing.not_shown(two.hear(heard_s)).tolist() == [
            False,
            True,
        ]  # that heartbeat may be older than the order
    assert [bool(killing.unheard(s * SECOND_NS)[1]) for s in (1, 60)] == [False, True]
    assert not killing.not_shown(two.hear(2.0)).any()
    assert [bool(killing.falling(s * SECOND_NS)[1]) for s in (4, 6)] == [True, False]


def test_who_was_never_seen_is_under_nobody_and_what_is_not_known_does_not_spread() -> None:
    unknown = np.full((1, 3), np.nan)
    pos_ned_m, vel_ned_m_s = np.vstack([np.ones((1, 3)), unknown]), np.vstack([np.full((1, 3), 0.5), unknown])
    level = np.array([[1.0, 0.0, 0.0, 0.0]] * 2)
    poses = Poses(pos_ned_m, vel_ned_m_s, level, np.zeros(2, dtype=np.bool_))
    seen = out_of_sight(poses)
    assert seen.pos_team_ned_m[1, 2] > 1e4  # far below, where nobody is told to leave a column
    assert np.linalg.norm(seen.pos_team_ned_m[1, :2]) > 1e4
    assert (seen.pos_team_ned_m[0].tolist(), seen.vel_ned_m_s.tolist()) == ([1.0] * 3, [[0.5] * 3, [0.0] * 3])
    assert out_of_sight(seen) is seen
    assert seen.rot_ned_from_flu[0].tolist() == np.diag([1.0, -1.0, -1.0]).tolist()
    with pytest.raises(ValueError, match=r"extra_radius_m has shape \(3,\), expected \(2,\)"):
        replace(poses, extra_radius_m=np.zeros(3))


def test_a_climb_is_asked_of_one_that_stands_and_ends_at_its_height(plan: MissionPlan) -> None:
    two = Two(plan)
    two.fleet.armed[:] = True
    climb = Climb(plan, two.roster, Guide(plan).beside_m, Standing(plan, two.fleet))
    height, target = np.zeros(2), np.full(2, 2.0)
    climb.step(two.hear(0.1), two.fleet, two.commands, height, target)
    assert two.asked(SECOND_NS // 10) == [(0, "takeoff"), (1, "takeoff")]
    climb.step(two.hear(1.0), two.fleet, two.commands, height, target)
    assert two.asked(SECOND_NS) == []
    two.fleet.landed_state[0] = LANDED_IN_AIR
    climb.step(two.hear(3.0), two.fleet, two.commands, np.array([1.9, 0.0]), target)
    assert two.asked(3 * SECOND_NS) == [(1, "takeoff")]
    assert two.roster.climbing.tolist() == [False, True]
    assert two.roster.steered.tolist() == [True, False]


def test_a_climb_is_over_when_it_stays_at_its_height_whatever_the_landed_state_says(plan: MissionPlan) -> None:
    two = Two(plan)
    two.fleet.armed[:] = True
    two.fleet.landed_state[:] = LANDED_TAKEOFF
    climb = Climb(plan, two.roster, Guide(plan).beside_m, Standing(plan, two.fleet))
    for now_s, climbs in ((1.0, True), (2.9, True), (3.0, False)):
        climb.step(two.hear(now_s), two.fleet, two.commands, np.array([1.6, 1.8]), np.full(2, 2.0))
        assert two.roster.climbing.tolist() == [True, climbs], now_s
    assert two.asked(3 * SECOND_NS) == []  # neither stands


def test_whoever_has_a_pad_above_its_own_climbs_when_that_one_is_ahead() -> None:
    for autopilots, ahead_m in ((("arducopter", "arducopter"), 0.0), (("arducopter", "px4"), 1.2)):
        stairs = pair(autopilots=autopilots)
        pads_enu_m = stairs.pads_enu_m[0] + np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 3.0]])
        two = Two(replace(stairs, pads_enu_m=pads_enu_m))
        two.fleet.armed[:] = True
        climb = Climb(two.plan, two.roster, Guide(stairs).beside_m, Standing(stairs, two.fleet))
        climb.step(two.hear(0.1), two.fleet, two.commands, np.zeros(2), np.full(2, 2.0))
        assert not [item for item in two.asked(SECOND_NS // 10) if item[0] == 0]
        if ahead_m:  # who climbs by velocity is ahead at six tenths of its height, and no sooner
            climb.step(two.hear(0.5), two.fleet, two.commands, np.array([0.0, ahead_m - 0.02]), np.full(2, 2.0))
            assert not [item for item in two.asked(SECOND_NS // 2) if item[0] == 0]
        two.fleet.landed_state[1] = LANDED_IN_AIR
        climb.step(two.hear(1.0), two.fleet, two.commands, np.array([0.0, ahead_m]), np.full(2, 2.0))
        assert two.asked(SECOND_NS) == [(0, "takeoff")]


def test_nobody_is_armed_before_everybody_follows_and_one_that_refuses_is_asked_alone(plan: MissionPlan) -> None:
    two = Two(plan)
    arming = Arming(plan, two.fleet, two.commands, Standing(plan, two.fleet), two.roster)
    assert not arming.step(two.hear(0.0))
    assert {name for _, name in two.asked(0)} == {plan.autopilots[0].streaming_mode().name}
    two.fleet.custom_mode[0] = GUIDED
    assert not arming.step(two.hear(1.0))
    assert two.asked(SECOND_NS) == [(1, plan.autopilots[1].streaming_mode().name)]
    two.fleet.custom_mode[1] = GUIDED
    assert not arming.step(two.hear(2.0))
    assert two.asked(2 * SECOND_NS) == [(0, "arm"), (1, "arm")]
    arming.heard(Outcome(1, plan.autopilots[1].arm(), 4))
    assert not arming.step(two.hear(3.0))
    assert two.asked(3 * SECOND_NS) == [(1, "arm")]
    assert "it acknowledged arm and did not do it" not in arming.why_not(9.0, {})
    assert arming.why_not(9.0, {1: "no"}) == "vehicle 2: not armed in mode GUIDED after 9 s: no"
    arming.heard(Outcome(1, plan.autopilots[1].arm(), 0))
    words = arming.why_not(9.0, {})
    assert "after 9 s: it acknowledged arm and did not do it; see what QGroundControl" in words
    two.commands.request(1, plan.autopilots[1].land())  # while something waits for its answer nothing else is asked
    assert not arming.step(two.hear(4.0))
    assert two.asked(4 * SECOND_NS) == [(1, plan.autopilots[1].land().name)]
    assert not two.commands.pending(1)
    two.fleet.armed[:] = True
    assert arming.step(two.hear(4.0))
    two.fleet.restarts[1] += 1
    assert arming.started_anew() == "vehicle 2: has started anew while the team was arming; see to its power"


def test_poses_that_change_in_part_are_what_replace_makes_and_keep_no_rotation_of_others() -> None:
    level = np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))
    poses = Poses(np.zeros((2, 3)), np.zeros((2, 3)), level, np.zeros(2, dtype=np.bool_))
    rotation = poses.rot_ned_from_flu
    moved = changed(poses, pos_team_ned_m=np.ones((2, 3)))
    assert moved.rot_ned_from_flu is rotation
    assert poses.pos_team_ned_m.sum() == 0.0
    turned = changed(moved, quat_ned_from_frd=np.tile([0.0, 0.0, 0.0, 1.0], (2, 1)))
    same = replace(moved, quat_ned_from_frd=turned.quat_ned_from_frd)
    np.testing.assert_array_equal(turned.rot_ned_from_flu, same.rot_ned_from_flu)
    assert turned.pos_team_ned_m is moved.pos_team_ned_m


def test_a_few_conditions_by_their_numbers_last_and_are_told_as_those_of_a_row_each() -> None:
    rng = np.random.default_rng(2)
    few, rows = LastingOf(0.2), Lasting(9, 0.2)
    told = []
    for tick in range(300):
        so = rng.random(9) < 0.8
        now_ns = tick * SECOND_NS // 20
        told.append(few(so.nonzero()[0].tolist(), now_ns))
        assert told[-1] == rows(so, now_ns)
    assert sorted(row for found in told for row in found) == list(range(9))
