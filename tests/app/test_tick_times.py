"""Percentiles of the ticks' times, against numpy's."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.app.tick_times import TIMES, Percentiles, TickTimes


@given(st.lists(st.floats(1e-6, 90.0), min_size=1, max_size=300))
def test_a_percentile_is_told_right_to_two_percent_and_never_too_short(times_s: list[float]) -> None:
    counted = Percentiles()
    for time_s in times_s:
        counted.add(time_s)
    figures = counted.figures_ms()
    assert figures is not None
    for name, share in (("p50", 0.5), ("p90", 0.9), ("p99", 0.99), ("max", 1.0)):
        exact_ms = 1e3 * float(np.quantile(times_s, share, method="inverted_cdf"))
        assert exact_ms - 1e-4 <= figures[name] <= 1.021 * exact_ms + 1e-4


def test_nothing_counted_is_no_figure_and_nothing_is_too_short_or_too_long() -> None:
    counted = Percentiles()
    assert counted.figures_ms() is None
    for time_s in (-1.0, 0.0, 1e6):
        counted.add(time_s)
    assert counted.figures_ms() == {"p50": pytest.approx(0.001, rel=0.03), "p90": 1e9, "p99": 1e9, "max": 1e9}


def test_the_three_times_of_a_tick() -> None:
    times = TickTimes()
    assert times.words() == ""
    assert set(times.figures()) == set(TIMES)
    times.tick(1_000_000_000, 1_002_000_000, 1_003_000_000, None, steers=True)
    times.tick(1_020_000_000, 1_020_000_000, 1_021_000_000, 1_019_000_000, steers=False)
    assert times.figures()["telemetry_to_setpoint_ms"] is None
    times.tick(1_040_000_000, 1_040_000_000, 1_041_000_000, 1_035_000_000, steers=True)
    figures = times.figures()
    assert [one["max"] for key in TIMES if (one := figures[key])] == [2.0, 1.0, 6.0]
    assert times.words().startswith("tick late p50 ")


def test_the_longest_tick_since_it_was_last_asked() -> None:
    times = TickTimes()
    assert np.isnan(times.take_worst_ms())
    times.tick(1_000_000_000, 1_002_000_000, 1_003_000_000, None, steers=True)
    times.tick(1_020_000_000, 1_020_000_000, 1_021_000_000, None, steers=True)
    assert times.take_worst_ms() == pytest.approx(3.0)  # due at 1.000 s, sent at 1.003 s
    assert np.isnan(times.take_worst_ms())
