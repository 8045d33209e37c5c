"""Flights in which somebody says what is not so: under a vehicle's id, from its address, in frames of pymavlink."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from groundstation.core.errors import UserError
from groundstation.mavlink.codec import Frame as WireFrame
from groundstation.mavlink.codec import FrameSplitter, message_id
from groundstation.mission.runner import Phase
from sitl.world import Outgoing, World, WorldConfig
from tests.app.flights import SECOND_NS, Flight, Tamper, pair, still_in
from tests.app.test_fleets import _assert_flown, _assert_on_the_ground
from tests.app.test_take_over import _holds, _left_in_the_air
from tests.mavlink.sender import (
    ARMED,
    COMPANION,
    DISARMED,
    FIXED_WING,
    IN_AIR,
    INVALID,
    LAND,
    LOITER,
    OFFBOARD,
    ON_GROUND,
    ROVER,
    Sender,
)

SHORT = "limits.preflight_s=12"
PX4_TWICE = ("px4", "px4")
NAMES = ("HEARTBEAT", "EXTENDED_SYS_STATE", "GPS_GLOBAL_ORIGIN")
HEARTBEAT, LANDED, ORIGIN = (message_id(name) for name in NAMES)
SET_ORIGIN = message_id("SET_GPS_GLOBAL_ORIGIN")


def _besides(raw: Callable[[], bytes], every_s: float, when: Callable[[Flight], bool]) -> Tamper:
    """A second sender behind the address of vehicle 1."""
    last = [-SECOND_NS]

    def add(datagram: Outgoing, flight: Flight) -> list[Outgoing]:
        if datagram.vehicle_index or not when(flight) or flight.now_ns - last[0] < every_s * SECOND_NS:
            return [datagram]
        last[0] = flight.now_ns
        return [datagram, datagram._replace(data=raw())]

    return add


def _instead(msgid: int, raw: Callable[[], bytes], when: Callable[[Flight], bool]) -> Tamper:
    """Vehicle 1 says something else than what is so, in one kind of message."""

    def put(datagram: Outgoing, flight: Flight) -> list[Outgoing]:
        if datagram.vehicle_index or not when(flight):
            return [datagram]
        pieces = [piece for piece in FrameSplitter().feed(datagram.data) if isinstance(piece, WireFrame)]
        return [datagram._replace(data=b"".join(raw() if item.msgid == msgid else item.raw for item in pieces))]

    return put


def _holding(flight: Flight) -> bool:
    return Phase.HOLD in flight.phase_seen


def _always(_flight: Flight) -> bool:
    return True


def _assert_brought_home(flight: Flight, words: str) -> None:
    """By the emulator's truth: nobody was left hovering, and nobody came down anywhere but on its pad."""
    assert flight.runner.outcome == "aborted"
    assert words in flight.runner.reason
    assert any(words in text for text in flight.texts("alarm"))
    assert "released" not in flight.runner.reason
    assert not flight.world.truth.armed.any()
    assert not flight.world.truth.airborne.any()
    pads = flight.plan.pads_enu_m
    assert (abs(flight.world.truth.pos_enu_m - pads)[:, :2] < 2.0).all()


def test_a_companion_that_speaks_as_the_autopilot_changes_nothing() -> None:
    """On 1719c84: "disarmed by itself; it is released", and it was left hovering while the program ended."""
    companion = Sender(1)

    def raw() -> bytes:
        return companion.heartbeat(DISARMED, 0, kind=COMPANION, autopilot=INVALID)

    flight = Flight(pair(autopilots=PX4_TWICE), tamper=_besides(raw, 0.2, _always))
    _assert_flown(flight)
    (note,) = [text for text in flight.texts("info") if "speaks also what is no autopilot" in text]
    assert note.startswith(
        "vehicle 1: under its id and component 1 speaks also what is no autopilot, onboard controller"
    )


@pytest.mark.parametrize("every_s", [1.0, 0.1])
def test_a_second_autopilot_of_its_kind_behind_its_address_brings_everybody_home(every_s: float) -> None:
    twin = Sender(1)
    plan = pair("steps.1.hold.seconds=20", autopilots=PX4_TWICE)
    flight = Flight(plan, tamper=_besides(lambda: twin.heartbeat(DISARMED, LOITER), every_s, _holding))
    _assert_brought_home(flight, "vehicle 1: two senders say that they are 1, both at emulator:1: their ")


