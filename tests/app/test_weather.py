"""Two that fly in gusts: within the mission's limit nothing happens, beyond it they come home before r is at stake."""

from __future__ import annotations

from dataclasses import replace

from sitl.config import WindConfig
from tests.app.flights import Flight, mission
from tests.app.test_who_lands_where import Truth


def _in_gusts(gust_m_s: float, hold_s: float, seed: int) -> tuple[Flight, float]:
    """A flight without a mean wind, and the smallest true distance, one of the two in the air."""
    truth = Truth()
    flight = Flight(
        mission("first_flight2", f"steps.1.hold.seconds={hold_s}"),
        seed=seed,
        prepare=truth.watch,
        change=lambda config: replace(config, wind=WindConfig(gust_sigma_m_s=gust_m_s)),
    )
    assert not flight.world.truth.airborne.any()
    return flight, float(truth.apart_m.min())


def test_gusts_within_the_limit_are_flown_through() -> None:
    """On 1719c84 3 of 3 were aborted: "does not follow its setpoints", said of healthy vehicles."""
    flight, apart_m = _in_gusts(0.5, 10.0, seed=1)
    assert (flight.runner.outcome, flight.texts("alarm")) == ("completed", [])
    assert apart_m >= flight.plan.spec.avoidance.radius_m


def test_gusts_beyond_the_limit_bring_everybody_home_in_time() -> None:
    """On 1719c84 gusts of 1.5 m/s brought these two within 1.6 m, for r = 2.5 m."""
    flight, apart_m = _in_gusts(2.0, 10.0, seed=2)
    assert flight.runner.outcome == "aborted"
    assert flight.runner.reason.startswith("wind of ")
    assert apart_m >= flight.plan.spec.avoidance.radius_m
