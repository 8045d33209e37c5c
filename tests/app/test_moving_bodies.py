"""A person or a cart that the motion capture sees: kept out of the way of, by the emulator's truth."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from groundstation.app.mocap.fake import FakeConfig
from groundstation.app.verify import verify_log
from groundstation.core import frames
from groundstation.core.errors import UserError
from groundstation.core.types import FloatArray
from groundstation.mission.runner import Phase
from tests.app.flights import Flight, mission

R_M, CART_M = 0.45, 0.3
CART = f"positioning={{source: mocap, obstacles: [{{body: cart, radius_m: {CART_M}}}]}}"
STEPS = "steps=[form: {tolerance_m: 0.05, timeout_s: 60}, hold: {seconds: 25}]"
FENCE = "fence={min_m: [-4, -4, 0], max_m: [4, 4, 2]}"
Where = Callable[[float], FloatArray | None]


def passing(time_s: float) -> FloatArray:
    """NED: comes from the south along the line of vehicle 2, from 15 s on, at 0.15 m/s."""
    north = -2.6 + 0.15 * max(0.0, time_s - 15.0)
    return np.array([north, 0.55, -0.2])


class Watched(Flight):
    """Measures how near anybody came to the cart, level, while all flew."""

    nearest_m = np.inf
    cart: Where = staticmethod(passing)

    def _watch(self, session, now_ns):  # type: ignore[no-untyped-def]
        super()._watch(session, now_ns)
        place = self.cart(now_ns / 1e9)
        if self.runner.phase in (Phase.FORM, Phase.HOLD) and place is not None:
            off = frames.ned_from_enu(self.world.truth.pos_enu_m)[:, :2] - place[:2]
            self.nearest_m = min(self.nearest_m, float(np.linalg.norm(off, axis=1).min()))


def fly(where: Where, *changes: str, log: Path | None = None) -> Watched:
    plan = mission("lab_pair2", STEPS, CART, FENCE, *changes)
    return Watched(plan, room=FakeConfig(others=(where,)), log=log)


def test_a_cart_that_comes_through_is_made_room_for_and_the_log_flies_the_same(tmp_path: Path) -> None:
    flight = fly(passing, log=tmp_path / "a.tlog")
    assert str(flight.runner.outcome) == "completed", flight.runner.reason
    assert R_M + CART_M <= flight.nearest_m < R_M + CART_M + 0.2, flight.nearest_m
    assert flight.world.min_distance_airborne_m >= R_M
    assert any("body cart is " in line and "keeps out of its way" in line for line in flight.texts("alarm"))
    checked = verify_log(tmp_path / "a.tlog")
    assert checked.mismatches == 0
    assert checked.setpoints > 100


def test_one_that_is_not_seen_any_more_is_kept_farther_from_the_longer_it_is_gone() -> None:
    def covered(time_s: float) -> FloatArray | None:
        return None if time_s > 19.0 else np.array([-1.6, 0.55, -0.2])

    class Stays(Watched):
        cart = staticmethod(lambda time_s: np.array([-1.6, 0.55, -0.2]))

    plan = mission("lab_pair2", STEPS, CART, FENCE)
    flight = Stays(plan, room=FakeConfig(others=(covered,)))
    told = [line for line in flight.texts("alarm") if "body cart is not seen" in line]
    assert len(told) == 1, flight.texts("alarm")
    assert flight.world.min_distance_airborne_m >= R_M
    east_m, north_m = flight.world.truth.pos_enu_m[1, :2]
    assert not flight.world.truth.airborne.any()
    assert np.hypot(east_m - 0.55, north_m + 1.6) > R_M + CART_M


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ("positioning={source: mocap, obstacles: [{body: cf1, radius_m: 0.3}]}", "cf1 is that of vehicle 1"),
        (
            "positioning={source: mocap, obstacles: [{body: a, radius_m: 0.3}, {body: a, radius_m: 0.3}]}",
            "body a stands there twice",
        ),
        ("positioning={source: mocap, obstacles: [{body: a, radius_m: 0}]}", "radius_m"),
    ],
)
def test_bodies_that_cannot_be_meant_are_refused(changes: str, words: str) -> None:
    with pytest.raises(UserError, match=words):
        mission("lab_pair2", changes)


def test_nobody_arms_before_the_cart_has_been_seen() -> None:
    flight = fly(lambda _time_s: None, "limits.preflight_s=6")
    assert str(flight.runner.outcome) == "refused"
    assert "no body cart in the motion capture's frames (positioning.obstacles)" in flight.runner.reason
