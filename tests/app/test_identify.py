"""``gs identify`` on flights of the emulator, whose response is known."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest

from groundstation.app.campaign.cases import Cases
from groundstation.app.campaign.run import fly_case
from groundstation.app.campaign.vary import load_vary
from groundstation.app.emulator import world_config
from groundstation.app.identifying import delay_note, response_line
from groundstation.core.damper import DamperParams
from groundstation.core.errors import UserError
from groundstation.core.velocity_loop import VelocityLoop
from groundstation.mission.plan.profiles import PROFILES
from groundstation.mission.plan.reading import load_mission
from tests.app.commands import gs
from tests.app.flights import CUBE8, cube8
from tests.mission.test_compensation import LAG_S, PX4_CUBE8, answers
from tests.mission.test_compensation import t63_s as answers_after_s


def _flown(folder: Path, profile: str, autopilot: str) -> Path:
    """A flight of four, a metre and a half from where they form."""
    vary = folder / "vary.yaml"
    vary.write_text(
        f"""
team: {{profile: {profile}, autopilot: {autopilot}}}
starts: {{kind: planar, spread: 6}}
emulator: {{noise: {{position_m: 0.01, velocity_m_s: 0.02}}}}
set:
  rate_hz: 25
  formation: ../formations/tetrahedron4.yaml
  gains: ../gains/tetrahedron4.npz
  avoidance.radius_m: 0.4
  avoidance.activation_m: 0.5
  steps.0.form.tolerance_m: 0.1
  steps.1.hold.seconds: 1
