"""The adversary: what it draws follows from seed and run, covers what it should, and a sample of it is flown."""

from __future__ import annotations

import json
from collections import Counter

import pytest

from groundstation.app.campaign.adversary import draw
from groundstation.app.campaign.cases import Cases
from groundstation.app.campaign.plot import PILOTS, STRANGERS
from groundstation.app.campaign.run import fly_case
from groundstation.app.campaign.summary import below_r
from groundstation.app.campaign.vary import load_vary
from groundstation.app.resources import packaged_configs
from tests.app.commands import gs

ADVERSARY = packaged_configs() / "campaigns" / "adversary.yaml"


def _cases(seed: int) -> Cases:
    return Cases(ADVERSARY, load_vary(ADVERSARY), seed)


def test_a_run_follows_from_the_seed_and_its_number_alone() -> None:
    first, again, other = _cases(4), _cases(4), _cases(5)
    forwards = [first.case(run) for run in range(6)]
    backwards = [again.case(run) for run in reversed(range(6))]
    assert forwards == backwards[::-1]
    assert all(case != other.case(case.run) for case in forwards)
    assert len({case.drawn for case in forwards}) == 6
    assert first.fingerprint() != other.fingerprint()


def test_everything_that_can_go_wrong_is_drawn() -> None:
    spec = load_vary(ADVERSARY).spec.adversary
    assert spec is not None
    seen: Counter[str] = Counter()
    for run in range(120):
        drawn = draw(spec, 1, run)
        assert drawn.error == ""
        vehicles = drawn.mission["vehicles"]
        seen.update({f"n {len(vehicles)}", f"outdoors {drawn.words['outdoors']}", f"shape {drawn.words['shape']}"})
        seen.update({f"on_lost {drawn.mission['on_lost']}", f"steps {drawn.words['steps'].count('form') > 1}"})
        seen[f"autopilots {len(drawn.words['autopilots'])}"] += 1
        seen.update({f"wind {'gusts_m_s' in drawn.emulator}", f"told {bool(drawn.mission['profiles'])}"})
        faults = [event.fault for event in drawn.events if event.fault is not None]
        seen.update({f"faults {len(faults)}", *(fault.kind for fault in faults)})
        seen.update(f"stranger {event.stranger}" for event in drawn.events if event.stranger)
        seen.update(event.order.split()[0] for event in drawn.events if event.order.strip())
        seen.update(f"pilot {event.pilot}" for event in drawn.events if event.pilot)
        seen.update("keys" for event in drawn.events if event.keys)
        seen.update("edge" for event in drawn.events if event.delay_s == 0.0)
    wanted = {f"n {n}" for n in range(2, 9)} | {f"faults {n}" for n in range(4)} | {f"stranger {s}" for s in STRANGERS}
    wanted |= {f"pilot {pilot}" for pilot in PILOTS}
    wanted |= {"hold", "resume", "return", "land", "kill", "keys", "edge", "battery_level", "motor_failure", "blackout"}
    wanted |= {"gps_lost"}
    wanted |= {"outdoors True", "outdoors False", "shape sphere", "shape cylinder", "shape ellipsoid", "steps True"}
    wanted |= {"wind True", "told True", "told False", "autopilots 1", "autopilots 2", "on_lost continue_open"}
    assert wanted <= set(seen)


def test_a_mission_that_cannot_be_read_for_a_fault_of_ours_is_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    def spoilt(*_: object) -> object:
        raise ZeroDivisionError("gains")

    monkeypatch.setattr("groundstation.app.campaign.adversary.load_mission", spoilt)
    row = fly_case(_cases(1).case(0))
    assert "ZeroDivisionError: gains, reading a mission" in row["error"]
    assert row["tracebacks"] == 1


def test_an_adversary_takes_no_mission(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = gs(
        ["campaign", "--vary", "adversary.yaml", "--mission", "cube8.yaml", "--only", "0"], monkeypatch, capsys
    )
    assert code == 2
    assert "draws its own missions" in err


@pytest.mark.parametrize("run", SAMPLE := (0, 3, 6))
def test_a_sample_keeps_r_tells_the_truth_and_can_be_replayed(run: int) -> None:
    row = fly_case(_cases(1).case(run))
    assert row["error"] == ""
    assert not below_r(row)
    assert row["safe"]
    assert (row["disagreements"], row["tracebacks"]) == (0, 0), row["disagreed"]
    assert (row["log_mismatches"], row["log_complete"]) == (0, True)
    assert row["events"]
    assert json.loads(row["drawn"])["vehicles"] == row["vehicles"]
