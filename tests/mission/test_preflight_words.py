"""What preflight waits for and refuses, a vehicle's answer at a time: each line alone, in milliseconds."""

from __future__ import annotations

import math

import numpy as np
import pytest

from groundstation.mavlink.station import Station
from groundstation.mavlink.vehicle import LANDED_IN_AIR, Ack
from groundstation.mission.ground.preflight import GroundState, Preflight
from groundstation.mission.ground.streams import Rates
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.profiles import approach_rate_1_s
from groundstation.mission.timing import SECOND_NS
from tests.app.flights import pair
from tests.mission.on_pads import NORTH_1_M_DEG, looked_at, standing

WELL = "its parameters are being read"
"""What one waits for that lacks nothing else: here nobody answers."""
PX4_OFFBOARD, PX4_LOITER = 6 << 16, 4 << 16 | 3 << 24


@pytest.fixture(scope="module")
def plan() -> MissionPlan:
    return pair()


class Ground:
    """Two that are well before takeoff; the tests spoil the first one."""

    def __init__(self, plan: MissionPlan) -> None:
        self.plan, self.fleet = plan, standing(plan)
        self.station = Station(self.fleet, 0)
        self.frame = looked_at(plan, self.fleet)
        self.preflight = Preflight(plan, self.station, self.frame)
        self.fleet.prearm_ok[:] = True
        self.fleet.custom_mode[:] = (PX4_LOITER, 0)
        self.fleet.clocks.samples[:], self.fleet.clocks.known[:] = 3, True
        self.fleet.clocks.round_trip_s[:] = 0.01
        self.fleet.firmware[:] = 0xFF << 24
        self.fleet.estimator_flags[:] = 0x1FF
        self.now_s = 1.9
        self.asked: list[str] = []
        self.state = GroundState()

    def look(self, now_s: float, said: str | None = None, *, silent: bool = False) -> str | None:
        """One tick in which everything arrives anew; returns what the first one still lacks."""
        self.now_s = now_s
        fleet, now_ns = self.fleet, round(now_s * SECOND_NS)
        heard = slice(1, None) if silent else slice(None)
        for times in (fleet.pose_ns, fleet.place_ns, fleet.attitude_ns, fleet.heard_ns, fleet.heartbeat_ns):
            times[heard] = now_ns
        fleet.estimator_ns[:] = now_ns
        for rates in range(2):
            self.preflight.streams.rates[rates] = Rates(now_ns, 0, now_ns, hz=(50.0, 50.0), good=True)
        self.frame.placement.look(fleet, now_ns)
        poses = self.frame.poses(fleet, now_ns)
        self.state = self.preflight.step(now_ns, {} if said is None else {0: said}, poses.pos_team_ned_m)
        commands = self.station.commands
        unanswered, answered, self.asked = list(commands.unanswered), list(commands.answered), []
        while commands.pending(0):  # each is sent, and taken at once, so that the next one may be asked
            for item in commands.due(now_ns):
                self.asked += [item.command.name] * (item.vehicle == 0)
                commands.acknowledge(Ack(item.vehicle, item.command.command, 0, now_ns))
        commands.unanswered, commands.answered = unanswered, answered
        lines = [line.removeprefix("vehicle 1: ") for line in self.state.waiting if line.startswith("vehicle 1: ")]
        assert len(lines) <= 1
        return lines[0] if lines else None

    def run(self, until_s: float, asks: str) -> list[float]:
        """Goes on by tenths of a second; returns when something was asked."""
        asked = []
        while self.now_s < until_s - 0.05:
            self.look(self.now_s + 0.1)
            asked += [round(self.now_s, 1)] * self.asked.count(asks)
        return asked

    def notes(self) -> list[str]:
        """What was told of it in the last tick."""
        return [note.removeprefix("vehicle 1: ") for note in self.state.notes if note.startswith("vehicle 1: ")]


def test_one_that_lacks_nothing_waits_for_its_parameters_alone(plan: MissionPlan) -> None:
    line = Ground(plan).look(2.0)
    assert line is not None
    assert line.startswith(WELL)


# Does it hear us?


