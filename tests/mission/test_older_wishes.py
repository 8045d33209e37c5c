"""Who may be in the air is never asked to disarm, and what was asked of it before its landing is forgotten."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from groundstation.core import frames
from groundstation.core.phases import Phase
from groundstation.mavlink.codec import Frame, Splitters, decode
from groundstation.mavlink.commands import CommandQueue
from groundstation.mavlink.vehicle import LANDED_ON_GROUND, Fleet
from groundstation.mission.flight.climb import Climb
from groundstation.mission.flight.columns import Distances
from groundstation.mission.flight.guidance import Guide
from groundstation.mission.flight.landing import Around, Landing, landing_distances
from groundstation.mission.flight.poses import Poses
from groundstation.mission.flight.standing import Standing
from groundstation.mission.ground.arming import Arming
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.roster import enlist
from sitl.world import Outgoing
from tests.app.flights import SECOND_NS, Flight, pair

TAKEOFF, SET_MODE, ARM_DISARM, COMMAND_LONG = 22, 176, 400, 76
OLD_S = 3.0  # age of the last report to stand on the ground, of one whose link has failed


@pytest.fixture(scope="module")
def plan() -> MissionPlan:
    return pair(autopilots=("arducopter", "arducopter"))


def _armed(plan: MissionPlan) -> tuple[Fleet, CommandQueue]:
    """Two vehicles, armed, that have told once, at the first instant, that they stand."""
    fleet = Fleet([vehicle.id for vehicle in plan.spec.vehicles], plan.link_of_vehicle)
    fleet.armed[:] = True
    fleet.landed_state[:], fleet.landed_ns[:] = LANDED_ON_GROUND, 0
    fleet.heartbeat_ns[:] = fleet.heard_ns[:] = 0
    return fleet, CommandQueue(2)


def _distances(plan: MissionPlan) -> Distances:
    return landing_distances(plan, Guide(plan).beside_m, 0.15)


def _names(commands: CommandQueue, now_s: float) -> list[str]:
    return [sent.command.name for sent in commands.due(round(now_s * SECOND_NS))]


@pytest.mark.parametrize("told", [True, False])
def test_whoever_has_not_told_lately_that_it_stands_is_landed_and_not_disarmed(
    plan: MissionPlan, *, told: bool
) -> None:
    fleet, commands = _armed(plan)
    landing = Landing(plan, fleet, commands, enlist(plan), _distances(plan), standing=Standing(plan, fleet))
    landing.want([0], 0)
    still, nobody = np.tile([1.0, 0, 0, 0], (2, 1)), np.zeros(2, dtype=np.bool_)
    pads_ned_m = frames.ned_from_enu(plan.pads_enu_m)
    poses = Poses(pads_ned_m, np.zeros((2, 3)), still, nobody)
    around = Around(poses, pads_ned_m, blind=nobody, unheard=nobody, foreign=nobody, led=~nobody, coming=~nobody)
    sent: list[str] = []
    for k in range(100):
        if told:
            fleet.landed_ns[:] = round(0.1 * k * SECOND_NS)
        landing.step(round(0.1 * k * SECOND_NS), around)
        sent += _names(commands, 0.1 * k)
    assert set(sent) == ({"disarm"} if told else {"LAND mode"})


def test_a_broken_off_arming_disarms_those_alone_that_tell_that_they_stand(plan: MissionPlan) -> None:
    fleet, commands = _armed(plan)
    fleet.landed_ns[1] = round(OLD_S * SECOND_NS)
    landing = Landing(plan, fleet, commands, enlist(plan), _distances(plan), standing=Standing(plan, fleet))
    landing.disarm_on_the_ground(round(OLD_S * SECOND_NS))
    assert [commands.pending(0), commands.pending(1)] == [False, True]


@pytest.mark.parametrize("told", [True, False])
def test_who_waits_armed_for_another_one_is_disarmed_only_where_it_tells_that_it_stands(
    plan: MissionPlan, *, told: bool
) -> None:
    fleet, commands = _armed(plan)
    fleet.custom_mode[:] = 4  # GUIDED
    fleet.armed[1] = False
    arming = Arming(plan, fleet, commands, Standing(plan, fleet), enlist(plan))
    arming._reluctant[1] = True
    names: list[str] = []
    for k in range(60):
        if told:
            fleet.landed_ns[:] = round(0.1 * k * SECOND_NS)
        arming.step(round(0.1 * k * SECOND_NS))
        names += [sent.command.name for sent in commands.due(round(0.1 * k * SECOND_NS)) if sent.vehicle == 0]
    assert ("disarm" in names) == told


def test_nobody_is_asked_to_take_off_who_has_not_told_lately_that_it_stands(plan: MissionPlan) -> None:
    fleet, commands = _armed(plan)
    fleet.landed_ns[1] = round(OLD_S * SECOND_NS)
    climb = Climb(plan, enlist(plan), Guide(plan).beside_m, Standing(plan, fleet))
    climb.step(round(OLD_S * SECOND_NS), fleet, commands, np.zeros(2), np.full(2, 3.0))
    assert [commands.pending(0), commands.pending(1)] == [False, True]


def test_what_was_asked_before_the_landing_is_not_repeated(plan: MissionPlan) -> None:
    fleet, commands = _armed(plan)
    takeoff = plan.autopilots[0].takeoff(3.0)
    assert takeoff is not None
    commands.request(0, takeoff)
    assert _names(commands, 0.0) == ["takeoff"]
    Landing(plan, fleet, commands, enlist(plan), _distances(plan), standing=Standing(plan, fleet)).want([0], 0)
    assert _names(commands, 5.0) == []


def test_a_downlink_that_is_lost_at_takeoff_leads_to_land_and_to_nothing_else(plan: MissionPlan) -> None:
    """ArduCopter hears us and is not heard: it has climbed, and its last word was that it stands."""
    asked: list[tuple[int, float, float]] = []
    gone: list[int] = []

    class Overheard(Flight):
        def receive(self, vehicle_index: int, data: bytes, now_ns: int) -> None:
            for piece in Splitters().feed((0, "ground"), data, stream=False):
                if gone and vehicle_index == 1 and isinstance(piece, Frame) and piece.msgid == COMMAND_LONG:
                    (batch,) = decode([piece])
                    command, first, second = (float(batch.values[name][0]) for name in ("command", "param1", "param2"))
                    asked.append((int(command), first, second))
            super().receive(vehicle_index, data, now_ns)

    def deaf(datagram: Outgoing, flight: Flight) -> list[Outgoing]:
        if flight.runner.phase is Phase.TAKEOFF and not gone:
            gone.append(flight.now_ns)
        return [] if gone and datagram.vehicle_index == 1 else [datagram]

    flight = Overheard(plan, tamper=deaf)
    counted = Counter(command for command, _, _ in asked)
    first_land = next(k for k, (command, _, mode) in enumerate(asked) if (command, mode) == (SET_MODE, 9.0))
    assert counted[ARM_DISARM] == 0
    assert counted[TAKEOFF] > 0
    assert not [command for command, _, _ in asked[first_land:] if command == TAKEOFF]
    assert not flight.world.truth.airborne.any()
    assert "vehicle 2: no position for 1 s; it lands where it is" in flight.runner.reason
