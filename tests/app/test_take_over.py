"""A ground station that dies in the air, and the one that is started in its place."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from groundstation.app.verify import verify_log
from groundstation.core.types import FloatArray
from groundstation.mavlink.codec import Batch, Frame, FrameSplitter, decode, message_id
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.purpose import Purpose
from groundstation.mission.runner import Phase, Runner
from sitl.faults import Fault
from sitl.personalities.px4.modes import LAND, POSCTL
from sitl.world import Outgoing, World
from tests.app.flights import SECOND_NS, Flight, cube8, four, mission, pair, still_in
from tests.app.test_who_lands_where import MOVED

SETPOINT = message_id("SET_POSITION_TARGET_LOCAL_NED")
DO_SET_MODE, COMPONENT_ARM_DISARM = 176, 400


class _Died(Exception):  # noqa: N818 - the end of a process, not an error
    """Ends a flight as SIGKILL does."""


def _left_in_the_air(
    plan: MissionPlan,
    when: Callable[[Flight], bool],
    *,
    idle_s: float = 3.0,
    prepare: Callable[[World], None],
) -> World:
    """Flies until something is so, then nobody is there for a while."""
    worlds: list[World] = []

    def die(flight: Flight) -> bool:
        if when(flight):
            worlds.append(flight.world)
            raise _Died
        return False

    with contextlib.suppress(_Died):
        Flight(plan, interrupt_when=die, chatter=True)
    (world,) = worlds
    prepare(world)  # only now: preflight would not have flown with all of this
    for _ in range(round(idle_s * 50)):
        world.advance(world.now_ns + SECOND_NS // 50)
    return world


def _holds(world: World) -> None:
    """Whoever loses the ground station holds for as long as the test lasts."""
    for pilot in world.autopilots:
        for name, value in (("COM_OBL_RC_ACT", 5), ("NAV_DLL_ACT", 1), ("FS_GCS_ENABLE", 0)):
            if name in pilot.params:
                pilot.params.set_value(name, value)


def _land_modes(world: World) -> None:
    """One that is left lands, and has to be asked out of that."""
    for pilot in world.autopilots:
        pilot.params.set_value("NAV_DLL_ACT", 3)
        pilot.params.set_value("COM_DL_LOSS_T", 1)
        pilot.params.set_value("COM_FAIL_ACT_T", 0)


def _asks_for_mode(batch: Batch) -> bool:
    return batch.name == "COMMAND_LONG" and bool((batch.values["command"] == DO_SET_MODE).any())


def flight_modes(world: World) -> list[str]:
    return [pilot.mode_name() for pilot in world.autopilots]


def _off_pads_m(flight: Flight) -> FloatArray:
    return np.asarray(np.linalg.norm(flight.world.truth.pos_enu_m[:, :2] - flight.plan.pads_enu_m[:, :2], axis=1))


def _assert_home(flight: Flight) -> None:
    truth = flight.world.truth
    assert not truth.armed.any()
    assert not truth.airborne.any()
    assert flight.world.min_distance_airborne_m >= flight.plan.spec.avoidance.radius_m


@pytest.mark.parametrize(
    ("phase", "for_s"), [(Phase.TAKEOFF, 3.2), (Phase.FORM, 1.5), (Phase.HOLD, 2.0), (Phase.RETURN, 1.0)]
)
def test_a_team_that_was_left_is_brought_home_from_every_phase(phase: Phase, for_s: float, tmp_path: Path) -> None:
    world = _left_in_the_air(four(), still_in(phase, for_s), prepare=_holds)
    assert world.truth.airborne.all()
    log = tmp_path / "flight.tlog"
    flight = Flight(four(), world=world, take_over=True, log=log)
    assert (flight.runner.outcome, flight.runner.reason) == ("completed", "")
    assert flight.phase_seen == [Phase.TAKEOVER, Phase.RETURN, Phase.LAND, Phase.DONE]
    _assert_home(flight)
    assert _off_pads_m(flight).max() < 0.3
    result = verify_log(log)
    assert (result.mismatches, result.setpoints > 500) == (0, True)


def test_eight_are_brought_home_out_of_a_cube() -> None:
    world = _left_in_the_air(cube8(), still_in(Phase.HOLD, 1.0), prepare=_holds)
    flight = Flight(cube8(), world=world, take_over=True)
    assert (flight.runner.outcome, flight.runner.reason) == ("completed", "")
    _assert_home(flight)
    assert _off_pads_m(flight).max() < 0.3


def test_setpoints_to_stand_still_come_before_the_mode_is_asked_for() -> None:
    sent: list[str] = []

    class Listening(Flight):
        def receive(self, vehicle_index: int, data: bytes, now_ns: int) -> None:
            if vehicle_index == 0 and self.runner.phase is Phase.TAKEOVER:
                frames = [piece for piece in FrameSplitter().feed(data) if isinstance(piece, Frame)]
                sent.extend("setpoint" for frame in frames if frame.msgid == SETPOINT)
                sent.extend("mode" for batch in decode(frames) if _asks_for_mode(batch))
            super().receive(vehicle_index, data, now_ns)

    world = _left_in_the_air(pair(autopilots=("px4", "px4")), still_in(Phase.HOLD), idle_s=4.0, prepare=_land_modes)
    flight = Listening(pair(autopilots=("px4", "px4")), world=world, take_over=True)
    assert flight.runner.outcome == "completed"
    assert "mode" in sent
    assert sent.index("mode") >= 15  # a second of setpoints


def test_a_vehicle_that_its_failsafe_has_landed_stays_where_it_is_and_the_others_come_home() -> None:
    plan = four()

    def one_lands(world: World) -> None:
        _holds(world)
        world.autopilots[2].params.set_value("COM_OBL_RC_ACT", 4)

    world = _left_in_the_air(plan, still_in(Phase.FORM, 2.0), idle_s=9.0, prepare=one_lands)
    assert world.truth.airborne.tolist() == [True, True, False, True]
    place = world.truth.pos_enu_m[2].copy()
    flight = Flight(plan, world=world, take_over=True)
    assert (flight.runner.outcome, flight.runner.reason) == ("completed", "")
    _assert_home(flight)
    assert np.delete(_off_pads_m(flight), 2).max() < 0.3
    np.testing.assert_allclose(world.truth.pos_enu_m[2], place, atol=1e-6)


def test_one_that_nobody_hears_is_named_and_the_others_come_home() -> None:
    def mute(datagram: Outgoing, _flight: Flight) -> list[Outgoing]:
        return [] if datagram.vehicle_index == 1 else [datagram]

    world = _left_in_the_air(four(), still_in(Phase.HOLD, 1.0), prepare=_holds)
    flight = Flight(four(), world=world, take_over=True, tamper=mute)
    assert flight.runner.outcome == "aborted"
    assert "vehicle 2: not heard, where it is is not known" in flight.runner.reason
    assert "fault in the ground station" not in flight.runner.reason
    truth = flight.world.truth
    assert truth.armed.tolist() == [False, True, False, False]
    assert np.delete(_off_pads_m(flight), 1).max() < 0.3


def test_one_that_is_heard_late_is_waited_for_and_brought_home_with_the_others() -> None:
    def late(datagram: Outgoing, flight: Flight) -> list[Outgoing]:
        return [] if datagram.vehicle_index == 1 and flight.now_ns < 7 * SECOND_NS else [datagram]

    world = _left_in_the_air(four(), still_in(Phase.HOLD, 1.0), prepare=_holds)
    flight = Flight(four(), world=world, take_over=True, tamper=late)
    assert (flight.runner.outcome, flight.runner.reason) == ("completed", "")
    _assert_home(flight)
    assert _off_pads_m(flight).max() < 0.3


def test_one_that_comes_down_by_its_failsafe_while_it_is_taken_over_is_told() -> None:
    def one_lands(world: World) -> None:
        _holds(world)
        world.autopilots[0].ignore_commands = True

    world = _left_in_the_air(four(), still_in(Phase.FORM, 2.0), idle_s=1.5, prepare=one_lands)
    assert world.truth.airborne.all()
    commander = world.autopilots[0].commander  # type: ignore[attr-defined]
    commander.intention, commander.failsafe = LAND, None
    flight = Flight(four(), world=world, take_over=True)
    assert flight.runner.outcome == "aborted"
    assert "vehicle 1: has come down by its own failsafe before it could be brought home" in flight.runner.reason
    assert np.delete(_off_pads_m(flight), 0).max() < 0.3
    _assert_home(flight)


def test_one_that_comes_down_onto_another_while_they_are_taken_over_is_told_and_that_nobody_leaves() -> None:
    def one_runs_down(world: World) -> None:
        _holds(world)
        world.inject(Fault("battery_level", 0.0, vehicles=(2,), numbers={"percent": 5.0}))

    plan = cube8(MOVED)  # the second above the first
    world = _left_in_the_air(plan, still_in(Phase.HOLD, 1.0), idle_s=0.5, prepare=one_runs_down)
    flight = Flight(plan, world=world, take_over=True)
    told = [note for note in flight.notes if "comes down by itself" in note.text]
    assert [note.kind for note in told] == ["alarm"]
    assert told[0].text.startswith("vehicle 2: comes down by itself, vehicle 1 is ")
    assert told[0].text.endswith(" beside, and cannot be told to leave; keep people away")


def test_where_nobody_tells_its_home_the_missions_own_word_is_taken_and_people_are_told() -> None:
    plan = four()
    world = _left_in_the_air(plan, still_in(Phase.HOLD, 1.0), prepare=_holds)
    world.state.broken.muted["HOME_POSITION"] = np.ones(4, dtype=np.bool_)
    flight = Flight(plan, world=world, take_over=True)
    assert (flight.runner.outcome, flight.runner.reason) == ("completed", "")
    trust = [text for text in flight.texts("info") if text.endswith("is taken on trust")]
    assert [text.split(":")[0] for text in trust] == [f"vehicle {k}" for k in (1, 2, 3, 4)]
    _assert_home(flight)


def test_who_is_killed_while_it_is_taken_over_is_asked_for_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("groundstation.mission.phases.come_down._DOWN_MAX_NS", 20 * SECOND_NS)
    asked: list[int] = []
    said: list[int] = []

    class Watched(Flight):
        def receive(self, vehicle_index: int, data: bytes, now_ns: int) -> None:
            if vehicle_index == 1 and said:
                frames = [piece for piece in FrameSplitter().feed(data) if isinstance(piece, Frame)]
                asked.extend(
                    int(code)
                    for batch in decode(frames)
                    if batch.name == "COMMAND_LONG"
                    for code in batch.values["command"]
                )
            super().receive(vehicle_index, data, now_ns)

    def kill(flight: Flight) -> bool:
        if flight.now_ns > 2 * SECOND_NS and not said:
            said.append(flight.now_ns)
            flight.session.operator("kill 2", flight.now_ns)
        return False

    plan = pair(autopilots=("px4", "px4"))
    world = _left_in_the_air(plan, still_in(Phase.HOLD, 1.0), prepare=_holds)
    world.autopilots[1].ignore_commands = True
    flight = Watched(plan, world=world, take_over=True, interrupt_when=kill)
    assert set(asked) == {COMPONENT_ARM_DISARM}
    assert "vehicle 2: told to stop its motors, and still armed by its own report after 20 s" in flight.runner.reason
    assert "it has not taken" not in flight.runner.reason
    assert world.truth.armed.tolist() == [False, True]


def test_a_fault_of_our_own_while_taking_over_leaves_everybody_to_its_failsafe(monkeypatch: pytest.MonkeyPatch) -> None:
    def faulty(*_given: object) -> None:
        raise FloatingPointError("made up")

    plan = pair(autopilots=("px4", "px4"))
    world = _left_in_the_air(plan, still_in(Phase.HOLD, 1.0), prepare=_land_modes)
    monkeypatch.setattr("groundstation.mission.ground.take_over.TakeOver.step", faulty)
    flight = Flight(plan, world=world, take_over=True, limit_s=400.0)
    assert flight.phase_seen == [Phase.SILENT, Phase.DONE]
    assert "FloatingPointError: made up; everybody is left to its own failsafe" in flight.runner.reason


def test_a_vehicle_that_a_pilot_flies_is_not_touched() -> None:
    plan = four()
    world = _left_in_the_air(plan, still_in(Phase.HOLD, 1.0), prepare=_holds)
    commander = world.autopilots[3].commander  # type: ignore[attr-defined]
    commander.intention, commander.failsafe = POSCTL, None
    before = flight_modes(world)
    flight = Flight(plan, world=world, take_over=True)
    assert flight.runner.outcome == "aborted"
    assert "vehicle 4: is flown by a pilot, in mode POSCTL; it is not fought over" in flight.runner.reason
    assert flight_modes(world)[3] == before[3] == "POSCTL"
    assert world.truth.armed.tolist() == [False, False, False, True]


def test_nobody_is_taken_from_another_ground_station() -> None:
    """The first one is alive: its vehicles follow it, and a second one waits and then leaves them alone."""
    plan = four()
    refused: list[str] = []
    others: list[Runner] = []

    class Haunted(Flight):
        """A flight whose vehicles talk to a second ground station, too."""

        def advance(self, now_ns: int) -> list[Outgoing]:
            sent = super().advance(now_ns)
            if self.runner.phase in (Phase.FORM, Phase.HOLD) and not refused:
                others.extend([Runner(plan, now_ns, Purpose.TAKE_OVER)] * (not others))
                other = others[0]
                for item in sent:
                    other.receive(0, f"emulator:{item.vehicle_index + 1}", item.data, now_ns)
                other.step(now_ns)
                assert other.setpoints_sent == 0
                refused.extend([other.reason] * other.done)
            return sent

    changed = four("steps.1.hold.seconds=25")
    flight = Haunted(changed)
    assert flight.runner.outcome == "completed"
    assert refused
    assert "follows setpoints that are not ours, in mode OFFBOARD; end the other ground station first" in refused[0]


def test_nothing_is_taken_over_where_everybody_stands_on_the_ground() -> None:
    flight = Flight(four(), take_over=True)
    assert flight.runner.outcome == "refused"
    assert flight.runner.reason == "nobody is in the air; there is nothing to take over"
    assert flight.runner.setpoints_sent == 0


def test_one_that_did_not_take_off_from_its_pad_is_left_to_its_failsafe() -> None:
    moved = four("vehicles.0.pad_m=[-1.0, -1.0, 0.0]")
    world = _left_in_the_air(four(), still_in(Phase.HOLD, 1.0), prepare=_holds)
    for pilot in world.autopilots[:1]:
        world.state.known.home_enu_m[:, pilot.body.index] += np.array([0.0, 0.8, 0.0])
    flight = Flight(moved, world=world, take_over=True)
    assert flight.runner.outcome == "aborted"
    assert "vehicle 1: took off 0.80 m from its pad, limit 0.3 m; is pad_m or its id right?" in flight.runner.reason
    assert world.truth.armed.tolist() == [True, False, False, False]


@pytest.mark.parametrize("name", ["px4_cube8", "mixed8"])
def test_teams_that_fly_by_gps_find_their_frame_again_in_the_air(name: str, tmp_path: Path) -> None:
    plan = mission(name)
    world = _left_in_the_air(plan, still_in(Phase.TAKEOFF, 5.0), idle_s=4.0, prepare=_holds)
    log = tmp_path / "flight.tlog"
    flight = Flight(plan, world=world, take_over=True, log=log)
    assert (flight.runner.outcome, flight.runner.reason) == ("completed", "")
    _assert_home(flight)
    assert _off_pads_m(flight).max() < 2.0
    assert verify_log(log).mismatches == 0


@pytest.mark.parametrize("autopilot", ["px4", "arducopter"])
def test_whoever_is_taken_over_gets_setpoints_before_anybody_flies_home(autopilot: str) -> None:
    """ArduCopters too, which take off by command and get none while they climb."""
    plan = pair("limits.hold_s=60", autopilots=(autopilot, autopilot))
    world = _left_in_the_air(plan, still_in(Phase.FORM, 0.5), prepare=_holds, idle_s=1.0)
    counts: list[int] = []

    def look(flight: Flight) -> bool:
        if flight.runner.phase is Phase.TAKEOVER:
            counts.append(flight.runner.setpoints_sent)
        return False

    flight = Flight(plan, world=world, take_over=True, interrupt_when=look)
    assert flight.runner.outcome == "completed"
    assert counts[-1] > 2 * 50
