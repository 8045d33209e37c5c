"""``make paper``: the figures say what the paper's example and a flight of ours come to."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from groundstation.app.resources import packaged_configs
from groundstation.mission.plan.reading import load_mission
from groundstation.records.replay import load_flight
from tests.app.flights import HALF_RATE, Flight
from tests.docs.paper import example_1, forming, snapshot_times_s, words, write_page


def test_example_1_is_the_papers() -> None:
    others, wish, turned, met = example_1()
    assert wish == pytest.approx([2.0, 1.0, 3.0])  # equation (5)
    assert met == (3,)
    assert np.linalg.norm(turned) == pytest.approx(np.linalg.norm(wish))
    assert wish @ turned > 0.0
    unit = turned / np.linalg.norm(turned)
    for centre in others:  # the way along it comes no nearer to a centre than the sphere's radius
        assert np.linalg.norm(centre - max(centre @ unit, 0.0) * unit) >= 1.0 - 1e-9


def test_the_page_shows_a_flight_of_ours(tmp_path: Path) -> None:
    log = tmp_path / "paper.tlog"
    plan = load_mission(packaged_configs() / "missions" / "paper_cube8.yaml", [HALF_RATE, "steps.1.hold.seconds=1"])
    flown = Flight(plan, log=log)
    page = write_page(log, tmp_path / "page")
    flight = load_flight(log)
    start, formed, stop = forming(flight)
    assert start < formed < stop
    assert snapshot_times_s(flight)[-1] == pytest.approx((formed - start) / 1e9, abs=0.06)
    said = words(flight)
    assert "All 28 distances" in said["fig5"]
    least = float(said["fig5"].split("Smallest: ")[1].split(" m")[0])
    assert least == pytest.approx(flown.meter.figures()["min_distance_m"], abs=0.06)  # as reported, with noise
    text = page.read_text()
    for name, words_below in said.items():
        assert words_below in text
        assert (page.parent / f"{name}.png").stat().st_size > 10_000
