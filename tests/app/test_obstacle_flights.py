"""Flights among obstacles, judged by the emulator's truth: nobody ever nearer than r to a surface."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from groundstation.app.verify import verify_log
from groundstation.core.errors import UserError
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.runner import Phase
from tests.app.flights import SECOND_NS, Flight, cube8, four

ROOM = "fence={min_m: [-3, -3, 0], max_m: [7, 7, 4]}"


class Among:
    """A flight with what was true of its distances from obstacles."""

    def __init__(self, plan: MissionPlan, *lines: str, log: Path | None = None, seed: int = 1) -> None:
        self.nearest_m, self.lines = np.inf, list(lines)
        self.flight = Flight(plan, log=log, interrupt_when=self._look, seed=seed, limit_s=300.0)

    def _look(self, flight: Flight) -> bool:
        truth = flight.world.truth
        if truth.airborne.any():
            distances, _ = flight.plan.obstacles.distances(truth.pos_enu_m[truth.airborne])
            self.nearest_m = min(self.nearest_m, float(distances.min()))
        if flight.runner.phase is Phase.HOLD and self.lines:
            flight.session.operator(self.lines.pop(0), flight.now_ns)
        return False

    def safe(self) -> None:
        flight = self.flight
        radius_m = flight.plan.spec.avoidance.radius_m
        assert self.nearest_m >= radius_m
        assert flight.world.min_distance_airborne_m >= radius_m
        assert not flight.world.truth.armed.any()


@pytest.mark.parametrize(
    ("obstacle", "replayed"),  # to read a log again costs as much as to fly it
    [
        ("{name: wall, at_m: [2.5, 2.5, 0], size_m: [1.0, 1.0, 4.5]}", True),
        ("{name: pole, at_m: [2.5, 2.5, 0], radius_m: 0.5, height_m: 4.5}", False),
        ("{name: balloon, at_m: [2.5, 2.5, 1.2], radius_m: 0.7}", False),
    ],
)
def test_the_way_home_goes_round_what_stands_in_it(obstacle: str, *, replayed: bool, tmp_path: Path) -> None:
    steps = "steps=[form: {}, move: {by_m: [0, 4, 0]}, move: {by_m: [4, 0, 0]}, hold: {seconds: 1}]"
    plan = four(ROOM, steps, f"obstacles=[{obstacle}]", "speed_limit_m_s=1.0")
    log = tmp_path / "home.tlog" if replayed else None
    flown = Among(plan, log=log)
    assert flown.flight.runner.outcome == "completed", flown.flight.runner.reason
    flown.safe()
    assert flown.nearest_m < 1.5  # it was in the way
    assert log is None or verify_log(log).mismatches == 0


def test_a_wall_that_cannot_be_slid_along_is_flown_round() -> None:
    there = "{move: {by_m: [0, 3.4, 0]}}, {move: {by_m: [4, 0, 0]}}, {move: {by_m: [0, -3.4, 0]}}"
    wall = "obstacles=[{name: wall, at_m: [2.5, 0.5, 0], size_m: [0.4, 3.0, 4.5]}]"
    flown = Among(four(ROOM, f"steps=[{{form: {{}}}}, {there}]", wall, "speed_limit_m_s=1.0"))
    assert flown.flight.runner.outcome == "completed", flown.flight.runner.reason
    flown.safe()
    assert any(note.text.endswith("is locked in: it goes round what is in its way") for note in flown.flight.notes)


def _random(seed: int) -> MissionPlan:
    """cube8, from pads and to points at random, among obstacles at random that leave it its room."""
    rng = np.random.default_rng(seed)
    given: list[str] = []
    plan = cube8(ROOM)
    while len(given) < 4:
        x, y, z = (float(value) for value in rng.uniform([-2.5, -2.5, 0.5], [2.5, 2.5, 2.5]))
        a, b, c = (float(value) for value in rng.uniform(0.1, 0.5, 3))
        one = (
            f"{{name: o{len(given)}, at_m: [{x:.2f}, {y:.2f}, {z:.2f}], radius_m: {a:.2f}}}",
            f"{{name: o{len(given)}, at_m: [{x:.2f}, {y:.2f}, 0], radius_m: {a:.2f}, height_m: {2 + b:.2f}}}",
            f"{{name: o{len(given)}, at_m: [{x:.2f}, {y:.2f}, 0], size_m: [{a:.2f}, {b:.2f}, {2 + c:.2f}]}}",
        )[int(rng.integers(3))]
        try:
            plan = cube8(ROOM, f"obstacles=[{', '.join([*given, one])}]", "assignment=fixed")
        except UserError:
            continue
        given.append(one)
    return plan


@pytest.mark.parametrize("seed", [0, 1, 2, 5])  # in 5 a ball hangs high above a pad
def test_among_obstacles_at_random_nobody_comes_nearer_than_r(seed: int) -> None:
    flown = Among(_random(seed), seed=seed)
    assert flown.flight.runner.outcome == "completed", flown.flight.runner.reason
    flown.safe()


@pytest.mark.parametrize(("line", "who"), [("land all", [0, 1, 2, 3]), ("land 2", [1])])
def test_whoever_lands_where_it_is_does_not_land_on_an_obstacle(line: str, who: list[int]) -> None:
    steps = "steps=[form: {}, move: {by_m: [2.5, 0, 1.5]}, hold: {seconds: 3}]"
    obstacle = "obstacles=[{name: crate, at_m: [3.0, 0.5, 0], size_m: [1.2, 1.2, 0.5]}]"
    flown = Among(four(ROOM, steps, obstacle), line)
    assert flown.flight.runner.phase is Phase.DONE
    flown.safe()
    pos_m = flown.flight.world.truth.pos_enu_m
    assert flown.flight.plan.obstacles.beside_m(pos_m[who]).min() >= flown.flight.plan.spec.avoidance.radius_m
    assert (pos_m[:, 2] < 0.1).all()
    pads_m = flown.flight.plan.pads_enu_m
    assert (np.linalg.norm(pos_m[who] - pads_m[who], axis=1) > 1.0).all()


def test_a_formation_that_is_led_stays_clear_of_an_obstacle(tmp_path: Path) -> None:
    obstacle = "obstacles=[{name: pole, at_m: [3.0, 0.5, 0], radius_m: 0.3, height_m: 4}]"
    plan = four(ROOM, "steps=[form: {}, lead: {seconds: 30}]", obstacle)
    said: list[int] = []

    def say(flight: Flight) -> bool:
        if flight.runner.phase is Phase.LEAD and not said:
            said.append(flight.now_ns)
            flight.session.operator("move 5 0 0", flight.now_ns)
            flight.session.operator("move 1 0 0", flight.now_ns)
        return False

    flight = Flight(plan, interrupt_when=say, log=tmp_path / "led.tlog")
    assert flight.runner.outcome == "completed"
    (why,) = [note.text for note in flight.notes if "refused" in note.text]
    assert "move 5 0 0 refused: it would take vehicle" in why
    assert "from obstacle pole, minimum is" in why
    assert any(note.text == "move 1 0 0: done" for note in flight.notes)
    assert said[0] < flight.now_ns - 5 * SECOND_NS
