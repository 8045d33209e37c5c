"""The operator's orders in flight: every order in every phase, and what whole flights come to."""

from __future__ import annotations

import copy
import copyreg
import struct
from collections.abc import Callable
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from groundstation.app.emulator import world_config
from groundstation.app.session import Session
from groundstation.app.verify import verify_log
from groundstation.core.errors import UserError
from groundstation.mission.operator import Order
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.purpose import Purpose
from groundstation.mission.runner import Note, Phase, Runner
from sitl.world import Outgoing, World
from tests.app.flights import SECOND_NS, Flight, Tamper, after, cube8, four, pair

PERIOD_NS = 20_000_000
copyreg.pickle(struct.Struct, lambda shape: (struct.Struct, (shape.format,)))  # so that flights can be copied
DONE = "."  # obeyed, no change of phase
# What an order leads to: a phase, . for no change, x for a refusal. Columns as in LINES.
LEADS_TO = {
    Phase.CONNECT: "done x done done silent silent x x",
    Phase.TAKEOVER: "x x x x . silent x x",
    Phase.ARM: "land x land land land silent x x",
    Phase.TAKEOFF: "pause x stop land return silent x x",
    Phase.FORM: "pause x stop land return silent x x",
    Phase.HOLD: "pause x stop land return silent x x",
    Phase.LEAD: "pause x stop land return silent . return",
    Phase.STOP: "pause x . land . silent x x",
    Phase.PAUSE: "x hold return land . silent x x",
    Phase.RETURN: "pause x . land . silent x x",
    Phase.LAND: "x x . x . silent x x",
    Phase.SILENT: "x x x . . x x x",
    Phase.DONE: "x x x x x x x x",
}
LINES = ("hold", "resume", "return", "land all", "kill 2", "silence", "turn 10", "next")


class Stepped:
    """A flight that is stepped by hand and can be copied at any moment."""

    def __init__(self, plan: MissionPlan, *, take_over: bool = False) -> None:
        self.world, self.runner = (
            World(world_config(plan, 1), 1),
            Runner(plan, 0, Purpose.TAKE_OVER if take_over else Purpose.FLY),
        )
        self.now_ns, self._begin_ns = 0, self.world.now_ns
        self.notes: list[Note] = []

    def step(self, ticks: int = 1) -> None:
        for _ in range(ticks):
            self.now_ns += PERIOD_NS
            fleet = self.runner.fleet
            for sent in self.world.advance(self.now_ns + self._begin_ns):
                peer = f"emulator:{fleet.sysid[sent.vehicle_index]}"
                self.runner.receive(int(fleet.link[sent.vehicle_index]), peer, sent.data, sent.t_ns - self._begin_ns)
            for datagram in self.runner.step(self.now_ns):
                row = fleet.sysid.tolist().index(int(datagram.peer.split(":")[1]))
                self.world.receive(row, b"".join(datagram.frames), self.now_ns + self._begin_ns)
            self.notes += self.runner.take_notes()

    def until(self, condition: Callable[[Stepped], bool]) -> Stepped:
        while not condition(self):
            self.step()
            assert self.now_ns < 200 * SECOND_NS
        return self


@pytest.fixture(scope="module")
def moments() -> dict[Phase, Stepped]:
    """One flight, kept as it was a moment after it entered each phase."""
    kept: dict[Phase, Stepped] = {}

    def reach(flight: Stepped, phase: Phase) -> None:
        flight.until(lambda flight: flight.runner.phase is phase)
        if phase is not Phase.DONE:
            flight.step(10 if phase in (Phase.TAKEOFF, Phase.FORM, Phase.HOLD, Phase.RETURN) else 2)
        kept[phase] = copy.deepcopy(flight)

    steps = "steps=[form: {tolerance_m: 0.4}, hold: {seconds: 2}, lead: {seconds: 6}]"
    flight = Stepped(pair(steps, autopilots=("px4", "px4")))
    for phase in (
        Phase.CONNECT,
        Phase.ARM,
        Phase.TAKEOFF,
        Phase.FORM,
        Phase.HOLD,
        Phase.LEAD,
        Phase.RETURN,
        Phase.LAND,
        Phase.DONE,
    ):
        reach(flight, phase)
    kept[Phase.TAKEOVER] = Stepped(flight.runner.plan, take_over=True)
    kept[Phase.TAKEOVER].step(2)
    for line, phase in (("return", Phase.STOP), ("hold", Phase.PAUSE), ("silence", Phase.SILENT)):
        branch = copy.deepcopy(kept[Phase.HOLD])
        branch.runner.operator(line)
        reach(branch, phase)
    return kept


