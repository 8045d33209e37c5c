"""The gateway's own look at the room, for when the flight is silent: who is told where it is, and who is not."""

from __future__ import annotations

import numpy as np
import pytest

from groundstation.core import frames
from groundstation.core.types import FloatArray
from groundstation.gateway.handover import Handover, RoomWord, read, read_room, written
from groundstation.gateway.measured import external_pose
from groundstation.gateway.orders import ExternalPose
from groundstation.gateway.relay import Relay
from groundstation.mavlink.mocap_frames import RoomEncoder
from groundstation.mocap.bodies import RoomConfig, relay_port

MS = 1_000_000
PLACES = frames.ned_from_enu(np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [2.0, 0.0, 1.0]]))
LEVEL = np.tile([1.0, 0.0, 0.0, 0.0], (3, 1))


class Left:
    """Three vehicles whose flight spoke until ``spoke_ns``, and a room at 100 Hz."""

    def __init__(self, *, by_place: bool = False) -> None:
        self.relay = Relay(RoomConfig(0, "udpin://here", (1, 2, 3), PLACES, by_place, 1.5), 25.0)
        self.now_ns = self.spoke_ns = 1_000 * MS
        self.pos: FloatArray = PLACES.copy()
        self._encoder, self._by_place = RoomEncoder(), by_place

    def told(self) -> dict[int, tuple[int, ExternalPose]]:
        return {sysid: (self.spoke_ns, external_pose(*PLACES[sysid - 1])) for sysid in (1, 2, 3)}

    def run(self, seconds: float, names: tuple[int, ...] = (1, 2, 3)) -> list[dict[int, ExternalPose]]:
        """Poses that go out, instant by instant."""
        found = []
        for _ in range(round(100 * seconds)):
            self.now_ns += 10 * MS
            said = [None] * 3 if self._by_place else list(names)
            data = self._encoder.datagram(self.now_ns // 1000, said, self.pos + self.now_ns * 1e-15, LEVEL)
            found.append(self.relay.poses([data], self.told(), self.now_ns))
        return found


@pytest.mark.parametrize("by_place", [False, True])
def test_as_long_as_the_flight_speaks_nothing_goes_out_and_then_everybody_is_told(by_place: bool) -> None:
    left = Left(by_place=by_place)
    assert not any(left.run(0.15))
    assert not left.relay.speaks
    out = [poses for poses in left.run(1.0) if poses]
    assert left.relay.speaks
    assert 24 <= len(out) <= 34  # no faster than asked for
    for poses in out:
        assert sorted(poses) == [1, 2, 3]
        for sysid, pose in poses.items():
            assert pose.pos_enu_m == pytest.approx(frames.ned_from_enu(PLACES[sysid - 1]), abs=1e-3)
    left.spoke_ns = left.now_ns  # it has come back
    assert not any(left.run(0.1))
    assert not left.relay.speaks


def test_bodies_that_exchange_names_and_one_that_jumps_are_told_from_each_other_as_in_a_flight() -> None:
    left = Left()
    left.run(0.3)
    for poses in left.run(0.5, names=(2, 1, 3)):
        for sysid, pose in poses.items():
            assert pose.pos_enu_m == pytest.approx(frames.ned_from_enu(PLACES[sysid - 1]), abs=1e-3)
    left.pos[2, 0] += 1.2
    out = [poses for poses in left.run(0.3) if poses]
    assert out
    assert not any(3 in poses for poses in out)


def test_whom_the_flight_has_never_told_is_not_looked_for() -> None:
    left = Left()
    data = RoomEncoder().datagram(1, [1, 2, 3], PLACES, LEVEL)
    assert left.relay.poses([data], {}, 10_000 * MS) == {}


def test_the_room_goes_with_the_word_that_a_gateway_is_given() -> None:
    room = RoomWord("udpin://127.0.0.1:15595", True, 1.5, 25.0)
    line = written({1: Handover(True)}, room)
    assert read_room(line) == room
    assert read(line) == {1: Handover(True)}
    assert read_room(written({1: Handover()})) is None
    for bad in ("no json", "[]", '{"room": 3}', '{"room": {"link": 1}}', '{"room": {"link": "x", "hz": 0}}'):
        assert read_room(bad) is None
    assert relay_port(14595) == 15595
    assert relay_port(65_000) == 64_000
