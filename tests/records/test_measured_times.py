"""When messages were measured: by their own clock, at whatever rate it runs."""

from __future__ import annotations

import numpy as np
import pytest

from groundstation.records.responses import measured_ns


def _received(rate: float, seconds: float, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """True times, times of arrival with a jitter of up to 40 ms, and what a clock of a rate says, every 20 ms."""
    rng = np.random.default_rng(seed)
    true_ns = np.arange(round(seconds / 0.02)) * 20_000_000
    boot_ms = 5_000 + np.rint(true_ns * rate / 1e6).astype(np.int64)
    return true_ns, true_ns + 30_000_000 + rng.integers(0, 40_000_000, len(true_ns)), boot_ms


@pytest.mark.parametrize("rate", [0.98, 0.985, 1.0, 1.02])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_clock_that_runs_slow_or_fast_does_not_shift_what_is_measured(rate: float, seed: int) -> None:
    true_ns, received_ns, boot_ms = _received(rate, 60.0, seed)
    off_ns = measured_ns(received_ns, boot_ms) - true_ns - 30_000_000
    assert np.abs(off_ns).max() < 6_000_000  # 1.2 s over a minute at 0.98


def test_a_clock_that_jumps_is_not_believed() -> None:
    _, received_ns, boot_ms = _received(1.0, 20.0, 3)
    boot_ms[500:] -= 4_000
    np.testing.assert_array_equal(measured_ns(received_ns, boot_ms), received_ns)
