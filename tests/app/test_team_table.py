"""What the terminal shows of the team in flight, read as text."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from groundstation.app.progress import FlightDisplay
from groundstation.app.session import Session
from groundstation.app.team_table import LastAlarms, team_table
from groundstation.mavlink.vehicle import LANDED_IN_AIR
from groundstation.mission.runner import Runner
from groundstation.mission.timing import SECOND_NS
from tests.app.flights import cube8

NOW_NS = 40 * SECOND_NS
OFFBOARD = 6 << 16


def _team() -> tuple[Session, LastAlarms]:
    """Eight vehicles in the air, one metre above their pads, as the fleet has heard them."""
    plan = cube8()
    session = Session(Runner(plan, 0), None)
    fleet = session.runner.fleet
    fleet.armed[:], fleet.custom_mode[:], fleet.landed_state[:] = True, OFFBOARD, LANDED_IN_AIR
    fleet.battery_remaining[:] = 0.87
    fleet.pos_local_ned_m[:] = [0.0, 0.0, -1.25]
    fleet.vel_ned_m_s[:] = [0.3, 0.0, 0.4]
    fleet.quat_ned_from_frd[:] = [1.0, 0.0, 0.0, 0.0]
    for times in (fleet.pose_ns, fleet.attitude_ns, fleet.heard_ns, fleet.heartbeat_ns):
        times[:] = NOW_NS - SECOND_NS // 10
    session.runner._last_step_ns = NOW_NS
    return session, LastAlarms([vehicle.id for vehicle in plan.spec.vehicles])


def _shown(session: Session, alarms: LastAlarms, lines: int = 40, width: int = 120) -> list[str]:
    text = io.StringIO()
    Console(file=text, width=width).print(team_table(session, session.runner.look(NOW_NS), alarms, NOW_NS, lines))
    return [line.rstrip() for line in text.getvalue().splitlines()]


def test_each_vehicle_has_a_line_with_what_it_does_and_where_it_is() -> None:
    session, alarms = _team()
    session.runner.fleet.battery_remaining[2] = float("nan")
    head, *rows = _shown(session, alarms)
    assert head.split()[:5] == ["id", "does", "mode", "height", "speed"]
    assert [row.split()[0] for row in rows] == [str(number) for number in range(1, 9)]
    assert rows[0].split() == ["1", "with", "the", "team", "OFFBOARD", "1.21", "m", "0.50", "m/s", "0.10", "s", "87%"]
    assert rows[2].split()[-1] == "-"
    session.runner.fleet.armed[4] = False
    assert _shown(session, alarms)[5].split()[1] == "disarmed"


def test_alarms_stand_beside_whom_they_name() -> None:
    session, alarms = _team()
    alarms.take("vehicle 3: battery at 14%, minimum is 15%; it comes back", NOW_NS)
    alarms.take("vehicles 5 and 6: 0.41 m apart, less than r", NOW_NS)
    alarms.take("link udpin://127.0.0.1:14540: nothing heard of anybody", NOW_NS)
    rows = _shown(session, alarms)[1:]
    assert rows[2].endswith("battery at 14%, minimum is 15%")
    assert rows[4].endswith("0.41 m apart, less than r")
    assert rows[5].endswith("0.41 m apart, less than r")
    assert all(row.endswith("%") for row in (rows[0], rows[1], rows[3], rows[6], rows[7]))


@pytest.mark.parametrize(("lines", "shown"), [(4, ["1", "7", "8"]), (5, ["1", "2", "7", "8"])])
def test_where_lines_are_few_those_with_something_wrong_come_first_and_the_rest_is_counted(
    lines: int, shown: list[str]
) -> None:
    session, alarms = _team()
    alarms.take("vehicle 7: is tilted by 69 degrees", NOW_NS)
    session.runner.fleet.pose_ns[7] = NOW_NS - 3 * SECOND_NS
    rows = _shown(session, alarms, lines)[1:]
    assert [row.split()[0] for row in rows[:-1]] == shown
    assert rows[-1].split()[:3] == ["and", str(8 - lines + 1), "more,"]
    assert "nothing of them" in rows[-1]


def test_the_picture_fits_a_small_terminal_and_a_wide_one() -> None:
    session, alarms = _team()
    alarms.take("vehicle 7: " + 20 * "a very long alarm ", NOW_NS)
    for width in (60, 80, 200):
        assert max(map(len, _shown(session, alarms, width=width))) <= width


def test_a_pipe_gets_lines_and_no_picture() -> None:
    session, _ = _team()
    text = io.StringIO()
    with FlightDisplay(Console(file=text, width=120), session.runner.plan) as display:
        session.remark("alarm", "vehicle 7: is tilted", NOW_NS)
        display(session, NOW_NS)
    assert text.getvalue().splitlines() == ["   40.00 s  alarm  vehicle 7: is tilted"]
    shown = io.StringIO()  # still waiting for vehicles: problems, no table
    with FlightDisplay(Console(file=shown, width=120, force_terminal=True), session.runner.plan) as display:
        display(session, NOW_NS)
    assert "with the team" not in shown.getvalue()
