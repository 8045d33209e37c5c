"""Aircraft that ADS-B receivers aboard tell of: frames of pymavlink, places of pymap3d, distances by truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pymap3d
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.app.verify import verify_log
from groundstation.core.damper import DamperParams, obstacle_bounds
from groundstation.core.errors import UserError
from groundstation.mavlink.codec import decode
from groundstation.mavlink.splitting import Frame, FrameSplitter
from groundstation.mavlink.traffic import MOST, Traffic
from groundstation.mission.flight.guidance import Guide
from groundstation.mission.flight.intruders import Intruders
from groundstation.mission.flight.poses import Poses
from groundstation.mission.runner import Phase
from sitl.world import Outgoing
from tests.app.flights import SECOND_NS, Flight, pair
from tests.mavlink.sender import Sender

ROOM = "fence={min_m: [-60, -60, 0], max_m: [60, 60, 30]}"
MIND = "traffic={radius_m: 3}"
PLACE = (47.4, 8.5, 488.0)


def _taken(traffic: Traffic, *raws: bytes, t_ns: int = 5 * SECOND_NS) -> None:
    frames = [piece for raw in raws for piece in FrameSplitter().feed(raw) if isinstance(piece, Frame)]
    for batch in decode(frames):
        traffic.take(batch, np.full(len(batch), t_ns))


def test_what_pymavlink_sends_is_read() -> None:
    traffic = Traffic()
    _taken(traffic, Sender(1).aircraft(PLACE, (30.0, -40.0, 2.0), since_s=2))
    (one,) = traffic.since(0)
    np.testing.assert_allclose(one.place_deg_m, PLACE, atol=1e-7)
    np.testing.assert_allclose(one.vel_ned_m_s, (30.0, -40.0, 2.0), atol=0.01)
    assert (one.name, one.measured_ns) == ("HB-ABC", 3 * SECOND_NS)
    assert traffic.since(3 * SECOND_NS + 1) == []


def test_what_is_not_valid_is_not_believed() -> None:
    traffic = Traffic()
    _taken(traffic, Sender(1).aircraft(PLACE, flags=2 | 4 | 8))  # no place
    assert len(traffic) == 0
    _taken(traffic, Sender(1).aircraft(PLACE, (30.0, 0.0, 0.0), flags=1, callsign=b"\x01\x02"))
    (one,) = traffic.since(0)
    assert one.name == "4B1234"
    assert np.isnan(one.place_deg_m[2])
    assert np.isnan(one.vel_ned_m_s).all()
    _taken(traffic, Sender(1).aircraft((48.0, 8.5, 0.0), since_s=4))  # older than what is there
    assert traffic.since(0)[0].place_deg_m[0] == pytest.approx(47.4)
    _taken(traffic, Sender(1).aircraft(PLACE, geometric=False))  # a height by pressure is none
    assert np.isnan(traffic.since(0)[0].place_deg_m[2])


def test_as_many_are_kept_as_are_told_and_no_more_than_that() -> None:
    traffic = Traffic()
    for number in range(MOST + 20):
        _taken(traffic, Sender(1).aircraft(PLACE, icao=number, callsign=b""), t_ns=(100 + number) * SECOND_NS)
    assert len(traffic) == MOST
    assert {item.name for item in traffic.since(0)} == {f"{number:06X}" for number in range(20, MOST + 20)}


class Passing:
    """An aircraft that flies by, told by vehicle 1 twice a second, and the distances by truth."""

    def __init__(
        self, begin_m: tuple[float, float, float], vel_m_s: tuple[float, float, float], *, high: bool = True
    ) -> None:
        self._begin_m, self._vel_m_s, self._high = np.array(begin_m), np.array(vel_m_s), high
        self._since_ns, self._told_ns = -1, -SECOND_NS
        self.nearest_m = self.passed_m = np.inf
        self._sender = Sender(1)

    def at_enu_m(self, now_ns: int) -> np.ndarray:
        """Where it is."""
        return self._begin_m + self._vel_m_s * (now_ns - self._since_ns) / SECOND_NS

    def tell(self, datagram: Outgoing, flight: Flight) -> list[Outgoing]:
        """What vehicle 1 passes on."""
        if flight.runner.phase is Phase.HOLD and self._since_ns < 0:
            self._since_ns = flight.now_ns
        if self._since_ns < 0 or datagram.vehicle_index or flight.now_ns - self._told_ns < SECOND_NS // 2:
            return [datagram]
        self._told_ns = flight.now_ns
        config = flight.world.config
        home = (config.home_lat_deg, config.home_lon_deg, config.home_alt_m)
        place = pymap3d.enu2geodetic(*self.at_enu_m(flight.now_ns), *home)
        east, north, up = self._vel_m_s.tolist()
        flags = 1 | 2 | 4 | 8 | 128 if self._high else 1 | 4 | 8
        raw = self._sender.aircraft(place, (north, east, -up), flags=flags)
        return [datagram._replace(data=datagram.data + raw)]

    def look(self, flight: Flight) -> bool:
        """Measures, while both hold."""
        if self._since_ns >= 0 and flight.runner.phase is Phase.HOLD:
            offset = flight.world.truth.pos_enu_m - self.at_enu_m(flight.now_ns)
            level = np.linalg.norm(offset[:, :2], axis=1)
            away = np.linalg.norm(offset, axis=1) if self._high else level
            self.nearest_m = min(self.nearest_m, float(away.min()))
        return False


STEPS = "steps=[form: {tolerance_m: 1.5, timeout_s: 60}, hold: {seconds: 45}]"  # who gives way leaves its place


@pytest.mark.parametrize("high", [True, False])
def test_a_team_makes_room_for_one_that_is_slower_than_it_and_keeps_r(high: bool, tmp_path: Path) -> None:
    passing = Passing((-24.0, 1.0, 4.0), (1.0, 0.0, 0.0), high=high)
    plan = pair(ROOM, MIND, STEPS, "speed_limit_m_s=2.0", autopilots=("px4", "px4"))
    log = tmp_path / "passing.tlog"
    flight = Flight(plan, tamper=passing.tell, interrupt_when=passing.look, log=log if high else None)
    assert flight.runner.outcome == "completed", flight.runner.reason
    assert passing.nearest_m >= 3.0 + plan.spec.avoidance.radius_m
    assert flight.world.min_distance_airborne_m >= plan.spec.avoidance.radius_m
    assert [text for text in flight.texts("alarm") if "aircraft HB-ABC is" in text and "out of its way" in text]
    if high:
        assert verify_log(log).mismatches == 0


def test_a_velocity_that_is_known_to_be_poor_counts_towards_aircraft_as_towards_what_stands() -> None:
    """By hand: the approach is bounded by alpha (d - size - keep - T (closing + 3 sigma)), d 20 m, size 3 m."""
    plan = pair(ROOM, MIND)
    aircraft = Intruders(np.array([[20.0, 0.0, 0.0]]), np.zeros((1, 3)), np.array([3.0]), ("x",))
    told: list[float] = []
    for poor_m_s in (0.0, 0.3):
        guide, level = Guide(plan), np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))
        poses = Poses(
            np.zeros((2, 3)), np.zeros((2, 3)), level, np.zeros(2, dtype=np.bool_), vel_error_m_s=np.full(2, poor_m_s),
            intruders=aircraft,
        )  # fmt: skip
        towards, most = guide._standing_in_the_way(poses)
        np.testing.assert_allclose(towards[0, 0], [1.0, 0.0, 0.0])
        told.append(float(most[0, 0]))
    damper = guide._damper
    assert told[0] == pytest.approx(damper.rate_1_s * (17.0 - plan.obstacles.keep_m))
    assert told[0] - told[1] == pytest.approx(damper.rate_1_s * damper.horizon_s * 3.0 * 0.3)


def test_without_the_key_nobody_minds_it() -> None:
    passing = Passing((-24.0, 1.0, 4.0), (1.0, 0.0, 0.0))
    plan = pair(ROOM, STEPS, "speed_limit_m_s=2.0", autopilots=("px4", "px4"))
    flight = Flight(plan, tamper=passing.tell, interrupt_when=passing.look)
    assert flight.runner.outcome == "completed"
    assert passing.nearest_m < 3.0
    assert flight.texts("alarm") == []


def test_one_that_is_too_fast_is_told_and_the_two_keep_r_all_the_same() -> None:
    passing = Passing((-300.0, 1.0, 3.0), (25.0, 0.0, 0.0))
    plan = pair(ROOM, MIND, STEPS.replace("45", "20"), autopilots=("px4", "px4"))
    flight = Flight(plan, tamper=passing.tell, interrupt_when=passing.look)
    told = [text for text in flight.texts("alarm") if "aircraft HB-ABC is" in text]
    assert "out of its way" in told[0]
    assert any("it is faster than the team can make room" in text for text in told)
    assert flight.world.min_distance_airborne_m >= plan.spec.avoidance.radius_m


def test_it_is_refused_where_nobody_knows_places_on_earth() -> None:
    with pytest.raises(UserError, match=r"traffic: places of aircraft are on earth, and no vehicle's are"):
        pair(MIND, "vehicles.0.origin=pad", "vehicles.1.origin=pad")


@settings(max_examples=40)
@given(st.integers(0, 10_000), st.floats(0.0, 0.6))
def test_a_vehicle_that_lags_is_never_reached_by_one_that_is_slower(seed: int, share: float) -> None:
    """Its own simulation: v' = (u - v) / tau, u as wished but for the one bound; the aircraft turns as it likes."""
    rng = np.random.default_rng(seed)
    damper = DamperParams(
        radius_m=2.0, margin_m=0.3, lag_s=1.0, delay_s=0.0, tick_s=0.02, speed_limit_m_s=2.0, accel_limit_m_s2=3.0
    )
    keep_m, size_m, limit_m_s = 2.3, 3.0, 2.0
    pos, vel = np.zeros(3), np.zeros(3)
    other = np.array([0.0, 14.0, 0.0])
    heading = rng.uniform(0, 2 * np.pi)
    wish = np.zeros(3)
    for tick in range(2000):
        if tick % 250 == 0:
            wish = rng.normal(size=3)
            wish *= limit_m_s / np.linalg.norm(wish)
            heading = np.arctan2(pos[1] - other[1], pos[0] - other[0]) + rng.normal(0.0, 0.5)
        moves = share * limit_m_s * np.array([np.cos(heading), np.sin(heading), 0.0])
        seen = Intruders(other[None], moves[None], np.array([size_m]), ("x",))
        away_m, towards = seen.distances(pos[None])
        comes_m_s = (towards * moves).sum(axis=2)
        most = obstacle_bounds(away_m - keep_m, towards, vel[None], damper, comes_m_s=comes_m_s)
        n, bound = towards[0, 0], float(most[0, 0])
        u = wish + min(bound - float(n @ wish), 0.0) * n
        u *= min(1.0, limit_m_s / max(float(np.linalg.norm(u)), 1e-9))
        if float(n @ u) > bound:  # shortened it may no longer flee as fast as it has to
            u = bound * n
        for _ in range(5):
            vel = vel + 0.004 * (u - vel) / damper.lag_s
            pos, other = pos + 0.004 * vel, other + 0.004 * moves
        assert np.linalg.norm(pos - other) >= size_m + keep_m - 0.3  # its margin is for what turns at once
