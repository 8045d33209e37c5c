"""Emulated Crazyflies whose gateway dies, or whose radio is too poor or too full: safe, told, judged by the truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from groundstation.app.gateway.emulated import RadioConfig
from groundstation.app.gateway.process import budget_of, handover_of
from groundstation.app.session import Session
from groundstation.app.verify import verify_log
from groundstation.core.errors import UserError
from groundstation.gateway.budget import capacity
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.runner import Phase
from tests.app.flights import Flight, mission

RADIUS_M = 0.45
TWO_RADIOS = {number: number // 4 for number in range(8)}


def lab(*changes: str) -> MissionPlan:
    return mission("lab_cube8", "steps.1.hold.seconds=2", *changes)


def stand_whole(flight: Flight) -> bool:
    truth = flight.world.truth
    return not truth.airborne.any() and {pilot.mode_name() for pilot in flight.world.autopilots} <= {"READY", "LANDED"}


class Killed(Flight):
    """The gateway dies half a second into the hold, and another one begins after a while."""

    away_s = 0.1
    _died_ns = 0

    def _watch(self, session: Session, now_ns: int) -> None:
        super()._watch(session, now_ns)
        if not self._died_ns and self.runner.phase is Phase.HOLD:
            self._died_ns = now_ns
            self.gateway.kill()
        elif self._died_ns and not self.back and now_ns - self._died_ns >= self.away_s * 1e9:
            self.back = True
            self.gateway.begin_anew(handover_of(self.plan, session))

    back = False


class KilledForLong(Killed):
    away_s = 1.6


def test_a_gateway_that_is_killed_is_replaced_and_the_flight_goes_on(tmp_path: Path) -> None:
    flight = Killed(lab(), log=tmp_path / "a.tlog")
    assert str(flight.runner.outcome) == "completed", flight.runner.reason
    told = " | ".join(flight.texts("info"))
    assert "vehicle 8 says: its gateway has begun anew; it stays where it is" in told
    assert flight.world.min_distance_airborne_m >= RADIUS_M
    assert stand_whole(flight)
    assert verify_log(tmp_path / "a.tlog").mismatches == 0


def test_one_that_is_replaced_late_but_before_the_firmware_lets_go_brings_everybody_down_whole() -> None:
    flight = KilledForLong(mission("lab_pair2", "steps.1.hold.seconds=2"))
    assert flight.world.min_distance_airborne_m >= RADIUS_M
    assert stand_whole(flight), {pilot.mode_name() for pilot in flight.world.autopilots}
    assert flight.texts("alarm")


class Deaf(Flight):
    """The radios lose nine packets of ten for a second."""

    def _watch(self, session: Session, now_ns: int) -> None:
        super()._watch(session, now_ns)
        for radio in self.gateway.radios.values():
            radio.loss = 0.9 if 12.0 <= now_ns / 1e9 < 13.0 else 0.0


def test_a_radio_that_loses_nine_of_ten_packets_for_a_second_is_safe_and_told() -> None:
    flight = Deaf(lab(), radio=RadioConfig(TWO_RADIOS))
    told = " | ".join((*flight.texts("alarm"), *flight.texts("info")))
    assert "rates at most 20 Hz" in told
    assert "there and back" in told
    assert flight.world.min_distance_airborne_m >= RADIUS_M
    assert stand_whole(flight)
    assert str(flight.runner.outcome) in ("completed", "aborted")
    assert sum(radio.lost for radio in flight.gateway.radios.values()) > 1000


class Timed(Flight):
    """Notes when velocities reach the vehicles."""

    def __init__(self, *args: object, **kwargs: object) -> None:
        self.arrivals: list[tuple[float, int]] = []
        self.worst_trip_s = 0.0
        super().__init__(*args, **kwargs)  # type: ignore[arg-type]

    def _watch(self, session: Session, now_ns: int) -> None:
        super()._watch(session, now_ns)
        if self.runner.phase in (Phase.FORM, Phase.HOLD):
            self.worst_trip_s = max(self.worst_trip_s, float(np.nanmax(session.runner.fleet.link_trip_s)))
            for number, pilot in enumerate(self.world.autopilots):
                self.arrivals.append((now_ns / 1e9 - pilot.commander.heard_ns / 1e9, number))  # type: ignore[attr-defined]


def test_setpoints_of_all_vehicles_of_a_radio_arrive_within_a_tick_beside_poses_for_several_at_once() -> None:
    plan = lab("gateway={broadcast: true}")
    flight = Timed(plan, radio=RadioConfig(TWO_RADIOS, broadcast=True))
    assert str(flight.runner.outcome) == "completed", flight.runner.reason
    # At each tick what is flown is the setpoint of the tick before: two periods at most, and one of the world's steps.
    late = [age_s for age_s, _ in flight.arrivals if age_s > 2.0 / plan.spec.rate_hz + 0.02]
    assert len(late) < 0.002 * len(flight.arrivals)
    assert flight.worst_trip_s < 0.1
    assert flight.world.min_distance_airborne_m >= RADIUS_M


def test_a_budget_that_is_refused_would_have_failed_and_one_that_fits_does_not() -> None:
    """Eight on one radio, with what the budget takes a radio for: 250 kbit/s are refused, 2 Mbit/s are not."""
    one = dict.fromkeys(range(8), 0)
    slow = [f"vehicles.{k}.link=radio://0/80/250K/E7E7E7E70{k + 1}" for k in range(8)]
    with pytest.raises(UserError, match=r"radio 0: 8 vehicles, 416 packets/s of 177 usable"):
        budget_of(lab(*slow))
    flight = Flight(lab(*slow, "limits.preflight_s=8"), radio=RadioConfig(one, capacity("250K")))
    assert str(flight.runner.outcome) == "refused"
    assert "s old, limit 0.5 s" in flight.runner.reason  # poses lie in queues

    quick = [f"vehicles.{k}.link=radio://0/80/2M/E7E7E7E70{k + 1}" for k in range(8)]
    assert len(budget_of(lab(*quick))) == 1
    flight = Flight(lab(*quick), radio=RadioConfig(one, capacity("2M")))
    assert str(flight.runner.outcome) == "completed", flight.runner.reason
    assert flight.world.min_distance_airborne_m >= RADIUS_M
    assert flight.gateway.radios[0].dropped == 0
