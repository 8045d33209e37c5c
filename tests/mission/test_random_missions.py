"""Missions at random, degenerate ones above all: each is refused in words for people, or has nothing but figures.

On 1719c84 two vehicles with a free scale were a traceback ("largest rate of the gains is 0.0"), and pads and moves of
any length were taken.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from groundstation.core.errors import UserError
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.reading import load_mission
from groundstation.mission.runner import Runner
from tests.design.random_teams import SHAPES, random_points

SCALES = [{"kind": kind, **gain} for kind in ("arctan", "tanh", "free") for gain in ({}, {"gain": 1e-9}, {"gain": 100})]
ODD: dict[str, list[Any]] = {
    "scale": SCALES,
    "gain": [1e-12, 0.01, 1, 10],
    "lead_s": [0, 0.2, 10],
    "compensate_s": ["auto", 0.3, 2],
    "upright_1_s": [0, 1e-9, 100],
    "formation_scale": [1e-6, 0.5, 3, 9999],
    "rate_hz": [10, 33.3, 200],
    "speed_limit_m_s": [0.05, 20],
    "acceleration_limit_m_s2": [0.1, 2, 20],
    "assignment": ["auto", "fixed"],
    "role_swaps": [True, False],
    "min_altitude_m": [0, 0.1, 5],
    "takeoff": [{"height_m": 1}, {"height_m": 3, "stagger_m": 1}, {"height_m": 1000}],
    "positioning": ["mocap", "rtk", "gps"],
    "position_error_m": [1e-9, 1, 9999],
    "link_delay_s": [0.3, 10_000],
    "profiles": [{"crazyflie": {"lag_s": lag, "delay_s": delay}} for lag in (0, 10) for delay in (0, 10)],
    "on_lost": ["continue_open", "continue_take_over"],
    "failsafe": [{"action": action} for action in ("return", "land", "hold", "own")],
    "limits": [{"pad_error_m": 1e-9}, {"pose_age_s": 9999}, {"tracking_m_s": 1e-9}],
    "anchor": [{"lat_deg": lat, "lon_deg": lon, "alt_m": 0} for lat in (-89, 0, 89) for lon in (0, 180)],
}
MOVES = [{"by_m": [0.5, 0, 0]}, {"by_m": [1e300, 0, 0]}, {"turn_deg": 3600}, {"scale": 0.1}, {"scale": 10}]


@st.composite
def points(draw: st.DrawFn) -> np.ndarray:
    n = draw(st.integers(1, 5))
    rng = np.random.default_rng(draw(st.integers(0, 10_000)))
    shape = draw(st.sampled_from([*SHAPES, "coincident", "rounded"]))
    team = rng.normal(size=(n, 3)) if shape in ("coincident", "rounded") or n == 1 else random_points(rng, n, shape)
    if shape == "coincident":
        team[:] = team[0]
    if shape == "rounded":
        team = np.round(team)
    apart = np.linalg.norm(team[:, None] - team[None], axis=2)[np.triu_indices(n, 1)].min(initial=np.inf)
    if 0.0 < apart < np.inf and draw(st.integers(0, 9)):
        team = (team - team.mean(axis=0)) / apart * draw(st.sampled_from([0.6, 1.0, 3.0]))
    return np.asarray(team)


@st.composite
def missions(draw: st.DrawFn) -> tuple[dict[str, Any], dict[str, Any]]:
    team = draw(points())
    n = len(team)
    pairs = [[i + 1, j + 1] for i in range(n) for j in range(i + 1, n)]
    some = st.lists(st.sampled_from(pairs), unique_by=tuple) if pairs else st.just([])
    formation = {
        "name": "f",
        "scale": draw(st.sampled_from([1.0, 1.0, 1.0, 2.0, 1e-6, 9999.0])),
        "points": team.tolist(),
        "edges": draw(st.one_of(st.just("complete"), st.just("complete"), some)) if n > 1 else [],
    }
    radius = draw(st.sampled_from([0.2, 0.2, 0.45, 1e-9, 9999.0]))
    pads = [[3.0 * (i % 3), 3.0 * (i // 3), 0.0] for i in range(n)]
    if not draw(st.integers(0, 29)):
        pads = draw(st.sampled_from([[[0.0, 0.0, 0.0]] * n, [[1e300 * i, 0.0, 0.0] for i in range(n)]]))
    odd = draw(st.lists(st.sampled_from(sorted(ODD)), max_size=4, unique=True))
    mission: dict[str, Any] = {
        "name": "m",
        "formation": "f.yaml",
        "avoidance": {"radius_m": radius, "activation_m": 1.3 * radius},
        "fence": {"min_m": [-100, -100, 0], "max_m": [100, 100, 100]},
        "steps": [{"form": {}}, {"hold": {}}],
        "vehicles": [{"id": i + 1, "link": "udpin://127.0.0.1:14540", "pad_m": pad} for i, pad in enumerate(pads)],
    } | {key: draw(st.sampled_from(ODD[key])) for key in odd}
    if not draw(st.integers(0, 3)):
        mission["steps"].append({"move": draw(st.sampled_from(MOVES))})
    if not draw(st.integers(0, 5)):
        mission["avoidance"] |= {"shape": draw(st.sampled_from(["cylinder", "ellipsoid"]))}
        mission["avoidance"] |= {"half_height_m": draw(st.sampled_from([0.3, 9999]))}
    return mission, formation


def _load(folder: Path, mission: dict[str, Any], formation: dict[str, Any]) -> MissionPlan:
    (folder / "f.yaml").write_text(yaml.safe_dump(formation))
    (folder / "m.yaml").write_text(yaml.safe_dump(mission))
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # an overflow is a figure that is none
        plan = load_mission(folder / "m.yaml")
        Runner(plan, 0).step(1)
    return plan


def _figures(name: str, value: Any) -> dict[str, Any]:
    """All numbers of a plan by where they stand."""
    if isinstance(value, (float, np.ndarray)):
        return {name: value}
    if isinstance(value, (tuple, list)):
        parts = {f"{name}[{k}]": item for k, item in enumerate(value)}
    elif isinstance(value, dict):
        parts = {f"{name}.{key}": item for key, item in value.items()}
    elif is_dataclass(value):
        parts = {f"{name}.{item.name}": getattr(value, item.name) for item in fields(value)}
    else:
        return {}
    return {key: figure for part, item in parts.items() for key, figure in _figures(part, item).items()}


@settings(max_examples=120, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(given=missions())
def test_a_mission_is_refused_in_words_or_has_nothing_but_figures(
    tmp_path_factory: pytest.TempPathFactory, given: tuple[dict[str, Any], dict[str, Any]]
) -> None:
    folder = tmp_path_factory.mktemp("mission")
    try:
        plan = _load(folder, *given)
    except UserError as error:
        words = str(error)
        assert words.startswith(f"{folder}/"), words
        assert " nan" not in words
        assert " inf " not in words
        return
    limits = ("pose_jump_m", "tracking_m_s", "frame_drift_m", "pad_error_m", "lost_radius_m")
    figures = _figures("plan", plan) | {name: getattr(plan.limits, name) for name in limits}
    figures["slowness"] = plan.slowness
    for name, value in figures.items():
        if not name.endswith("limit_bytes_s"):  # where a link has none
            assert np.isfinite(value).all(), name
    assert all(0.0 < stage.control_gain < math.inf for stage in plan.stages)


def _pair(*points_m: list[float], **mission: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    return {
        "name": "m",
        "formation": "f.yaml",
        "avoidance": {"radius_m": 0.2, "activation_m": 0.3},
        "fence": {"min_m": [-9, -9, 0], "max_m": [9, 9, 9]},
        "steps": [{"form": {}}],
        "vehicles": [
            {"id": i + 1, "link": "udpin://127.0.0.1:14540", "pad_m": [i, 0, 0]} for i in range(len(points_m))
        ],
    } | mission, {"name": "f", "points": list(points_m), "edges": "complete"}


@pytest.mark.parametrize("second", [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.5, 0.5, 0.5]])
def test_two_that_nothing_pulls_are_refused_by_key_and_two_that_are_pulled_are_not(
    tmp_path: Path, second: list[float]
) -> None:
    """Gains of two are zero where they stand neither level nor one above the other."""
    for law, where in ((0, "scale: "), (1, "steps[1].form.scale: ")):
        free = {"kind": "free"}
        changes: dict[str, Any] = {"scale": free} if law == 0 else {"steps": [{"form": {}}, {"form": {"scale": free}}]}
        values = _pair([0.0, 0.0, 0.0], second, **changes)
        if 1.0 in second:
            assert _load(tmp_path, *values).stages[-1].control_gain > 0.0
            continue
        with pytest.raises(UserError) as error:
            _load(tmp_path, *values)
        assert str(error.value).startswith(f"{tmp_path}/m.yaml: {where}kind free with formation f of 2: nothing")
    assert _load(tmp_path, *_pair([0.0, 0.0, 0.0], second)).stages[0].control_gain > 0.0


def test_a_length_that_is_none_on_earth_is_refused_by_key(tmp_path: Path) -> None:
    mission, formation = _pair([0.0, 0.0, 0.0], [1.0, 0.0, 0.0])
    mission["vehicles"][1]["pad_m"] = [1e300, 0, 0]
    with pytest.raises(UserError, match=r"m\.yaml: vehicles\[1\]\.pad_m\[0\]: expected a number of at most"):
        _load(tmp_path, mission, formation)
