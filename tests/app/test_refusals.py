"""What a vehicle that cannot fly is told of: its own words, what arrives of it, and nobody else's fault."""

from __future__ import annotations

from dataclasses import replace

import pytest

from groundstation.mavlink.codec import Frame as WireFrame
from groundstation.mavlink.codec import FrameSplitter, message_id
from groundstation.mission.runner import Phase
from sitl.faults import Fault
from sitl.world import Outgoing
from tests.app.flights import SECOND_NS, Flight, Tamper, mission, pair
from tests.app.test_fleets import _forged_origin as forged_origin


def _refused(flight: Flight) -> str:
    """The reason of a flight that has ended with nothing armed."""
    assert flight.runner.outcome == "refused"
    assert not flight.world.truth.armed.any()
    assert Phase.ARM not in flight.phase_seen
    return flight.runner.reason


def _never_armed(vehicle: int) -> Fault:
    return Fault("arming_refused", at_s=0.0, vehicles=(vehicle,))


def test_a_vehicle_whose_own_checks_fail_for_good_is_refused_in_its_own_words() -> None:
    flight = Flight(pair("limits.preflight_s=25"), change=lambda world: replace(world, faults=(_never_armed(2),)))
    assert _refused(flight) == (
        "vehicle 2: not ready to arm: it says: PreArm: Compass not healthy; its own checks have to pass"
    )
    # Asked every ten seconds, not more often.
    assert 2 <= flight.texts("info").count("vehicle 2 says: PreArm: Compass not healthy") <= 3


def test_one_that_says_nothing_when_asked_is_told_to_give_no_reason() -> None:
    asked: list[int] = []

    def silent(flight: Flight) -> bool:
        def heard(_params: object, _frame: object) -> int:
            asked.append(flight.now_ns)
            return 0

        flight.world.autopilots[0].commands[401] = heard
        return False

    plan = pair("limits.preflight_s=25")
    flight = Flight(plan, change=lambda world: replace(world, faults=(_never_armed(1),)), interrupt_when=silent)
    assert _refused(flight).startswith("vehicle 1: not ready to arm, and gives no reason (it was asked); see what ")
    assert len(asked) == 2
    assert asked[1] - asked[0] >= 10 * SECOND_NS


def test_words_of_the_start_are_forgotten_when_a_vehicle_says_something_newer() -> None:
    flight = Flight(
        pair("limits.preflight_s=70", autopilots=("arducopter", "arducopter")),
        change=lambda world: replace(world, real_boot=True, faults=(_never_armed(2),)),
    )
    assert "EKF attitude" not in _refused(flight)
    assert "vehicle 2: not ready to arm: it says: PreArm: Compass not healthy" in flight.runner.reason


HEARTBEAT = message_id("HEARTBEAT")


def _without_heartbeats(until_ns: int) -> Tamper:
    """The second vehicle's heartbeats are lost."""

    def lose(datagram: Outgoing, _flight: Flight) -> list[Outgoing]:
        if datagram.vehicle_index != 1 or datagram.t_ns >= until_ns:
            return [datagram]
        pieces = FrameSplitter().feed(datagram.data)
        kept = [piece.raw for piece in pieces if isinstance(piece, WireFrame) and piece.msgid != HEARTBEAT]
        return [datagram._replace(data=b"".join(kept))] if kept else []

    return lose


@pytest.mark.parametrize("autopilots", [("px4", "px4"), ("px4", "arducopter")])
def test_one_that_is_heard_without_heartbeats_is_told_of_its_link_and_asked_for_lower_rates(
    autopilots: tuple[str, str],
) -> None:
    plan = pair("limits.preflight_s=12", autopilots=autopilots)
    flight = Flight(plan, tamper=_without_heartbeats(1000 * SECOND_NS), chatter=True)
    reason = _refused(flight)
    url = plan.links[plan.link_of_vehicle[1]]
    assert reason.startswith(f"vehicle 2: is heard on {url}, without a heartbeat: its link is overfull or drops them (")
    assert " bytes/s arrive); lower rates were asked for" in reason
    assert "switch it on" not in reason
    # It was asked, and does as it was asked.
    assert flight.runner.fleet.seen["ATTITUDE_QUATERNION"][1] > 100
    assert flight.runner.fleet.seen["ATTITUDE"][1] < 100