def test_one_that_has_disarmed_and_is_said_to_land_for_ever_is_not_called_armed() -> None:
    """On 1719c84, and after: "still armed after 120 s, it acknowledged disarm and does not do it"; it had disarmed."""
    twin = Sender(1)
    plan = pair("steps.1.hold.seconds=6", autopilots=PX4_TWICE)
    flight = Flight(plan, tamper=_besides(lambda: twin.heartbeat(ARMED, LAND), 0.1, _holding))
    _assert_brought_home(flight, "vehicle 1: two senders say that they are 1, both at emulator:1: their ")
    assert "still armed" not in flight.runner.reason
    assert "vehicle 1: stands on the ground by its own report, whether it is disarmed is not kn" in flight.runner.reason
    assert flight.now_ns < 80 * SECOND_NS


@pytest.mark.parametrize("where", ["emulator:99", "10.0.0.9:5000"])
def test_what_another_address_says_of_a_vehicle_in_the_air_changes_nothing(where: str) -> None:
    """Also on 1719c84: from arming on, what comes from elsewhere is told apart by its address alone."""
    stranger = Sender(1)
    lies = (
        stranger.heartbeat(DISARMED, LOITER), stranger.heartbeat(ARMED, LAND), stranger.landed(ON_GROUND),
        stranger.origin(400_000_000, 100_000_000), stranger.battery(1), stranger.position(5, 50.0),
        stranger.heartbeat(ARMED, 0, kind=ROVER), stranger.text(b"Crash"),
    )  # fmt: skip
    said = [0]

    def lie(flight: Flight) -> tuple[str, bytes] | None:
        if Phase.ARM not in flight.phase_seen:
            return None
        said[0] += 1
        return where, lies[said[0] % len(lies)]

    flight = Flight(pair(autopilots=PX4_TWICE), intrude=lie)
    _assert_flown(flight)
    assert flight.runner.fleet.counts["second sender under a vehicle's id"] > 0.8 * said[0] > 100
    assert not any("Crash" in note.text for note in flight.notes)


LIES: dict[str, tuple[int, Callable[[Sender], bytes], str]] = {
    "disarmed": (
        HEARTBEAT,
        lambda sender: sender.heartbeat(DISARMED, OFFBOARD),
        "vehicle 1: its heartbeats say disarmed, its landed state that it flies; it counts as flying",
    ),
    "on the ground": (
        LANDED,
        lambda sender: sender.landed(ON_GROUND),
        "vehicle 1: says that it stands on the ground, ",
    ),
    "a fixed wing": (
        HEARTBEAT,
        lambda sender: sender.heartbeat(ARMED, OFFBOARD, kind=FIXED_WING),
        "vehicle 1: heartbeats of a fixed wing (MAV_TYPE 1), MAV_AUTOPILOT 12 come under its id, it is a quadrotor",
    ),
}


@pytest.mark.parametrize("lie", LIES)
def test_one_word_against_all_others_is_told_and_nobody_is_left_in_the_air(lie: str) -> None:
    """It begins while holding and ends when the team is over its pads: what lands is told by the true words."""
    msgid, make, words = LIES[lie]
    liar = Sender(1)

    def lies(flight: Flight) -> bool:
        return _holding(flight) and Phase.LAND not in flight.phase_seen

    plan = pair("steps.1.hold.seconds=20", autopilots=PX4_TWICE)
    flight = Flight(plan, tamper=_instead(msgid, lambda: make(liar), lies))
    _assert_brought_home(flight, words)


def test_two_words_that_agree_are_not_believed_of_one_that_is_seen_high_above_its_pad() -> None:
    """Disarmed, and on the ground: it was released, and left in the air when the program ended."""
    liar, own = Sender(1), _instead(HEARTBEAT, lambda: Sender(1).heartbeat(DISARMED, OFFBOARD), _holding)
    grounded = _instead(LANDED, lambda: liar.landed(ON_GROUND), _holding)

    def both(datagram: Outgoing, flight: Flight) -> list[Outgoing]:
        return [item for sent in own(datagram, flight) for item in grounded(sent, flight)]

    flight = Flight(pair("steps.1.hold.seconds=8", autopilots=PX4_TWICE), tamper=both)
    words = "vehicle 1: its heartbeats say disarmed, its landed state that it stands, "
    _assert_brought_home(flight, words)
    assert not any("released" in text for text in flight.texts("alarm"))