def test_one_that_talks_and_answers_nothing_is_told_and_asked_now_and_then(plan: MissionPlan) -> None:
    ground = Ground(plan)
    ground.station.commands.unanswered[0] = 1
    assert "answers no command" not in (ground.look(2.0) or "")  # on a lossy link that is chance
    ground.station.commands.unanswered[0] = 2
    probe = plan.autopilots[0].once("AUTOPILOT_VERSION").name
    assert (ground.look(3.0) or "").startswith("is heard, and answers no command (2 so far); ")
    asked = [3.0] * ground.asked.count(probe) + ground.run(7.4, probe)
    assert asked == pytest.approx([3.0, 5.0, 7.0], abs=0.25)  # other questions go first
    ground.station.commands.answered[0] = True
    assert (ground.look(8.0) or "").startswith("is heard, and answers no command any more; ")


def test_one_that_does_not_talk_either_is_only_not_heard(plan: MissionPlan) -> None:
    ground = Ground(plan)
    ground.look(2.0)
    ground.station.commands.unanswered[0] = 5
    assert (ground.look(20.0, silent=True) or "").startswith("last heard 18.0 s ago, limit ")


# Is it ready?


def test_why_one_is_not_ready_is_asked_after_a_while_and_told_in_its_own_words(plan: MissionPlan) -> None:
    ground = Ground(plan)
    ground.fleet.prearm_ok[0] = False
    check = plan.autopilots[0].run_prearm_checks().name
    waits = "not ready to arm, and has not said why yet; its own checks have to pass"
    nothing = "not ready to arm, and gives no reason (it was asked); "
    assert ground.look(2.0) == waits
    (first_s,) = ground.run(7.8, check)
    assert first_s == pytest.approx(5.0, abs=0.15)  # other questions go first
    assert ground.look(first_s + 2.9) == waits
    assert (ground.look(first_s + 3.0) or "").startswith(nothing)
    (second_s,) = ground.run(20.0, check)
    assert second_s == pytest.approx(first_s + 10.0, abs=0.15)
    assert (ground.look(20.1) or "").startswith(nothing)
    assert ground.look(20.2, "no GPS fix") == "not ready to arm: no GPS fix; its own checks have to pass"
    ground.fleet.prearm_ok[0] = True
    assert (ground.look(40.0) or "").startswith(WELL)
    ground.fleet.prearm_ok[0] = False
    (third_s,) = ground.run(44.0, check)  # it counts from anew
    assert third_s == pytest.approx(43.1, abs=0.15)


@pytest.mark.parametrize(("mode", "leaves"), [(PX4_OFFBOARD, True), (PX4_LOITER, False)])
def test_one_that_stands_in_the_mode_of_its_last_flight_is_asked_to_leave_it(
    plan: MissionPlan, mode: int, *, leaves: bool
) -> None:
    ground = Ground(plan)
    ground.fleet.prearm_ok[0], ground.fleet.custom_mode[0] = False, mode
    idle = plan.autopilots[0].idle_mode().name
    asked = ground.run(8.5, idle)
    assert len(asked) == (2 if leaves else 0)
    assert not leaves or asked[1] - asked[0] == pytest.approx(5.0, abs=0.15)


def test_one_that_does_not_stand_is_not_armed(plan: MissionPlan) -> None:
    ground = Ground(plan)
    ground.fleet.landed_state[0] = LANDED_IN_AIR
    words = f"does not report to stand on the ground (landed state {LANDED_IN_AIR}); put it on its pad, or restart it"
    assert ground.look(2.0) == words


# Its clock


def test_a_clock_is_waited_for_and_done_without_when_it_does_not_come(plan: MissionPlan) -> None:
    ground = Ground(plan)
    ground.fleet.clocks.samples[0], ground.fleet.clocks.known[0] = 2, False
    for now_s in (2.0, 6.9):
        assert ground.look(now_s) == "clock asked for, not answered yet"
    assert (ground.look(7.0) or "").startswith(WELL)
    assert ground.notes()[0] == "does not answer TIMESYNC; its positions are dated by their arrival"
    ground.fleet.clocks.samples[0] = 3
    ground.look(7.1)
    assert not any("TIMESYNC" in note for note in ground.notes())  # said once


def test_answers_that_take_longer_than_r_reckons_with_are_refused(plan: MissionPlan) -> None:
    ground = Ground(plan)
    limit_s = plan.profile.delay_s + 0.15
    ground.fleet.clocks.round_trip_s[0] = limit_s + 0.1
    line = ground.look(2.0)
    assert line is not None
    assert line.startswith(
        f"its answers take {limit_s + 0.1:.2f} s, limit {limit_s:.2f} s for the delay that r is kept with; "
    )
    assert line.endswith(f"set link_delay_s: {plan.spec.link_delay_s + 0.15:.2f}")
    ground.fleet.clocks.round_trip_s[0] = limit_s - 0.001
    assert (ground.look(2.1) or "").startswith(WELL)