@pytest.mark.parametrize("phase", list(LEADS_TO), ids=lambda phase: phase.value)
@pytest.mark.parametrize("line", LINES)
def test_every_order_in_every_phase(moments: dict[Phase, Stepped], phase: Phase, line: str) -> None:
    expected = LEADS_TO[phase].split()[LINES.index(line)]
    flight = copy.deepcopy(moments[phase])
    flight.notes.clear()
    flight.runner.operator(line)
    flight.step()
    refused = [note.text for note in flight.notes if note.text.startswith(f"operator: {line} refused: ")]
    assert bool(refused) == (expected == "x"), flight.notes
    assert flight.runner.phase.value == (phase.value if expected in ("x", ".") else expected)
    if expected != "x":
        assert Note("info", f"operator: {line}") in flight.notes


def _says(*lines: tuple[Callable[[Flight], bool], str]) -> Callable[[Flight], bool]:
    """Says each line once, as soon as its moment has come and the ones before it were said."""
    left = list(lines)

    def look(flight: Flight) -> bool:
        if left and left[0][0](flight):
            flight.session.operator(left.pop(0)[1], flight.now_ns)
        return False

    return look


def _safe(flight: Flight) -> None:
    truth = flight.world.truth
    assert not truth.armed.any()
    assert not truth.airborne.any()
    assert flight.world.min_distance_airborne_m >= flight.plan.spec.avoidance.radius_m


def _verified(log: Path) -> None:
    result = verify_log(log)
    assert (result.mismatches, result.complete) == (0, True)
    assert result.setpoints > 0


@pytest.mark.parametrize(
    ("phase", "name"),
    [(Phase.TAKEOFF, "pair"), (Phase.FORM, "cube8"), (Phase.HOLD, "pair"), (Phase.RETURN, "pair")],
)
def test_a_hold_stands_still_pauses_the_clock_of_the_step_and_goes_on_where_it_was(
    phase: Phase, name: str, tmp_path: Path
) -> None:
    """Held for longer than the step may last: nothing times out, nobody moves, and the mission is completed."""
    log = tmp_path / "flight.tlog"
    places = []

    class Watched(Flight):
        def _watch(self, session: Session, now_ns: int) -> None:
            super()._watch(session, now_ns)
            if self.runner.phase is Phase.PAUSE:
                places.append(self.world.truth.pos_enu_m.copy())

    limits = ("takeoff.timeout_s=12", "steps.0.form.timeout_s=20", "land.timeout_s=14")
    plan = cube8(*limits) if name == "cube8" else pair(*limits)
    says = _says((after(phase, 6.0 if phase is Phase.TAKEOFF else 0.3), "hold"), (after(Phase.PAUSE, 15.0), "resume"))
    flight = Watched(plan, seed=2, log=log, interrupt_when=says)
    assert (flight.runner.outcome, flight.runner.reason) == ("completed", "")
    _safe(flight)
    stood = np.array(places[round(5 * plan.spec.rate_hz) :])  # five seconds to come to rest
    assert len(stood) >= 9.9 * plan.spec.rate_hz
    assert np.linalg.norm(stood - stood[0], axis=-1).max() < max(0.1, plan.margin_m)
    kept = [seen.value for seen in flight.phase_seen]
    where = kept.index("pause")
    assert kept[where - 1] == kept[where + 1] == phase.value
    _verified(log)


def test_a_hold_that_nobody_ends_is_ended_by_the_battery_and_by_its_own_limit() -> None:
    def drain(world: World) -> None:
        world.autopilots[1].battery.extra_per_s = 0.02

    flight = Flight(pair(), prepare=drain, interrupt_when=_says((after(Phase.FORM), "hold")))
    assert flight.runner.outcome == "aborted"
    assert flight.runner.reason.startswith("vehicle 2: battery at ")
    _safe(flight)
    held = Flight(pair("limits.hold_s=4"), interrupt_when=_says((after(Phase.FORM), "hold")))
    assert held.runner.reason == "held for 4 s, which is the limit; the hold is over, everybody comes back"
    _safe(held)


