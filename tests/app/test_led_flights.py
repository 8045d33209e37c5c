"""A team that an operator leads: where it goes, what is refused, and that it keeps r, fence and shape, by truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from groundstation.app.verify import verify_log
from groundstation.core.metrics import formation_error_m
from groundstation.mission.runner import Phase
from groundstation.records.replay import load_flight
from tests.app.flights import SECOND_NS, Flight, cube8, four

LED = "steps=[form: {}, lead: {seconds: 40, smallest: 0.8, largest: 1.5}, hold: {seconds: 2}]"


class Led:
    """A flight with the operator's lines at their moments, and what was true while it was led."""

    def __init__(
        self, *lines: tuple[float, str], steps: str = LED, log: Path | None = None, small: bool = False
    ) -> None:
        self._left, self._since_ns = list(lines), -1
        self.pos_m: list[np.ndarray] = []
        self.speeds_m_s: list[float] = []
        plan = four(steps) if small else cube8(steps)
        self.flight = Flight(plan, log=log, interrupt_when=self._look)

    def _look(self, flight: Flight) -> bool:
        if flight.runner.phase is Phase.LEAD:
            truth = flight.world.truth
            self.pos_m.append(truth.pos_enu_m.copy())
            self.speeds_m_s.append(float(np.linalg.norm(flight.runner.sent_ned_m_s, axis=1).max()))
            self._since_ns = flight.now_ns if self._since_ns < 0 else self._since_ns
        while self._left and self._since_ns >= 0 and flight.now_ns - self._since_ns >= self._left[0][0] * SECOND_NS:
            flight.session.operator(self._left.pop(0)[1], flight.now_ns)
        return False

    def safe(self) -> None:
        """Nobody within r of anybody, beyond the fence or faster than the limit."""
        flight, spec = self.flight, self.flight.plan.spec
        assert flight.world.min_distance_airborne_m >= spec.avoidance.radius_m
        pos_m = np.array(self.pos_m)
        assert (pos_m >= np.array(spec.fence.min_m)).all()
        assert (pos_m <= np.array(spec.fence.max_m)).all()
        assert max(self.speeds_m_s) <= spec.speed_limit_m_s + 1e-9

    def told(self, begins: str) -> list[str]:
        """What was said that begins so."""
        return [note.text for note in self.flight.notes if note.text.startswith(begins)]


@pytest.fixture(scope="module")
def led(tmp_path_factory: pytest.TempPathFactory) -> tuple[Led, Path]:
    log = tmp_path_factory.mktemp("led") / "led.tlog"
    lines = (0.5, "move 0.6 -0.4 0.2"), (0.6, "turn 60"), (1.0, "scale 1.3"), (30.0, "next")
    return Led(*lines, log=log), log


def test_orders_move_turn_and_scale_the_formation_one_after_the_other(led: tuple[Led, Path]) -> None:
    flown, _ = led
    runner = flown.flight.runner
    assert (runner.outcome, runner.reason) == ("completed", "")
    flown.safe()
    assert [text.split(":")[0] for text in flown.told("") if text.endswith(": done")] == [
        "move 0.6 -0.4 0.2", "turn 60", "scale 1.3",
    ]  # fmt: skip
    assert flown.told("turn 60: takes")[0].endswith("s, after 1 before it")
    first, last = flown.pos_m[0], flown.pos_m[-1]
    np.testing.assert_allclose(last.mean(axis=0) - first.mean(axis=0), [0.6, -0.4, 0.2], atol=0.08)
    a, b = first - first.mean(axis=0), last - last.mean(axis=0)
    turned = np.sum(np.conj(a[:, 0] + 1j * a[:, 1]) * (b[:, 0] + 1j * b[:, 1]))
    assert np.degrees(np.angle(turned)) == pytest.approx(60.0, abs=5.0)
    roles = np.array(next(note.roles for note in flown.flight.notes if note.roles))
    assert formation_error_m(last, 1.3 * flown.flight.plan.formation.distances_m, roles) < 0.1
    assert flown.flight.meter.move_error_m < 0.12
    assert flown.told("lead is over, ") == ["lead is over, by the operator: 3 orders were flown"]


def test_its_replay_makes_every_setpoint_again_and_knows_the_sizes(led: tuple[Led, Path]) -> None:
    _, log = led
    result = verify_log(log)
    assert (result.mismatches, result.complete) == (0, True)
    assert result.setpoints > 5000
    flight = load_flight(log)
    assert [phase.name for phase in flight.phases if phase.name in ("form", "lead", "hold")] == ["form", "lead", "hold"]
    assert np.ptp(flight.formations[-1].points_enu_m[:, 2]) == pytest.approx(1.3)


