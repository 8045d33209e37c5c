"""Teams over links that lose and delay, autopilots that do not answer or start anew: flown, or refused in words."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from groundstation.app.emulator import read_faults
from groundstation.app.progress import FlightDisplay
from groundstation.app.resources import packaged_configs
from groundstation.app.session import Session
from groundstation.app.verify import verify_log
from groundstation.links.opening import open_link
from groundstation.mavlink.codec import Encoder, FrameSplitter, decode, message_id
from groundstation.mavlink.codec import Frame as WireFrame
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.schema import FormStep
from groundstation.mission.runner import Phase, Runner
from groundstation.records.replay import load_flight
from sitl.autopilot import Autopilot
from sitl.estimator import GPS
from sitl.faults import Fault
from sitl.world import Outgoing
from tests.app.flights import FULL_RATE, SECOND_NS, Flight, mission, pair

FAULTS = packaged_configs() / "faults"
PLACE = message_id("GLOBAL_POSITION_INT")
BOTH = (("px4", "px4"), ("px4", "arducopter"), ("arducopter", "arducopter"))


def _faulty(plan: MissionPlan, name: str, *, seed: int = 1, log: Path | None = None) -> Flight:
    """Flies with one of the timetables that come along."""
    timetable = read_faults(FAULTS / f"{name}.yaml", plan)
    return Flight(plan, seed=seed, log=log, change=lambda world: replace(world, faults=timetable), limit_s=300)


def _assert_completed(flight: Flight, tolerances: float) -> None:
    """Completed, r kept, and the true error within so many tolerances and three deviations of two positions."""
    spec = flight.plan.spec
    assert (flight.runner.outcome, flight.runner.reason) == ("completed", "")
    assert flight.world.min_distance_airborne_m >= spec.avoidance.radius_m
    step = spec.steps[0]
    assert isinstance(step, FormStep)
    assert flight.meter.formation_error_m <= tolerances * step.tolerance_m + 3.0 * np.sqrt(2.0) * GPS.pos_sigma_m
    assert not flight.world.truth.armed.any()


def _assert_nothing_armed(flight: Flight, log: Path | None = None) -> None:
    assert flight.runner.outcome == "refused"
    assert not flight.world.truth.armed.any()
    assert flight.runner.setpoints_sent == 0
    if log is not None:
        result = verify_log(log)
        assert (result.mismatches, result.setpoints, result.complete) == (0, 0, True)
        assert result.frames > 100


def test_eight_vehicles_lose_a_fifth_of_all_datagrams_and_fly(tmp_path: Path) -> None:
    """This seed ended in a false alarm when a global position was brought over three seconds to be compared."""
    log = tmp_path / "flight.tlog"
    flight = _faulty(mission("mixed8", "steps.1.hold.seconds=5"), "lossy", log=log)
    _assert_completed(flight, 1.0)
    result = verify_log(log)
    assert (result.mismatches, result.setpoints > 10_000) == (0, True)


def test_eight_vehicles_behind_a_slow_link_are_refused_with_the_delay_to_reckon_with(tmp_path: Path) -> None:
    log = tmp_path / "flight.tlog"
    flight = _faulty(mission("mixed8", FULL_RATE, "limits.preflight_s=20"), "slow_link", log=log)
    _assert_nothing_armed(flight, log)
    for vehicle in range(1, 9):
        assert f"vehicle {vehicle}: its answers take 0.6" in flight.runner.reason
    assert "set link_delay_s: 0.4" in flight.runner.reason


@pytest.mark.parametrize("autopilots", BOTH)
def test_an_autopilot_that_answers_no_command_is_refused_with_these_words(
    autopilots: tuple[str, str], tmp_path: Path
) -> None:
    log = tmp_path / "flight.tlog"
    flight = _faulty(pair("limits.preflight_s=20", autopilots=autopilots), "deaf", log=log)
    _assert_nothing_armed(flight, log)
    assert flight.runner.reason.startswith("vehicle 2: is heard, and answers no command (")
    assert "see that its link carries both ways, that it takes commands from system 255" in flight.runner.reason


@pytest.mark.parametrize("autopilots", BOTH)
def test_one_that_hears_again_after_a_while_is_asked_again_and_flies(autopilots: tuple[str, str]) -> None:
    deaf = Fault("commands_ignored", at_s=0.0, for_s=15.0, vehicles=(2,))
    plan = pair("steps.1.hold.seconds=1", autopilots=autopilots)
    flight = Flight(plan, change=lambda world: replace(world, faults=(deaf,)))
    _assert_completed(flight, 1.0)


def test_one_that_acknowledges_rates_and_sends_nothing_is_told_so() -> None:
    def yes_man(autopilot: Autopilot) -> None:
        for command in (511, 512):
            autopilot.commands[command] = lambda _params, _frame: 0

    def look(flight: Flight) -> bool:
        yes_man(flight.world.autopilots[1])
        return False

    plan = pair("limits.preflight_s=30", autopilots=("px4", "arducopter"))
    # It obeys from the first tick on: what it is asked for later it only acknowledges.
    flight = Flight(plan, prepare=lambda world: yes_man(world.autopilots[1]), interrupt_when=look)
    _assert_nothing_armed(flight)
    assert (
        "position and attitude: none yet, limit 0.5 s; it acknowledged the rates and sends none;"
        in flight.runner.reason
    )


# Two positions


def _displaced(count: int) -> Flight:
    """A flight in which that many global positions in a row, one a second, are told 11 m off."""
    left = [count]

    def displace(datagram: Outgoing, flight: Flight) -> list[Outgoing]:
        if datagram.vehicle_index != 1 or Phase.HOLD not in flight.phase_seen or not left[0]:
            return [datagram]
        frames = [piece for piece in FrameSplitter().feed(datagram.data) if isinstance(piece, WireFrame)]
        if not any(frame.msgid == PLACE for frame in frames):
            return [datagram]
        left[0] -= 1
        return [_elsewhere(datagram, frames)]

    return Flight(pair("steps.1.hold.seconds=8", autopilots=("arducopter", "arducopter")), tamper=displace)


def _elsewhere(datagram: Outgoing, frames: list[WireFrame]) -> Outgoing:
    data = b""
    for frame in frames:
        if frame.msgid != PLACE:
            data += frame.raw
            continue
        (batch,) = decode([frame])
        names = batch.values.dtype.names or ()
        fields = {name: int(batch.values[name][0]) for name in names}
        fields["lat"] += 1000
        data += Encoder(2).encode("GLOBAL_POSITION_INT", **fields)
    return datagram._replace(data=data)


def test_one_global_position_that_is_off_disturbs_nobody_and_two_in_a_row_bring_everybody_down() -> None:
    _assert_completed(_displaced(1), 1.0)
    flight = _displaced(2)
    assert flight.runner.outcome == "aborted"
    assert flight.runner.reason.startswith("vehicle 2: its local and global positions are 1")
    assert not flight.world.truth.armed.any()


# Starting anew


@pytest.mark.parametrize("vehicle", [2, 6])
def test_one_that_starts_anew_is_given_one_reason_and_its_positions_count_no_longer(
    vehicle: int, tmp_path: Path
) -> None:
    """Those of PX4 were counted from the team's origin, which was given to it and is forgotten."""
    log = tmp_path / "flight.tlog"
    begun: list[int] = []

    def look(flight: Flight) -> bool:
        if flight.runner.phase is Phase.ARM and not begun and flight.world.truth.armed.any():
            begun.append(flight.now_ns)
            flight.world.reboot(vehicle - 1)
        return False

    flight = Flight(mission("mixed8"), interrupt_when=look, log=log)
    assert flight.runner.outcome == "aborted"
    assert flight.runner.reason.startswith(f"vehicle {vehicle}: ")
    assert flight.runner.reason.count("vehicle ") == 1
    assert not flight.world.truth.armed.any()
    smallest_m = load_flight(log).min_distance_m()
    assert smallest_m is not None
    assert smallest_m > 4.0
    assert verify_log(log).mismatches == 0


# What is shown


def test_a_port_that_is_not_there_is_shown_from_the_first_moment_and_while_waiting(tmp_path: Path) -> None:
    url = f"serial://{tmp_path}/ttyUSB0:57600"
    plan = pair(f"vehicles.0.link={url}")
    link = open_link(url)
    link.service(0)
    session, text = Session(Runner(plan, 0), None), io.StringIO()
    with FlightDisplay(Console(file=text, width=300), plan, [link]) as display:
        for tick in range(1, 140):
            session.tick(tick * SECOND_NS // 20)
            display(session, tick * SECOND_NS // 20)
    lines = text.getvalue().splitlines()
    told = [line for line in lines if f"{url}: cannot open {tmp_path}/ttyUSB0: No such file or directory" in line]
    assert [line.split()[2] for line in told] == ["link", "waiting:"]
    assert float(told[0].split()[0]) < 0.3
    assert float(told[1].split()[0]) < 5.3
    link.close()