def test_nothing_is_held_on_a_low_battery() -> None:
    hold = _says((after(Phase.RETURN, 0.5), "hold"))

    def look(flight: Flight) -> bool:
        if flight.runner.phase is Phase.HOLD:
            flight.world.autopilots[1].battery.left = min(flight.world.autopilots[1].battery.left, 0.3)
        return hold(flight)

    flight = Flight(pair(), interrupt_when=look)
    assert "operator: hold refused: vehicle 2: battery at 30%, minimum is 40%" in flight.texts("alarm")
    assert Phase.PAUSE not in flight.phase_seen
    _safe(flight)


def test_the_battery_of_one_that_has_landed_holds_up_nobody() -> None:
    """On with three of four; the fourth has come home with an empty battery, and stands on its pad."""

    def look(flight: Flight) -> bool:
        if flight.runner.phase is Phase.FORM and not drained:
            flight.world.autopilots[1].battery.left = 0.15
            drained.append(True)
        if any("battery at 1" in text for text in flight.texts("alarm")):
            flight.world.autopilots[1].battery.left = min(flight.world.autopilots[1].battery.left, 0.09)
        return holds(flight)

    drained: list[bool] = []
    holds = _says((_one_is_down, "hold"), (after(Phase.PAUSE, 2.0), "resume"))
    flight = Flight(four("on_lost=continue_open", "steps.1.hold.seconds=12"), interrupt_when=look)
    assert "vehicle 2: battery at 1" in flight.runner.reason
    assert "vehicle 2: battery at 9%, lands below 10%; it lands where it is when nobody is below, the others go on" in (
        flight.texts("alarm")
    )
    assert not [text for text in flight.texts("alarm") if "refused" in text or "the hold is over" in text]
    where = flight.phase_seen.index(Phase.PAUSE)
    assert flight.phase_seen[where + 1 :] == [Phase.HOLD, Phase.RETURN, Phase.LAND, Phase.DONE]
    _safe(flight)


def _one_is_down(flight: Flight) -> bool:
    return flight.runner.phase is Phase.HOLD and not flight.world.truth.armed[1]


def test_one_that_is_lost_during_a_hold_costs_the_others_none_of_their_time_to_form() -> None:
    says = _says((after(Phase.HOLD), "hold"), (after(Phase.PAUSE, 2.0), "land 4"), (after(Phase.PAUSE, 20.0), "resume"))
    flight = Flight(four("on_lost=continue_open", "steps.0.form.timeout_s=12"), interrupt_when=says)
    assert flight.runner.reason == "vehicle 4: landed by the operator"
    where = flight.phase_seen.index(Phase.PAUSE)
    assert flight.phase_seen[where + 1 :] == [Phase.FORM, Phase.HOLD, Phase.RETURN, Phase.LAND, Phase.DONE]
    _safe(flight)


def test_a_hold_in_which_everybody_is_landed_one_by_one_ends_on_the_ground() -> None:
    says = _says((after(Phase.HOLD), "hold"), (after(Phase.PAUSE, 1.0), "land 1"), (after(Phase.PAUSE, 2.0), "land 2"))
    flight = Flight(pair(), interrupt_when=says)
    assert flight.phase_seen[-4:] == [Phase.HOLD, Phase.PAUSE, Phase.LAND, Phase.DONE]
    assert flight.runner.reason == "vehicle 1: landed by the operator; vehicle 2: landed by the operator"
    _safe(flight)


def test_a_team_too_small_to_go_on_without_one_comes_back() -> None:
    flight = Flight(pair("on_lost=continue_open"), interrupt_when=_says((after(Phase.FORM), "land 1")))
    assert flight.runner.reason.startswith(
        "vehicle 1: landed by the operator; 1 of 2 vehicles are left in the formation"
    )
    assert flight.phase_seen[-3:] == [Phase.RETURN, Phase.LAND, Phase.DONE]
    _safe(flight)


@pytest.mark.parametrize("seed", [1])
def test_land_all_from_the_cube_comes_down_in_place_and_whoever_has_somebody_below_moves_aside(
    seed: int, tmp_path: Path
) -> None:
    log = tmp_path / "flight.tlog"
    flight = Flight(cube8(), seed=seed, log=log, interrupt_when=_says((after(Phase.HOLD), "land all")))
    assert (flight.runner.outcome, flight.runner.reason) == ("aborted", "landed by the operator")
    _safe(flight)
    assert Phase.RETURN not in flight.phase_seen
    asked = [text for text in flight.texts("info") if "aside before it lands" in text]
    assert 0 < len(asked) <= 4
    places = flight.world.truth.pos_enu_m[:, :2]
    apart = np.linalg.norm(places[:, None] - places[None, :], axis=-1)[~np.eye(8, dtype=bool)]
    assert apart.min() >= 0.45
    _verified(log)


