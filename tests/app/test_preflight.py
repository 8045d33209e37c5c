"""Preflight on virtual time: every check failing alone, what is not told, and what is set."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from groundstation.app.check_screen import check_table, rows_as_values
from groundstation.app.loop import Interrupts, fly_virtual
from groundstation.app.session import Session
from groundstation.app.verify import verify_log
from groundstation.mavlink.codec import Encoder, FrameSplitter, decode, message_id
from groundstation.mavlink.codec import Frame as WireFrame
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.purpose import Purpose
from groundstation.mission.runner import Phase, Runner
from sitl.faults import Fault
from sitl.network import LinkConfig
from sitl.world import Outgoing, World, WorldConfig
from tests.app.flights import SECOND_NS, Flight, pair
from tests.app.test_fleets import _assert_flown, _assert_on_the_ground

PARAM_VALUE, PARAM_SET, VERSION = (message_id(name) for name in ("PARAM_VALUE", "PARAM_SET", "AUTOPILOT_VERSION"))
ESTIMATORS = (message_id("ESTIMATOR_STATUS"), message_id("EKF_STATUS_REPORT"))
BOTH = ("px4", "arducopter")
SHORT = "limits.preflight_s=12"


def _defaults(config: WorldConfig) -> WorldConfig:
    """Vehicles with the parameters that their firmware comes with."""
    return replace(config, vehicles=tuple(replace(vehicle, params=()) for vehicle in config.vehicles))


def _with(*params: tuple[str, float], vehicle: int = 0) -> Callable[[World], None]:
    def change(world: World) -> None:
        for name, value in params:
            world.autopilots[vehicle].params.set_value(name, value)

    return change


def _without(*msgids: int) -> Callable[[Outgoing, Flight], list[Outgoing]]:
    def strip(datagram: Outgoing, _flight: Flight) -> list[Outgoing]:
        pieces = FrameSplitter().feed(datagram.data)
        kept = [piece.raw for piece in pieces if isinstance(piece, WireFrame) and piece.msgid not in msgids]
        return [datagram._replace(data=b"".join(kept))] if kept else []

    return strip


class Checked:
    """``gs check`` on virtual time: until it has an answer."""

    def __init__(
        self,
        plan: MissionPlan,
        *,
        change: Callable[[WorldConfig], WorldConfig] | None = None,
        prepare: Callable[[World], None] | None = None,
        look_only: bool = False,
    ) -> None:
        from groundstation.app.emulator import world_config

        config = world_config(plan, 1)
        self.world = World(config if change is None else change(config), 1)
        if prepare is not None:
            prepare(self.world)
        self.runner = Runner(plan, 0, Purpose.LOOK if look_only else Purpose.PREPARE)
        self.sent: dict[int, int] = {}
        self.now_ns = 0
        session = Session(self.runner, None)
        fly_virtual(
            session,
            self,
            period_ns=round(SECOND_NS / plan.spec.rate_hz),
            watchers=(),
            interrupts=Interrupts(),
        )
        self.notes = [note.text for note in session.take_notes()]

    def advance(self, now_ns: int) -> list[Outgoing]:
        self.now_ns = now_ns
        return self.world.advance(now_ns)

    def receive(self, vehicle_index: int, data: bytes, now_ns: int) -> None:
        for piece in FrameSplitter().feed(data):
            if isinstance(piece, WireFrame):
                self.sent[piece.msgid] = self.sent.get(piece.msgid, 0) + 1
        self.world.receive(vehicle_index, data, now_ns)


def test_all_is_well_in_a_few_seconds_and_nothing_is_set() -> None:
    checked = Checked(pair())
    assert checked.runner.outcome == "completed"
    assert checked.now_ns < 8 * SECOND_NS
    assert PARAM_SET not in checked.sent
    rows = checked.runner.check_rows()
    assert [row.ready for row in rows] == [True, True]
    assert [row.firmware for row in rows] == ["px4 1.17.0 dev", "arducopter 4.7.0 dev"]
    assert [(row.estimator, row.failsafe, row.role) for row in rows] == [
        ("good", "as planned", 1),
        ("good", "as planned", 2),
    ]
    assert all(row.notes == () and row.battery == 1.0 and 0.4 < row.battery_need < 0.5 for row in rows)
    assert all(row.positions_hz > 10.0 and row.clock_s < 0.1 and row.off_pad_m < row.off_pad_limit_m for row in rows)
    assert check_table(rows).row_count == 2
    assert rows_as_values(rows)[1]["mode"] == "STABILIZE"


def test_parameters_of_the_firmware_are_refused_and_fix_sets_them(tmp_path: Path) -> None:
    flight = Flight(pair(SHORT), change=_defaults)
    _assert_on_the_ground(flight)
    reason = flight.runner.reason
    assert flight.runner.outcome == "refused"
    assert "vehicle 1: 2 parameters" not in reason
    assert "NAV_DLL_ACT is 0" in reason
    assert "vehicle 2: " in reason
    assert "FS_GCS_ENABLE is 0" in reason
    assert "`gs check --fix` sets" in reason
    assert [row.failsafe.endswith("wrong") for row in flight.runner.check_rows()] == [True, True]

    log = tmp_path / "flight.tlog"
    flight = Flight(pair("failsafe.set_parameters=true"), change=_defaults, log=log)
    _assert_flown(flight)
    assert any(
        "vehicle 1: parameters were set: " in text and "NAV_DLL_ACT from 0 to 3" in text
        for text in flight.texts("info")
    )
    assert flight.world.autopilots[1].params["FS_GCS_ENABLE"] == 5
    result = verify_log(log)
    assert (result.mismatches, result.setpoints > 100) == (0, True)


def test_fix_sets_once_and_finds_nothing_to_set_again() -> None:
    plan = pair("failsafe.set_parameters=true")
    first = Checked(plan, change=_defaults)
    assert first.runner.outcome == "completed"
    assert first.sent[PARAM_SET] > 5
    kept = [tuple((name, pilot.params[name]) for name in ("COM_LOW_BAT_ACT", "NAV_DLL_ACT", "COM_OBL_RC_ACT"))
            for pilot in first.world.autopilots[:1]]  # fmt: skip
    assert kept == [(("COM_LOW_BAT_ACT", 3.0), ("NAV_DLL_ACT", 3.0), ("COM_OBL_RC_ACT", 5.0))]
    assert PARAM_SET not in Checked(plan).sent


def _swap(world: World) -> None:
    world.dynamics.motion.pos_enu_m[:, [0, 1]] = world.dynamics.motion.pos_enu_m[:, [1, 0]]


def _one_moved(world: World) -> None:
    world.dynamics.motion.pos_enu_m[:, 0] = world.dynamics.motion.pos_enu_m[:, 1] + np.array([0.0, 0.5, 0.0])


def _close_up(world: World) -> None:
    world.dynamics.motion.pos_enu_m[0] *= 0.2


def _battery(left: float) -> Callable[[World], None]:
    def drain(world: World) -> None:
        world.autopilots[0].battery.left = left

    return drain


def _old(version: int) -> Callable[[World], None]:
    def age(world: World) -> None:
        pilot = world.autopilots[0]
        pilot.version_fields = {**pilot.version_fields, "flight_sw_version": version}  # type: ignore[misc]

    return age


def _stubborn(world: World) -> None:
    world.autopilots[0].params.set_value("NAV_DLL_ACT", 0.0)
    world.autopilots[0].params.set_value = lambda name, value: False  # type: ignore[method-assign]


ANCHOR = "anchor={lat_deg: 47.397742, lon_deg: 8.545594, alt_m: 488.0}"


@pytest.mark.parametrize(
    ("prepare", "changes", "words"),
    [
        (_swap, (ANCHOR,), " m from its pad, limit 1.32 m: it stands"),
        (_swap, (ANCHOR,), ": it stands on the pad of vehicle 2, and vehicle 2 on its pad; exchange them"),
        (_one_moved, (ANCHOR,), "it stands on the pad of vehicle 2; put it on its own pad, or correct pad_m"),
        (_close_up, (ANCHOR, "limits.pad_error_m=2.4"), " m from vehicle 2, minimum is 2.5 m (avoidance.radius_m)"),
        (_battery(0.3), (), "vehicle 1: battery at 30%, the mission of about 51 s needs 46%: 6% to fly"),
        (_battery(0.9), ("vehicles.0.endurance_s=100",), "needs 108%"),
        (_battery(0.9), ("vehicles.0.endurance_s=100",), "; make the mission shorter"),
        (_old(0x010B0000), (), "vehicle 1: its firmware is 1.11.0 dev, 1.12 at least is needed; update it"),
        (_with(("COM_OBL_RC_ACT", 7)), (), "COM_OBL_RC_ACT is 7: motors off: it falls; that is what it does"),
        (_with(("COM_OF_LOSS_T", 30.0)), (), "vehicle 1: COM_OF_LOSS_T is 30: "),
        (_with(("NAV_DLL_ACT", 0)), (), "NAV_DLL_ACT is 0: does nothing; that is what it does when the ground station"),
        (_with(("COM_LOW_BAT_ACT", 0)), (), "set 3; `gs check --fix` sets it"),
        (_with(("FS_GCS_ENABLE", 0), vehicle=1), (), "vehicle 2: FS_GCS_ENABLE is 0: does nothing;"),
        (_with(("FS_EKF_ACTION", 0), vehicle=1), (), "vehicle 2: FS_EKF_ACTION is 0: only reports;"),
        (_with(("GUID_TIMEOUT", 20.0), vehicle=1), (), "vehicle 2: GUID_TIMEOUT is 20: so long it"),
        (_with(("MAV_GCS_SYSID", 1), vehicle=1), (), "MAV_GCS_SYSID is 1: the heartbeats of this ground station"),
        (_stubborn, ("failsafe.set_parameters=true",), "set 3; it was told to, and keeps it: set it by hand"),
        (None, ("failsafe.action=return",), "mission: failsafe.action: return: 2 vehicles that return one"),
    ],
)  # fmt: skip
def test_each_check_refuses_alone(
    prepare: Callable[[World], None] | None, changes: tuple[str, ...], words: str
) -> None:
    flight = Flight(pair(SHORT, *changes), prepare=prepare)
    assert flight.runner.outcome == "refused"
    assert words in flight.runner.reason
    assert not flight.world.truth.armed.any()
    assert set(flight.phase_seen) <= {Phase.CONNECT, Phase.DONE}
    assert flight.runner.setpoints_sent == 0


def test_the_rest_of_the_team_is_told_together() -> None:
    flight = Flight(pair(SHORT), change=_defaults, prepare=_battery(0.1))
    assert "vehicle 1: battery at 10%" in flight.runner.reason
    assert "vehicle 1: " in flight.runner.reason
    assert "vehicle 2: " in flight.runner.reason


@pytest.mark.parametrize(
    ("vehicle", "flags", "words"),
    [
        # what a real PX4 1.16 tells before it has GPS, after 2 s, and in its first second
        (0, 0xE5, "has no velocity"),
        (0, 0x480, "finds GPS far from where it believes to be"),
        (0, 0x33F & ~0x18, "has no position"),
        (0, 0x33F & ~0x4, "has no vertical velocity"),
        (0, 0x3FF & ~0x300, "has nothing that measures its position"),
        (0, 0x33E, "has no attitude"),
        # what a real ArduCopter 4.7 tells from 8 s to 41 s, and before
        (1, 0xA7, "has nothing that measures its position"),
        (1, 0x400, "has not begun"),
        (1, 0x33F & ~0x20, "has no height"),
        (1, 0x33F | 0x8000, "sees GPS jump"),
    ],
)
def test_an_estimator_that_is_not_well_is_waited_for_and_then_named(vehicle: int, flags: int, words: str) -> None:
    encoder = Encoder(vehicle + 1)
    strip = _without(*ESTIMATORS)
    name = ("ESTIMATOR_STATUS", "EKF_STATUS_REPORT")[vehicle]

    def sick(datagram: Outgoing, flight: Flight) -> list[Outgoing]:
        if datagram.vehicle_index != vehicle:
            return [datagram]
        return [item._replace(data=item.data + encoder.encode(name, flags=flags)) for item in strip(datagram, flight)]

    flight = Flight(pair(SHORT), tamper=sick)
    _assert_on_the_ground(flight)
    remedy = "let it stand still, see to its GPS or motion capture, or restart it"
    assert f"vehicle {vehicle + 1}: its estimator: {words}; {remedy}" in flight.runner.reason


def test_what_is_not_told_is_told_and_not_waited_for() -> None:
    flight = Flight(pair(), tamper=_without(PARAM_VALUE, VERSION, *ESTIMATORS))
    _assert_flown(flight)
    told = flight.texts("info")
    for vehicle, message in ((1, "ESTIMATOR_STATUS"), (2, "EKF_STATUS_REPORT")):
        assert any(text.startswith(f"vehicle {vehicle}: answers no question for its parameters;") for text in told)
        assert f"vehicle {vehicle}: does not tell its firmware's version" in told
        assert any(f"vehicle {vehicle}: does not tell how its estimator does ({message})" in text for text in told)
    assert [row.failsafe for row in flight.runner.check_rows()] == ["not told", "not told"]


def test_a_battery_that_is_not_told_is_left_to_people() -> None:
    status = message_id("SYS_STATUS")
    encoder = Encoder(1)

    def unknown(datagram: Outgoing, _flight: Flight) -> list[Outgoing]:
        out = b""
        for piece in FrameSplitter().feed(datagram.data):
            if not isinstance(piece, WireFrame):
                continue
            if datagram.vehicle_index == 0 and piece.msgid == status:
                (batch,) = decode([piece])
                names = batch.values.dtype.names or ()
                fields = {name: batch.values[name][0].item() for name in names}
                out += encoder.encode("SYS_STATUS", **{**fields, "battery_remaining": -1})
            else:
                out += piece.raw
        return [datagram._replace(data=out)]

    flight = Flight(pair(), tamper=unknown)
    _assert_flown(flight)
    told = flight.texts("info")
    assert "vehicle 1: does not tell what is left in its battery; 46% have to be, look at it by hand" in told


def test_a_parameter_that_the_firmware_does_not_have_is_told_and_not_waited_for() -> None:
    def older(world: World) -> None:
        params = world.autopilots[0].params
        params._position.pop("COM_LOW_BAT_ACT")
        params = world.autopilots[1].params
        params._position.pop("FS_EKF_ACTION")

    flight = Flight(pair(), prepare=older)
    _assert_flown(flight)
    assert "vehicle 1: its firmware has no COM_LOW_BAT_ACT; look up what it does instead" in flight.texts("info")
    assert "vehicle 2: its firmware has no FS_EKF_ACTION; look up what it does instead" in flight.texts("info")
    assert flight.runner.figures.ticks * 0.05 < 80


def test_what_is_unusual_is_told_and_flown() -> None:
    flight = Flight(pair(), prepare=_with(("COM_OF_LOSS_T", 3.0), ("COM_DL_LOSS_T", 16)))
    _assert_flown(flight)
    assert any("vehicle 1: unusual: COM_OF_LOSS_T is 3: " in text for text in flight.texts("info"))
    assert flight.runner.check_rows()[0].failsafe == "2 unusual"


def test_an_old_but_usable_firmware_is_told() -> None:
    checked = Checked(pair(), prepare=_old(0x010D02FF))
    assert checked.runner.outcome == "completed"
    assert "vehicle 1: its firmware 1.13.2 is older than 1.14, from which on its failsafes are known" in checked.notes


def test_nothing_is_set_in_a_vehicle_that_is_armed() -> None:
    def armed(world: World) -> None:
        world.autopilots[0].arm()

    checked = Checked(pair("failsafe.set_parameters=true"), change=_defaults, prepare=armed)
    assert checked.runner.outcome == "refused"
    assert "vehicle 1: is armed already" in checked.runner.reason
    assert PARAM_SET not in checked.sent


def test_parameters_fit_a_narrow_radio_that_two_share() -> None:
    radio = "serial:///dev/ttyUSB0:57600"
    plan = pair("rate_hz=20", *(f"vehicles.{number}.link={radio}" for number in (0, 1)), "failsafe.set_parameters=true")
    checked = Checked(plan, change=_defaults)
    assert checked.runner.outcome == "completed"
    assert checked.now_ns < 20 * SECOND_NS


def test_commands_that_are_ignored_do_not_hang_preflight() -> None:
    def deaf(world: World) -> None:
        world.inject(Fault("commands_ignored"))

    flight = Flight(pair("limits.preflight_s=40", "limits.arming_s=10", autopilots=("px4", "px4")), prepare=deaf)
    _assert_on_the_ground(flight)
    assert flight.now_ns < 75 * SECOND_NS
    assert "vehicle 1: is heard, and answers no command" in flight.runner.reason


@pytest.mark.parametrize(
    ("each_way_s", "declared_s", "told"),
    [(0.03, 0.0, False), (0.06, 0.0, True), (0.11, 0.0, True), (0.06, 0.05, False)],
)
def test_a_round_trip_that_makes_the_team_swing_is_told_once_and_not_refused(
    each_way_s: float, declared_s: float, told: bool
) -> None:
    """Above the limit (0.25 s for this pair) it is refused, see the poor links."""

    def slow(config: WorldConfig) -> WorldConfig:
        late = LinkConfig(delay_ns=round(each_way_s * SECOND_NS))
        return replace(config, uplink=late, downlink=late)

    checked = Checked(pair(f"link_delay_s={declared_s}"), change=slow)
    assert checked.runner.outcome == "completed"
    notes = [note for note in checked.notes if "its answers take" in note]
    assert [note[:11] for note in notes] == (["vehicle 1: ", "vehicle 2: "] if told else [])
    for note in notes:
        named_s = float(note.rpartition("link_delay_s: ")[2].removesuffix(" would make it calmer"))
        assert 2.0 * each_way_s <= named_s < 2.0 * each_way_s + 0.03