""",
        encoding="utf-8",
    )
    log = folder / f"{profile}.tlog"
    row = fly_case(Cases(CUBE8, load_vary(vary), 4).case(0), log)
    assert row["success"], row
    return log


@pytest.mark.parametrize(
    ("profile", "t63_s", "tolerance_s"),
    [
        ("crazyflie", 0.23, 0.04),
        ("arducopter", 0.57, 0.06),  # shaped as one lag of 0.5 s, 0.08 s late
        ("px4_quad", 1.05, 0.3),  # it creeps over the last fifth for many seconds
    ],
)
def test_profiles_are_found_in_their_flights(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    *,
    profile: str,
    t63_s: float,
    tolerance_s: float,
) -> None:
    log, picture = _flown(tmp_path, profile, "arducopter" if profile == "arducopter" else "px4"), tmp_path / "it.png"
    code, out, _ = gs(["identify", str(log), "--json", "--picture", str(picture)], monkeypatch, capsys)
    assert code == 0
    assert picture.read_bytes().startswith(b"\x89PNG")
    values = json.loads(out.splitlines()[-1])
    assert values["identified"] >= 3
    for vehicle in values["vehicles"]:
        if vehicle["t63_s"] is not None:
            assert vehicle["t63_s"] == pytest.approx(t63_s, abs=tolerance_s)
            assert vehicle["profile"] == profile
    (line,) = values["profiles"]
    assert line.startswith(f"{profile}: {{lag_s: ")
    known = [item["second_order"]["horizontal"] for item in values["vehicles"]]
    known = [item for item in known if not item["problem"]]
    assert known
    if profile == "px4_quad":  # the emulator's own gains: 1.8, 0.5, and a drag of 1.35 1/s
        assert all(item["needed"] and item["explained"] > 0.98 > item["one_lag_explained"] + 0.02 for item in known)
        assert [item["p_1_s"] for item in known] == pytest.approx([1.8] * len(known), rel=0.4)
        # The line goes into a mission as it is, whose setpoints are shaped by it.
        plan = load_mission(PX4_CUBE8, [f"profiles={{{line}}}"])
        response = plan.vehicle_profiles[0].response
        assert response is not None
        for axis in (0, 2):
            went, _ = answers(profile, axis, 0.3, response)
            assert answers_after_s(went, 0.3) <= LAG_S + 2.5 * PROFILES[profile].delay_s
            assert went.max() <= 1.2 * 0.3
    else:
        assert "response" not in line
    if profile == "crazyflie":
        assert not any(item["needed"] for item in known)


def test_a_response_is_printed_where_all_vehicles_answer_alike_and_one_lag_does_not_do() -> None:
    level = VelocityLoop(1.8, 0.3, 0.9, 0.1, 0.99, 0.93, 0.9, 0.1, 0.02)
    up = VelocityLoop(5.3, 1.5, 0.9, 0.05, 0.99, 0.98, 0.2, 0.1, 0.02)
    usual = {"horizontal": level, "up": up}
    slower = {"horizontal": replace(level, p_1_s=1.7), "up": replace(up, p_1_s=5.0)}
    horizontal, vertical = "{p_1_s: 1.70, i_1_s2: 0.30, drag_1_s: 0.90}", "{p_1_s: 5.00, i_1_s2: 1.50, drag_1_s: 0.90}"
    assert response_line([usual, slower, usual]) == f"{{horizontal: {horizontal}, vertical: {vertical}}}"
    plain = {"horizontal": replace(level, one_lag_explained=0.99), "up": up}
    unknown = {"horizontal": level, "up": VelocityLoop(problem="setpoints vary by 0.01 m/s only")}
    assert response_line([usual, slower, plain])
    assert response_line([usual, plain]) == ""
    assert response_line([usual, unknown])
    assert response_line([unknown]) == response_line([]) == ""
    assert response_line([usual, {"horizontal": replace(level, p_1_s=0.9), "up": up}]) == ""
    assert response_line([usual, {"horizontal": level, "up": replace(up, p_1_s=2.0)}]) == ""


def test_a_log_in_which_nothing_moves_is_refused_with_the_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    vary = tmp_path / "vary.yaml"
    vary.write_text("limit_s: 5.5\nsettle_s: 0\n", encoding="utf-8")
    log = tmp_path / "short.tlog"
    fly_case(Cases(CUBE8, load_vary(vary), 4).case(0), log)
    code, _, err = gs(["identify", str(log)], monkeypatch, capsys)
    assert code == 1
    assert "no vehicle could be identified" in err.replace("\n", " ")


def test_a_mission_takes_identified_values() -> None:
    plain = cube8()
    plan = cube8("profiles={crazyflie: {lag_s: 0.3, delay_s: 0.12}}")
    assert plan.profile.lag_s == 0.3
    assert plan.profile.delay_s - plain.profile.delay_s == pytest.approx(0.07)
    assert plan.control_gain < plain.control_gain
    assert plan.record()["profiles"] == {"crazyflie": {"lag_s": 0.3, "delay_s": 0.12}}
    own = cube8("profiles={slow: {like: crazyflie, lag_s: 0.5}}", "vehicles.2.profile=slow")
    assert own.profile.lag_s == 0.5
    assert world_config(own).vehicles[2].profile == "crazyflie"
    with pytest.raises(UserError, match=r"profiles\.slow\.like: slow is not known"):
        cube8("profiles={slow: {lag_s: 0.5}}")


def test_a_delay_that_is_most_of_the_answer_is_worth_a_word() -> None:
    """An S-shaped response is found as half delay, half lag: the sum is right."""
    s_shaped = {"id": 3, "lag_s": 0.5, "delay_s": 0.49, "t63_s": 0.99}
    usual = {"id": 4, "lag_s": 0.16, "delay_s": 0.07, "t63_s": 0.23}
    unknown = {"id": 5, "lag_s": None, "delay_s": None, "t63_s": None}
    note = delay_note([s_shaped, usual, unknown, {**s_shaped, "id": 7}])
    assert note.startswith("vehicles 3 (49%), 7 (49%): that much of t63 is delay. Either the links are slow, or it")
    assert "r is kept with the sum of both" in note
    assert delay_note([usual, unknown]) == ""
    # By the pair the damper holds a vehicle with the true lag as well, all but critically damped: it is more careful.
    found, true = (
        DamperParams(3.0, 0.0, lag_s, delay_s, 0.02, speed_limit_m_s=1.5, accel_limit_m_s2=2.5)
        for lag_s, delay_s in ((0.5, 0.49), (0.9, 0.1))
    )
    # 0.9 d'' + (1 + alpha T) d' + alpha d = 0, two of them at their bounds
    assert (1.0 + found.rate_1_s * found.horizon_s) / (2.0 * math.sqrt(0.9 * found.rate_1_s)) > 0.95
    assert found.rate_1_s < true.rate_1_s
