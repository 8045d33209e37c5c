from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from groundstation.core.errors import UserError
from groundstation.mavlink.codec import Encoder
from groundstation.records.manifest import Manifest, manifest_path, write_manifest
from groundstation.records.replay import Flight, Phase, load_flight
from groundstation.records.tlog import TlogWriter

EPOCH_US = 1_577_836_800_000_000
SECOND_NS = 1_000_000_000
SQUARE = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]]


class Recording:
    """A log in the making: positions, setpoints and notes by hand."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.writer = TlogWriter(path, EPOCH_US)
        self.ground = Encoder(255, 190)

    def position(self, sysid: int, t_s: float, ned: Sequence[float]) -> None:
        frame = Encoder(sysid).encode("LOCAL_POSITION_NED", x=ned[0], y=ned[1], z=ned[2])
        self.writer.received(0, "p", frame, round(t_s * SECOND_NS))

    def setpoint(self, sysid: int, t_s: float, ned: Sequence[float], mask: int = 0x0DC7) -> None:
        frame = self.ground.encode(
            "SET_POSITION_TARGET_LOCAL_NED", target_system=sysid, type_mask=mask, vx=ned[0], vy=ned[1], vz=ned[2]
        )
        self.writer.sent(frame, round(t_s * SECOND_NS))

    def load(self, mission: dict[str, Any] | None) -> Flight:
        self.writer.close()
        if mission is not None:
            write_manifest(manifest_path(self.path), Manifest(mission=mission, epoch_unix_us=EPOCH_US))
        return load_flight(self.path)


@pytest.fixture
def recording(tmp_path: Path) -> Recording:
    return Recording(tmp_path / "flight.tlog")


def team(*origins: str) -> dict[str, Any]:
    pads = [[10.0, 20.0, 30.0], [11.0, 20.0, 30.0], [10.0, 22.0, 30.0]]
    vehicles = [{"id": k + 1, "pad_m": pads[k], "origin": origin} for k, origin in enumerate(origins)]
    return {"name": "three", "vehicles": vehicles}


def test_ned_from_the_pad_becomes_enu_in_the_team_frame(recording: Recording) -> None:
    recording.position(1, 0.0, [1.0, 2.0, -3.0])
    recording.position(2, 0.0, [1.0, 2.0, -3.0])
    flight = recording.load(team("pad", "team"))
    np.testing.assert_array_equal(flight.vehicles[0].pos_team_enu_m, [[12.0, 21.0, 33.0]])
    np.testing.assert_array_equal(flight.vehicles[1].pos_team_enu_m, [[2.0, 1.0, 3.0]])


def test_setpoints_are_enu_and_only_those_of_velocity(recording: Recording) -> None:
    recording.position(1, 0.0, [0.0, 0.0, 0.0])
    recording.setpoint(1, 1.0, [0.25, -0.5, 1.0])
    recording.setpoint(1, 2.0, [9.0, 9.0, 9.0], mask=0x0DF8)
    recording.setpoint(2, 2.0, [0.0, 0.0, -1.0])
    flight = recording.load(team("pad", "pad"))
    np.testing.assert_array_equal(flight.vehicles[0].setpoint_vel_enu_m_s, [[-0.5, 0.25, -1.0]])
    np.testing.assert_array_equal(flight.vehicles[0].setpoint_t_ns, [SECOND_NS])
    np.testing.assert_array_equal(flight.vehicles[1].setpoint_vel_enu_m_s, [[0.0, 0.0, 1.0]])
    assert flight.setpoints == 2


def test_positions_are_interpolated_between_reports_and_nowhere_else(recording: Recording) -> None:
    for t_s, east in ((1.0, 0.0), (1.5, 1.0), (4.0, 9.0)):
        recording.position(1, t_s, [0.0, east, 0.0])
    flight = recording.load({"vehicles": [{"id": 1, "origin": "team"}]})
    t_ns = np.array([0.9, 1.0, 1.25, 1.5, 2.0, 4.0, 4.1]) * SECOND_NS
    found = flight.positions_at(t_ns.astype(np.int64))[:, 0, 0]
    np.testing.assert_array_equal(found, [np.nan, 0.0, 0.5, 1.0, np.nan, 9.0, np.nan])


def test_smallest_distance_is_found_between_reports_of_different_times(recording: Recording) -> None:
    # Vehicle 1 passes east along the line; vehicle 2 stands 0.5 m beside it and reports in between.
    for step in range(11):
        recording.position(1, step * 0.2, [0.0, step * 0.2 - 1.1, 0.0])
    for step in range(11):
        recording.position(2, step * 0.2 + 0.1, [0.5, 0.0, 0.0])
    flight = recording.load({"vehicles": [{"id": 1, "origin": "team"}, {"id": 2, "origin": "team"}]})
    assert flight.min_distance_m() == pytest.approx(0.5, abs=1e-6)
    assert flight.samples == 11
    assert flight.duration_s == pytest.approx(2.1)


def test_invalid_positions_are_left_out_and_not_zero(recording: Recording) -> None:
    recording.position(1, 0.0, [0.0, 0.0, 0.0])
    recording.position(2, 0.0, [np.nan, 0.0, 0.0])
    flight = recording.load(team("team", "team"))
    assert [len(track.t_ns) for track in flight.vehicles] == [1, 0]
    assert flight.min_distance_m() is None


def test_without_a_manifest_distances_are_unknown(recording: Recording) -> None:
    recording.position(5, 0.0, [0.0, 0.0, 0.0])
    recording.position(3, 0.0, [0.0, 0.0, 0.0])
    flight = recording.load(None)
    assert [track.sysid for track in flight.vehicles] == [3, 5]
    assert not any(track.in_team_frame for track in flight.vehicles)
    assert flight.min_distance_m() is None
    assert flight.name == "flight"
    assert flight.formation is None


def test_formation_error_follows_the_roles(recording: Recording) -> None:
    places = {1: SQUARE[2], 2: SQUARE[0], 3: [1.0, 0.1, 0.0]}  # role 2 is 0.1 m off, towards role 3
    recording.writer.roles([0, 1, 2], 0)
    for t_s in (0.0, 1.0):
        for sysid, (east, north, up) in places.items():
            recording.position(sysid, t_s, [north, east, -up])
    recording.writer.roles([2, 0, 1], SECOND_NS)
    formation = {"name": "corner", "points": SQUARE, "scale": 1.0, "edges": [[1, 2], [2, 3]]}
    flight = recording.load({**team("team", "team", "team"), "formation": formation})
    t_ns = np.array([0, SECOND_NS])
    wrong = np.sqrt(2) - 0.9  # vehicles 1 and 3, under the first roles at the ends of the diagonal, are 0.9 m apart
    np.testing.assert_allclose(flight.formation_error_at(t_ns), [wrong, 0.1], atol=1e-6)
    assert flight.role_changes == 3
    assert flight.roles_at(SECOND_NS - 1) == (0, 1, 2)
    assert flight.roles_at(SECOND_NS) == (2, 0, 1)
    assert flight.roles_at(-1) is None


def test_vehicles_without_a_role_do_not_count_in_the_error(recording: Recording) -> None:
    recording.writer.roles([0, None, 1], 0)
    for sysid, east in ((1, 0.0), (2, 50.0), (3, 1.25)):
        recording.position(sysid, 0.0, [0.0, east, 0.0])
    formation = {"points": [[0, 0, 0], [0.5, 0, 0], [9, 9, 9]], "scale": 2.0, "edges": "complete"}
    flight = recording.load({**team("team", "team", "team"), "formation": formation})
    assert flight.formation_error_at(np.array([0])) == pytest.approx(0.25)
    assert flight.formation is not None
    assert flight.formation.edges == ((0, 1), (0, 2), (1, 2))


def test_phases_last_until_the_next(recording: Recording) -> None:
    recording.writer.event("phase: form", SECOND_NS)
    recording.writer.event("alarm: vehicle 3: late", 2 * SECOND_NS)
    recording.writer.event("phase: hold", 3 * SECOND_NS)
    recording.writer.operator("stop", 4 * SECOND_NS)
    recording.writer.tick(5 * SECOND_NS, 0)
    recording.writer.received(0, "p", b"12345", 6 * SECOND_NS)
    flight = recording.load(None)
    assert flight.phases == (
        Phase("form", SECOND_NS, 3 * SECOND_NS),
        Phase("hold", 3 * SECOND_NS, 6 * SECOND_NS),
    )
    assert [event.text for event in flight.events][1] == "alarm: vehicle 3: late"
    assert [command.text for command in flight.operator] == ["stop"]
    assert (flight.ticks, flight.noise_bytes, flight.duration_s) == (1, 5, 5.0)


@pytest.mark.parametrize(
    ("mission", "words"),
    [
        ({"vehicles": [{"pad_m": [0, 0, 0]}]}, r"vehicles\[0\]: no usable id"),
        ({"vehicles": [{"id": 1, "pad_m": [0, 0]}]}, r"vehicles\[0\]\.pad_m"),
        ({"formation": {"points": [[0, 0, "x"]]}}, r"formation\.points"),
        ({"formation": {"points": SQUARE, "edges": [[1, 4]]}}, "not in 1 to 3"),
        ({"formation": {"points": SQUARE, "edges": [1]}}, "expected pairs"),
        ({"avoidance": {"radius_m": "wide"}}, r"avoidance\.radius_m"),
    ],
)
def test_damaged_missions_are_told(recording: Recording, mission: dict[str, Any], words: str) -> None:
    with pytest.raises(UserError, match=words):
        recording.load(mission)


def test_radius_is_read_where_it_stands(recording: Recording) -> None:
    assert recording.load({"avoidance": {"radius_m": 0.45}}).safety_radius_m == 0.45
