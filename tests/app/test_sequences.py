"""Whole flights of several formations in one mission, of moves, and of gridlocks that are resolved on the way."""

from __future__ import annotations

import itertools
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from groundstation.app.verify import verify_log
from groundstation.core.metrics import formation_error_m
from groundstation.mission.runner import Phase
from groundstation.records.replay import load_flight
from tests.app.flights import SECOND_NS, Flight, cube8

STEPS = (
    "steps=[form: {}, move: {by_m: [0.3, -0.2, 0.1], turn_deg: 40, scale: 1.2}, hold: {seconds: 1},"
    " form: {formation: ../formations/two_squares8_low.yaml, gains: ../gains/two_squares8_low.npz,"
    " formation_scale: 1.0}, hold: {seconds: 1}, form: {scale: {kind: free}, assignment: fixed}]"
)


class _Watched:
    """One flight with what was seen on the way."""

    def __init__(self, log: Path) -> None:
        self.log = log
        self.moved_m: list[np.ndarray] = []
        self.move_errors_m: list[float] = []
        self.flight = Flight(cube8(STEPS), log=log, interrupt_when=self._look)

    def _look(self, flight: Flight) -> bool:
        if flight.runner.phase is Phase.MOVE:
            pos = flight.world.truth.pos_enu_m
            self.moved_m.append(pos.copy())
            self.move_errors_m.append(flight.runner.formation_error_m(pos))
        return False


@pytest.fixture(scope="module")
def watched(tmp_path_factory: pytest.TempPathFactory) -> _Watched:
    return _Watched(tmp_path_factory.mktemp("sequence") / "sequence.tlog")


def test_a_sequence_of_formations_moves_and_laws_is_flown_to_its_end(watched: _Watched) -> None:
    runner = watched.flight.runner
    assert (runner.outcome, runner.reason) == ("completed", "")
    assert runner.figures.converged
    formed = [text for text in watched.flight.texts("info") if text.startswith("formed")]
    assert [text.split()[1] for text in formed] == ["cube8", "two_squares8_low", "cube8"]
    assert watched.flight.world.min_distance_airborne_m >= runner.plan.spec.avoidance.radius_m


def test_the_formation_keeps_its_shape_while_it_moves_turns_and_grows(watched: _Watched) -> None:
    assert max(watched.move_errors_m) < 0.1
    first, last = watched.moved_m[0], watched.moved_m[-1]
    np.testing.assert_allclose(last.mean(axis=0) - first.mean(axis=0), [0.3, -0.2, 0.1], atol=0.1)
    a, b = first - first.mean(axis=0), last - last.mean(axis=0)
    turned = np.sum(np.conj(a[:, 0] + 1j * a[:, 1]) * (b[:, 0] + 1j * b[:, 1]))
    assert np.degrees(np.angle(turned)) == pytest.approx(40.0, abs=6.0)
    cube = watched.flight.plan.formation
    roles = np.array(next(note.roles for note in watched.flight.notes if note.roles))
    assert formation_error_m(last, 1.2 * cube.distances_m, roles) < 0.1
    assert np.isfinite(watched.flight.runner.figures.move_error_m)


def test_moves_start_and_stop_smoothly(watched: _Watched) -> None:
    flight = load_flight(watched.log)
    (move,) = [phase for phase in flight.phases if phase.name == "move"]
    common = np.mean([_mean_setpoint(track, move.start_ns, move.stop_ns) for track in flight.vehicles], axis=0)
    assert np.linalg.norm(common[:3], axis=1).max() < 0.08
    assert np.linalg.norm(common[-3:], axis=1).max() < 0.08
    assert np.linalg.norm(common, axis=1).max() <= 0.35
    assert np.linalg.norm(np.diff(common, axis=0), axis=1).max() < 0.15