@pytest.mark.parametrize("autopilots", [("px4", "px4"), ("arducopter", "arducopter")])
@pytest.mark.parametrize("phase", [Phase.TAKEOFF, Phase.STOP, Phase.PAUSE, Phase.RETURN])
def test_land_all_lands_from_other_phases_too(phase: Phase, autopilots: tuple[str, str]) -> None:
    before = {Phase.STOP: "return", Phase.PAUSE: "hold"}
    first = [(after(Phase.FORM), before[phase])] if phase in before else []
    flight = Flight(
        pair(autopilots=autopilots), interrupt_when=_says(*first, (after(phase, 0.3), "land all")), limit_s=120
    )
    assert "landed by the operator" in flight.runner.reason
    _safe(flight)
    away = np.linalg.norm(flight.world.truth.pos_enu_m[:, :2] - flight.plan.pads_enu_m[:, :2], axis=1)
    assert phase is not Phase.PAUSE or away.max() > 0.3  # not flown back first


@pytest.mark.parametrize("vehicle", [4])
def test_land_one_brings_it_down_where_it_is_and_nobody_is_hit(vehicle: int, tmp_path: Path) -> None:
    log = tmp_path / "flight.tlog"
    flight = Flight(cube8(), log=log, interrupt_when=_says((after(Phase.HOLD), f"land {vehicle}")))
    assert flight.runner.reason == f"vehicle {vehicle}: landed by the operator"
    _safe(flight)
    off_pad = np.linalg.norm(flight.world.truth.pos_enu_m[:, :2] - flight.plan.pads_enu_m[:, :2], axis=1)
    assert off_pad[vehicle - 1] > 0.2
    assert np.delete(off_pad, vehicle - 1).max() < 0.3
    _verified(log)


@pytest.mark.parametrize("vehicle", [1, 6])
def test_a_killed_vehicle_falls_at_once_and_the_others_come_back(vehicle: int) -> None:
    told: list[int] = []
    stopped: list[int] = []

    def look(flight: Flight) -> bool:
        if flight.runner.phase is Phase.HOLD and not told:
            told.append(flight.now_ns)
            flight.session.operator(f"kill {vehicle}", flight.now_ns)
        if told and not stopped and not flight.world.truth.armed[vehicle - 1]:
            stopped.append(flight.now_ns)
        return False

    flight = Flight(cube8(), interrupt_when=look)
    assert stopped[0] - told[0] <= 0.1 * SECOND_NS
    # Whoever has its pad beside the wreck is told to be near it as well.
    assert flight.runner.reason.startswith(f"vehicle {vehicle}: killed by the operator")
    hits = [text for text in flight.texts("alarm") if "has hit the ground at " in text]
    assert [text.split(":")[0] for text in hits if not text.startswith("aborted")] == [f"vehicle {vehicle}"]
    truth = flight.world.truth
    assert not truth.armed.any()
    assert not truth.airborne.any()
    off_pad = np.linalg.norm(truth.pos_enu_m[:, :2] - flight.plan.pads_enu_m[:, :2], axis=1)
    assert np.delete(off_pad, vehicle - 1).max() < 0.3


@pytest.mark.parametrize("phase", [Phase.ARM, Phase.TAKEOFF, Phase.HOLD, Phase.LAND, Phase.SILENT])
def test_kill_all_gets_through_a_link_that_loses_half_of_everything(phase: Phase, tmp_path: Path) -> None:
    log = tmp_path / "flight.tlog"
    rng = np.random.default_rng(3)
    told: list[int] = []

    class Lossy(Flight):
        def receive(self, vehicle_index: int, data: bytes, now_ns: int) -> None:
            if not (told and rng.random() < 0.5):
                super().receive(vehicle_index, data, now_ns)

    def lose(datagram: object, _flight: Flight) -> list[object]:
        return [] if told and rng.random() < 0.5 else [datagram]

    lines = _says(*([(after(Phase.HOLD), "silence")] if phase is Phase.SILENT else []), (after(phase), "kill all"))

    def look(flight: Flight) -> bool:
        lines(flight)
        if "operator: kill all" in flight.texts("info"):
            told.append(flight.now_ns)
        return False

    flight = Lossy(pair(), log=log, tamper=cast("Tamper", lose), interrupt_when=look)
    assert "everybody: killed by the operator" in flight.runner.reason
    assert not flight.world.truth.armed.any()
    assert flight.runner.done
    assert flight.now_ns - told[0] < 15 * SECOND_NS
    if phase in (Phase.HOLD, Phase.SILENT):
        assert any("has hit the ground at " in text for text in flight.texts("alarm"))
    _verified(log)


