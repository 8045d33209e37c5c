"""GPS receivers that lose their fix in the air: named before the autopilot knows, landed while the place is known."""

from __future__ import annotations

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from groundstation.mavlink.station import Station
from groundstation.mavlink.vehicle import NEVER, UNKNOWN, Fleet
from groundstation.mission.monitors.findings import Finding, Reaction, Sight
from groundstation.mission.monitors.fixes import GpsFix
from groundstation.mission.runner import Phase
from sitl.faults import Fault
from tests.app.flights import SECOND_NS, Flight, after, pair

WORDS = "vehicle 1: its GPS has had no fix for 1 s, so that its position is a guess; "


def _flown(phase: Phase, for_s: float | None = None, autopilots: tuple[str, str] = ("px4", "arducopter")) -> Flight:
    """The first one's GPS is lost a second after a phase has begun."""
    reached = after(phase, 1.0)
    struck: list[int] = []

    def strike(flight: Flight) -> bool:
        if not struck and reached(flight):
            struck.append(flight.now_ns)
            flight.world.inject(Fault("gps_lost", vehicles=(1,), for_s=for_s))
        return False

    flight = Flight(pair(autopilots=autopilots), seed=5, interrupt_when=strike)
    assert struck
    return flight


@pytest.mark.parametrize("autopilots", [("px4", "arducopter"), ("arducopter", "px4")])
def test_it_is_landed_before_its_autopilot_says_a_word_and_the_other_comes_back(autopilots: tuple[str, str]) -> None:
    flight = _flown(Phase.FORM, autopilots=autopilots)
    assert flight.runner.reason == WORDS + "it lands where it is when nobody is below, the others come back"
    assert flight.texts("alarm")[0].startswith(WORDS)
    assert not [text for text in flight.texts("info") if "says:" in text and "failsafe" in text.lower()]
    assert not flight.world.truth.armed.any()
    assert flight.world.min_distance_airborne_m > flight.plan.spec.avoidance.radius_m


def test_a_receiver_that_misses_a_moment_costs_nothing() -> None:
    flight = _flown(Phase.HOLD, for_s=0.7)
    assert (flight.runner.outcome, flight.runner.reason) == ("completed", "")


def test_one_that_lands_already_is_told_of() -> None:
    flight = _flown(Phase.LAND)
    assert flight.runner.outcome == "aborted"
    assert flight.runner.reason.startswith(WORDS + "it lands by it, keep people away")
    assert len(flight.texts("alarm")) == 2  # what is told, and that the mission is not completed


class Told:
    """One vehicle in the air, as the monitor sees it."""

    def __init__(self) -> None:
        self.plan = pair()
        self.fleet = Fleet([1, 2], [0, 1])
        self.fleet.armed[:] = True
        self.monitor, self.now_ns = GpsFix(self.plan), 10 * SECOND_NS

    def hear(self, first: int | None, second: int | None = None) -> list[Finding]:
        """Fix types of its receivers; None: not heard."""
        self.now_ns += SECOND_NS // 4
        for receiver, fix in enumerate((first, second)):
            if fix is not None:
                self.fleet.gps_fix[receiver, 0], self.fleet.gps_fix_ns[receiver, 0] = fix, self.now_ns
        nobody, everybody = np.zeros(2, dtype=np.bool_), np.ones(2, dtype=np.bool_)
        zeros = np.zeros((2, 3))
        sight = Sight(
            self.fleet, self.now_ns, zeros, zeros, np.full(2, self.now_ns), np.full(2, np.nan), zeros,
            ours=everybody, steered=everybody, lands_here=nobody, excused=nobody, blind=nobody, airborne=everybody,
        )  # fmt: skip
        return list(self.monitor.look(sight, everybody))


@pytest.mark.parametrize(
    ("then", "found"),
    [((1, None), True), ((2, None), True), ((0, None), True), ((4, None), False), ((None, None), False)],
    ids=["no fix", "2D", "none", "DGPS", "silent"],
)
def test_only_a_receiver_that_says_so_has_no_fix(then: tuple[int | None, int | None], found: bool) -> None:
    told = Told()
    assert [told.hear(3) for _ in range(8)] == [[]] * 8
    findings = [finding for _ in range(20) for finding in told.hear(*then)]
    assert bool(findings) == found
    assert all((item.reaction, item.vehicles, item.lost) == (Reaction.LAND, (0,), True) for item in findings)


def test_one_of_two_receivers_is_enough_and_one_that_never_had_a_fix_is_not_lived_by() -> None:
    told = Told()
    assert [told.hear(3, 3) for _ in range(8)] == [[]] * 8
    assert [told.hear(1, 3) for _ in range(20)] == [[]] * 20
    assert sum(len(told.hear(1, 1)) for _ in range(20)) == 1
    never = Told()
    assert [never.hear(1, 0) for _ in range(40)] == [[]] * 40


def test_fixes_are_read_from_what_pymavlink_writes() -> None:
    fleet = Fleet([3], [0])
    station = Station(fleet, 0)
    assert (fleet.gps_fix == UNKNOWN).all()
    assert (fleet.gps_fix_ns == NEVER).all()
    writer = dialect.MAVLink(None, srcSystem=3, srcComponent=1)
    place = (0, 2, 473977420, 85455940, 489400, 70, 80, 12, 3400, 11)
    first = dialect.MAVLink_gps_raw_int_message(*place)
    second = dialect.MAVLink_gps2_raw_message(0, 5, *place[2:], dgps_numch=0, dgps_age=0)
    heartbeat = dialect.MAVLink_heartbeat_message(2, 12, 81, 0, 3, 3)
    for message in (heartbeat, first, second):
        station.receive(0, "10.0.0.3:14580", message.pack(writer), 5 * SECOND_NS)
    station.ingest()
    assert fleet.gps_fix[:, 0].tolist() == [2, 5]
    assert fleet.gps_fix_ns[:, 0].tolist() == [5 * SECOND_NS] * 2
