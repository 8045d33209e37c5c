"""Bodies of a motion capture system: whose each is, what is not believed, and what people are told of it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.core import frames
from groundstation.core.types import FloatArray
from groundstation.mocap.bodies import RoomConfig, RoomFrame, room_config, turned
from groundstation.mocap.room import Room, Seen
from groundstation.mocap.stamps import FrameClock

MS = 1_000_000
PADS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.5, 1.0, -0.2]])


class Scene:
    """A room at 100 Hz whose bodies stand or move as the test says."""

    def __init__(self, *, by_place: bool = False, held: bool = True) -> None:
        self.room = Room(RoomConfig(1, "udpin://here", (11, 12, 13, 14), PADS, by_place, 2.0))
        self.now_ns = 5_000 * MS
        self.pos: FloatArray = PADS.copy()
        self._rng = np.random.default_rng(1)
        self.run(0.3)
        if held:
            self.room.hold()

    def frame(self, names: list[int] | None = None, rows: list[int] | None = None, exact: bool = False) -> Seen | None:
        """The next frame: of these bodies alone, under these names."""
        self.now_ns += 10 * MS
        kept = list(range(4)) if rows is None else rows
        said = kept if names is None else names
        noise = 0.0 if exact else self._rng.normal(0.0, 5e-4, (len(kept), 3))
        quat = np.tile([1.0, 0.0, 0.0, 0.0], (len(kept), 1))
        seen = self.room.take(
            RoomFrame(self.now_ns + 77 * MS, self.now_ns, np.array(said, dtype=np.int64), self.pos[kept] + noise, quat)
        )
        self.room.look(self.now_ns)
        return seen

    def run(self, seconds: float, names: list[int] | None = None, rows: list[int] | None = None) -> None:
        for _ in range(round(100 * seconds)):
            self.frame(names, rows)

    def off_m(self) -> float:
        return float(np.abs(self.room.pos_ned_m - self.pos).max())


def test_everybody_is_seen_where_it_is_and_when() -> None:
    scene = Scene()
    seen = scene.frame()
    assert seen is not None
    assert seen.row.tolist() == [0, 1, 2, 3]
    assert scene.off_m() < 0.005
    assert seen.measured_ns == scene.now_ns
    assert all(scene.room.words(k, scene.now_ns) is None for k in range(4))
    assert scene.room.take_news() == []


def test_two_that_exchange_their_names_in_flight_are_followed_by_their_places() -> None:
    scene = Scene()
    scene.run(0.5, names=[1, 0, 2, 3])
    assert scene.off_m() < 0.005
    (news,) = scene.room.take_news()
    assert "the bodies of vehicles 11 and 12 have exchanged their names; each is followed by where it flew" in news
    scene.run(0.1)
    assert scene.off_m() < 0.005
    assert [line for line in scene.room.take_news() if "has its own name again" in line]


def test_a_name_that_wanders_to_another_body_is_told_of_one() -> None:
    scene = Scene()
    scene.run(0.3, names=[-1, 1, 2, 3])
    assert scene.off_m() < 0.005  # its markers are still there, without a name
    assert scene.room.take_news() == []


def test_a_body_that_jumps_is_not_believed_and_the_others_are() -> None:
    scene = Scene()
    before = scene.room.pos_ned_m[2].copy()
    scene.pos[2, 0] += 0.9
    scene.run(0.3)
    assert np.abs(scene.room.pos_ned_m[2] - before).max() < 0.005
    assert scene.now_ns - scene.room.measured_ns[2] >= 300 * MS
    assert scene.now_ns - scene.room.measured_ns[0] == 0
    (news,) = scene.room.take_news()
    assert news.startswith("vehicle 13: its body has jumped by 0.9")
    assert "see to reflections" in news
    scene.pos[2] = before
    scene.run(0.05)
    assert scene.now_ns == scene.room.measured_ns[2]


def test_one_that_was_covered_is_told_and_believed_again_where_it_can_be() -> None:
    scene = Scene()
    scene.run(0.5, rows=[0, 1, 3])
    (news,) = scene.room.take_news()
    assert news.startswith("vehicle 13: its body is not in the frames: its markers are covered")
    scene.pos[2] += [0.2, 0.1, -0.1]
    scene.run(0.05)
    assert scene.off_m() < 0.005
    assert scene.room.take_news() == ["vehicle 13: the motion capture sees it again"]


def test_two_that_were_covered_together_and_could_be_each_other_are_nobody() -> None:
    scene = Scene()
    scene.pos[1] = PADS[0] + [0.35, 0.0, 0.0]
    scene.room = Room(scene.room.config)
    scene.run(0.2)
    scene.room.hold()
    scene.run(0.6, rows=[2, 3])
    scene.pos[0], scene.pos[1] = PADS[0] + [0.17, 0.0, 0.0], PADS[0] + [0.18, 0.0, 0.0]
    before = scene.room.measured_ns.copy()
    scene.run(0.3)
    assert scene.room.measured_ns[:2].tolist() == before[:2].tolist()
    assert any("cannot be told from another one" in scene.room._why[k] for k in (0, 1))


def test_a_body_that_stands_still_to_the_bit_is_frozen() -> None:
    scene = Scene()
    still = scene.pos[1].copy()
    for _ in range(40):
        scene.frame()
        scene.room.pos_ned_m[1] = still
    scene.room.take_news()
    for _ in range(40):
        scene.frame(exact=True)
    assert scene.now_ns - scene.room.measured_ns[0] >= 200 * MS
    assert any("is frozen: its position is the same to the last bit" in line for line in scene.room.take_news())


def test_frames_that_stop_are_told_once_for_all_and_when_they_come_again() -> None:
    scene = Scene()
    for _ in range(100):
        scene.now_ns += 10 * MS
        scene.room.look(scene.now_ns)
    assert scene.room.gone
    (news,) = scene.room.take_news()
    assert "no frame on udpin://here for 0.3 s, of anybody" in news
    assert (
        "no frame of the motion capture on udpin://here" in (scene.room.words(0, scene.now_ns) or "") or scene.room.gone
    )
    scene.run(0.05)
    assert not scene.room.gone
    assert scene.room.take_news() == ["motion capture: frames come again"]


@pytest.mark.parametrize(
    ("bend", "remedy"),
    [
        (lambda enu: 1000.0 * enu, "write unit: mm"),
        (lambda enu: np.stack([enu[:, 0], enu[:, 2], -enu[:, 1]], axis=1), "write up: y"),
        (lambda enu: 1000.0 * np.stack([enu[:, 0], enu[:, 2], -enu[:, 1]], axis=1), "write unit: mm"),
        (lambda enu: np.stack([enu[:, 1], enu[:, 2], enu[:, 0]], axis=1), "let the system stream z up"),
        (lambda enu: enu + np.array([0.0, 0.0, 1.0]), "correct pad_m, or the room's origin"),
    ],
)
def test_units_axes_and_origins_that_are_wrong_are_named_with_the_remedy(bend, remedy) -> None:  # type: ignore[no-untyped-def]
    scene = Scene(held=False)
    scene.pos = frames.ned_from_enu(bend(frames.enu_from_ned(PADS)))
    scene.run(0.2)
    words = [scene.room.words(k, scene.now_ns) for k in range(4)]
    assert any(remedy in (line or "") for line in words), words


def test_vehicles_on_each_others_pads_are_named() -> None:
    scene = Scene(held=False)
    scene.run(0.1, names=[1, 0, 2, 3])
    assert "its body stands on the pad of vehicle 12, and the other way round" in (
        scene.room.words(0, scene.now_ns) or ""
    )
    assert scene.room.words(2, scene.now_ns) is None


def test_markers_without_names_are_whose_pads_they_stand_on_and_then_followed() -> None:
    scene = Scene(by_place=True)
    rng = np.random.default_rng(2)
    for _ in range(200):
        scene.pos[:, 0] += 0.005 * np.array([1.0, -1.0, 1.0, -1.0])  # they pass each other, 1 m apart
        scene.frame(names=[-1] * 4, rows=rng.permutation(4).tolist())
    assert scene.off_m() < 0.005
    assert scene.room.take_news() == []


def test_an_older_frame_changes_nothing_and_a_clock_that_begins_anew_is_followed() -> None:
    scene = Scene()
    before = scene.room.pos_ned_m.copy()
    row, quat = np.arange(4), np.tile([1.0, 0.0, 0.0, 0.0], (4, 1))
    assert scene.room.take(RoomFrame(scene.now_ns, scene.now_ns, row, PADS + 0.01, quat)) is None
    assert np.array_equal(scene.room.pos_ned_m, before)
    seen = scene.room.take(RoomFrame(5 * MS, scene.now_ns + 10 * MS, row, PADS + 0.01, quat))
    assert seen is not None
    assert seen.measured_ns == scene.now_ns + 10 * MS


@settings(deadline=None)
@given(late_ms=st.lists(st.integers(min_value=0, max_value=80), min_size=5, max_size=60))
def test_a_frame_is_as_old_as_it_took_longer_than_the_quickest_and_never_from_the_future(late_ms: list[int]) -> None:
    clock = FrameClock()
    quickest = late_ms[0]
    for k, late in enumerate(late_ms):
        quickest = min(quickest, late)
        stamp_ns = (100 + 100 * k) * MS
        t_rx_ns = stamp_ns + 9_000 * MS + late * MS
        measured_ns = clock.measured_ns(stamp_ns, t_rx_ns)
        assert measured_ns <= t_rx_ns
        assert clock.lateness_ns == pytest.approx((late - quickest) * MS, abs=2e-4 * 100 * MS * len(late_ms))


@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_nobody_is_ever_seen_where_it_cannot_have_come(data: st.DataObject) -> None:
    """Whatever a system tells after takeoff, nobody flies faster than it can."""
    scene = Scene()
    place = st.floats(min_value=-3.0, max_value=3.0)
    for _ in range(data.draw(st.integers(min_value=1, max_value=12))):
        scene.now_ns += data.draw(st.integers(min_value=1, max_value=400)) * MS
        k = data.draw(st.integers(min_value=0, max_value=6))
        names = np.array(data.draw(st.lists(st.integers(-1, 3), min_size=k, max_size=k, unique=False)), dtype=np.int64)
        pos = np.array(data.draw(st.lists(st.tuples(place, place, place), min_size=k, max_size=k))).reshape(-1, 3)
        before, when_ns = scene.room.pos_ned_m.copy(), scene.room.measured_ns.copy()
        moved = scene.room.vel_ned_m_s.copy()
        seen = scene.room.take(RoomFrame(scene.now_ns + 77 * MS, scene.now_ns, names, pos, np.full((k, 4), np.nan)))
        if seen is None:
            continue
        assert len(set(seen.row.tolist())) == len(seen.row)
        for row, here in zip(seen.row.tolist(), seen.pos_ned_m, strict=True):
            dt_s = (seen.measured_ns - int(when_ns[row])) / 1e9
            reach_m = min(0.10 + 2.0 * dt_s, 1.0) + np.linalg.norm(moved[row]) * min(dt_s, 0.3)
            assert np.linalg.norm(here - before[row]) <= reach_m + 1e-9
        places = {tuple(item) for item in seen.pos_ned_m.tolist()}
        assert len(places) == len(seen.row) or len({tuple(item) for item in pos.tolist()}) < k


@settings(deadline=None)
@given(
    pos=st.tuples(*[st.floats(min_value=-50, max_value=50)] * 3),
    quat=st.tuples(*[st.floats(min_value=-1, max_value=1)] * 4).filter(lambda q: float(np.linalg.norm(q)) > 0.1),
    up=st.sampled_from(["z", "y"]),
)
def test_axes_are_turned_as_scipy_would(pos: tuple[float, ...], quat: tuple[float, ...], up: str) -> None:
    from scipy.spatial.transform import Rotation

    w, x, y, z = np.array(quat) / np.linalg.norm(quat)
    place, attitude = turned(np.array([pos]), np.array([[w, x, y, z]]), up=up, unit="mm")
    to_enu = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]]) if up == "y" else np.eye(3)
    to_ned = np.array([[0, 1.0, 0], [1.0, 0, 0], [0, 0, -1.0]])
    assert place[0] == pytest.approx(0.001 * to_ned @ to_enu @ np.array(pos), abs=1e-12)
    body = Rotation.from_quat([x, y, z, w]).as_matrix()
    expected = to_ned @ to_enu @ body @ to_enu.T @ np.diag([1.0, -1.0, -1.0])
    got = attitude[0]
    assert Rotation.from_quat([*got[1:], got[0]]).as_matrix() == pytest.approx(expected, abs=1e-9)


def test_a_mission_without_a_room_has_none() -> None:
    assert room_config({"positioning": "mocap"}, None, 1) is None
    assert room_config({}, None, 1) is None