def test_a_killed_vehicle_is_not_landed_but_can_be_killed_again() -> None:
    flight = Flight(
        pair(),
        interrupt_when=_says(
            (after(Phase.HOLD), "kill 1"), (after(Phase.RETURN), "land 1"), (after(Phase.RETURN), "kill 1")
        ),
    )
    assert "operator: vehicle 1 was killed and is not ours to land" in flight.texts("alarm")
    assert not flight.world.truth.armed.any()


def test_what_is_not_understood_is_said_and_changes_nothing(tmp_path: Path) -> None:
    """The session refuses it before it is recorded; the runner, should it get one all the same, answers by an alarm."""
    log = tmp_path / "flight.tlog"
    said: list[int] = []

    def look(flight: Flight) -> bool:
        if flight.runner.phase is Phase.FORM and not said:
            said.append(flight.now_ns)
            with pytest.raises(ValueError, match="operator command 'dance' is none of hold"):
                flight.session.operator("dance", flight.now_ns)
            with pytest.raises(ValueError, match="99 is no vehicle of this mission; those are 1, 2"):
                flight.session.operator("kill 99", flight.now_ns)
            flight.runner.operator("dance")
        return False

    flight = Flight(pair(), log=log, interrupt_when=look)
    assert flight.runner.outcome == "completed"
    assert len(flight.texts("alarm")) == 1
    assert "operator command 'dance' is none of hold" in flight.texts("alarm")[0]
    _verified(log)


def test_a_killed_vehicle_that_falls_silent_is_judged_by_nobody() -> None:
    """Killed while holding, its link silent 1.5 s later: all that is ever said of it is that it was killed."""
    killed: list[int] = []

    def look(flight: Flight) -> bool:
        if flight.runner.phase is Phase.HOLD and not killed:
            killed.append(flight.now_ns)
            flight.session.operator("kill 4", flight.now_ns)
        return False

    def hush(datagram: Outgoing, flight: Flight) -> list[Outgoing]:
        silent = datagram.vehicle_index == 3 and killed and flight.now_ns - killed[0] >= 1.5 * SECOND_NS
        return [] if silent else [datagram]

    flight = Flight(four("on_lost=continue_open", "steps.1.hold.seconds=8"), tamper=hush, interrupt_when=look)
    assert flight.now_ns - killed[0] > 15 * SECOND_NS  # so long that a silent one of ours would be given up as lost
    killed_words, hit = flight.texts("alarm")  # that it fell is told; it is blamed for nothing
    assert killed_words == "aborted: vehicle 4: killed by the operator"
    assert hit.startswith("vehicle 4: has hit the ground at ")
    assert (flight.runner.outcome, flight.runner.reason) == ("aborted", "vehicle 4: killed by the operator")
    assert flight.phase_seen[-4:] == [Phase.HOLD, Phase.RETURN, Phase.LAND, Phase.DONE]


def test_a_team_that_is_told_to_waits_on_its_pads_for_the_order() -> None:
    flight = Stepped(pair("takeoff.wait=true", "limits.preflight_s=3"))
    flight.step()
    flight.runner.operator("start")
    flight.step()
    assert any("start refused: preflight is not through: vehicle 1: " in note.text for note in flight.notes)
    flight.until(lambda it: any("waits for the order `start`" in note.text for note in it.notes))
    flight.step(200)  # longer than preflight may take otherwise
    assert (flight.runner.phase, flight.runner.refusal(Order.START)) == (Phase.CONNECT, None)
    flight.runner.operator("start")
    flight.step()
    assert flight.runner.phase is Phase.ARM
    with pytest.raises(UserError, match=r"takeoff\.wait: nobody gives the order"):
        Flight(pair("takeoff.wait=true"))
