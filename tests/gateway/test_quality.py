"""How good a link is and what follows; what waits while it is busy; poses for several vehicles in one packet."""

from __future__ import annotations

import math
import struct

import pytest

from groundstation.gateway.orders import ExternalPose, LandAt, Ping, SetpointsStop, TakeOff, Velocity
from groundstation.gateway.outbox import OLD_NS, Outbox
from groundstation.gateway.packets import echo_number, packed_poses, packet_of
from groundstation.gateway.quality import CAPS_HZ, LinkQuality
from sitl.personalities.crazyflie.crtp import unpacked_quaternion

SECOND_NS = 1_000_000_000
EAST = Velocity((1.0, 0.0, 0.0), 0.0)


def flown(quality: LinkQuality, from_s: float, to_s: float, every_ms: int | None, trip_s: float) -> None:
    """Lets poses come so often, None as often as they are asked for, and echoes after so long."""
    asked: dict[int, int] = {}
    for now_ms in range(round(from_s * 1000), round(to_s * 1000), 10):
        now_ns = now_ms * 1_000_000
        if now_ms % (every_ms or round(100.0 / quality.log_hz) * 10) == 0:
            quality.posed(now_ms, now_ns)
        if (number := quality.ping(now_ns)) is not None:
            asked[number] = now_ns
        for number, sent_ns in list(asked.items()):
            if now_ns - sent_ns >= trip_s * SECOND_NS:
                quality.echoed(number, now_ns)
                del asked[number]
        quality.step(now_ns)


def test_a_good_link_is_told_as_such_and_changes_no_rates() -> None:
    quality = LinkQuality(25.0)
    flown(quality, 0.0, 5.0, 40, 0.01)
    assert quality.heard == pytest.approx(1.0)
    assert quality.trip_s == pytest.approx(0.01, abs=0.011)
    assert (quality.level, quality.cap_hz, quality.log_hz) == (0, math.inf, 25.0)


def test_rates_fall_step_by_step_where_poses_are_lost_and_rise_again_slowly() -> None:
    quality = LinkQuality(25.0)
    flown(quality, 0.0, 2.0, 40, 0.01)
    flown(quality, 2.0, 4.0, 160, 0.01)  # three of four are lost
    assert quality.heard < 0.5
    assert quality.cap_hz == CAPS_HZ[2]
    assert "at most 10 Hz" in quality.words()
    flown(quality, 4.0, 8.0, None, 0.01)
    assert quality.level == 2
    flown(quality, 8.0, 25.0, None, 0.01)
    assert quality.level == 0


def test_an_echo_that_does_not_come_is_as_late_as_it_is() -> None:
    quality = LinkQuality(25.0)
    flown(quality, 0.0, 2.0, 40, 0.01)
    flown(quality, 2.0, 3.5, 40, 9.0)
    assert quality.trip_s > 0.5
    assert quality.level > 0


def test_of_velocities_and_poses_only_the_newest_waits_and_what_moves_and_is_old_is_not_sent() -> None:
    box = Outbox()
    pose = ExternalPose((0.0, 0.0, 0.0), None)
    for order in (EAST, pose, Velocity((0.0, 1.0, 0.0), 0.0), ExternalPose((1.0, 0.0, 0.0), None)):
        box.put(order, 0)
    assert box.take(0) == Velocity((0.0, 1.0, 0.0), 0.0)
    assert box.take(0) == ExternalPose((1.0, 0.0, 0.0), None)
    assert box.take(0) is None
    box.put(EAST, 0)
    box.put(TakeOff(1.0, 2.0), 0)
    box.put(LandAt(0.0, 2.0), 0)
    assert box.take(OLD_NS + 1) == LandAt(0.0, 2.0)
    assert box.take(OLD_NS + 1) is None
    box.put(EAST, 0)
    box.put(SetpointsStop(), 0)
    assert [box.take(0), box.take(0)] == [SetpointsStop(), None]


def test_an_echo_comes_back_by_its_number() -> None:
    data = packet_of(Ping(517), {})
    assert data is not None
    assert echo_number(data[1:]) == 517
    assert echo_number(b"\0" * 9) is None


def test_poses_for_three_go_in_two_packets_and_each_is_found_by_its_number() -> None:
    half = math.sqrt(0.5)
    poses = {k: ExternalPose((0.1 * k, -1.0, 2.0), (0.0, 0.0, half, half)) for k in (1, 2, 7)}
    packets = packed_poses(poses)
    assert [len(data) for data in packets] == [2 + 22, 2 + 11]
    number, x, y, z, quat = struct.unpack_from("<BhhhI", packets[0], 2 + 11)
    assert (number, x, y, z) == (2, 200, -1000, 2000)
    assert unpacked_quaternion(quat) == pytest.approx((0.0, 0.0, half, half), abs=2e-3)
