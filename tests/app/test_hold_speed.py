"""How still a team stood in its hold, by the truth: a team that goes round its places forms and completes as well."""

from __future__ import annotations

import math

import numpy as np
import pytest

from groundstation.app.emulator import HoldSpeed
from groundstation.mission.timing import SECOND_NS

TICK_NS = SECOND_NS // 50


def held(speeds_m_s: list[list[float]], meter: HoldSpeed | None = None) -> HoldSpeed:
    """A hold in which vehicles go in circles at these speeds, a row for each tick."""
    meter = meter or HoldSpeed()
    for tick, row in enumerate(speeds_m_s):
        turn = 0.3 * tick
        meter.take(tick * TICK_NS, np.array([[v * math.cos(turn), v * math.sin(turn), 0.0] for v in row]))
    return meter


def test_the_liveliest_vehicle_over_the_last_second_counts() -> None:
    assert held([[0.0, 0.5]] * 60).m_s == pytest.approx(0.5)
    assert held([[2.0, 2.0]] * 60 + [[0.1, 0.3]] * 51).m_s == pytest.approx(0.3)
    assert held([[0.0, 1.0], [0.0, -1.0]] * 60).m_s == pytest.approx(1.0)  # to and fro is not still


def test_the_worst_of_all_holds_counts_also_when_the_last_one_was_still() -> None:
    meter = held([[0.6]] * 60)
    meter.end()
    assert held([[0.1]] * 60, meter).m_s == pytest.approx(0.6)
    meter.end()
    meter.end()
    assert meter.m_s == pytest.approx(0.6)


def test_a_hold_of_less_than_a_second_tells_nothing() -> None:
    meter = held([[0.6]] * 50)
    assert math.isnan(meter.m_s)
    meter.end()
    assert math.isnan(held([[0.1]] * 50, meter).m_s)  # two short ones are not one long one