def test_what_cannot_be_done_is_refused_with_its_reason_and_the_team_stays_as_it_is(tmp_path: Path) -> None:
    lines = (
        (0.5, "move 9 0 0"), (0.5, "move 0 0 -1"), (0.5, "scale 1.6"), (0.5, "scale 0.7"), (0.5, "hold"),
        (0.6, "turn 10"), (0.7, "resume"), (1.0, "turn 360"), (1.1, "move 0.1 0 0"), (1.1, "move 0 0.1 0"),
        (1.1, "move 0 0 0.1"), (1.1, "scale 1.1"), (1.2, "turn 5"), (1.3, "stay"), (3.0, "next"), (3.1, "move 1 0 0"),
    )  # fmt: skip
    flown = Led(*lines, small=True, log=tmp_path / "refused.tlog")
    assert flown.flight.runner.outcome == "completed"
    flown.safe()
    refused = [text.removeprefix("operator: ").split(" refused: ") for text in flown.told("") if "refused" in text]
    assert [line for line, _ in refused] == [
        "move 9 0 0", "move 0 0 -1", "scale 1.6", "scale 0.7", "turn 10", "turn 5", "move 1 0 0",
    ]  # fmt: skip
    why = dict(refused)
    assert "beyond the fence or below min_altitude_m" in why["move 9 0 0"]
    assert "to z = " in why["move 0 0 -1"]
    assert "1.6 times its size; the mission allows 0.8 to 1.5" in why["scale 1.6"]
    assert "0.7 times its size" in why["scale 0.7"]
    assert why["turn 10"] == "the team is held; `resume` first"
    assert why["turn 5"] == "4 orders wait already; `stay` drops them"
    assert flown.told("dropped: ") == ["dropped: move 0.1 0 0, move 0 0.1 0, move 0 0 0.1, scale 1.1"]
    assert flown.told("turn 360: ")[-1] == "turn 360: ended early"
    first, last = flown.pos_m[0], flown.pos_m[-1]
    assert np.linalg.norm(last - first, axis=1).max() < 0.15
    assert verify_log(tmp_path / "refused.tlog").mismatches == 0


def test_a_move_that_is_held_goes_on_afterwards_and_the_held_time_does_not_count() -> None:
    steps = "steps=[form: {}, lead: {seconds: 9}]"
    flown = Led((0.5, "move 0.5 0 0"), (1.5, "hold"), (7.0, "resume"), small=True, steps=steps)
    assert flown.flight.runner.outcome == "completed"
    flown.safe()
    assert flown.told("move 0.5 0 0: done")
    assert flown.told("lead is over, its 9 s are over: 1 order was flown")
    assert flown.flight.phase_seen.count(Phase.LEAD) == 2
    np.testing.assert_allclose((flown.pos_m[-1] - flown.pos_m[0]).mean(axis=0), [0.5, 0.0, 0.0], atol=0.08)


def test_an_order_that_would_outlast_the_step_is_refused_and_one_under_way_comes_to_rest_with_it() -> None:
    steps = "steps=[form: {}, lead: {seconds: 5}, hold: {seconds: 1}]"
    flown = Led((0.2, "turn 300"), (0.4, "move 0.2 0 0"), (0.6, "hold"), (0.7, "resume"), small=True, steps=steps)
    assert flown.flight.runner.outcome == "completed"
    (why,) = flown.told("operator: turn 300 refused: it takes ")
    assert "and the lead step ends in 4.8 s" in why
    assert flown.told("move 0.2 0 0: done")


@pytest.mark.parametrize("seed", range(3))
def test_whoever_is_led_at_random_keeps_r_fence_and_shape(seed: int, tmp_path: Path) -> None:
    """Orders as they come, most of them too large for the fence: what is taken is flown, what is refused is not."""
    rng = np.random.default_rng(seed)
    lines = []
    for k in range(20):
        east, north, up = (float(value) for value in rng.uniform([-2.5, -2.5, -0.8], [2.5, 2.5, 1.5]))
        order = (
            f"move {east:.2f} {north:.2f} {up:.2f}",
            f"turn {rng.uniform(-180, 180):.1f}",
            f"scale {rng.uniform(0.6, 1.6):.3f}",
            "stay",
        )[int(rng.choice(4, p=[0.5, 0.25, 0.2, 0.05]))]
        lines.append((0.5 + 1.4 * k, order))
    steps = "steps=[form: {}, lead: {seconds: 30, smallest: 0.8, largest: 1.5}, hold: {seconds: 1}]"
    log = tmp_path / "random.tlog" if seed == 0 else None  # to read one again costs as much as to fly it
    flown = Led(*lines, small=True, steps=steps, log=log)
    assert flown.flight.runner.outcome == "completed", flown.flight.runner.reason
    flown.safe()
    assert flown.flight.meter.move_error_m < 0.15
    taken = len([text for text in flown.told("") if text.endswith((": done", ": ended early"))])
    assert taken >= 3
    assert any("beyond the fence" in text for text in flown.told("operator: "))
    assert log is None or verify_log(log).mismatches == 0
