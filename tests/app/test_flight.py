"""The whole loop on virtual time: runner, bytes, emulator; what people are promised, and what may go wrong."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from groundstation.app.emulator import world_config
from groundstation.app.loop import Interrupts, fly_virtual
from groundstation.app.session import Session
from groundstation.core.formation import Formation
from groundstation.core.types import FloatArray, IntArray
from groundstation.mavlink.codec import Encoder, Frame, FrameSplitter, message_id
from groundstation.mission.flight.guidance import Guide, Setpoints
from groundstation.mission.flight.poses import Poses
from groundstation.mission.monitors.board import Board
from groundstation.mission.monitors.findings import Findings, Sight
from groundstation.mission.runner import Phase, Runner
from sitl.world import Outgoing, World
from tests.app.flights import FULL_RATE, SECOND_NS, Flight, cube8, pair

POSITION = message_id("LOCAL_POSITION_NED")
HEARTBEAT = message_id("HEARTBEAT")
SAMPLE = (1, 6)
"""Vehicles of the lower and the upper half of the cube, counted from 0."""


def _all_down(flight: Flight) -> bool:
    truth = flight.world.truth
    return not truth.armed.any() and not truth.airborne.any()


def _without(datagram: Outgoing, *msgids: int) -> list[Outgoing]:
    pieces = FrameSplitter().feed(datagram.data)
    kept = [piece.raw for piece in pieces if isinstance(piece, Frame) and piece.msgid not in msgids]
    return [datagram._replace(data=b"".join(kept))] if kept else []


class Watched:
    """A flight as it should be, and what was true on the way: flown once for all who look at it.

    Attributes:
        shapes_m: how far the team was from the formation while it was held (``_shape_error_m``).
        apart_m: distance of every two of whom one was in the air, at every tick.
    """

    def __init__(self) -> None:
        self.shapes_m: list[float] = []
        self.apart_m: list[float] = []
        self.flight = Flight(cube8(), seed=3, interrupt_when=self._look, chatter=True)

    def _look(self, flight: Flight) -> bool:
        truth = flight.world.truth
        if flight.runner.phase is Phase.HOLD:
            self.shapes_m.append(_shape_error_m(truth.pos_enu_m, flight.plan.formation, flight.runner.role_of_agent))
        for i, j in itertools.combinations(range(8), 2):
            if truth.airborne[i] or truth.airborne[j]:
                self.apart_m.append(float(np.linalg.norm(truth.pos_enu_m[i] - truth.pos_enu_m[j])))
        return False


@pytest.fixture(scope="module")
def watched() -> Watched:
    return Watched()


@pytest.mark.parametrize("seed", [1, 2, 4])
def test_cube8_is_formed_held_and_landed_on_the_pads_at_every_seed(seed: int) -> None:
    # the first one as it comes
    _formed_held_and_landed(Flight(cube8(*((FULL_RATE,) if seed == 1 else ())), seed=seed, chatter=True))


def test_cube8_is_formed_held_and_landed_on_the_pads_at_the_seed_that_others_look_at(watched: Watched) -> None:
    _formed_held_and_landed(watched.flight)


def _formed_held_and_landed(flight: Flight) -> None:
    assert (flight.runner.outcome, flight.runner.reason) == ("completed", "")
    assert flight.runner.figures.converged
    assert flight.meter.formation_error_m <= 0.05
    assert flight.world.min_distance_airborne_m >= 0.45
    assert _all_down(flight)
    off_pad = np.linalg.norm(flight.world.truth.pos_enu_m[:, :2] - flight.plan.pads_enu_m[:, :2], axis=1)
    assert off_pad.max() < 0.3
    assert [phase.value for phase in flight.phase_seen] == [
        "connect", "arm", "takeoff", "form", "hold", "return", "land", "done",
    ]  # fmt: skip


def _shape_error_m(pos_enu_m: FloatArray, formation: Formation, roles: IntArray) -> float:
    """Largest distance to the formation after the best yaw and translation: no mirror image, no tilt allowed."""
    wanted = formation.points_enu_m[roles] - formation.points_enu_m.mean(axis=0)
    have = pos_enu_m - pos_enu_m.mean(axis=0)
    turn = np.vdot(wanted[:, 0] + 1j * wanted[:, 1], have[:, 0] + 1j * have[:, 1])
    turned = (wanted[:, 0] + 1j * wanted[:, 1]) * turn / abs(turn)
    return float(np.linalg.norm(np.column_stack([turned.real, turned.imag, wanted[:, 2]]) - have, axis=1).max())


def test_the_cube_stands_upright_in_the_world_and_not_only_in_its_distances(watched: Watched) -> None:
    assert len(watched.shapes_m) > 100
    assert max(watched.shapes_m) < 0.08


@pytest.mark.parametrize(
    "phase", [Phase.CONNECT, Phase.ARM, Phase.TAKEOFF, Phase.FORM, Phase.HOLD, Phase.RETURN, Phase.LAND]
)
def test_ctrl_c_once_brings_everybody_back_and_down(phase: Phase) -> None:
    done: list[int] = []

    def interrupt(flight: Flight) -> bool:
        if flight.runner.phase is phase and not done and flight.phase_seen[-1] is phase:
            done.append(flight.now_ns)
            return True
        return False

    flight = Flight(cube8(), interrupt_when=interrupt)
    assert flight.runner.outcome == "aborted"
    assert "operator" in flight.runner.reason
    assert _all_down(flight)
    assert flight.world.min_distance_airborne_m >= 0.45
    off_pad = np.linalg.norm(flight.world.truth.pos_enu_m[:, :2] - flight.plan.pads_enu_m[:, :2], axis=1)
    assert off_pad.max() < 0.3
    if phase in (Phase.CONNECT, Phase.ARM):
        assert Phase.TAKEOFF not in flight.phase_seen


def test_ctrl_c_while_arming_is_under_way_leaves_nobody_armed() -> None:
    """The arm commands are on their way, no heartbeat shows it yet: the runner has to disarm all the same."""
    armed: list[bool] = []
    done: list[int] = []

    def interrupt(flight: Flight) -> bool:
        truth_armed = bool(flight.world.truth.armed.any())
        armed.append(truth_armed)
        if truth_armed and not flight.runner.fleet.armed.any() and not done:
            done.append(flight.now_ns)
            return True
        return False

    flight = Flight(cube8(), interrupt_when=interrupt)
    assert done
    assert flight.runner.outcome == "aborted"
    assert not flight.runner.fleet.armed.any()
    assert _all_down(flight)
    assert Phase.TAKEOFF not in flight.phase_seen


def test_ctrl_c_twice_ends_the_setpoints_and_the_autopilots_land_by_themselves() -> None:
    sent_at: list[tuple[int, int]] = []

    def interrupt(flight: Flight) -> bool:
        sent_at.append((flight.now_ns, flight.runner.setpoints_sent))
        return flight.runner.phase in (Phase.HOLD, Phase.STOP)

    flight = Flight(cube8(), interrupt_when=_twice(interrupt))
    assert flight.runner.outcome == "aborted"
    assert Phase.SILENT in flight.phase_seen
    assert _all_down(flight)
    silent_since = next(note for note in flight.notes if "setpoints stop" in note.text)
    assert silent_since.kind == "alarm"
    counts = [count for _, count in sent_at]
    assert counts[-1] == counts[-200]
    assert any("Failsafe activated" in text for text in flight.texts("info"))


def _twice(condition: Callable[[Flight], bool]) -> Callable[[Flight], bool]:
    fired: list[int] = []

    def once_or_twice(flight: Flight) -> bool:
        if condition(flight) and len(fired) < 2:
            fired.append(flight.now_ns)
            return True
        return False

    return once_or_twice


def test_a_vehicle_that_is_not_there_is_named_and_nothing_is_armed() -> None:
    armed: list[bool] = []

    def absent(datagram: Outgoing, flight: Flight) -> list[Outgoing]:
        armed.append(bool(flight.world.truth.armed.any()))
        return [] if datagram.vehicle_index == 4 else [datagram]

    flight = Flight(cube8("limits.preflight_s=5"), tamper=absent)
    assert flight.runner.outcome == "refused"
    assert flight.runner.reason.startswith("vehicle 5: no heartbeat on udpin://127.0.0.1:14540;")
    assert "vehicle 4" not in flight.runner.reason
    assert not any(armed)
    assert flight.runner.setpoints_sent == 0


def test_positions_that_are_not_numbers_never_arm_a_vehicle() -> None:
    encoder = Encoder(2)

    def spoilt(datagram: Outgoing, _flight: Flight) -> list[Outgoing]:
        if datagram.vehicle_index != 1:
            return [datagram]
        nan = encoder.encode("LOCAL_POSITION_NED", x=math.nan, y=math.nan, z=math.nan)
        return [datagram._replace(data=rest.data + nan) for rest in _without(datagram, POSITION)]

    flight = Flight(cube8("limits.preflight_s=5"), tamper=spoilt)
    assert flight.runner.outcome == "refused"
    assert "vehicle 2: position and attitude: none yet" in flight.runner.reason
    assert flight.runner.fleet.counts["position that is not a number"] > 10
    assert not flight.world.truth.armed.any()


def test_a_vehicle_that_stands_on_another_ones_pad_is_refused() -> None:
    encoder = Encoder(2)

    def elsewhere(datagram: Outgoing, _flight: Flight) -> list[Outgoing]:
        if datagram.vehicle_index != 1:
            return [datagram]
        wrong = encoder.encode("LOCAL_POSITION_NED", x=0.0, y=1.0, z=0.0)
        return [datagram._replace(data=rest.data + wrong) for rest in _without(datagram, POSITION)]

    flight = Flight(cube8("limits.preflight_s=5"), tamper=elsewhere)
    assert flight.runner.outcome == "refused"
    assert "vehicle 2: reports a position 1.00 m from its pad, limit 0.3 m" in flight.runner.reason


@pytest.mark.parametrize("vehicle", SAMPLE)
def test_a_vehicle_whose_position_stops_in_flight_lands_and_the_others_come_back(vehicle: int) -> None:
    """Half of the cube hovers above the other half: whoever is below has to be gone before the blind one comes down."""

    def blind(datagram: Outgoing, flight: Flight) -> list[Outgoing]:
        if datagram.vehicle_index == vehicle and Phase.HOLD in flight.phase_seen:
            return _without(datagram, POSITION)
        return [datagram]

    flight = Flight(cube8(), tamper=blind)
    assert flight.runner.outcome == "aborted"
    assert flight.runner.reason.startswith(f"vehicle {vehicle + 1}: no position for 1 s; it lands where it is")
    assert any("position is 0.5" in text and "holding" in text for text in flight.texts("alarm"))
    assert _all_down(flight)
    assert flight.world.min_distance_airborne_m >= 0.45
    places_m = flight.world.truth.pos_enu_m[:, :2]
    off_pad = np.linalg.norm(places_m - flight.plan.pads_enu_m[:, :2], axis=1)
    # Whose pad is nearer than r to where the blind one stands lands elsewhere; the others on their pads.
    beside_m = np.linalg.norm(flight.plan.pads_enu_m[:, :2] - places_m[vehicle], axis=1)
    assert off_pad[(beside_m > 0.5) & (np.arange(8) != vehicle)].max() < 0.3
    for other in np.flatnonzero((off_pad >= 0.3) & (np.arange(8) != vehicle)).tolist():
        assert f"vehicle {other + 1}: lands " in flight.runner.reason


@pytest.mark.parametrize("vehicle", SAMPLE)
def test_a_vehicle_that_falls_silent_altogether_hits_nobody_and_is_not_waited_for(vehicle: int) -> None:
    """Its link is dead both ways: its own failsafe holds it, and brings it home when the others are down."""
    dead: list[int] = []

    class Cut(Flight):
        def receive(self, vehicle_index: int, data: bytes, now_ns: int) -> None:
            if not (dead and vehicle_index == vehicle):
                super().receive(vehicle_index, data, now_ns)

    def mute(datagram: Outgoing, flight: Flight) -> list[Outgoing]:
        if flight.runner.phase is Phase.HOLD and not dead:
            dead.append(datagram.t_ns)
        return [] if dead and datagram.vehicle_index == vehicle else [datagram]

    flight = Cut(cube8(), tamper=mute)
    assert flight.runner.outcome == "aborted"
    assert f"vehicle {vehicle + 1}: not heard from any more" in flight.runner.reason
    assert flight.world.min_distance_airborne_m >= 0.45
    flight.world.advance(flight.world.now_ns + round(flight.runner.failsafe.down_s) * SECOND_NS)
    assert _all_down(flight)
    assert flight.world.min_distance_airborne_m >= 0.45


def test_two_vehicles_with_one_id_are_named_and_nothing_is_armed() -> None:
    twin = Encoder(3)

    def intrude(flight: Flight) -> tuple[str, bytes] | None:
        return ("elsewhere:1", twin.encode("HEARTBEAT", type=2)) if flight.now_ns > SECOND_NS else None

    flight = Flight(cube8("limits.preflight_s=10"), intrude=intrude)
    assert flight.runner.outcome == "refused"
    assert flight.runner.reason.startswith(
        "vehicle 3: two vehicles say that they are 3, at emulator:3 and elsewhere:1; give each vehicle its own id"
    )
    assert flight.runner.setpoints_sent == 0
    assert not flight.world.truth.armed.any()


def test_a_stranger_who_speaks_under_a_vehicles_id_in_flight_changes_nothing() -> None:
    twin = Encoder(3)

    def intrude(flight: Flight) -> tuple[str, bytes] | None:
        forged = twin.encode("LOCAL_POSITION_NED", x=0.5, y=0.5, z=-1.0) + twin.encode("HEARTBEAT", type=2)
        return ("elsewhere:1", forged) if Phase.TAKEOFF in flight.phase_seen else None

    flight = Flight(cube8(), intrude=intrude)
    assert flight.runner.outcome == "completed"
    assert flight.runner.fleet.counts["second sender under a vehicle's id"] > 500
    assert flight.runner.fleet.peer[2] == "emulator:3"


@pytest.mark.parametrize("broken", ["formation", "to_targets"])
def test_a_fault_in_our_own_mathematics_never_leaves_a_vehicle_without_a_setpoint(
    broken: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    sound = getattr(Guide, broken)

    def faulty(self: Guide, poses: Poses, *rest: object) -> Setpoints:
        if (poses.pos_team_ned_m[:, 2] < -0.45).all():
            raise FloatingPointError("made up")
        return cast("Setpoints", sound(self, poses, *rest))

    monkeypatch.setattr(Guide, broken, faulty)
    gaps: list[int] = []

    def look(flight: Flight) -> bool:
        gaps.append(flight.runner.setpoints_sent)
        return False

    flight = Flight(cube8("land.timeout_s=20", "takeoff.timeout_s=5"), interrupt_when=look)
    assert flight.runner.outcome == "aborted"
    assert "fault in the ground station, FloatingPointError: made up" in flight.runner.reason
    assert _all_down(flight)
    assert flight.world.min_distance_airborne_m >= 0.45
    first = next(k for k, count in enumerate(gaps) if count)
    sent = np.diff(gaps[first:])
    landing = flight.runner.figures.ticks
    assert (sent[: landing - first - 300] == 8).all()


def test_a_desk_that_fails_is_told_once_and_costs_nobody_a_tick() -> None:
    class Broken:
        def sources(self) -> tuple[int, ...]:
            return ()

        def read(self) -> None:
            raise RuntimeError("made up")

        def apply(self, session: Session, now_ns: int) -> None:
            raise RuntimeError("made up")

        def answer(self, session: Session) -> None:
            raise RuntimeError("made up")

    plan = pair()
    session = Session(Runner(plan, 0), None)
    world = World(world_config(plan, 1), 1)
    fly_virtual(
        session, world, period_ns=50_000_000, watchers=(), interrupts=Interrupts(), controls=(Broken(), Broken())
    )
    told = [note.text for note in session.take_notes() if "RuntimeError" in note.text]
    assert told == ["fault in the ground station, Broken: RuntimeError: made up; the flight goes on"] * 2
    assert session.runner.outcome == "completed"


def test_a_takeoff_that_takes_too_long_is_given_up() -> None:
    flight = Flight(pair("takeoff.timeout_s=1"))
    assert flight.runner.reason.startswith("takeoff not finished after 1 s: vehicle ")
    assert Phase.FORM not in flight.phase_seen
    assert _all_down(flight)


def test_a_stream_that_would_flicker_is_ended_and_the_failsafe_takes_over(monkeypatch: pytest.MonkeyPatch) -> None:
    sound = Board.look

    def look(self: Board, sight: Sight) -> Findings:
        findings = sound(self, sight)
        if sight.now_ns > 15 * SECOND_NS:
            findings.silence = "setpoints end, made up"
        return findings

    monkeypatch.setattr(Board, "look", look)
    flight = Flight(pair("failsafe.hold_s=10"), limit_s=400.0)
    assert flight.phase_seen[-2:] == [Phase.SILENT, Phase.DONE]
    assert flight.runner.reason.startswith("setpoints end, made up")
    assert _all_down(flight)


@pytest.mark.parametrize("broken", ["trusted", "look", "obstacles"])
def test_a_fault_in_the_monitors_brings_everybody_home_and_down(broken: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """From the middle of forming on they never work again: landing must not depend on them."""
    sound = getattr(Board, broken)
    begun: list[int] = []

    def faulty(self: Board, *rest: object) -> object:
        if begun:
            raise FloatingPointError("made up")
        return sound(self, *rest)

    def look(flight: Flight) -> bool:
        if flight.runner.phase is Phase.FORM and not begun:
            begun.append(flight.now_ns)
        return False

    monkeypatch.setattr(Board, broken, faulty)
    flight = Flight(cube8(), interrupt_when=look)
    assert flight.runner.outcome == "aborted"
    assert flight.runner.reason == "fault in the ground station, FloatingPointError: made up"
    assert _all_down(flight)
    assert flight.world.min_distance_airborne_m >= 0.45
    off_pad = np.linalg.norm(flight.world.truth.pos_enu_m[:, :2] - flight.plan.pads_enu_m[:, :2], axis=1)
    assert off_pad.max() < 0.3


def test_a_heartbeat_that_stops_while_telemetry_goes_on_brings_everybody_back_in_time() -> None:
    """Mode and arming are not known then; positions are, so that the vehicle is brought back like the others."""
    stopped, back = [], []

    def mute(datagram: Outgoing, flight: Flight) -> list[Outgoing]:
        if datagram.vehicle_index == 6 and Phase.FORM in flight.phase_seen:
            stopped.append(datagram.t_ns)
            return _without(datagram, HEARTBEAT)
        return [datagram]

    def look(flight: Flight) -> bool:
        if flight.runner.phase is Phase.RETURN:
            back.append(flight.now_ns)
        return False

    flight = Flight(cube8("steps.1.hold.seconds=60"), tamper=mute, interrupt_when=look)
    assert flight.runner.reason == (
        "vehicle 7: no heartbeat for 12 s, whether it is armed and follows is not known any more; everybody comes back;"
        " vehicle 7: stands on the ground by its own report, whether it is disarmed is not known, since it sends no"
        " heartbeat; keep away from it, and disarm it by remote control or take its battery out"
    )
    assert 10.9 * SECOND_NS < back[0] - stopped[0] < 12.1 * SECOND_NS
    assert flight.now_ns < back[0] + 40 * SECOND_NS
    assert _all_down(flight)


def test_heartbeats_that_are_missing_for_eight_seconds_while_telemetry_goes_on_disturb_nobody() -> None:
    began: list[int] = []

    def gap(datagram: Outgoing, flight: Flight) -> list[Outgoing]:
        if datagram.vehicle_index == 6 and Phase.HOLD in flight.phase_seen:
            began.append(datagram.t_ns)
            if datagram.t_ns < began[0] + 8 * SECOND_NS:
                return _without(datagram, HEARTBEAT)
        return [datagram]

    flight = Flight(cube8("steps.1.hold.seconds=12"), tamper=gap)
    assert (flight.runner.outcome, flight.runner.reason) == ("completed", "")


def test_a_pilot_who_takes_over_is_not_fought() -> None:
    """The vehicle's mode is changed from outside; from then on it gets neither setpoints nor commands."""
    pilot = Encoder(254, 1)
    told: list[int] = []

    def take_over(flight: Flight) -> bool:
        if flight.runner.phase is Phase.HOLD and not told:
            told.append(flight.now_ns)
            hold = pilot.encode(
                "COMMAND_LONG", target_system=4, target_component=1, command=176, param1=1.0, param2=4.0, param3=3.0
            )
            flight.world.receive(3, hold, flight.now_ns)
        if told and flight.now_ns > told[0] + 20 * SECOND_NS and len(told) == 1:
            told.append(flight.now_ns)
            land = pilot.encode("COMMAND_LONG", target_system=4, target_component=1, command=21)
            flight.world.receive(3, land, flight.now_ns)
        return False

    flight = Flight(cube8("steps.1.hold.seconds=10"), interrupt_when=take_over)
    assert flight.runner.outcome == "aborted"
    assert flight.runner.reason.startswith("vehicle 4: left for mode AUTO.LOITER; it is released")
    truth = flight.world.truth
    assert not np.delete(truth.armed, 3).any()
    assert flight.world.min_distance_airborne_m >= 0.45


