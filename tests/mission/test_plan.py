"""Mission files: what is wrong is told with file, key, value, limit and remedy, before anything flies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from groundstation.app.resources import packaged_configs
from groundstation.core.errors import UserError
from groundstation.mission.plan.reading import load_mission, plan_from_record

CONFIGS = packaged_configs()
CUBE8 = CONFIGS / "missions" / "cube8.yaml"


@pytest.mark.parametrize("path", sorted((CONFIGS / "missions").glob("*.yaml")), ids=lambda path: path.stem)
def test_every_mission_that_comes_along_is_valid(path: Path) -> None:
    plan = load_mission(path)
    assert plan.size == plan.formation.size
    assert plan.source == str(path)


def test_a_crazyflie_follows_as_its_own_firmware_does_and_the_profile_as_before_under_others() -> None:
    missions = packaged_configs() / "missions"

    def lag_and_delay(name: str, *changes: str) -> set[tuple[float, float]]:
        return {(item.lag_s, item.delay_s) for item in load_mission(missions / name, changes).vehicle_profiles}

    assert lag_and_delay("lab_cube8.yaml") == {(0.13, 0.2)}
    assert lag_and_delay("lab_cube8.yaml", "profiles={crazyflie: {lag_s: 0.15, delay_s: 0.3}}") == {(0.15, 0.3)}
    assert lag_and_delay("cube8.yaml") == {(0.2, 0.05)}


def test_cube8_is_flown_as_the_paper_says_with_the_gain_that_the_lag_allows() -> None:
    plan = load_mission(CUBE8)
    assert (plan.spec.avoidance.radius_m, plan.spec.avoidance.activation_m) == (0.45, 0.5)
    assert (plan.scale.kind, plan.scale.gain) == ("arctan", 2.5)
    # The paper's law alone: k lambda_max (tau + delay) = 0.6 with lambda_max = 10, tau = 0.2 s, delay = 0.05 s and the
    # tick of 0.02 s.
    bare = ["lead_s=0", "upright_1_s=0", "compensate_s=0"]
    assert load_mission(CUBE8, bare).control_gain == pytest.approx(0.6 / (10 * 0.27), rel=1e-6)
    slower = load_mission(CUBE8, [*bare, "vehicles.3.profile=px4_quad"])
    assert slower.control_gain == pytest.approx(0.6 / (10 * 1.12), rel=1e-6)
    assert load_mission(CUBE8, ["gain=0.07"]).control_gain == 0.07
    assert slower.control_gain < load_mission(CUBE8, ["vehicles.3.profile=px4_quad"]).control_gain < plan.control_gain
    assert (plan.lead_s, plan.upright_1_s) == (0.2, 1.0)
    assert load_mission(CUBE8, ["scale={kind: free}"]).upright_1_s == 0.0


def test_the_law_looks_ahead_no_farther_than_the_quickest_axis_bears() -> None:
    """k lambda lead / lag upward, what a quick change is answered with: 4.9 1/s and more swung for good."""
    for name, lag_up_s in (("arducopter_two_squares8", 0.2), ("mixed8", 0.2)):
        plan = load_mission(CONFIGS / "missions" / f"{name}.yaml")
        late_s = plan.profile.delay_s + 1.0 / plan.spec.rate_hz
        rate_1_s = 0.6 / (plan.profile.lag_s - 0.75 * plan.lead_s + late_s)
        assert 0.0 < rate_1_s * plan.lead_s / lag_up_s < 2.9
    assert load_mission(CUBE8).lead_s == 0.2  # the same on all axes
    of_one_lag = ["profiles={arducopter: {lag_up_s: 0.6}}"]
    two_squares = CONFIGS / "missions" / "arducopter_two_squares8.yaml"
    assert load_mission(two_squares, of_one_lag).lead_s == 0.6
    assert load_mission(two_squares, ["lead_s=0.45"]).lead_s == 0.45


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (["speed_limt_m_s=1"], "speed_limt_m_s: unknown key"),
        (["avoidance.shpe=sphere"], "avoidance.shpe: unknown key"),
        (["speed_limit_m_s=-1"], "speed_limit_m_s: expected a number of at least 0.05, got -1"),
        (["speed_limit_m_s=true"], "speed_limit_m_s: expected a number, got True"),
        (["speed_limit_m_s=1e308"], "speed_limit_m_s: expected a number of at most 20, got '1e308'"),
        (["gain=1e308"], "gain: "),
        (["name=../../elsewhere"], "name: expected letters, digits, '.', '_' and '-'"),
        (["takeoff.stagger_m=2.5"], "takeoff.height_m: 0.5 m less half of takeoff.stagger_m 2.5 m is below"),
        (["steps=[{hold: {seconds: 1}}]"], "steps[0]: the first step has to be `form`"),
        (["speed_limit_m_s=.nan"], "speed_limit_m_s: expected a "),
        (["vehicles.1.id=1"], "vehicles[1].id: 1 is the id of vehicles[0] too"),
        (["vehicles.1.sysid=255"], "vehicles[1].sysid: expected a number of at most 250, got 255"),
        (["vehicles.1.id=10000"], "vehicles[1].id: expected a number of at most 9999, got 10000"),
        (["vehicles.2.autopilot=px5"], "vehicles[2].autopilot: px5: unknown, did you mean px4? known are px4"),
        (["vehicles.2.profile=brick"], "vehicles[2].profile: brick: unknown; known are crazyflie"),
        (["vehicles.0.link=carrier-pigeon"], "vehicles[0].link: carrier-pigeon"),
        (
            ["vehicles.1.pad_m=[-1.0, -0.8, 0]"],
            "vehicles[1].pad_m: 0.2 m from the pad of vehicles[0], minimum is 0.45 m",
        ),
        (["vehicles.1.pad_m=[9, 9, 0]"], "vehicles[1].pad_m: [9.0, 9.0, 0.0] with the takeoff height of 0.5 m is not"),
        (
            ["avoidance.radius_m=1.0", "avoidance.activation_m=1.1"],
            "formation.points[1]: 1 m from points[0], minimum is",
        ),
        (["avoidance.radius_m=0.6"], "avoidance.activation_m: 0.5 m is less than avoidance.radius_m 0.6 m"),
        (["fence.max_m=[1, 1, 1]"], "fence: 0.6 m of room along z, formation cube8 needs 1 m"),
        (["fence.min_m=[3, 3, 3]"], "fence.min_m[0]: 3 m is not below fence.max_m[0] 3 m"),
        (["formation=../formations/nowhere.yaml"], "formation: ../formations/nowhere.yaml: no such file"),
        (["gains=../gains/nowhere.npz"], "gains: ../gains/nowhere.npz: no such file"),
        (["gains=../gains/pyramid5.npz"], "gains of another formation: they are for 5 agents"),
        (["gains=../gains/two_squares8_low.npz"], "gains of another formation: agent"),
        (
            ["formation=../formations/pyramid5.yaml", "gains=../gains/pyramid5.npz"],
            "vehicles: 8 listed, formation pyramid5",
        ),
        (["steps=[]"], "steps: "),
        (["steps=[{land: {}}]"], "steps[0].land: unknown key"),
        (["steps=[{form: {}, hold: {}}]"], "steps[0]: a step has exactly one key"),
        (["rate_hz=5"], "rate_hz: expected a number of at least 10, got 5"),
        (
            ["acceleration_limit_m_s2=5"],
            "acceleration_limit_m_s2: 5 m/s^2, maximum is 4 m/s^2, what the slowest vehicle reaches (crazyflie): r is",
        ),
        (["no-equals-sign"], "--set no-equals-sign: expected key.path=value"),
        (["vehicles.9.id=3"], "--set vehicles.9.id=3: vehicles.9: expected a number from 0 to 7"),
        (["name.first=x"], "there are no keys below a single value"),
        (["name=[unclosed"], "the value is not valid YAML"),
    ],
)
def test_what_is_wrong_is_said_by_its_key(changes: list[str], message: str) -> None:
    with pytest.raises(UserError) as caught:
        load_mission(CUBE8, changes)
    assert message in str(caught.value)
    assert caught.value.exit_code == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected keys and values at the top level"),
        ("- a\n- b\n", "expected keys and values at the top level"),
        ("name: [unclosed\n", "is not valid YAML"),
        ("name: a\nname: b\n", "key 'name' is given twice"),
        ("!!python/object/apply:os.system ['true']\n", "is not valid YAML"),
        ("name: a\n", "avoidance: is missing"),
    ],
)
def test_files_that_are_no_missions(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "mission.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(UserError, match=r"mission\.yaml") as caught:
        load_mission(path)
    assert message in str(caught.value)


def test_a_file_that_is_not_text_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "mission.yaml"
    path.write_bytes(b"\xff\xfe\x00name")
    with pytest.raises(UserError, match="not a text file in UTF-8"):
        load_mission(path)


def test_without_a_gains_file_the_gains_are_designed_on_the_spot() -> None:
    values = yaml.safe_load(CUBE8.read_text(encoding="utf-8"))
    assert values["gains"]
    plan = load_mission(CUBE8, ["gains=null"])
    stored = load_mission(CUBE8)
    np.testing.assert_allclose(np.linalg.eigvalsh(plan.gains.z), np.linalg.eigvalsh(stored.gains.z), atol=1e-3)
    assert plan.gains_npz


def test_a_formation_that_no_gains_hold_is_not_flown() -> None:
    with pytest.raises(UserError, match="no gains exist"):
        load_mission(
            CUBE8,
            ["formation=../formations/twisted_cube8.yaml", "gains=null"],
        )


def test_the_record_of_a_plan_gives_the_plan_back_to_the_bit() -> None:
    plan = load_mission(CUBE8, ["speed_limit_m_s=0.3", "vehicles.2.profile=px4_quad"])
    again = plan_from_record(plan.record(), plan.gains_npz, "manifest")
    np.testing.assert_array_equal(again.gains.xy, plan.gains.xy)
    np.testing.assert_array_equal(again.gains.z, plan.gains.z)
    np.testing.assert_array_equal(again.formation.points_enu_m, plan.formation.points_enu_m)
    assert again.formation.edges == plan.formation.edges
    assert again.control_gain == plan.control_gain
    assert again.spec.model_dump(exclude={"formation", "gains"}) == plan.spec.model_dump(exclude={"formation", "gains"})


def test_a_record_of_something_else_is_refused() -> None:
    plan = load_mission(CUBE8)
    with pytest.raises(UserError, match=r"mission\.formation: is missing"):
        plan_from_record({"name": "x"}, plan.gains_npz, "manifest")
    with pytest.raises(UserError, match="manifest: mission: wings: unknown key"):
        plan_from_record({**plan.record(), "wings": 2}, plan.gains_npz, "manifest")


def test_setpoints_may_change_as_fast_as_the_mission_says_its_vehicles_can() -> None:
    assert load_mission(CUBE8).acceleration_limit_m_s2 == 4.0
    assert load_mission(CUBE8, ["acceleration_limit_m_s2=1.5"]).acceleration_limit_m_s2 == 1.5
    own = load_mission(CUBE8, ["acceleration_limit_m_s2=5", "profiles={crazyflie: {acceleration_max_m_s2: 6}}"])
    assert own.acceleration_limit_m_s2 == 5.0
