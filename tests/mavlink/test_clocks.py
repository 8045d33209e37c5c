"""Clocks: the true instant is within the stated uncertainty, restarts and twins are told from time stamps."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from groundstation.mavlink.clocks import BootTimes, Clocks

MS = 1_000_000


def _ints(*values: int) -> np.ndarray:
    return np.array(values, dtype=np.int64)


@given(
    ahead_ns=st.integers(-(10**12), 10**12),
    trips=st.lists(st.tuples(st.integers(0, 300 * MS), st.integers(0, 300 * MS)), min_size=1, max_size=20),
)
def test_the_mapped_time_is_off_by_half_the_quickest_round_trip_at_most(
    ahead_ns: int, trips: list[tuple[int, int]]
) -> None:
    clocks = Clocks(1)
    now = 10**13
    for up, down in trips:
        now += 10**9
        clocks.asked(0, now)
        clocks.answered(0, now + up + ahead_ns, now, now + up + down)
    now += 10**9
    boot_ms = (now + ahead_ns) // MS
    (mapped,) = clocks.measured_ns(_ints(0), _ints(boot_ms), _ints(now + 10**9))
    assert abs(int(mapped) - now) <= clocks.uncertainty_s()[0] * 1e9 + MS
    assert clocks.round_trip_s[0] >= min(up + down for up, down in trips) / 1e9
    assert clocks.samples[0] == len(trips)


SECOND = 1_000_000_000


class _Talk:
    """Round trips with a vehicle whose clock goes as it is told, on a link with delays of its own."""

    def __init__(self, seed: int = 0) -> None:
        self.clocks, self.rng = Clocks(1), np.random.default_rng(seed)
        self.now_ns, self.boot_ns, self.rate = 10**13, 20.0 * SECOND, 1.0
        self.restarts = 0

    def passes(self, seconds: float) -> None:
        self.now_ns += round(seconds * SECOND)
        self.boot_ns += seconds * SECOND * self.rate

    def ask(self) -> None:
        up_s, down_s = self.rng.uniform(0.002, 0.02, 2)
        asked_ns = self.now_ns
        self.clocks.asked(0, asked_ns)
        self.passes(up_s)
        told_ns = round(self.boot_ns)
        self.passes(down_s)
        self.restarts += self.clocks.answered(0, told_ns, asked_ns, self.now_ns)

    def error_s(self) -> float:
        """How far off the time of a measurement made now is, that arrives 5 ms later."""
        measured_ns, boot_ms = self.now_ns, int(self.boot_ns) // MS
        self.passes(0.005)
        (mapped,) = self.clocks.measured_ns(_ints(0), _ints(boot_ms), _ints(self.now_ns))
        return abs(int(mapped) - measured_ns) / SECOND


@given(rate=st.floats(0.98, 1.02), seed=st.integers(0, 99))
def test_a_clock_that_runs_two_percent_off_is_followed(rate: float, seed: int) -> None:
    talk = _Talk(seed)
    talk.rate = rate
    for k in range(40):
        talk.ask()
        assert talk.clocks.samples[0] == k + 1  # never forgotten
        talk.passes(2.0)
        if k > 3:
            assert talk.error_s() < 0.04  # half the largest round trip, and what the rate is not known by
    assert not talk.restarts


def test_a_rate_that_changes_is_followed() -> None:
    talk = _Talk()
    for rate in (1.0, 0.985, 0.989, 1.0):
        talk.rate = rate
        for k in range(15):
            talk.ask()
            talk.passes(2.0)
            assert talk.error_s() < (0.08 if k < 4 else 0.04)
    assert talk.clocks.samples[0] == 60
    assert not talk.restarts


def test_steps_and_stalls_are_followed_without_a_restart() -> None:
    talk = _Talk()
    for jump_s in (-1.0, 5.0, -0.3, 60.0, -2.0):
        for _ in range(5):
            talk.ask()
            talk.passes(2.0)
        talk.boot_ns += jump_s * SECOND
        if jump_s < -0.3:
            talk.error_s()
            assert talk.clocks.doubtful()[0]  # asked again soon
        talk.ask()
        assert talk.error_s() < 0.03
        if jump_s > 0.0:
            assert talk.clocks.doubtful()[0]  # one answer that fits no other: asked again soon
            talk.ask()
        assert talk.error_s() < 0.03
        assert not talk.clocks.doubtful()[0]
    assert not talk.restarts


def test_a_clock_that_begins_anew_is_a_restart() -> None:
    for uptime_s, away_s in ((20.0, 1.5), (5.0, 10.0)):
        talk = _Talk()
        talk.boot_ns = uptime_s * SECOND
        for _ in range(3):
            talk.ask()
            talk.passes(0.5)
        talk.passes(away_s)
        talk.boot_ns = 0.8 * away_s * SECOND
        talk.ask()
        assert talk.restarts == 0  # one answer alone may be anybody's
        talk.passes(0.5)
        talk.ask()
        assert talk.restarts == 1
        assert not talk.clocks.known[0]
        talk.ask()
        assert talk.error_s() < 0.03


def test_answers_to_others_do_not_count_and_nothing_was_measured_after_it_arrived() -> None:
    clocks = Clocks(2)
    clocks.asked(1, 1000)
    clocks.answered(0, 5, 1000, 2000)
    clocks.answered(1, 5, 1001, 2000)
    assert not clocks.known.any()
    assert clocks.measured_ns(_ints(0, 1), _ints(7, 7), _ints(50, 60)).tolist() == [50, 60]
    clocks.answered(1, 1500, 1000, 2000)
    clocks.answered(1, 9999, 1000, 2500)  # a copy of the answer
    assert clocks.samples.tolist() == [0, 1]
    assert clocks.measured_ns(_ints(1), _ints(100), _ints(3000)).tolist() == [3000]
    clocks.forget(1)
    assert not clocks.known.any()


def test_old_news_is_left_out_and_small_disorder_is_no_restart() -> None:
    times = BootTimes(2)
    row = _ints(0, 0, 0, 1, 0)
    fresh, restarted = times.take(row, _ints(5000, 4980, 5020, 10, 4100), row)
    assert fresh.tolist() == [True, False, True, True, False]
    assert restarted == []


def test_a_time_that_stays_back_is_a_restart_and_one_straggler_is_not() -> None:
    times = BootTimes(1)
    zero = _ints(0)
    times.take(zero, _ints(60_000), zero)
    assert not times.take(zero, _ints(30_000), zero)[0][0]
    assert times.take(zero, _ints(60_020), zero)[0][0]
    news = [times.take(zero, _ints(ms), zero) for ms in (100, 120, 140, 160)]
    assert [bool(fresh[0]) for fresh, _ in news] == [False, False, True, True]
    assert [restarted for _, restarted in news] == [[], [], [0], []]
    assert not times.two_at_once(0, 0)


def test_two_vehicles_under_one_id_are_told_by_their_times_whatever_their_rates() -> None:
    for burst in (1, 5):
        times = BootTimes(1)
        zero = _ints(0)
        for k in range(100):
            boot = 500_000 + 20 * k if k % (burst + 1) == 0 else 9_000 + 20 * k
            times.take(zero, _ints(boot), _ints(k * 20 * MS))
        assert times.two_at_once(0, 100 * 20 * MS)
        assert not times.two_at_once(0, 10**12)


WRAP_MS = 1 << 32


def test_a_time_that_begins_again_after_49_days_is_no_restart_and_dates_positions_as_before() -> None:
    clocks, times, zero = Clocks(1), BootTimes(1), _ints(0)
    begin_ns = (WRAP_MS - 1007) * MS  # the vehicle's 64 bit clock at our time 0
    clocks.asked(0, 0)
    clocks.answered(0, begin_ns, 0, 0)
    for k in range(200):
        now_ns = k * 20 * MS
        boot_ms = (begin_ns + now_ns) // MS % WRAP_MS
        fresh, restarted = times.take(zero, _ints(boot_ms), _ints(now_ns))
        assert (bool(fresh[0]), restarted) == (True, [])
        assert abs(int(clocks.measured_ns(zero, _ints(boot_ms), _ints(now_ns + 5 * MS))[0]) - now_ns) <= MS
        late, restarted = times.take(zero, _ints((boot_ms - 60) % WRAP_MS), _ints(now_ns))
        assert (bool(late[0]), restarted) == (False, [])
    assert not times.two_at_once(0, 4_000 * MS)


def test_a_restart_after_months_is_one() -> None:
    times, zero = BootTimes(1), _ints(0)
    times.take(zero, _ints(3_000_000_000), zero)
    news = [times.take(zero, _ints(ms), _ints(ms * MS)) for ms in (100, 120, 140)]
    assert [restarted for _, restarted in news] == [[], [], [0]]


def test_one_message_from_a_time_that_cannot_be_changes_nothing() -> None:
    for strange_ms in (0, WRAP_MS - 1, 50_000_000):
        times, zero = BootTimes(1), _ints(0)
        for k in range(10):
            assert times.take(zero, _ints(60_000 + 20 * k), _ints(20 * k * MS))[0][0]
        fresh, restarted = times.take(zero, _ints(strange_ms), _ints(200 * MS))
        assert (bool(fresh[0]), restarted) == (False, [])
        for k in range(10, 20):
            fresh, restarted = times.take(zero, _ints(60_000 + 20 * k), _ints(20 * k * MS))
            assert (bool(fresh[0]), restarted) == (True, [])
        assert not times.two_at_once(0, 400 * MS)


def test_a_clock_that_was_set_forward_is_followed_and_is_no_restart() -> None:
    times, zero = BootTimes(1), _ints(0)
    times.take(zero, _ints(60_000), zero)
    news = [times.take(zero, _ints(3_660_000 + 20 * k), _ints(20 * k * MS)) for k in range(1, 6)]
    assert [bool(fresh[0]) for fresh, _ in news] == [False, False, True, True, True]
    assert not any(restarted for _, restarted in news)


def test_one_answer_that_fits_no_other_sets_no_clock_and_no_sum_overflows() -> None:
    clocks, zero = Clocks(1), _ints(0)

    def answer(now_ns: int, tc1_ns: int) -> bool:
        clocks.asked(0, now_ns)
        return clocks.answered(0, tc1_ns, now_ns, now_ns + 2 * MS)

    second = 1_000 * MS
    for k in range(5):
        assert not answer(k * second, 70 * second + k * second)
    for strange in (-(1 << 63), (1 << 63) - 1, 0, 5 * second):
        assert not answer(6 * second, strange)
        assert clocks.known[0]
        assert not answer(7 * second, 77 * second)
    assert abs(int(clocks.measured_ns(zero, _ints(78_000), _ints(9 * second))[0]) - 8 * second) < 3 * MS
    # Two that agree are believed: it has started anew.
    assert not answer(8 * second, 1 * second)
    assert answer(9 * second, 2 * second)
