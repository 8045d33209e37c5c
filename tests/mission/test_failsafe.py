"""How a team comes down by itself, and what its batteries have to hold: worked out before takeoff."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.app.resources import packaged_configs
from groundstation.mission.ground.battery_need import battery_needs, flight_time_s
from groundstation.mission.ground.failsafe import make_failsafe, out_of_turn
from groundstation.mission.ground.on_the_pads import pad_words, too_near, wrong_pad
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.reading import load_mission


def _mission(name: str, *changes: str) -> MissionPlan:
    return load_mission(packaged_configs() / "missions" / f"{name}.yaml", changes)


@pytest.mark.parametrize("name", ["cube8", "px4_cube8", "arducopter_two_squares8", "mixed8"])
def test_who_is_higher_goes_first_and_every_height_is_its_own(name: str) -> None:
    plan = _mission(name)
    failsafe = make_failsafe(plan)
    clearance_m = plan.spec.avoidance.radius_m + plan.margin_m
    heights = np.array([wish.height_m for wish in failsafe.wishes]) + plan.pads_enu_m[:, 2]
    turns = np.array([wish.after_s for wish in failsafe.wishes])
    waits = np.array([wish.wait_s for wish in failsafe.wishes])
    assert (failsafe.action, failsafe.problem, failsafe.stacked) == ("return", None, True)
    order = np.argsort(turns)
    assert (np.diff(heights[order]) <= -clearance_m + 1e-9).all()
    assert (np.diff(plan.formation.points_enu_m[failsafe.roles[order], 2]) <= 1e-9).all()
    assert heights.min() >= plan.formation.points_enu_m[:, 2].max() + clearance_m
    assert heights.max() <= (plan.spec.failsafe.ceiling_m or 0.0)
    assert turns.min() == plan.spec.failsafe.hold_s
    # In the time between two turns the one before has climbed a level.
    assert (np.diff(turns[order]) >= clearance_m / plan.profile.climb_m_s).all()
    # Nobody comes down before the last one has had time to climb and to fly home.
    assert (turns + waits >= turns.max()).all()
    assert waits.max() <= 60.0
    assert turns.max() <= 110.0


def test_roles_that_were_exchanged_are_out_of_turn_only_between_heights() -> None:
    plan = _mission("cube8")
    failsafe = make_failsafe(plan)
    heights = plan.formation.points_enu_m[failsafe.roles, 2]
    assert out_of_turn(failsafe, heights) == []
    upper, lower = np.flatnonzero(heights == 1.0), np.flatnonzero(heights == 0.0)
    assert out_of_turn(failsafe, heights[_exchanged(8, int(upper[0]), int(upper[1]))]) == []
    pairs = out_of_turn(failsafe, heights[_exchanged(8, int(upper[0]), int(lower[0]))])
    assert (int(upper[0]), int(lower[0])) in pairs
    assert all(i == upper[0] or j == lower[0] for i, j in pairs)
    assert out_of_turn(make_failsafe(_mission("cube8", "failsafe.ceiling_m=3")), heights[::-1]) == []


def _exchanged(n: int, i: int, j: int) -> list[int]:
    order = list(range(n))
    order[i], order[j] = j, i
    return order


def test_roles_are_known_from_the_pads() -> None:
    assert make_failsafe(_mission("cube8")).roles.tolist() == make_failsafe(_mission("cube8")).roles.tolist()
    assert make_failsafe(_mission("cube8", "assignment=fixed")).roles.tolist() == list(range(8))


def test_pads_of_different_heights_count_from_each_home() -> None:
    plan = _mission("px4_cube8", "vehicles.0.pad_m=[-5,-5,1]")
    above_home = np.array([wish.height_m for wish in make_failsafe(plan).wishes])
    levels = np.sort(above_home + plan.pads_enu_m[:, 2])
    assert np.diff(levels) == pytest.approx(np.full(7, 4.1))


@pytest.mark.parametrize(
    ("name", "changes", "action", "problem"),
    [
        ("cube8", ("failsafe.ceiling_m=3",), "hold", None),
        ("cube8", ("failsafe.action=return", "failsafe.ceiling_m=3"), "return", "raise failsafe.ceiling_m"),
        ("cube8", ("failsafe.action=land",), "land", "would land on the lower ones"),
        ("cube8", ("failsafe.action=own",), "own", None),
        ("first_flight2", (), "land", None),
        ("first_flight2", ("failsafe.ceiling_m=30",), "return", None),
        ("cube8", ("failsafe.hold_s=60", "failsafe.ceiling_m=6"), "return", None),
        ("cube8", ("vehicles.1.pad_m=[-0.9, -1, 0.6]",), "hold", None),
        (
            "cube8",
            ("vehicles.1.pad_m=[-0.9, -1, 0.6]", "failsafe.action=return"),
            "return",
            "the pad of vehicle 2 lies above that of vehicle 1, 0.10 m beside it, minimum is r = 0.45 m",
        ),
    ],
)
def test_what_is_chosen(name: str, changes: tuple[str, ...], action: str, problem: str | None) -> None:
    failsafe = make_failsafe(_mission(name, *changes))
    assert failsafe.action == action
    assert failsafe.problem is None if problem is None else problem in (failsafe.problem or "")


def test_batteries_have_to_hold_the_flight_and_the_way_home_alone() -> None:
    plan = _mission("cube8")
    failsafe = make_failsafe(plan)
    (need, *_) = battery_needs(plan, failsafe)
    assert need.flight_s == flight_time_s(plan, failsafe)
    assert need.reserve == pytest.approx(failsafe.down_s / 360.0)  # more than battery_min
    assert need.share == need.flight + need.reserve
    assert need.flight == pytest.approx(4.0 / 3.0 * need.flight_s / need.endurance_s)
    assert f"{need.flight:.0%} to fly, a third on top in that (360 s of hovering" in need.words()
    longer = _mission("cube8", "steps.1.hold.seconds=105")
    assert flight_time_s(longer, make_failsafe(longer)) == pytest.approx(need.flight_s + 100.0)
    (old, *others) = battery_needs(_mission("cube8", "vehicles.0.endurance_s=180"), failsafe)
    assert old.flight == pytest.approx(2.0 * others[0].flight)


# How long the missions that come along took in the emulator, from takeoff to the last one down.
@pytest.mark.parametrize(
    ("name", "took_s"),
    [
        ("cube8", 22.5),
        ("first_flight2", 43.5),
        ("mixed8", 65.5),
        ("px4_cube8", 65.5),
        ("arducopter_two_squares8", 59.5),
    ],
)
def test_flights_are_not_reckoned_too_short(name: str, took_s: float) -> None:
    plan = _mission(name)
    assert took_s <= flight_time_s(plan, make_failsafe(plan)) <= 2.0 * took_s


PADS = np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0], [0.0, 5.0, 0.0], [5.0, 5.0, 0.0]])


@settings(max_examples=50)
@given(st.permutations(range(4)), st.integers(0, 2**32 - 1))
def test_everybody_who_is_on_a_wrong_pad_is_told_whose_it_is(order: list[int], seed: int) -> None:
    pos = PADS[order] + np.random.default_rng(seed).uniform(-0.5, 0.5, PADS.shape)
    for vehicle, stands_on in enumerate(order):
        assert wrong_pad(vehicle, pos, PADS, 1.0) == (None if stands_on == vehicle else stands_on)
        words = pad_words(vehicle, [11, 12, 13, 14], pos, PADS, 1.0)
        if stands_on == vehicle:
            assert words is None
        else:
            assert words is not None
            assert words.startswith(f": it stands on the pad of vehicle {11 + stands_on}")
            assert ("on its pad; exchange them" in words) == (order[stands_on] == vehicle)


def test_positions_that_are_not_known_are_on_no_pad_and_near_nobody() -> None:
    pos = PADS.copy()
    pos[1] = np.nan
    assert wrong_pad(1, pos, PADS, 1.0) is None
    assert too_near(1, pos, 10.0) is None
    assert too_near(0, pos, 6.0) == (2, 5.0)
    assert too_near(0, pos, 5.0) is None