def test_one_whose_heartbeats_come_after_all_flies() -> None:
    flight = Flight(pair("steps.1.hold.seconds=1"), tamper=_without_heartbeats(14 * SECOND_NS))
    assert (flight.runner.outcome, flight.runner.reason) == ("completed", "")


@pytest.fixture
def soon(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody is waited for longer than 15 s while coming down."""
    monkeypatch.setattr("groundstation.mission.phases.come_down._DOWN_MAX_NS", 15 * SECOND_NS)


@pytest.mark.usefixtures("soon")
@pytest.mark.parametrize("vehicle", [0, 1])
def test_one_that_acknowledges_land_and_stays_up_is_told_with_its_place_and_what_is_left(vehicle: int) -> None:
    def yes_man(flight: Flight) -> bool:
        if flight.runner.phase is Phase.LAND:
            for command in (21, 176):
                flight.world.autopilots[vehicle].commands[command] = lambda _params, _frame: 0
        return False

    flight = Flight(pair("steps.1.hold.seconds=1"), interrupt_when=yes_man)
    reason = flight.runner.reason
    assert flight.runner.outcome == "aborted"
    mode, land = (("OFFBOARD", "land"), ("GUIDED", "LAND mode"))[vehicle]
    assert reason.startswith(f"vehicle {vehicle + 1}: still armed after 15 s of landing, in the air, ")
    assert f" m above its pad, in mode {mode}: it acknowledged {land} and does not do it; setpoints stop now" in reason
    assert "its own failsafe lands it where it is; take it over" in reason
    assert "take it over by remote control" in reason
    assert f"kill {vehicle + 1} stops its motors" in reason


@pytest.mark.usefixtures("soon")
def test_one_that_would_hover_is_not_said_to_come_down_by_itself() -> None:
    """With ``failsafe.action: hold`` nobody comes down before the battery is low; the words have to say so."""

    def deaf(flight: Flight) -> bool:
        if flight.runner.phase is Phase.LAND:
            for command in (21, 176):
                flight.world.autopilots[1].commands[command] = lambda _params, _frame: 4
        return False

    flight = Flight(pair("steps.1.hold.seconds=1", "failsafe.action=hold"), interrupt_when=deaf)
    assert "setpoints stop now: its own failsafe lets it hover until its battery is low" in flight.runner.reason


@pytest.mark.usefixtures("soon")
def test_one_that_lands_and_never_disarms_is_told_to_stand_armed() -> None:
    def yes_man(flight: Flight) -> bool:
        if flight.runner.phase is Phase.LAND:
            pilot = flight.world.autopilots[1]
            pilot.commands[400] = lambda _params, _frame: 0
            pilot.disarm = lambda: None  # type: ignore[method-assign]
        return False

    flight = Flight(pair("steps.1.hold.seconds=1"), interrupt_when=yes_man)
    assert (
        "vehicle 2: still armed after 15 s of landing, on the ground by its own report: it acknowledged disarm and does"
        " not do it; its motors may start: keep away from it" in flight.runner.reason
    )


@pytest.mark.parametrize("vehicle", [0, 5])
def test_an_origin_in_doubt_accuses_nobody_but_the_vehicle_that_tells_it(vehicle: int) -> None:
    plan = mission("mixed8", "limits.preflight_s=10")
    reason = _refused(Flight(plan, tamper=forged_origin(vehicle, 5.0, lambda _: True)))
    assert reason.startswith(f"vehicle {vehicle + 1}: reports two different origins, ")
    assert "; vehicle" not in reason
    assert not any("stands on the pad" in word or "minimum is" in word for word in reason.split("; "))
