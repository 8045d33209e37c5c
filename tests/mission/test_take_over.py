"""Taking over, vehicle by vehicle: what is missing, and what is left alone, by what the vehicles report."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from groundstation.app.resources import packaged_configs
from groundstation.mavlink.vehicle import LANDED_IN_AIR
from groundstation.mission.ground.take_over import TakeOverState
from groundstation.mission.phases.taking_over import TakeOverPhase
from groundstation.mission.plan.reading import load_mission
from groundstation.mission.purpose import Purpose
from groundstation.mission.runner import Runner

SECOND_NS = 1_000_000_000
CUBE8 = packaged_configs() / "missions" / "cube8.yaml"
OFFBOARD = 6 << 16
MAV_AUTOPILOT_PX4 = 12


class Scene:
    """Eight vehicles that hover above their pads and report all that they should."""

    def __init__(self) -> None:
        self.runner = Runner(load_mission(CUBE8), 0, Purpose.TAKE_OVER)
        state = self.runner._machine.state
        assert isinstance(state, TakeOverPhase)
        self.fleet, self.take_over = self.runner.fleet, state.take_over
        self.roster = self.runner._team.roster
        self.now_ns = 0
        fleet = self.fleet
        fleet.armed[:] = True
        fleet.custom_mode[:] = 4 << 16 | 3 << 24  # AUTO.LOITER
        fleet.landed_state[:] = LANDED_IN_AIR
        fleet.autopilot[:] = MAV_AUTOPILOT_PX4
        fleet.quat_ned_from_frd[:] = [1.0, 0.0, 0.0, 0.0]
        fleet.pos_local_ned_m[:] = [0.0, 0.0, -1.0]
        fleet.vel_ned_m_s[:] = 0.0
        fleet.home_local_ned_m[:] = 0.0
        self.state = TakeOverState(np.zeros(8, dtype=np.bool_))

    def _step(self) -> TakeOverState:
        frame = self.runner._team.frame
        frame.placement.look_in_flight(self.fleet, self.now_ns)
        return self.take_over.step(self.now_ns, frame.poses(self.fleet, self.now_ns).pos_team_ned_m)

    def run(self, each: Callable[[], None] | None = None, seconds: float = 30.0) -> TakeOverState:
        """Goes on until everybody is held or left alone."""
        for _ in range(round(seconds / 0.1)):
            self.now_ns += SECOND_NS // 10
            fleet = self.fleet
            for times in (fleet.heartbeat_ns, fleet.heard_ns, fleet.pose_ns, fleet.attitude_ns, fleet.status_ns):
                times[:] = self.now_ns
            if each is not None:
                each()
            self.state = self._step()
            if self.state.done:
                break
            # Who is asked comes into the mode a second after it was taken.
            fleet.custom_mode[self.roster.steered] = OFFBOARD
        return self.state


def test_all_that_hover_are_held_and_brought_home() -> None:
    scene = Scene()
    state = scene.run()
    assert (state.done, state.problems) == (True, [])
    assert state.home.all()


SPOILT: dict[str, tuple[Callable[[Scene], None], str]] = {
    "old heartbeat": (lambda scene: _set(scene.fleet.heartbeat_ns, scene.now_ns // 10), "last heartbeat "),
    "another autopilot": (lambda scene: _set(scene.fleet.autopilot, 3), "its heartbeat says MAV_AUTOPILOT 3; correct"),
    "fixed wing": (
        lambda scene: _set(scene.fleet.mav_type, 1),
        "it says that it is a fixed wing (MAV_TYPE 1), and only",
    ),
    "not told": (lambda scene: _set(scene.fleet.landed_state, 0), "has not told whether it is in the air"),
    "no attitude": (lambda scene: _set(scene.fleet.attitude_ns, -10 * SECOND_NS), "no attitude yet"),
    "no position": (lambda scene: _set(scene.fleet.pose_ns, 0), "no position yet"),
    "far away": (lambda scene: _set(scene.fleet.pos_local_ned_m[:, 0], 9.0), "reports a place 5.0 m outside the fence"),
    "another pad": (lambda scene: _set(scene.fleet.home_local_ned_m[:, 1], 1.0), "took off 1.00 m from its pad"),
}


def _set(values: NDArray[Any], value: float) -> None:
    values[2] = value


@pytest.mark.parametrize("how", SPOILT)
def test_one_that_cannot_be_brought_home_is_named_and_the_others_are(how: str) -> None:
    scene = Scene()
    spoil, words = SPOILT[how]
    state = scene.run(lambda: spoil(scene))
    assert state.done
    assert scene.now_ns >= 20 * SECOND_NS  # it was waited for
    (problem,) = state.problems
    assert problem.startswith(f"vehicle 3: {words}")
    assert state.home.tolist() == [True, True, False, True, True, True, True, True]


def test_two_under_one_id_are_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene()
    monkeypatch.setattr(
        scene.fleet, "twin", lambda vehicle, now_ns: "two vehicles say that they are 3" if vehicle == 2 else None
    )
    state = scene.run()
    assert state.problems == [
        "vehicle 3: two vehicles say that they are 3; neither is touched: bring them down by their remote controls"
    ]


def test_one_that_does_not_tell_where_it_took_off_is_taken_on_trust() -> None:
    scene = Scene()
    said: list[str] = []

    def forget() -> None:
        scene.fleet.home_local_ned_m[2] = np.nan
        said.extend(scene.state.notes)

    state = scene.run(forget)
    assert (state.done, state.problems) == (True, [])
    assert state.home.all()
    assert [text for text in [*said, *state.notes] if "taken on trust" in text] == [
        "vehicle 3: does not tell where it took off; that its frame begins where the mission says is taken on trust"
    ]
