"""Two links with the same system ids on both: the team's ids name the vehicles, from the mission to the report."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from groundstation.app.emulator import world_config
from groundstation.app.exporting import MADE_BY, claim_export
from groundstation.app.link_log import write_link
from groundstation.app.report_facts import facts_of
from groundstation.app.verify import verify_log
from groundstation.core.errors import UserError
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.reading import load_mission
from groundstation.records.notes import Received, Sent
from groundstation.records.replay import load_flight
from groundstation.records.responses import load_motions
from groundstation.records.tlog import read_tlog
from sitl.faults import Fault
from sitl.world import World
from tests.app.flights import CUBE8, HALF_RATE, SECOND_NS, Flight

_IDS = (11, 12, 13, 14, 301, 302, 303, 304)
_OTHER = "udpin://127.0.0.1:14541"


def _two_links(*changes: str) -> MissionPlan:
    """Cube8, the last four behind another link under the system ids of the first four."""
    own = [f"vehicles.{row}.id={name}" for row, name in enumerate(_IDS)]
    own += [f"vehicles.{row}.sysid={row % 4 + 1}" for row in range(8)]
    own += [f"vehicles.{row}.link={_OTHER}" for row in range(4, 8)]
    return load_mission(CUBE8, [*own, *changes])


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Flight, Path]:
    log = tmp_path_factory.mktemp("shared") / "flight.tlog"
    return Flight(_two_links(HALF_RATE, "steps.1.hold.seconds=2"), log=log, seed=4, chatter=True), log


def test_the_same_system_id_on_two_links_is_no_clash_and_the_team_forms(flown: tuple[Flight, Path]) -> None:
    flight, _ = flown
    assert (flight.runner.outcome, flight.runner.reason) == ("completed", "")
    assert flight.world.min_distance_airborne_m >= flight.plan.spec.avoidance.radius_m
    assert flight.runner.fleet.sysid.tolist() == [1, 2, 3, 4, 1, 2, 3, 4]
    said = {text.split(" says: ")[0] for text in flight.texts("info") if " says: " in text}
    assert said == {f"vehicle {name}" for name in _IDS}
    assert not flight.runner.fleet.counts["wrong link"]


def test_its_log_tells_them_apart_and_is_flown_again_to_the_bit(flown: tuple[Flight, Path]) -> None:
    flight, log = flown
    result = verify_log(log)
    assert (result.mismatches, result.complete) == (0, True)
    assert result.setpoints > 1000
    read = load_flight(log)
    assert [(track.id, track.sysid, track.link) for track in read.vehicles] == [
        (name, row % 4 + 1, row // 4) for row, name in enumerate(_IDS)
    ]
    first = np.array([track.pos_team_enu_m[0] for track in read.vehicles])
    assert np.abs(first - flight.plan.pads_enu_m).max() < 0.1
    assert {len(track.setpoint_t_ns) for track in read.vehicles} == {len(read.vehicles[0].setpoint_t_ns)}
    assert sum(len(track.setpoint_t_ns) for track in read.vehicles) == result.setpoints
    assert [motion.id for motion in load_motions(log, 0.1)] == list(_IDS)


def test_its_log_names_the_link_of_every_frame(flown: tuple[Flight, Path]) -> None:
    _, log = flown
    links: dict[bool, set[int | None]] = {True: set(), False: set()}
    peers = set()
    for record in read_tlog(log):
        if isinstance(record, Sent):
            links[True].add(record.link)
        elif isinstance(record, Received):
            links[False].add(record.link)
            peers.add((record.link, record.frame.sysid, record.peer))
    assert links == {True: {0, 1}, False: {0, 1}}
    assert peers == {(row // 4, row % 4 + 1, f"emulator:{name}") for row, name in enumerate(_IDS)}


def test_its_report_counts_lost_frames_by_link(flown: tuple[Flight, Path]) -> None:
    _, log = flown
    rows = facts_of(load_flight(log), log).links[1:]
    assert [row[0] for row in rows] == [str(name) for name in _IDS]
    assert {row[2] for row in rows} == {"0.00 %"}  # nothing was lost; mixed up, every second frame would be


def test_the_frames_of_one_link_are_a_log_for_those_who_know_system_ids_alone(
    flown: tuple[Flight, Path], tmp_path: Path
) -> None:
    _, log = flown
    own = tmp_path / "link1.tlog"
    for _ in range(2):  # what it wrote itself it replaces
        claim_export("tlog", own, force=False)
        told = write_link(log, 1, own, MADE_BY)
    reader = read_tlog(own)
    assert not reader.native
    there = [(record.t_ns, record.frame.raw) for record in reader if isinstance(record, Received | Sent)][1:]
    here = [
        (record.t_ns, record.frame.raw)
        for record in read_tlog(log)
        if isinstance(record, Received | Sent) and record.link == 1
    ]
    first_ns = here[0][0]
    assert there == [(t_ns - first_ns, raw) for t_ns, raw in here]
    assert told["frames"] == len(here)
    assert [track.id for track in load_flight(own).vehicles] == [1, 2, 3, 4]
    with pytest.raises(UserError, match="--link 2: nothing came over it; links in the log: 0, 1"):
        write_link(log, 2, own, MADE_BY)


def test_a_log_in_which_no_id_is_shared_says_nothing_of_links(tmp_path: Path) -> None:
    plan = load_mission(CUBE8, [HALF_RATE, *(f"vehicles.{row}.link={_OTHER}" for row in range(4, 8))])
    log = tmp_path / "flight.tlog"
    Flight(plan, log=log, interrupt_when=lambda flight: flight.now_ns > SECOND_NS)
    assert {record.link for record in read_tlog(log) if isinstance(record, Sent)} == {None}


def test_a_fault_strikes_the_vehicle_of_that_id_alone() -> None:
    fault = Fault("reboot", at_s=0.5, vehicles=(302,))
    world = World(replace(world_config(_two_links()), faults=(fault,)), 0)
    before = list(world.autopilots)
    world.advance(SECOND_NS)
    assert [now is then for now, then in zip(world.autopilots, before, strict=True)] == [row != 5 for row in range(8)]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (["vehicles.5.sysid=1"], "vehicles[5].sysid: 1 on udpin://127.0.0.1:14541 is that of vehicles[4] too"),
        (["vehicles.4.id=11"], "vehicles[4].id: 11 is the id of vehicles[0] too"),
        (["vehicles.4.id=0"], "vehicles[4].id: expected a number of at least 1"),
        (["vehicles.4.sysid=251"], "vehicles[4].sysid: expected a number of at most 250"),
        (["forward=udpout://127.0.0.1:14550"], "it could not tell vehicles of one system id on different links apart"),
        (["positioning={source: mocap}"], "motion capture and gateways know vehicles by their id"),
    ],
)
def test_what_could_not_be_told_apart_is_refused(changes: list[str], words: str) -> None:
    with pytest.raises(UserError) as refused:
        _two_links(*changes)
    assert words in str(refused.value)


def test_an_id_above_250_is_its_place_on_the_link_where_nothing_else_is_said() -> None:
    plan = load_mission(CUBE8, [f"vehicles.{row}.id={row + 249}" for row in range(8)])
    assert plan.sysids == (249, 250, 3, 4, 5, 6, 7, 8)
    assert [vehicle.get("sysid") for vehicle in plan.record()["vehicles"]] == [None, None, 3, 4, 5, 6, 7, 8]