@pytest.mark.parametrize("kind", [FIXED_WING, ROVER, 4, 20, 0])
def test_what_is_no_multirotor_is_refused_by_its_type(kind: int) -> None:
    """On 1719c84 fixed wings and rovers passed preflight."""
    sender = Sender(1)
    raw = _instead(HEARTBEAT, lambda: sender.heartbeat(DISARMED, LOITER, kind=kind), _always)
    flight = Flight(pair(SHORT, autopilots=PX4_TWICE), tamper=raw)
    _assert_on_the_ground(flight)
    assert flight.runner.outcome == "refused"
    assert flight.runner.reason.startswith("vehicle 1: it says that it is a ")
    assert "only multirotors are flown" in flight.runner.reason


@pytest.mark.parametrize("kind", [3, 13, 14, 15, 29, 35, 43])
def test_every_multirotor_is_let_through(kind: int) -> None:
    sender = Sender(1)
    raw = _instead(HEARTBEAT, lambda: sender.heartbeat(DISARMED, LOITER, kind=kind), _always)
    flight = Flight(pair("limits.preflight_s=2", autopilots=PX4_TWICE), tamper=raw)
    assert "multirotor" not in flight.runner.reason


def test_an_autopilot_on_component_2_is_told_by_name() -> None:
    """On 1719c84: "no heartbeat", though thousands of its frames were counted."""
    second = Sender(1, 2)

    def as_second(datagram: Outgoing, _flight: Flight) -> list[Outgoing]:
        return [datagram if datagram.vehicle_index else datagram._replace(data=second.heartbeat(DISARMED, LOITER))]

    flight = Flight(pair("limits.preflight_s=3", autopilots=PX4_TWICE), tamper=as_second)
    _assert_on_the_ground(flight)
    assert "vehicle 1: no heartbeat on udpin://0.0.0.0:14540; heard as component 2, and an" in flight.runner.reason