@pytest.mark.parametrize("vehicle", SAMPLE)
def test_nobody_stays_under_a_vehicle_that_its_pilot_lands_from_the_formation(vehicle: int) -> None:
    pilot = Encoder(254, 1)
    told: list[int] = []

    def land(flight: Flight) -> bool:
        if flight.runner.phase is Phase.HOLD and not told:
            told.append(flight.now_ns)
            command = pilot.encode("COMMAND_LONG", target_system=vehicle + 1, target_component=1, command=21)
            flight.world.receive(vehicle, command, flight.now_ns)
        return False

    flight = Flight(cube8(), interrupt_when=land)
    assert flight.runner.outcome == "aborted"
    assert f"vehicle {vehicle + 1}: left for mode AUTO.LAND" in flight.runner.reason
    assert _all_down(flight)
    assert flight.world.min_distance_airborne_m >= 0.45


def test_strange_bytes_on_the_link_change_nothing() -> None:
    rng = np.random.default_rng(5)
    stranger = Encoder(99)

    def noisy(datagram: Outgoing, _flight: Flight) -> list[Outgoing]:
        junk = rng.integers(0, 256, 40, dtype=np.uint8).tobytes()
        foreign = stranger.encode("LOCAL_POSITION_NED", x=1.0)
        return [datagram._replace(data=junk + datagram.data + foreign)]

    flight = Flight(cube8(), tamper=noisy)
    assert flight.runner.outcome == "completed"
    assert flight.runner.fleet.counts["unknown system"] > 1000
    assert flight.runner.fleet.counts["bytes that were no frame"] > 10_000


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others(tmp_path: Path) -> None:
    logs = []
    for number, seed in enumerate((4, 4, 5)):
        log = tmp_path / f"{number}.tlog"
        Flight(cube8("steps.1.hold.seconds=1"), seed=seed, log=log)
        logs.append(log.read_bytes())
    assert logs[0] == logs[1]
    assert logs[0] != logs[2]


def test_pairs_of_vehicles_cover_the_whole_team(watched: Watched) -> None:
    """The distance that is reported is the smallest over all pairs of the emulator's own truth."""
    smallest_m = min(watched.apart_m)
    assert watched.flight.world.min_distance_airborne_m <= smallest_m + 1e-9
    assert watched.flight.world.min_distance_airborne_m > smallest_m - 0.02
