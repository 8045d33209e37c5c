"""What is told at the end of those that are left: by whose vehicle it is, and by what it said last. No flights."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from groundstation.app.resources import packaged_configs
from groundstation.core import frames
from groundstation.mavlink.vehicle import LANDED_IN_AIR, LANDED_ON_GROUND
from groundstation.mission.flight.poses import Poses
from groundstation.mission.phases.come_down import LandPhase
from groundstation.mission.phases.on_the_ground import ArmPhase
from groundstation.mission.phases.state import Entry
from groundstation.mission.phases.table import Event
from groundstation.mission.plan.reading import load_mission
from groundstation.mission.reasons.blame import HELP_IN_THE_AIR
from groundstation.mission.team import Team

SECOND_NS = 1_000_000_000
TICK_NS = SECOND_NS // 5
LANDS_NS = 100 * SECOND_NS
LOITER = 50593792
PLAN = load_mission(packaged_configs() / "missions" / "first_flight2.yaml")


def _ours(team: Team) -> None:
    """Nothing becomes of it."""


def _released(team: Team) -> None:
    team.roster.release([0])


def _killed(team: Team) -> None:
    team.killing.want([0], LANDS_NS)


def _silent(team: Team, now_ns: int) -> None:
    """Nothing is heard of it from the moment on when landing begins."""
    team.fleet.armed[0] = True
    team.fleet.landed_state[0] = LANDED_IN_AIR


def _shows_and_falls_silent(team: Team, now_ns: int) -> None:
    """One heartbeat says disarmed a second later, then nothing."""
    team.fleet.armed[0] = now_ns < LANDS_NS + SECOND_NS
    team.fleet.heard_ns[0] = team.fleet.heartbeat_ns[0] = min(now_ns, LANDS_NS + SECOND_NS)


def _no_heartbeats(team: Team, now_ns: int) -> None:
    """It goes on telling that it stands on the ground, and sends no heartbeat."""
    team.fleet.armed[0] = True
    team.fleet.landed_state[0] = LANDED_ON_GROUND
    team.fleet.heard_ns[0] = team.fleet.landed_ns[0] = now_ns


Says = Callable[[Team, int], None]


def _told(fate: Callable[[Team], None], says: Says) -> tuple[str, float]:
    """The reason at the end, and how long it took: vehicle 1 has this fate, 2 is down and disarmed after 15 s."""
    team = Team(PLAN, 0)
    fleet, above = team.fleet, frames.ned_from_enu(PLAN.pads_enu_m) - [0.0, 0.0, 2.0]
    poses = Poses(above, np.zeros((2, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)), np.zeros(2, dtype=np.bool_))
    fleet.armed[:] = True
    fleet.landed_state[:] = LANDED_IN_AIR
    fleet.custom_mode[:] = LOITER
    for times in (fleet.heard_ns, fleet.heartbeat_ns, fleet.landed_ns):
        times[:] = LANDS_NS
    team.stance.take_off(SECOND_NS)
    fate(team)
    phase = LandPhase(team, Entry(LANDS_NS))
    for now_ns in range(LANDS_NS + TICK_NS, LANDS_NS + 200 * SECOND_NS, TICK_NS):
        fleet.heard_ns[1] = fleet.heartbeat_ns[1] = fleet.landed_ns[1] = now_ns
        if now_ns >= LANDS_NS + 15 * SECOND_NS:
            fleet.armed[1], fleet.landed_state[1] = False, LANDED_ON_GROUND
        says(team, now_ns)
        team.landing.step(now_ns, team.around(poses, coming=True, silent=False))
        if phase.step(now_ns, poses).event is Event.DOWN:
            return team.verdict.reason, (now_ns - LANDS_NS) / SECOND_NS
    raise AssertionError("it never ends")


LOST = f"vehicle 1: not heard from any more, whether it has landed is not known; if it flies, {HELP_IN_THE_AIR}"
UNSURE = (
    "vehicle 1: stands on the ground by its own report, whether it is disarmed is not known, since it sends no"
    " heartbeat; keep away from it, and disarm it by remote control or take its battery out"
)
FLIES_ON = f"vehicle 1 may still be in the air, in AUTO.LOITER when last told; {HELP_IN_THE_AIR}"
NOT_SHOWN = (
    "vehicle 1: told to stop its motors, and nothing shows that it did; keep clear of it, stop it by remote control"
)
STILL_ARMED = (
    "vehicle 1: told to stop its motors, and still armed by its own report after 120 s; keep clear of it, stop it by"
    " remote control"
)


@pytest.mark.parametrize(
    ("fate", "says", "reason", "least_s", "most_s"),
    [
        (_ours, _silent, LOST, 15, 20),
        (_ours, _no_heartbeats, UNSURE, 15, 20),
        (_released, _silent, FLIES_ON, 15, 20),
        (_released, _no_heartbeats, "", 15, 20),
        (_killed, _shows_and_falls_silent, "", 15, 20),
        (_killed, _silent, NOT_SHOWN, 15, 20),  # nobody waits for a report that will not come
        (_killed, _no_heartbeats, STILL_ARMED, 120, 125),
    ],
)
def test_one_that_is_not_ours_is_not_judged_at_the_end(
    fate: Callable[[Team], None], says: Says, reason: str, least_s: float, most_s: float
) -> None:
    told, took_s = _told(fate, says)
    assert told == reason
    assert least_s <= took_s <= most_s


def test_a_killed_one_that_starts_anew_while_everybody_is_disarmed_is_not_blamed_for_it() -> None:
    for fate, words in (
        (_ours, "vehicle 1: has started anew while the team was arming; see to its power"),
        (_killed, None),
    ):
        team = Team(PLAN, 0)
        arming = ArmPhase(team, Entry(LANDS_NS)).arming
        fate(team)
        team.fleet.restarts[0] += 1
        assert arming.started_anew() == words