def test_one_that_has_landed_and_whose_landed_state_stays_in_the_air_is_told_as_it_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It was "no heartbeat for 12 s", though one came each second, and "still armed"."""
    monkeypatch.setattr("groundstation.mission.phases.come_down._DOWN_MAX_NS", 25 * SECOND_NS)
    sender = Sender(1)
    stuck = _instead(LANDED, lambda: sender.landed(IN_AIR), lambda flight: flight.runner.phase is Phase.LAND)
    flight = Flight(pair("limits.preflight_s=20", autopilots=PX4_TWICE), tamper=stuck)
    assert flight.runner.outcome == "aborted"
    assert not flight.world.truth.armed.any()
    says = "its heartbeats say disarmed for 12 s, its landed state that it flies; whether it is armed is not known"
    assert f"vehicle 1: {says}; everybody comes back" in flight.runner.reason
    late = "vehicle 1: after 25 s of landing its heartbeats say disarmed, its landed state that it flies, its position"
    assert f"{late} stands " in flight.runner.reason
    assert "above its pad: it has landed, most likely; setpoints stop now; keep away, look" in flight.runner.reason
    for false in ("no heartbeat", "still armed", "vehicle 2"):
        assert false not in flight.runner.reason


# Origins


ANCHORED = ("anchor.lat_deg=47.39774", "anchor.lon_deg=8.54559", "anchor.alt_m=488.0", "set_gps_origin=true")
SWAPPED = ("anchor.lat_deg=8.54559", "anchor.lon_deg=47.39774", "anchor.alt_m=488.0", "set_gps_origin=true")


def _in_zurich(config: WorldConfig) -> WorldConfig:
    return replace(config, home_lat_deg=47.39774, home_lon_deg=8.54559, home_alt_m=488.0)


class Listening(Flight):
    """Counts the origins that are given."""

    origins = 0

    def receive(self, vehicle_index: int, data: bytes, now_ns: int) -> None:
        for piece in FrameSplitter().feed(data):
            self.origins += isinstance(piece, WireFrame) and piece.msgid == SET_ORIGIN
        super().receive(vehicle_index, data, now_ns)


@pytest.mark.parametrize(
    ("changes", "guess"),
    [
        (SWAPPED, "are anchor.lat_deg and anchor.lon_deg swapped?"),
        (
            ("anchor.lat_deg=47.39774", "anchor.lon_deg=-8.54559", *ANCHORED[2:]),
            "is the sign of anchor.lon_deg wrong?",
        ),
        (
            ("anchor.lat_deg=46.90000", "anchor.lon_deg=8.5", *ANCHORED[2:]),
            "correct anchor.lat_deg and anchor.lon_deg (are",
        ),
    ],
    ids=["swapped", "sign", "elsewhere"],
)
def test_a_wrong_anchor_is_given_to_nobody_and_the_right_mission_flies_afterwards(
    changes: tuple[str, ...], guess: str
) -> None:
    """On 1719c84 both vehicles were given it first, and then refused the right mission as well."""
    flight = Listening(pair(*changes, "limits.preflight_s=30", autopilots=PX4_TWICE), change=_in_zurich)
    _assert_on_the_ground(flight)
    assert flight.runner.outcome == "refused"
    assert guess in flight.runner.reason
    assert f"km from its pad by the mission's anchor ({changes[0].partition('=')[2]}" in flight.runner.reason
    assert flight.origins == 0
    if guess.startswith("are "):
        right = Listening(pair(*ANCHORED, autopilots=PX4_TWICE), world=flight.world)
        _assert_flown(right)
        assert right.origins >= 2


@pytest.mark.parametrize("lat_deg", [151.2, -118.0])
def test_a_latitude_that_can_only_be_a_longitude_is_asked_about(lat_deg: float) -> None:
    with pytest.raises(UserError) as refused:
        pair(f"anchor.lat_deg={lat_deg}", "anchor.lon_deg=-33.9", "anchor.alt_m=10.0")
    asked = "expected -89 to 89 (are anchor.lat_deg and anchor.lon_deg swapped?)"
    assert str(refused.value).endswith(f"anchor.lat_deg: {asked}, got {lat_deg}")


def test_an_anchor_just_beyond_the_limit_is_told_with_figures_that_differ() -> None:
    """It was "3 km from its pad, limit 3 km"."""
    changes = ("anchor.lat_deg=47.42474", *ANCHORED[1:], "limits.preflight_s=12")
    flight = Listening(pair(*changes, autopilots=PX4_TWICE), change=_in_zurich)
    assert ", 3.002 km from its pad by the mission's anchor (47.42474, 8.54559), limit 3 km" in flight.runner.reason


@pytest.mark.parametrize("autopilot", ["px4", "arducopter"])
@pytest.mark.parametrize(
    ("alt_m", "given", "says"),
    [
        (0.0, False, "488 m above its pad by anchor.alt_m (0 m)"),
        (700.0, False, "212 m below its pad by anchor.alt_m (700 m)"),
        (440.0, True, "48 m above its pad by anchor.alt_m (440 m)"),
    ],
)
def test_an_anchor_at_a_wrong_height_is_named_and_one_far_off_is_given_to_nobody(
    alt_m: float, given: bool, says: str, autopilot: str
) -> None:
    """By heights above the ellipsoid it is 48 m off here, which is for the pads to tell."""
    changes = (*ANCHORED[:2], f"anchor.alt_m={alt_m}", "set_gps_origin=true", "limits.preflight_s=15")
    twice = (autopilot, autopilot)
    flight = Listening(pair(*changes, autopilots=twice), change=_in_zurich)
    _assert_on_the_ground(flight)
    assert flight.runner.outcome == "refused"
    assert f"its GPS says 488 m above sea level, {says}" in flight.runner.reason
    assert "correct anchor.alt_m, or wait for its GPS (heights above the ellipsoid" in flight.runner.reason
    assert (flight.origins > 0) == (given and autopilot == "px4")  # ArduPilots have an origin of their own
    right = Listening(pair(*ANCHORED, autopilots=twice), world=flight.world)
    _assert_flown(right)


@pytest.mark.parametrize("autopilot", ["px4", "arducopter"])
@pytest.mark.parametrize("north_deg", [0.00027, 0.018])
def test_an_anchor_that_is_off_by_less_than_kilometres_is_named_on_the_pads(north_deg: float, autopilot: str) -> None:
    changes = (f"anchor.lat_deg={47.39774 + north_deg}", *ANCHORED[1:], "limits.preflight_s=12")
    flight = Listening(pair(*changes, autopilots=(autopilot, autopilot)), change=_in_zurich)
    _assert_on_the_ground(flight)
    assert flight.runner.outcome == "refused"
    assert "correct pad_m, or anchor.lat_deg and anchor.lon_deg" in flight.runner.reason
    assert flight.origins == 0


def test_a_wrong_origin_that_somebody_has_written_is_corrected_by_the_right_mission() -> None:
    other = Sender(255, 190)

    def wrong(world: World) -> None:
        for _ in range(200):
            world.advance(world.now_ns + SECOND_NS // 20)
        for vehicle in range(2):
            world.receive(vehicle, other.set_origin(8.545594, 47.397742, target=vehicle + 1), world.now_ns)

    for changes in (ANCHORED, ("set_gps_origin=true",)):
        _assert_flown(Flight(pair(*changes, autopilots=PX4_TWICE), change=_in_zurich, prepare=wrong))
    flight = Flight(pair("limits.preflight_s=15", autopilots=PX4_TWICE), change=_in_zurich, prepare=wrong)
    _assert_on_the_ground(flight)
    assert "vehicle 1: its origin (GPS_GLOBAL_ORIGIN) is kilometres from where it stands" in flight.runner.reason


@pytest.mark.parametrize("place", [(0, 0, 0), (2**31 - 1, 2**31 - 1, 0)])
def test_an_origin_that_is_no_place_is_unknown_and_not_a_jump(place: tuple[int, int, int]) -> None:
    """On 1719c84 0/0/0 was a jump of 5,361 km that landed everybody."""
    sender = Sender(1)
    flight = Flight(pair(autopilots=PX4_TWICE), tamper=_besides(lambda: sender.origin(*place), 0.5, _always))
    _assert_flown(flight)


def test_an_origin_that_its_positions_do_not_follow_lands_nobody_where_it_is() -> None:
    """On 1719c84 one false message landed the vehicle where it was."""
    sender = Sender(1)
    told: list[int] = []

    def once(flight: Flight) -> bool:
        if _holding(flight) and not told:
            told.append(flight.now_ns)
            return True
        return False

    plan = pair("steps.1.hold.seconds=6", autopilots=PX4_TWICE)
    flight = Flight(plan, tamper=_besides(lambda: sender.origin(474_022_600, 85_455_940, 488_000), 0.0, once))
    _assert_brought_home(flight, "m from its own is told under its id (GPS_GLOBAL_ORIGIN), and neither")
    off_pads_m = abs(flight.world.truth.pos_enu_m - flight.plan.pads_enu_m)[:, :2]
    assert off_pads_m.max() < 0.6


def test_a_second_sender_while_the_team_is_arming_is_told_as_one() -> None:
    """It was "acknowledged OFFBOARD mode and did not do it", after a minute; it had."""
    twin = Sender(1)
    flight = Flight(
        pair(autopilots=PX4_TWICE), tamper=_besides(lambda: twin.heartbeat(DISARMED, LOITER), 0.1, lambda _flight: True)
    )
    _assert_on_the_ground(flight)
    assert flight.runner.reason.startswith("vehicle 1: two senders say that they are 1, both at emulator:1: their ")
    assert flight.now_ns < 30 * SECOND_NS


def test_a_take_over_does_not_ask_strangers_where_the_vehicles_began() -> None:
    """One false origin or home left one, or both, hovering: "took off 828,062 m from its pad"."""
    sender = Sender(1)
    plan = pair(autopilots=PX4_TWICE)
    world = _left_in_the_air(plan, still_in(Phase.HOLD, 0.5), prepare=_holds)
    told = sender.origin(400_000_000, 100_000_000) + sender.home(400_000_000, 100_000_000, 500.0)
    flight = Flight(plan, world=world, tamper=_besides(lambda: told, 0.1, _always), take_over=True)
    assert flight.runner.outcome == "completed"
    assert not world.truth.armed.any()
    assert (abs(world.truth.pos_enu_m - plan.pads_enu_m)[:, :2] < 1.0).all()
