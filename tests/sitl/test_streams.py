"""Streams: what is due when, held against a plain list of times."""

from __future__ import annotations

import numpy as np

from sitl.streams import Streams

NAMES, N, STEP_NS, EPOCH_NS = ("A", "B", "C", "D"), 5, 4_000_000, 7_000_000


def test_what_is_due_is_what_a_list_of_times_for_each_vehicle_says() -> None:
    """Rates change at any time; two vehicles of the same rate may be due in different rounds, and are then together."""
    rng = np.random.default_rng(3)
    streams = Streams(NAMES, N, EPOCH_NS)
    interval_ns, due_ns = {}, {}
    for step in range(3_000):
        now_ns = EPOCH_NS + step * STEP_NS
        if rng.random() < 0.05:
            name, vehicle = NAMES[rng.integers(len(NAMES))], int(rng.integers(N))
            interval = int(rng.choice([0, 1_000_000, 10_000_000, 20_000_000, 33_333_333, 1_000_000_000]))
            assert streams.set_interval(vehicle, name, interval, now_ns)
            interval_ns[name, vehicle] = interval
            due_ns[name, vehicle] = (step * STEP_NS // interval + 1) * interval if interval else None
            assert streams.interval(vehicle, name) == interval
        wanted = []
        for name in NAMES:
            due = [v for v in range(N) if (at := due_ns.get((name, v))) is not None and at <= step * STEP_NS]
            for vehicle in due:
                interval = interval_ns[name, vehicle]
                due_ns[name, vehicle] = (step * STEP_NS // interval + 1) * interval
            if due:
                wanted.append((name, due))
        assert [(name, vehicles.tolist()) for name, vehicles in streams.take_due(now_ns)] == wanted
    assert not streams.set_interval(0, "E", 1, 0)
    assert streams.interval(0, "E") is None
