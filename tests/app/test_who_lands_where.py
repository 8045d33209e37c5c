"""Whole flights in which somebody stands, or lands, where another one would come down: by the emulator's truth.

The distance is taken here, at every physics step, over all pairs of which at least one is in the air.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from groundstation.core.phases import Phase
from groundstation.core.types import FloatArray
from groundstation.mission.plan.plan import MissionPlan
from sitl.faults import Fault
from sitl.world import World
from tests.app.flights import Flight, after, cube8, pair

_CRITICAL = 5  # MAV_STATE

MOVED = "steps=[{form: {tolerance_m: 0.05, timeout_s: 60}}, {move: {by_m: [-0.375, -0.375, 0]}}, {hold: {seconds: 5}}]"


class Truth:
    """Nearest any two vehicles came, one of them at least in the air, and how hard anybody hit the ground."""

    def __init__(self) -> None:
        self.apart_m: FloatArray = np.zeros((0, 0))
        self.hit_m_s = 0.0

    def watch(self, world: World) -> None:
        dynamics, step = world.dynamics, world.dynamics.step
        itself = np.eye(world.n, dtype=bool)
        self.apart_m = np.full((world.n, world.n), np.inf)

        def watched() -> None:
            flew, sank_m_s = dynamics.motion.airborne(), -dynamics.motion.vel_enu_m_s[2]
            step()
            up, places = dynamics.motion.airborne(), dynamics.motion.pos_enu_m.T
            self.hit_m_s = max(self.hit_m_s, float(sank_m_s[flew & ~up].max(initial=0.0)))
            if up.any():
                apart_m = np.linalg.norm(places[:, None] - places[None], axis=2)
                counts = (up[:, None] | up[None]) & ~itself
                self.apart_m = np.minimum(self.apart_m, np.where(counts, apart_m, np.inf))

        dynamics.step = watched  # type: ignore[method-assign]


def _fly(
    plan: MissionPlan,
    *,
    seed: int = 1,
    says: tuple[Callable[[Flight], bool], str] | None = None,
    faults: tuple[Fault, ...] = (),
    strike: Callable[[Flight], None] | None = None,
    outcome: str = "aborted",
) -> tuple[Flight, Truth]:
    truth, said = Truth(), list[int]()

    def look(flight: Flight) -> bool:
        if says is not None and not said and says[0](flight):
            said.append(flight.now_ns)
            flight.session.operator(says[1], flight.now_ns)
        if strike is not None:
            strike(flight)
        return False

    flight = Flight(
        plan,
        seed=seed,
        interrupt_when=look,
        change=lambda config: replace(config, faults=faults),
        prepare=truth.watch,
    )
    assert not flight.world.truth.airborne.any()
    assert flight.runner.outcome == outcome
    return flight, truth


def _empty(vehicle: int, at_s: float) -> Fault:
    return Fault("battery_level", at_s, vehicles=(vehicle,), numbers={"percent": 5.0})


@pytest.mark.parametrize(("plan", "vehicle"), [(cube8(MOVED), 2), (cube8(), 7)], ids=["moved", "packaged"])
def test_nobody_is_landed_on_one_that_goes_home_below_it(plan: MissionPlan, vehicle: int) -> None:
    flight, truth = _fly(plan, says=(after(Phase.HOLD, 0.5), f"land {vehicle}"))
    assert truth.apart_m.min() >= plan.spec.avoidance.radius_m
    assert [text for text in flight.texts("alarm") if text.startswith(f"vehicle {vehicle}: lands ")]


@pytest.mark.parametrize(
    ("plan", "seed", "faults"),
    [(cube8(MOVED), 1, (_empty(2, 19.0),)), (cube8(), 8, (_empty(2, 15.0), _empty(7, 15.0)))],
    ids=["one", "two"],
)
def test_nobody_comes_home_onto_one_that_has_landed_there_with_an_empty_battery(
    plan: MissionPlan, seed: int, faults: tuple[Fault, ...]
) -> None:
    """PX4 lands by itself at 5 %, at once: who hovers below has the time of its fall to leave."""
    flight, truth = _fly(plan, seed=seed, faults=faults)
    assert truth.apart_m.min() >= plan.spec.avoidance.radius_m
    for fault in faults:
        words = f"vehicle {fault.vehicles[0]}: comes down by itself, vehicle "
        assert any(text.startswith(words) for text in flight.texts("alarm"))
    assert "where it would have landed" in flight.runner.reason
    places = flight.world.truth.pos_enu_m[:, :2]
    apart_m = np.linalg.norm(places[:, None] - places[None], axis=2)[~np.eye(8, dtype=bool)]
    assert apart_m.min() >= plan.spec.avoidance.radius_m


def test_four_in_a_column_land_on_their_pads_where_the_fence_has_no_place_for_all(tmp_path: Path) -> None:
    points = [[0.0, 0.0, 0.0], [0.02, 0.0, 0.6], [0.0, 0.02, 1.2], [0.02, 0.02, 1.8]]
    (tmp_path / "column.yaml").write_text(json.dumps({"name": "column", "points": points, "edges": "complete"}))
    pads = [[-0.4, -0.4, 0.0], [0.4, -0.4, 0.0], [-0.4, 0.4, 0.0], [0.4, 0.4, 0.0]]
    vehicles = [{"id": k + 1, "link": "udpin://127.0.0.1:14540", "pad_m": pad} for k, pad in enumerate(pads)]
    plan = cube8(
        f"formation={tmp_path / 'column.yaml'}",
        "gains=null",
        f"vehicles={json.dumps(vehicles)}",
        "fence.min_m=[-0.5, -0.5, 0]",
        "fence.max_m=[0.5, 0.5, 4]",
        "failsafe.action=hold",
        "steps.0.form.tolerance_m=0.2",
    )
    flight, truth = _fly(plan, says=(after(Phase.HOLD, 0.5), "land all"))
    assert truth.apart_m.min() >= plan.spec.avoidance.radius_m
    told = [text for text in flight.texts("alarm") if "the fence holds no place for everybody" in text]
    assert len(told) == 4
    off_pad_m = np.linalg.norm(flight.world.truth.pos_enu_m[:, :2] - plan.pads_enu_m[:, :2], axis=1)
    assert off_pad_m.max() < 0.2


@pytest.mark.parametrize("autopilots", [("px4", "arducopter"), ("arducopter", "px4")])
def test_one_that_does_not_take_land_is_kept_above_its_pad_until_it_does(autopilots: tuple[str, str]) -> None:
    """Told to stand still it would drift 2 to 4 m in a minute, over others too, and land there by its failsafe."""
    plan = pair("steps=[{hover: {seconds: 1}}]", "rate_hz=10", "wind.mean_m_s=3", autopilots=autopilots)
    off_m, struck = list[float](), list[int]()

    def strike(flight: Flight) -> None:
        if flight.runner.phase is Phase.RETURN and not struck:
            struck.append(flight.now_ns)
            flight.world.inject(Fault("commands_ignored", for_s=60.0, vehicles=(1,)))
        place_m = flight.world.truth.pos_enu_m[0]
        if flight.runner.phase is Phase.LAND and place_m[2] > 1.0:
            off_m.append(float(np.linalg.norm(place_m[:2] - plan.pads_enu_m[0, :2])))

    flight, truth = _fly(plan, seed=2, strike=strike, outcome="completed")
    assert len(off_m) > 500, "it landed at once"
    assert max(off_m) < 0.8
    assert truth.apart_m.min() >= plan.spec.avoidance.radius_m
    assert "no answer to 4 tries" in " ".join(flight.texts("info"))


@pytest.mark.parametrize(("vehicle", "after_s"), [(1, 1.0), (1, 4.0), (2, 1.0)])
def test_a_motor_that_fails_while_landing_is_told_and_the_mission_not_completed(vehicle: int, after_s: float) -> None:
    struck: list[int] = []
    lands = after(Phase.LAND, after_s)

    def strike(flight: Flight) -> None:
        if lands(flight) and not struck:
            struck.append(flight.now_ns)
            flight.world.inject(Fault("motor_failure", vehicles=(vehicle,), numbers={"thrust_share": 0.6}))

    flight, truth = _fly(pair("steps.1.hold.seconds=1"), strike=strike)
    assert truth.hit_m_s > 1.5
    assert f"vehicle {vehicle}: is tilted by " in flight.runner.reason


def _outage(direction: str, for_s: float = 3.0) -> Callable[[Flight], None]:
    """Nothing is heard for a while by anybody, or of anybody, while the team holds."""
    struck: list[int] = []
    hold = after(Phase.HOLD, 2.0)

    def strike(flight: Flight) -> None:
        if not struck and hold(flight):
            struck.append(flight.now_ns)
            flight.world.inject(Fault("blackout", for_s=for_s, direction=direction))

    return strike


def test_a_team_that_did_not_hear_us_for_a_while_goes_on_when_it_does() -> None:
    """PX4's own failsafe holds it meanwhile; it follows by itself again, and the first setpoint that comes through.

    Eight PX4 were told to flee from each other at 1.5 m/s while all stood: they went up to 1.5 m when they heard it.
    """
    strike, told_m_s = _outage("up"), list[float]()

    def look(flight: Flight) -> None:
        strike(flight)
        fleet = flight.runner.fleet
        waits = fleet.armed & (fleet.system_status == _CRITICAL)
        told_m_s.extend(np.linalg.norm(flight.runner.sent_ned_m_s[waits], axis=1).tolist())

    flight, truth = _fly(cube8(), strike=look, outcome="completed")
    assert truth.apart_m.min() >= flight.plan.spec.avoidance.radius_m
    assert len(told_m_s) > 100
    assert max(told_m_s) == 0.0
    words = [note.text for note in flight.notes if note.kind == "alarm"]
    assert len(words) == 8
    assert all("its own failsafe holds it in mode AUTO.LOITER; it is waited for, 10 s" in text for text in words)


@pytest.mark.parametrize(("direction", "for_s"), [("both", 3.0), ("down", 3.0), ("down", 8.0)])
def test_who_is_heard_again_after_an_outage_of_all_is_led_to_a_free_place(direction: str, for_s: float) -> None:
    """A cube holds. After 5 s the lower four are told to land; whoever is above waits, and comes down on nobody."""
    flight, truth = _fly(cube8(), strike=_outage(direction, for_s))
    assert truth.apart_m.min() >= flight.plan.spec.avoidance.radius_m
    assert truth.hit_m_s < 1.0
    words = [note.text for note in flight.notes if note.kind == "alarm"]
    assert sum("its position is told again" in text for text in words) >= 4
    assert any("cannot be led elsewhere" in text for text in words) == (for_s > 5.0)
    assert not any("comes down all the same" in text for text in words)