def _mean_setpoint(track: object, start_ns: int, stop_ns: int) -> np.ndarray:
    """Mean setpoint of each fifth of a second."""
    t_ns, vel = track.setpoint_t_ns, track.setpoint_vel_enu_m_s  # type: ignore[attr-defined]
    edges = np.arange(start_ns, stop_ns - SECOND_NS // 5, SECOND_NS // 5)
    return np.array([vel[(t_ns >= t) & (t_ns < t + SECOND_NS // 5)].mean(axis=0) for t in edges])


def test_its_replay_makes_every_setpoint_again(watched: _Watched) -> None:
    result = verify_log(watched.log)
    assert (result.mismatches, result.complete) == (0, True)
    assert result.setpoints > 5000


def test_the_record_knows_each_formation_from_when_on_it_was_flown(watched: _Watched) -> None:
    flight = load_flight(watched.log)
    assert [(item.name, item.sized) for item in flight.formations] == [
        ("cube8", True),
        ("cube8", False),
        ("cube8", True),
        ("two_squares8_low", True),
        ("cube8", False),
    ]
    holds = [phase for phase in flight.phases if phase.name == "hold"]
    for hold in holds:
        t_ns = np.arange(hold.start_ns, hold.stop_ns, SECOND_NS // 10)
        assert np.nanmax(flight.formation_error_at(t_ns)) < 0.1
    assert np.ptp(flight.formations[2].points_enu_m[:, 2]) == pytest.approx(1.2)


GRIDLOCKED = (
    "assignment=fixed",
    "avoidance={radius_m: 0.8, activation_m: 0.85}",
    "vehicles.0.pad_m=[0, 1, 0]",
    "vehicles.7.pad_m=[-1, -1, 0]",
    "vehicles.1.pad_m=[1, 0, 0]",
    "vehicles.5.pad_m=[0, -1, 0]",
)


@pytest.mark.parametrize("swaps", [True, False])
def test_a_gridlocked_team_forms_is_counted_and_replayed(swaps: bool, tmp_path: Path) -> None:
    log = tmp_path / "gridlock.tlog"
    flight = Flight(cube8(*GRIDLOCKED, f"role_swaps={str(swaps).lower()}"), log=log, seed=2)
    figures = flight.runner.figures
    assert (flight.runner.outcome, flight.runner.reason) == ("completed", "")
    assert figures.gridlocks > 0
    assert (figures.role_swaps > 0) == swaps
    assert swaps or figures.detours > 0
    assert flight.world.min_distance_airborne_m >= 0.8
    roles = [note.roles for note in flight.notes if note.kind == "roles"]
    assert roles[0] == tuple(range(8))
    assert len(load_flight(log).roles) == len(roles)
    changed = [sum(a != b for a, b in zip(old, new, strict=True)) for old, new in itertools.pairwise(roles)]
    assert sum(changed) == 2 * figures.role_swaps
    assert not swaps or verify_log(log).mismatches == 0


FREE = (
    "scale={kind: free}",
    "takeoff.height_m=1.1",
    "min_altitude_m=0.3",
    "avoidance={radius_m: 0.4, activation_m: 0.45}",
)


def _sizes_told(flight: Flight) -> list[float]:
    """Level sizes that the log tells of a formation with free scale."""
    told = [text for text in flight.texts("info") if text.startswith("cube8 stands, with free scale, at ")]
    return [float(text.split(", at ")[1].split()[0]) for text in told]


def test_a_free_formation_that_r_does_not_let_shrink_is_not_said_to_have_moved(tmp_path: Path) -> None:
    log = tmp_path / "free.tlog"
    flight = Flight(cube8(*FREE, "steps=[form: {tolerance_m: 0.08}, move: {scale: 0.35}]"), log=log)
    before, after = _sizes_told(flight)
    assert after > 0.35 * before * 1.1
    assert (flight.runner.outcome, flight.runner.figures.converged) == ("aborted", False)
    assert flight.runner.reason.startswith("move not finished: cube8 stands at ")
    assert re.search(r"0\.4[56] m are kept \(avoidance.radius_m and what positions and gusts", flight.runner.reason)
    assert flight.world.min_distance_airborne_m >= 0.4
    assert verify_log(log).mismatches == 0
    assert [item.sized for item in load_flight(log).formations] == [False] * 3


def test_a_free_formation_that_has_room_moves_to_the_size_that_is_asked_for() -> None:
    flight = Flight(cube8(*FREE, "steps=[form: {tolerance_m: 0.08}, move: {scale: 1.4}]"))
    assert (flight.runner.outcome, flight.runner.reason) == ("completed", "")
    before, after = _sizes_told(flight)
    assert after == pytest.approx(1.4 * before, rel=0.1)


def test_a_move_that_would_leave_the_fence_from_where_the_team_is_does_not_begin() -> None:
    plan = cube8("steps=[form: {}, move: {by_m: [0.5, 0, 0]}]")
    # As if the team had drifted: what was judged by the pads is judged again by where everybody is.
    too_far = replace(plan, moves={1: replace(plan.moves[1], by_enu_m=np.array([4.0, 0.0, 0.0]), seconds=40.0)})
    flight = Flight(too_far, seed=1)
    assert flight.runner.outcome == "aborted"
    assert "move not begun: it would take vehicle" in flight.runner.reason
    assert "beyond the fence" in flight.runner.reason
    assert flight.phase_seen[-3:] == [Phase.RETURN, Phase.LAND, Phase.DONE]
