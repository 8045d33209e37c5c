"""A third autopilot is a folder on each side: world, fleet, the desk's commands and a mission take it unasked."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from groundstation.app.serving import SitlOptions, open_server
from groundstation.core.errors import UserError
from groundstation.mavlink import autopilots
from groundstation.mission.runner import Phase
from sitl import personalities
from sitl.fleet import fleet
from sitl.world import World, WorldConfig
from tests.app.flights import Flight, mission
from tests.sitl.virtual_ground import Ground

_HERE = Path(__file__).parents[1] / "third"


@pytest.fixture
def toycopter() -> Iterator[None]:
    """Both halves of it, as long as a test lasts."""
    sides = (personalities, _HERE / "emulated"), (autopilots, _HERE / "flown")
    for side, folder in sides:
        side.__path__.append(str(folder))
        side.discover()
    yield
    for side, folder in sides:
        side.__path__.remove(str(folder))
        sys.modules.pop(f"{side.__name__}.toycopter")
        side.discover()


def _sent(world: World) -> str:
    return hashlib.sha256(b"".join(item.data for item in world.advance(4_000_000_000))).hexdigest()


def test_a_third_personality_flies_a_mission_beside_another_one(toycopter: None) -> None:
    plan = mission("first_flight2", "vehicles.0.autopilot=toycopter", "steps.1.hold.seconds=1")
    flight = Flight(plan)
    assert str(flight.runner.outcome) == "completed", flight.runner.reason
    assert Phase.HOLD in flight.phase_seen
    assert not flight.world.truth.armed.any()
    assert flight.world.autopilots[0].mode_name() == "LAND"


def test_a_third_personality_sends_its_own_messages_and_nobody_else_does(toycopter: None) -> None:
    ground = Ground(WorldConfig(vehicles=[*fleet(1, autopilot="toycopter"), *fleet(2)[1:]]))
    ground.run(2.5)
    assert ground.count(0)["DEBUG_VECT"] == 24
    assert ground.all("DEBUG_VECT")[0][1].name == "toy"
    assert (ground.ask(512, 250), ground.ask(512, 250, vehicle=1)) == (0, 2)


def test_the_bytes_of_the_others_stay_as_they_are(request: pytest.FixtureRequest) -> None:
    config = WorldConfig(vehicles=[*fleet(2), *fleet(3, autopilot="arducopter")[2:]])
    alone = _sent(World(config, 3))
    request.getfixturevalue("toycopter")
    assert list(personalities.PERSONALITIES) == ["px4", "arducopter", "crazyflie", "toycopter"]
    assert _sent(World(config, 3)) == alone


def test_the_desk_serves_it_and_says_what_it_does_not_know_of_it(
    toycopter: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    from groundstation.app.real_sitl import HOME, lines

    with pytest.raises(UserError, match=r"vehicles\[0\]\.autopilot: toycopter: how its own simulator is started"):
        lines(mission("first_flight2", "vehicles.0.autopilot=toycopter"), HOME)
    options = SitlOptions(
        1, "toycopter", 14540, 1, None, False, False, None, "none", "toy", True, 1.0, 0.0, 0.0, False, 0.0, 0.0, 1.0,
        None, 2, False, None,
    )  # fmt: skip
    with open_server(options) as server:
        assert [pilot.mode_name() for pilot in server.world.autopilots] == ["STAND"]
