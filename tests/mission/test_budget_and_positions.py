"""What links carry and what positions can hold: told before anything is opened, with what would do."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.core.damper import DamperParams
from groundstation.core.errors import UserError
from groundstation.mavlink.codec import Encoder
from groundstation.mission.plan.budget import LinkRates, fit_rates, frame_bytes
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.positioning import POSITION_ERROR_M, margin_deviations, margin_m
from groundstation.mission.plan.profiles import PROFILES
from groundstation.mission.plan.reading import load_mission, plan_from_record
from tests.app.flights import CUBE8, FULL_RATE, cube8, mission, pair

GPS_MARGIN_M = 3.0 * math.sqrt(2.0) * 0.24


@pytest.mark.parametrize(
    ("message", "fields"),
    [
        ("LOCAL_POSITION_NED", {"time_boot_ms": 1, "vz": 1.0}),
        ("GLOBAL_POSITION_INT", {"time_boot_ms": 1, "hdg": 65535}),
        ("ATTITUDE_QUATERNION", {"time_boot_ms": 1, "yawspeed": 0.1}),
        ("SET_POSITION_TARGET_LOCAL_NED", {"coordinate_frame": 1}),
        ("HEARTBEAT", {"mavlink_version": 3}),
    ],
)
def test_sizes_are_those_on_the_wire(message: str, fields: dict[str, float]) -> None:
    assert frame_bytes(message) == len(Encoder(1).encode(message, **fields))


@given(
    vehicles=st.integers(1, 12), limit=st.floats(500.0, 200_000.0), pose_hz=st.floats(10.0, 100.0),
    setpoint_hz=st.floats(10.0, 100.0),
)  # fmt: skip
def test_what_is_fitted_fits_and_is_no_more_than_was_wanted(
    vehicles: int, limit: float, pose_hz: float, setpoint_hz: float
) -> None:
    def fit() -> LinkRates:
        return fit_rates(
            "serial", vehicles, limit, pose_hz=pose_hz, setpoint_hz=setpoint_hz, position="LOCAL_POSITION_NED"
        )

    if limit < 500 * vehicles:
        with pytest.raises(UserError, match="use a faster link"):
            fit()
        return
    if limit < 700 * vehicles:
        return
    rates = fit()
    assert rates.lean == (rates.attitude_hz < rates.pose_hz)
    assert max(rates.down_bytes_s, rates.up_bytes_s) <= 0.8 * limit * (1 + 1e-9)
    assert 8.0 <= rates.pose_hz <= pose_hz
    assert 5.0 <= rates.setpoint_hz <= setpoint_hz
    assert rates.narrow == (rates.lean or rates.pose_hz < pose_hz or rates.setpoint_hz < setpoint_hz)


def test_a_narrow_link_makes_the_law_slower_and_a_radio_may_be_narrower_than_its_port() -> None:
    url = "serial:///dev/ttyUSB0:57600"
    links = [f"vehicles.{number}.link={url}" for number in range(2)]
    wide = pair("rate_hz=50")
    narrow = pair("rate_hz=50", *links)
    slow = pair("rate_hz=50", *links, f"link_bytes_per_s={{'{url}': 3400}}")
    assert narrow.profile.delay_s > wide.profile.delay_s
    assert narrow.control_gain < wide.control_gain
    assert slow.rates[0].pose_hz < 0.6 * narrow.rates[0].pose_hz
    assert slow.rates[0].words(url, 2).startswith(f"{url}: 2 vehicles, positions and attitudes at 1")
    with pytest.raises(UserError, match="no vehicle uses this link"):
        pair("link_bytes_per_s={'udpin://1.2.3.4:5': 100}")


def test_the_margin_is_three_deviations_of_a_difference() -> None:
    assert margin_m(POSITION_ERROR_M["gps"]) == pytest.approx(GPS_MARGIN_M)
    assert pair().margin_m == pytest.approx(GPS_MARGIN_M)
    assert pair("position_error_m=0.1").margin_m == pytest.approx(0.3 * math.sqrt(2.0))
    assert cube8().positioning == "mocap"
    assert mission("px4_cube8").positioning == "gps"


@pytest.mark.parametrize(
    ("plan", "message"),
    [
        (
            lambda: mission("px4_cube8", "avoidance.radius_m=4.2", "avoidance.activation_m=5"),
            "avoidance.radius_m: 4.2 m cannot be kept with gps positions: two of them may be 1.02 m off against each"
            " other, and the shortest distance of the pads is 5 m; an r of 3.98 m could be kept",
        ),
        (
            lambda: mission("px4_cube8", "formation_scale=4.0"),
            "the shortest distance of the formation cube8 is 4 m; an r of 2.98 m could be kept",
        ),
        (lambda: cube8("positioning=gps"), "no r could be kept: move further apart, or use better positions than gps"),
        # The formation (8 m) would leave an r of 1.63 m, the pads (5 m) leave none.
        (
            lambda: mission("px4_cube8", "position_error_m=1.5"),
            "6.36 m off against each other, and the shortest distance of the pads is 5 m; no r could be kept: move",
        ),
        (
            lambda: mission(
                "px4_cube8",
                "position_error_m=1.5",
                "avoidance.shape=cylinder",
                "avoidance.half_height_m=2.0",
            ),
            "of room in the pads; no size could be kept: move further apart",
        ),
        (
            lambda: cube8("avoidance.radius_m=0.97", "avoidance.activation_m=1.0"),
            "0.97 m cannot be kept with mocap positions: two of them may be 0.04 m off",
        ),
    ],
)
def test_an_r_that_positions_cannot_keep_is_refused_with_the_one_that_could(plan: object, message: str) -> None:
    assert callable(plan)
    with pytest.raises(UserError) as caught:
        plan()
    assert message in str(caught.value)


def test_the_r_that_is_named_can_be_kept_and_a_little_more_cannot() -> None:
    assert mission("px4_cube8", "avoidance.radius_m=3.98", "avoidance.activation_m=5").size == 8
    with pytest.raises(UserError, match="cannot be kept"):
        mission("px4_cube8", "avoidance.radius_m=3.99", "avoidance.activation_m=5")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("vehicles.0.origin=declared", "origin: declared and origin_m"),
        ("vehicles.0.origin_m=[1, 2, 3]", "origin: declared and origin_m"),
        ("vehicles.0.position=sideways", "vehicles[0].position"),
        ("anchor={lat_deg: 91, lon_deg: 0, alt_m: 0}", "anchor.lat_deg"),
        ("anchor={lat_deg: 47}", "anchor.lon_deg: is missing"),
        ("positioning=hope", "positioning"),
        ("formation_scale=0", "formation_scale"),
        ("vehicles.1.link=mavsdk://nowhere", "vehicles[1].link: mavsdk://nowhere: expected udpin://HOST:PORT"),
    ],
)
def test_wrong_values_of_the_new_keys_are_said_by_their_key(change: str, message: str) -> None:
    with pytest.raises(UserError) as caught:
        pair(change)
    assert message in str(caught.value)


def _again(plan: MissionPlan) -> MissionPlan:
    return plan_from_record(plan.record(), plan.gains_npz, "manifest")


@pytest.mark.parametrize("name", ["px4_cube8", "arducopter_two_squares8", "mixed8", "first_flight2"])
def test_a_scaled_formation_comes_back_from_its_record_to_the_bit(name: str) -> None:
    plan = mission(name)
    again = _again(plan)
    assert again.formation.points_enu_m.tolist() == plan.formation.points_enu_m.tolist()
    assert (again.control_gain, again.rates, again.margin_m) == (plan.control_gain, plan.rates, plan.margin_m)
    assert again.record() == plan.record()


def test_a_link_is_lean_only_where_too_few_positions_would_fit() -> None:
    def fit(vehicles: int) -> LinkRates:
        return fit_rates(
            "serial", vehicles, 5760, pose_hz=50, setpoint_hz=50, position="LOCAL_POSITION_NED", cross_check=True
        )

    assert [fit(vehicles).lean for vehicles in range(1, 10)] == [False] * 4 + [True] * 5
    assert fit(8).pose_hz == pytest.approx(10.0, abs=0.1)
    assert (fit(8).attitude_hz, fit(8).setpoint_hz > 8.0) == (2.0, True)
    with pytest.raises(UserError, match=r"minimum is 8 Hz; 9 would fit: use a faster link \(115200 baud do\)"):
        fit(10)


def test_a_tolerance_that_wandering_vehicles_cannot_keep_is_refused_and_the_one_that_is_named_is_taken() -> None:
    slow = (FULL_RATE, "link_delay_s=0.39")
    with pytest.raises(UserError, match=r"steps\[0\].form.tolerance_m: 0.4 m, minimum is 0.46 m"):
        mission("px4_cube8", *slow)
    with pytest.raises(UserError, match=r"tolerance_m: 0.45 m, minimum is 0.46 m"):
        mission("px4_cube8", *slow, "steps.0.form.tolerance_m=0.45")
    assert mission("px4_cube8", *slow, "steps.0.form.tolerance_m=0.46").slowness > 2.0
    assert mission("px4_cube8", FULL_RATE).slowness == 1.0
    assert cube8("link_delay_s=0.5").size == 8  # motion capture does not wander


def _rows(heading: str) -> list[list[str]]:
    """Cells of the table of docs/avoidance-why.md that has this heading."""
    lines = (Path(__file__).parents[2] / "docs" / "avoidance-why.md").read_text(encoding="utf-8").splitlines()
    start = next(number for number, line in enumerate(lines) if line.startswith(heading))
    rows = itertools.takewhile(lambda line: line.startswith("|"), lines[start + 2 :])
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]


def test_the_margin_is_of_as_many_deviations_as_the_docs_say() -> None:
    rows = _rows("| profile | T | σ 1 cm")
    assert [row[0].strip("`") for row in rows] == list(PROFILES)
    for name, horizon, *told in rows:
        profile = PROFILES[name.strip("`")]
        horizon_s = max(profile.lag_s, 0.5 / profile.acceleration_max_m_s2)
        assert float(horizon.removesuffix(" s")) == pytest.approx(horizon_s)
        errors = [(0.01, 0.01), (0.02, 0.01), (POSITION_ERROR_M["gps"], 0.035), (POSITION_ERROR_M["gps"], 0.1)]
        assert told == [f"{margin_deviations(*both, horizon_s):.2f}" for both in errors]


def test_what_the_argument_assumes_is_told_for_every_mission_that_comes_along() -> None:
    rows = _rows("| mission | `delay_product`")
    plans = {path.stem: load_mission(path) for path in sorted(CUBE8.parent.glob("*.yaml"))}
    damped = {name: plan for name, plan in plans.items() if plan.spec.avoidance.method != "rotation"}
    assert set(plans) - set(damped) == {"paper_cube8"}  # the paper's pure law: the argument is not about it
    assert [row[0] for row in rows] == list(damped)
    for name, product, speeds, late in rows:
        plan = damped[name]
        v, a, profile = plan.spec.speed_limit_m_s, plan.acceleration_limit_m_s2, plan.profile
        params = DamperParams(
            1.0, 0.0, profile.lag_s, profile.delay_s, 1.0 / plan.spec.rate_hz, speed_limit_m_s=v, accel_limit_m_s2=a
        )
        assert product == f"{params.delay_product:.2f}"
        assert speeds == f"{v:.2f}, {2 * v:.2f}, {profile.acceleration_max_m_s2 * profile.lag_s:.2f}"
        assert late == f"{2 * v / a:.2f}"
        assert v <= profile.acceleration_max_m_s2 * profile.lag_s  # standing still at once saturates nobody
