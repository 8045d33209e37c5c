"""A ground station that dies in the air, and the one that is started in its place."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from groundstation.app.verify import verify_log
from groundstation.mavlink.codec import Frame, FrameSplitter
from groundstation.mission.plan import MissionPlan
from groundstation.mission.runner import Phase
from sitl.world import Outgoing, World
from tests.app.flights import SECOND_NS, Flight, cube8, mission, pair


class _Died(Exception):  # noqa: N818 - the end of a process, not an error
    """Ends a flight as SIGKILL does."""


def _left_in_the_air(
    plan: MissionPlan, when: Callable[[Flight], bool], *, idle_s: float = 3.0, prepare: Callable[[World], None] | None = None
) -> World:
    """Flies until something is so, then nobody is there for a while."""
    worlds: list[World] = []

    def die(flight: Flight) -> bool:
        if when(flight):
            worlds.append(flight.world)
            raise _Died
        return False

    with contextlib.suppress(_Died):
        Flight(plan, interrupt_when=die, prepare=prepare)
    (world,) = worlds
    for _ in range(round(idle_s * 50)):
        world.advance(world.now_ns + SECOND_NS // 50)
    return world


def _in(phase: Phase, for_s: float = 0.0) -> Callable[[Flight], bool]:
    since: list[int] = []

    def there(flight: Flight) -> bool:
        if flight.runner.phase is not phase:
            return False
        since.append(flight.now_ns)
        return flight.now_ns - since[0] >= for_s * SECOND_NS

    return there


def _holds(world: World) -> None:
    """PX4 holds when setpoints stop, as it is set before takeoff."""
    for pilot in world.autopilots:
        for name, value in (("COM_OBL_RC_ACT", 5), ("COM_OF_LOSS_T", 0.3), ("GUID_TIMEOUT", 0.3)):
            if name in pilot.params:
                pilot.params.set_value(name, value)


def _off_pads_m(flight: Flight) -> np.ndarray:
    return np.linalg.norm(flight.world.truth.pos_enu_m[:, :2] - flight.plan.pads_enu_m[:, :2], axis=1)


def _assert_home(flight: Flight) -> None:
    truth = flight.world.truth
    assert not truth.armed.any()
    assert not truth.airborne.any()
    assert flight.world.min_distance_airborne_m >= flight.plan.spec.avoidance.radius_m


@pytest.mark.parametrize(
    ("phase", "for_s"), [(Phase.TAKEOFF, 1.8), (Phase.FORM, 1.5), (Phase.HOLD, 2.0), (Phase.RETURN, 1.0)]
)
def test_a_team_that_holds_is_brought_home(phase: Phase, for_s: float, tmp_path: Path) -> None:
    world = _left_in_the_air(cube8(), _in(phase, for_s), prepare=_holds)
    assert world.truth.airborne.all()
    log = tmp_path / "flight.tlog"
    flight = Flight(cube8(), world=world, take_over=True, log=log)
    assert (flight.runner.outcome, flight.runner.reason) == ("completed", "")
    assert flight.phase_seen == [Phase.TAKEOVER, Phase.RETURN, Phase.LAND, Phase.DONE]
    _assert_home(flight)
    assert _off_pads_m(flight).max() < 0.3
    result = verify_log(log)
    assert (result.mismatches, result.setpoints > 1000) == (0, True)
