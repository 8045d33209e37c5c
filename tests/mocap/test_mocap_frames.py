"""A system's frames on the wire: what is read out of them is what was put in; what a reader makes of a system."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.app.mocap.reading import Reader
from groundstation.gateway.bridge import Bridge
from groundstation.gateway.orders import ExternalPose
from groundstation.mavlink.codec import Encoder, Frame, FrameSplitter, decode
from groundstation.mavlink.mocap_frames import (
    BODY_SYSID,
    RoomEncoder,
    own_pose,
    packed_poses,
    room_frames,
    room_words,
    unpacked_poses,
)
from groundstation.mocap.bodies import RoomConfig, RoomFrame
from groundstation.mocap.room import Room


def frames_of(data: bytes) -> list[Frame]:
    return [piece for piece in FrameSplitter().feed(data) if isinstance(piece, Frame)]


def room(n: int = 6) -> Room:
    pads = np.stack([np.arange(n), np.zeros(n), np.zeros(n)], axis=1).astype(float)
    made = Room(RoomConfig(1, "udpin://here", tuple(range(1, n + 1)), pads, False, 2.0))
    quat = np.tile([0.8, 0.0, 0.0, 0.6], (n, 1))
    made.take(RoomFrame(10_000, 20_000_000, np.arange(n), pads + np.array([0.0, 0.25, -1.5]), quat))
    return made


@settings(deadline=None)
@given(
    sysids=st.lists(st.one_of(st.none(), st.integers(1, 250)), min_size=1, max_size=20),
    stamp_us=st.integers(1, 2**50),
)
def test_what_is_read_is_what_was_sent(sysids: list[int | None], stamp_us: int) -> None:
    k = len(sysids)
    pos = np.random.default_rng(k).normal(size=(k, 3)).astype(np.float32).astype(float)
    quat = np.tile([0.5, 0.5, -0.5, 0.5], (k, 1))
    data = RoomEncoder().datagram(stamp_us, sysids, pos, quat)
    (frame,) = room_frames([(item, 7_000) for item in frames_of(data)], {sysid: sysid + 100 for sysid in range(1, 251)})
    assert frame.stamp_ns == 1000 * stamp_us
    assert frame.row.tolist() == [-1 if sysid is None else sysid + 100 for sysid in sysids]
    assert np.array_equal(frame.pos_ned_m, pos)
    assert np.allclose(frame.quat_ned_from_frd, quat)


def test_frames_of_two_instants_are_two_and_a_rotation_that_is_none_is_unknown() -> None:
    encoder = RoomEncoder()
    here, nothing = np.zeros((1, 3)), np.zeros((1, 4))
    data = encoder.datagram(5, [3], here, nothing) + encoder.datagram(9, [3], here, nothing)
    first, second = room_frames([(item, 1) for item in frames_of(data)], {3: 0})
    assert (first.stamp_ns, second.stamp_ns) == (5_000, 9_000)
    assert np.isnan(first.quat_ned_from_frd).all()


def test_an_estimator_is_told_its_own_pose_with_what_it_may_be_off() -> None:
    told = own_pose(room(), 2, 0.005)
    data = Encoder(255, 190).encode("VISION_POSITION_ESTIMATE", **told)
    values = decode(frames_of(data))[0].values[0]
    assert [float(values[name]) for name in ("x", "y", "z")] == pytest.approx([2.0, 0.25, -1.5])
    assert float(values["yaw"]) == pytest.approx(2.0 * np.arctan2(0.6, 0.8), abs=1e-6)
    assert values["covariance"][[0, 6, 11]] == pytest.approx([2.5e-5] * 3)
    assert int(values["usec"]) == 20_000


def test_a_gateway_is_told_of_all_of_its_vehicles_and_each_takes_its_own() -> None:
    packed = list(packed_poses(room(), range(6)))
    assert len(packed) == 2
    bridge = Bridge(5, 0)
    station = Encoder(255, 190)
    for fields in packed:
        bridge.receive(station.encode("TUNNEL", **fields), 0)
    (pose,) = [order for order in bridge.take_orders() if isinstance(order, ExternalPose)]
    assert pose.pos_enu_m == pytest.approx((0.25, 4.0, 1.5))
    assert pose.quat_enu_from_flu is not None
    x, y, z, w = pose.quat_enu_from_flu
    assert 2.0 * np.arctan2(z, w) == pytest.approx(np.pi / 2 - 2.0 * np.arctan2(0.6, 0.8), abs=1e-6)
    assert (x, y) == pytest.approx((0.0, 0.0), abs=1e-6)


def test_only_the_newest_pose_waits_and_damage_is_none() -> None:
    bridge, station = Bridge(1, 0), Encoder(255, 190)
    for _ in range(5):
        for fields in packed_poses(room(), [0]):
            bridge.receive(station.encode("TUNNEL", **fields), 0)
    assert sum(isinstance(order, ExternalPose) for order in bridge.take_orders()) == 1
    bridge.receive(station.encode("TUNNEL", payload_type=0xA000, payload_length=7, payload=b"1234567"), 0)
    bridge.receive(station.encode("TUNNEL", payload_type=3, payload_length=29, payload=b"\1" * 29), 0)
    assert bridge.take_orders() == []
    assert list(unpacked_poses(b"\1" * 28)) == []


@dataclass
class Turn:
    """As ``motioncapture`` has rotations."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    w: float = 1.0


@dataclass
class Rigid:
    """As ``motioncapture`` has bodies."""

    position: np.ndarray
    rotation: Turn


def test_a_system_with_y_up_in_millimetres_is_read_and_strangers_are_named() -> None:
    reader = Reader({"cf1": 1, "cf2": 2}, up="y", unit="mm")
    bodies = {
        "cf1": Rigid(np.array([1000.0, 500.0, -2000.0]), Turn()),
        "wand": Rigid(np.array([0.0, 0.0, 0.0]), Turn()),
    }
    (frame,) = room_frames([(item, 1) for item in frames_of(reader.datagram(bodies, 40))], {1: 0, 2: 1})
    assert frame.row.tolist() == [0, -1]
    assert frame.pos_ned_m[0] == pytest.approx([2.0, 1.0, -0.5])
    words = frames_of(reader.words())
    assert words[0].sysid == BODY_SYSID
    assert room_words([(words[0], 1)]) == ["bodies of nobody: wand"]
    assert reader.datagram({}, 50) == b""


def test_the_package_that_reads_systems_has_what_is_asked_of_it() -> None:
    motioncapture = pytest.importorskip("motioncapture")
    system = motioncapture.connect("mock", {"hostname": "nowhere"})
    system.waitForNextFrame()
    assert Reader({}, up="z", unit="m").datagram(system.rigidBodies, 1) == b""
