"""Two numbers that are one are told as one."""

from __future__ import annotations

from groundstation.mission.ground.failsafe import _span


def test_a_span_of_one_height_is_one_number() -> None:
    assert (_span(6.2, 6.24), _span(6.2, 7.0)) == ("6.2", "6.2 to 7.0")
