"""A sample of the fault matrix: faults of the emulator in the phases of a flight, under both autopilots.

The whole of it, every fault in every phase, is a campaign (docs/safety.md). Judged by the emulator's truth: vehicles
that can be steered keep r, everybody is down or in its failsafe in the end, and people are told why.
"""

from __future__ import annotations

import math
from typing import Any

import pytest

from groundstation.app.campaign.cases import Case
from groundstation.app.campaign.run import fly_case
from groundstation.app.campaign.vary import Setting
from groundstation.app.resources import packaged_configs
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.reading import load_mission
from tests.app.flights import HALF_RATE

CONFIGS = packaged_configs()
PADS = [[-0.7, -0.7, 0.0], [0.7, -0.7, 0.0], [-0.7, 0.7, 0.0], [0.7, 0.7, 0.0]]


def _tetrahedron(autopilot: str, *changes: str) -> MissionPlan:
    vehicles = [
        {"id": k + 1, "link": "udpin://127.0.0.1:14540", "autopilot": autopilot, "profile": "crazyflie", "pad_m": pad}
        for k, pad in enumerate(PADS)
    ]
    return load_mission(
        CONFIGS / "missions" / "cube8.yaml",
        (
            HALF_RATE,
            f"formation={CONFIGS / 'formations' / 'tetrahedron4.yaml'}",
            f"gains={CONFIGS / 'gains' / 'tetrahedron4.npz'}",
            f"vehicles={vehicles}",
            "steps.1.hold.seconds=3",
            "limits.preflight_s=30",
            "limits.arming_s=15",
            *changes,
        ),
    )


def _fly(
    kind: str, phase: str, autopilot: str, *changes: str, verify: bool = False, **numbers: float
) -> dict[str, Any]:
    plan = _tetrahedron(autopilot, *changes)
    setting = Setting(
        verify=verify,
        limit_s=250.0,
        settle_s=40.0,
        faults={"what": ({"kind": kind, **numbers},), "phase": phase, "who": "one"},
    )
    row = fly_case(Case(0, kind, "", 1, plan.record(), plan.gains_npz, setting, victim=3, delay_s=0.4))
    assert row["error"] == ""
    assert row["safe"], (row["end"], row["min_obedient_m"], row["alarms"])
    assert math.isnan(row["min_obedient_m"]) or row["min_obedient_m"] >= 0.45
    assert row["outcome"] == "completed" or row["reason"]
    if verify:
        assert (row["log_mismatches"], row["log_complete"]) == (0, True)
    return row


@pytest.mark.parametrize(
    ("kind", "phase", "autopilot", "numbers", "words"),
    [
        ("blackout", "form", "arducopter", {}, "vehicle 4: no position for 1 s; it lands where it is when nobody is"),
        ("blackout", "hold", "px4", {}, "vehicle 4: not heard from any more, whether it has landed is not known"),
        ("position_jump", "form", "px4", {"east_m": 2.0}, "vehicle 4: its position is 2.0"),
        ("position_frozen", "return", "arducopter", {}, ""),
        ("position_nan", "takeoff", "px4", {}, "vehicle 4: no position for 1 s; it lands where it is"),
        ("position_drift", "hold", "arducopter", {"east_m_s": 0.3}, "from where its velocity leads, limit 0.37 m"),
        ("motor_failure", "form", "px4", {}, "vehicle 4: is tilted by "),
        ("reboot", "return", "px4", {}, "vehicle 4: "),
        ("battery_level", "hold", "arducopter", {"percent": 15.0}, "vehicle 4: battery at 15%, minimum is 20%"),
        ("commands_ignored", "land", "px4", {}, ""),
        ("clock_jump", "form", "px4", {"seconds": 3600.0}, ""),
        ("arming_refused", "ground", "px4", {}, "vehicle 4: "),
    ],
)
def test_a_fault_in_flight_ends_safely_and_is_told(
    kind: str, phase: str, autopilot: str, numbers: dict[str, float], words: str
) -> None:
    verify = kind in ("position_jump", "motor_failure", "reboot")
    row = _fly(kind, phase, autopilot, verify=verify, **numbers)
    assert words in row["reason"], row["reason"]
    if kind == "blackout":  # nobody waits for one that is gone, and its silence is nothing else besides
        said = row["reason"] + str(row["alarms"])
        assert "not everybody is back" not in said
        assert "from where its velocity leads" not in said


@pytest.mark.parametrize("policy", ["continue_open", "continue_take_over"])
def test_the_others_go_on_without_a_lost_vehicle_where_the_mission_says_so(policy: str) -> None:
    row = _fly("blackout", "form", "px4", f"on_lost={policy}", verify=True)
    assert row["outcome"] == "aborted"
    assert row["reason"].startswith(
        "vehicle 4: no position for 1 s; it lands where it is when nobody is below, the others"
    )
    assert "the others go on" in row["reason"]
    assert row["phases"] == "connect arm takeoff form hold return land done"
    assert row["formed"]
