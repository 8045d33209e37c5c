"""What sensors leave of views: by hand, by counting, and against scipy's rotations."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from groundstation.core.sensing import Sensor, Sharing, cameras, lost, noise_m, sensed
from groundstation.core.types import FloatArray


def _rel(*places_m: tuple[float, float, float]) -> FloatArray:
    """Relative positions of agents that all face forward, along x."""
    pos = np.array(places_m)
    rel = pos[None] - pos[:, None]
    return np.where(np.eye(len(pos), dtype=bool)[..., None], np.nan, rel)


IN_A_ROW = _rel((0.0, 0.0, 0.0), (2.0, 0.0, 0.0), (2.0, 1.0, 0.0))


def _edges(sensor: Sensor, now_s: float = 0.0) -> list[tuple[int, int]]:
    return [(int(i), int(j)) for i, j in np.argwhere(sensed(sensor, IN_A_ROW, now_s))]


def test_a_plain_sensor_sees_everybody_but_itself_and_those_without_a_position() -> None:
    assert len(_edges(Sensor())) == 6
    unknown = IN_A_ROW.copy()
    unknown[0], unknown[:, 0] = np.nan, np.nan
    assert sensed(Sensor(), unknown, 0.0).tolist() == [[False] * 3, [False, False, True], [False, True, False]]


def test_range_is_that_of_space() -> None:
    assert _edges(Sensor(range_m=2.1)) == [(0, 1), (1, 0), (1, 2), (2, 1)]
    assert _edges(Sensor(range_m=math.sqrt(5.0) + 1e-9)) == _edges(Sensor())


@pytest.mark.parametrize(
    ("share", "edges"),
    [
        # The first looks at both others; these have it behind them, and each other at their sides.
        ("own", [(0, 1), (0, 2)]),
        ("either", [(0, 1), (0, 2), (1, 0), (2, 0)]),
        ("both", []),
    ],
)
def test_an_edge_is_there_as_its_ends_share_it(share: Sharing, edges: list[tuple[int, int]]) -> None:
    assert _edges(Sensor(field_of_view_rad=math.radians(90.0), share=share)) == edges


def test_the_field_of_view_is_a_cone_about_the_nose() -> None:
    above = _rel((0.0, 0.0, 0.0), (1.0, 0.0, 1.0))
    for opening_deg, seen in ((89.0, False), (91.0, True)):
        found = sensed(Sensor(field_of_view_rad=math.radians(opening_deg), share="own"), above, 0.0)
        assert bool(found[0, 1]) is seen
    behind = Sensor(field_of_view_rad=math.radians(359.0), share="own")
    assert _edges(behind) == [(i, j) for i, j in _edges(Sensor()) if (i, j) != (1, 0)]


@pytest.mark.parametrize("share", ["either", "both", "own"])
def test_edges_are_lost_for_their_share_of_the_time_and_whole_slots(share: Sharing) -> None:
    sensor = Sensor(loss=0.3, lost_for_s=0.5, share=share, seed=4)
    gone = np.array([lost(sensor, 4, 0.1 * k) for k in range(10_000)])
    away = gone[:, ~np.eye(4, dtype=bool)]
    assert away.mean() == pytest.approx(0.3, abs=0.02)
    assert away.mean(axis=0).max() < 0.4
    runs = [run for edge in away.T for run in "".join("x" if item else " " for item in edge).split()[1:-1]]
    assert min(map(len, runs)) >= 4  # five samples of 0.1 s to a slot, one of which may fall on its rim
    assert (gone == gone.transpose(0, 2, 1)).all() == (share != "own")
    starts = [int(np.flatnonzero(edge)[0]) % 5 for edge in away.T]
    assert len(set(starts)) > 1  # not all at once


def test_nothing_depends_on_when_it_was_asked_before() -> None:
    sensor = Sensor(loss=0.5, noise_m=0.1, seed=9)
    late = lost(sensor, 5, 77.3), noise_m(sensor, 5, 77.3)
    for k in range(10):
        lost(sensor, 5, 70.0 + k), noise_m(sensor, 5, 70.0 + k)
    assert (late[0] == lost(sensor, 5, 77.3)).all()
    assert (late[1] == noise_m(sensor, 5, 77.3)).all()
    other = Sensor(loss=0.5, noise_m=0.1, seed=10)
    assert (noise_m(other, 5, 77.3) != late[1]).all()


def test_noise_is_as_large_as_was_asked_for_at_any_time() -> None:
    sensor = Sensor(noise_m=0.05)
    for phase_s in (0.0, 0.05, 0.1, 0.15):
        drawn = np.array([noise_m(sensor, 6, 0.2 * k + phase_s) for k in range(400)])
        assert drawn.std() == pytest.approx(0.05, rel=0.03)
        assert abs(drawn.mean()) < 0.002
    step = noise_m(sensor, 6, 10.02) - noise_m(sensor, 6, 10.0)
    assert np.abs(step).max() < 0.05  # it wanders, it does not jump


def test_cameras_are_turned_by_the_angles_that_were_asked_for() -> None:
    for sensor, angle in ((Sensor(heading_rad=0.5), 0.5), (Sensor(level_rad=0.2), 0.2)):
        found = Rotation.from_matrix(cameras(sensor, 20))
        assert found.as_matrix() == pytest.approx(cameras(sensor, 20))
        assert found.magnitude() == pytest.approx(angle)
        vertical = np.abs(found.as_rotvec()[:, 2]) / found.magnitude()
        assert vertical == pytest.approx(1.0 if sensor.heading_rad else 0.0, abs=1e-9)
    assert (
        len({round(float(z), 6) for z in Rotation.from_matrix(cameras(Sensor(heading_rad=0.5), 20)).as_rotvec()[:, 2]})
        == 2
    )
