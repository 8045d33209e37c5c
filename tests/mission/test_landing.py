"""Who may come down when: nobody onto anybody, whatever the pads are, and nobody waits for ever."""

from __future__ import annotations

import json

import numpy as np
import pytest

from groundstation.app.resources import packaged_configs
from groundstation.core import frames
from groundstation.core.types import FloatArray
from groundstation.mavlink.commands import Command, CommandQueue
from groundstation.mavlink.vehicle import LANDED_ON_GROUND, Fleet
from groundstation.mission.flight.guidance import Guide
from groundstation.mission.flight.landing import Around, Landing, landing_distances
from groundstation.mission.flight.poses import Poses
from groundstation.mission.flight.standing import Standing
from groundstation.mission.plan.reading import load_mission
from groundstation.mission.roster import enlist

SECOND_NS = 1_000_000_000
IN_AIR = 2
FLAT = [[0.0, 0.0, 0.0], [0.56, 0.0, 0.0]]
POSTS = [[0.0, 0.0, 0.0], [0.2, 0.0, 0.6]]


class _Wishes(CommandQueue):
    """Commands that nobody takes to anybody."""

    def __init__(self, n: int) -> None:
        super().__init__(n)
        self.asked: list[tuple[int, str]] = []

    def request(self, vehicle: int, command: Command) -> None:
        self.asked.append((vehicle, command.name))


class _Team:
    """Two vehicles on the first two pads, the others far away on the ground; all want to land at the first instant."""

    def __init__(self, pads: list[list[float]]) -> None:
        pads = [*pads, *([5.0 + 2.0 * k, 5.0, 0.0] for k in range(6))]
        vehicles = [
            {"id": k + 1, "link": "udpin://127.0.0.1:14540", "autopilot": "px4", "profile": "px4_quad", "pad_m": pad}
            for k, pad in enumerate(pads)
        ]
        mission = packaged_configs() / "missions" / "cube8.yaml"
        wide = (
            "fence.max_m=[20,20,9]",
            "failsafe.action=hold",
            "position_error_m=0.02",
            "steps.0.form.tolerance_m=0.1",
        )
        self.plan = load_mission(mission, (f"vehicles={json.dumps(vehicles)}", *wide))
        self.fleet = Fleet([vehicle.id for vehicle in self.plan.spec.vehicles], self.plan.link_of_vehicle)
        self.fleet.armed[:2] = True
        self.fleet.landed_state[:] = LANDED_ON_GROUND
        self.fleet.landed_state[:2] = IN_AIR
        self.wishes = _Wishes(8)
        self.roster = enlist(self.plan)
        distances = landing_distances(self.plan, Guide(self.plan).beside_m, 0.15)
        self.landing = Landing(
            self.plan, self.fleet, self.wishes, self.roster, distances, standing=Standing(self.plan, self.fleet)
        )
        self.landing.want([0, 1], 0)
        self.pos_enu_m = np.array(pads)

    def place_enu_m(self, vehicle: int) -> FloatArray:
        """The place that a vehicle was given."""
        return frames.enu_from_ned(self.roster.place_ned_m[vehicle])

    def asked(self, now_s: float) -> list[int]:
        """Who is asked to land at this instant."""
        still = np.tile([1.0, 0, 0, 0], (8, 1))
        nobody = np.zeros(8, dtype=np.bool_)
        poses = Poses(frames.ned_from_enu(self.pos_enu_m), np.zeros((8, 3)), still, nobody)
        self.wishes.asked.clear()
        self.fleet.landed_ns[:] = round(now_s * SECOND_NS)
        home_ned_m = self.plan.pads_enu_m[:, [1, 0, 2]] * [1.0, 1.0, -1.0] - [0.0, 0.0, 0.5]
        self.landing.step(
            round(now_s * SECOND_NS),
            Around(poses, home_ned_m, blind=nobody, unheard=nobody, foreign=nobody, led=~nobody, coming=~nobody),
        )
        return [vehicle for vehicle, _ in self.wishes.asked]


@pytest.mark.parametrize("towards_m", [0.0, 0.1, 0.14])
def test_over_its_pad_or_not_nobody_lands_on_who_is_below(towards_m: float) -> None:
    """Who is below is asked at once, who is above never, however long it waits: it is given another place."""
    team = _Team(FLAT)
    team.pos_enu_m[:2] = [[towards_m, 0.0, 0.4], [0.56 - towards_m, 0.0, 0.9]]
    beside = 0.56 - 2.0 * towards_m >= 0.45
    assert team.asked(0.0) == ([0, 1] if beside else [0])
    if beside:
        return
    asked = [team.asked(0.5 * k) for k in range(1, 200)]
    assert not any(1 in who for who in asked)
    assert np.linalg.norm(team.place_enu_m(1)[:2] - [towards_m, 0.0]) >= 0.45
    team.pos_enu_m[1] = team.place_enu_m(1)
    assert 1 in team.asked(101.0)


def test_who_is_on_the_upper_post_waits_until_the_lower_one_stands() -> None:
    team = _Team(POSTS)
    team.pos_enu_m[:2] = [[0.0, 0.0, 0.5], [0.2, 0.0, 1.1]]
    assert team.asked(0.0) == [0]
    team.pos_enu_m[0, 2] = 0.05
    assert 1 not in team.asked(5.0)
    team.pos_enu_m[0, 2] = 0.0
    team.fleet.landed_state[0] = LANDED_ON_GROUND
    assert 1 in team.asked(6.0)


def test_where_somebody_stands_under_a_post_nobody_lands_beside_it() -> None:
    team = _Team(POSTS)
    team.pos_enu_m[:3] = [[0.0, 0.0, 0.5], [0.2, 0.0, 1.1], [0.0, 0.3, 0.0]]
    assert not [who for k in range(400) for who in team.asked(0.5 * k)]
    places = np.array([team.place_enu_m(0), team.place_enu_m(1), team.pos_enu_m[2]])[:, :2]
    apart_m = np.linalg.norm(places[:, None] - places[None], axis=2)[~np.eye(3, dtype=bool)]
    assert apart_m.min() >= 0.45
    team.pos_enu_m[:2] = [team.place_enu_m(0), team.place_enu_m(1)]
    assert team.asked(201.0) == [0, 1]


def test_who_flies_below_the_post_that_is_lower_is_waited_for() -> None:
    team = _Team(POSTS)
    team.pos_enu_m[:2] = [[0.0, 0.0, 0.5], [0.2, 0.0, 0.3]]  # a pilot brought the upper one down beside the posts
    assert 0 not in team.asked(0.0)