def test_a_delay_that_makes_the_team_swing_is_told_once_and_waited_for_by_nobody() -> None:
    plan = pair("link_delay_s=0.02")
    ground = Ground(plan)
    calm_s = 0.02 + 0.25 * 0.25 / approach_rate_1_s(plan.profile, plan.lead_s)
    told = []
    for now_s, trip_s in ((2.0, calm_s - 0.001), (2.1, calm_s + 0.001), (2.2, calm_s + 0.02)):
        ground.fleet.clocks.round_trip_s[0] = trip_s
        assert (ground.look(now_s) or "").startswith(WELL)
        told += [(now_s, note) for note in ground.notes() if "its answers take" in note]
    ((now_s, note),) = told
    assert now_s == 2.1
    assert note.startswith(
        f"its answers take {calm_s + 0.001:.2f} s, and the mission reckons with link_delay_s: 0.02; "
    )
    assert note.endswith(f"link_delay_s: {math.ceil(100.0 * (calm_s + 0.001)) / 100.0:.2f} would make it calmer")


# Where it stands


def test_an_origin_that_is_not_told_is_waited_for_and_asked_for(plan: MissionPlan) -> None:
    ground = Ground(plan)
    ground.fleet.origin_deg_m[0] = np.nan
    assert ground.look(2.0) == "has not told its origin (GPS_GLOBAL_ORIGIN) yet; has it a GPS position?"
    assert plan.autopilots[0].once("GPS_GLOBAL_ORIGIN").name in ground.asked


def test_an_origin_that_moves_is_waited_for_and_its_neighbours_are_not_accused(plan: MissionPlan) -> None:
    ground = Ground(plan)
    ground.look(2.0)
    ground.fleet.origin_moved_ns[0], ground.fleet.origin_moved_m[0] = 2 * SECOND_NS, 3.0
    ground.fleet.origin_deg_m[1, 0] += 3.0 * NORTH_1_M_DEG  # seen from the first one the second seems to have moved
    line = ground.look(3.0)
    assert line is not None
    assert line.startswith("reports two different origins, 3.00 m apart; wait until its estimator has settled")
    assert not any("from its pad" in waiting for waiting in ground.state.waiting)


def test_positions_that_disagree_are_waited_for(plan: MissionPlan) -> None:
    ground = Ground(plan)
    limit_m = plan.limits.frame_drift_m
    ground.look(2.0)
    for now_s in (3.0, 4.0):
        ground.fleet.pos_local_ned_m[0, 0] = limit_m + 1.0
        line = ground.look(now_s)
    assert line is not None
    assert line.startswith(f"its local and global positions are {limit_m + 1.0:.2f} m apart, limit {limit_m:.2g} m; ")


def test_one_that_stands_beside_its_pad_is_told_how_far(plan: MissionPlan) -> None:
    ground = Ground(plan)
    limit_m = plan.limits.pad_error_m
    for off_m, waits in ((limit_m - 0.1, False), (limit_m + 0.1, True)):
        ground.fleet.origin_deg_m[1] = ground.fleet.place_deg_m[1]
        ground.fleet.pos_local_ned_m[1, 0] = off_m
        ground.look(2.0 + off_m)
        told = [line for line in ground.state.waiting if line.startswith("vehicle 2: reports a position ")]
        assert bool(told) == waits
    assert told[0].startswith(f"vehicle 2: reports a position {off_m:.2f} m from its pad, limit {limit_m:.3g} m; put")


def test_without_the_first_ones_place_nobody_has_one() -> None:
    plan = pair("vehicles.0.position=global", "vehicles.1.position=global")
    ground = Ground(plan)
    ground.frame.placement.anchor_deg_m = None
    ground.fleet.place_deg_m[0] = np.nan
    ground.fleet.origin_deg_m[1] = np.nan  # it flies by global positions and needs none
    ground.look(2.0)
    words = "its place in the team frame is not known yet: no global position of the first vehicle"
    assert f"vehicle 2: {words}" in ground.state.waiting
