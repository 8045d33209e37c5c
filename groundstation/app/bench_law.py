"""How fast teams form, and how near they come: the product against others, with the same starts and noise."""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.table import Table

from groundstation.app.law_bench.plant import LINK_DELAY_S, TICK_S, WANDER_M, Plant
from groundstation.app.law_bench.rivals import RIVALS, Rival
from groundstation.app.output import Output
from groundstation.app.resources import find_config
from groundstation.core.choices import unknown
from groundstation.core.errors import UserError
from groundstation.core.formation import Formation
from groundstation.core.metrics import formation_error_m
from groundstation.core.types import FloatArray
from groundstation.design.store import load_formation
from groundstation.mavlink.autopilots import AUTOPILOTS
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.profiles import PROFILES
from groundstation.mission.plan.reading import plan_from_record

FORMATIONS = ("cube8", "ring12", "grid27")
STARTS = ("planar", "volume")
Figures = dict[str, float | int | None]

_RADIUS_M, _APART_M, _SPEED_M_S = 0.45, 0.5, 0.5
_WITHIN_M = 0.1
_STEADY_S, _HELD_S, _LONGEST_S = 1.0, 3.0, 60.0
_SETTLING_S, _REST_S = 10.0, 5.0  # what is left of errors dies out first: it is no swinging
_ROOM_M, _LEVEL_M2 = 3.0, 0.8


@dataclass(frozen=True)
class Race:
    """What came of one flight.

    Attributes:
        formed_s: from when on all distances were right within 10 cm for a second; None: never.
        smallest: smallest true distance over r.
        jerkiness_m_s2: how fast what was told changed until then, root mean square.
        effort_m2_s3: true acceleration squared over that time, mean of the vehicles.
        held_m_s: what was told in the three seconds after that second, one axis, root mean square; None: not formed.
        rest_m_s: the same from the tenth to the fifteenth second after it.
    """

    formed_s: float | None
    smallest: float
    jerkiness_m_s2: float
    effort_m2_s3: float
    held_m_s: float | None
    rest_m_s: float | None


def run(
    out: Output,
    formations: Sequence[str] = FORMATIONS,
    profiles: Sequence[str] = tuple(PROFILES),
    *,
    starts: Sequence[str] = STARTS,
    rivals: Sequence[str] = tuple(RIVALS),
    seeds: int = 3,
) -> dict[str, dict[str, Figures]]:
    """Flies all races and returns their figures, by formation, profile, kind of start and name.

    Raises:
        UserError: an unknown name.
    """
    for what, names, known in (
        ("profiles", profiles, tuple(PROFILES)),
        ("starts", starts, STARTS),
        ("rivals", rivals, tuple(RIVALS)),
    ):
        for name in names:
            if name not in known:
                raise UserError(f"gs bench law: --{what}: {name}: {unknown(name, known)}")
    values: dict[str, dict[str, Figures]] = {}
    table = Table(
        "team",
        "who",
        "formed",
        "median s",
        "smallest / r",
        "below r",
        "change m/s2",
        "effort",
        "held m/s",
        "at rest m/s",
        title=f"bench law, {seeds} starts each",
    )
    for formation in formations:
        for profile in profiles:
            plans = {name: plan_for(formation, profile, compensated=name == "product") for name in rivals}
            for start in starts:
                team = f"{formation} {profile} {start}"
                values[team] = {}
                for name in rivals:
                    races = list(_races(plans[name], profile, start, name, seeds))
                    figures = _figures(races)
                    values[team][name] = figures
                    table.add_row(team, name, *_words(figures))
                    out.console.print(f"{team}, {name}: {figures['median_s']} s")
    out.console.print(table)
    return values


def plan_for(name: str, profile: str, *, compensated: bool = True) -> MissionPlan:
    """The mission of a race: formed within 10 cm, then held; pads count for nothing.

    Raises:
        UserError: no such formation.
    """
    path = find_config(Path(name), "formations")
    formation = load_formation(path)
    gains = path.parent.parent / "gains" / f"{path.stem}.npz"
    if not gains.is_file():
        raise UserError(f"gs bench law: --formations: {name}: has no gains in {gains}; name one that comes along")
    room_m = _room_m(formation)
    side = int(np.ceil(np.sqrt(formation.size)))
    vehicles = [
        {
            "id": k + 1,
            "link": "udpin://127.0.0.1:14540",
            "autopilot": profile if profile in AUTOPILOTS else next(iter(AUTOPILOTS)),
            "profile": profile,
            "pad_m": [2.0 * (k % side) - side, 2.0 * (k // side) - side, 0.0],
        }
        for k in range(formation.size)
    ]
    values = {
        "name": f"{path.stem}-{profile}",
        "formation": {
            "name": path.stem,
            "scale": 1.0,
            "points": formation.points_enu_m.tolist(),
            "edges": [[i + 1, j + 1] for i, j in formation.edges],
        },
        "speed_limit_m_s": _SPEED_M_S,
        "link_delay_s": LINK_DELAY_S,
        "position_error_m": WANDER_M,
        "min_altitude_m": 0.3,
        "compensate_s": "auto" if compensated else 0,
        "avoidance": {"radius_m": _RADIUS_M, "activation_m": _APART_M},
        "takeoff": {"height_m": 1.0},
        "steps": [{"form": {"tolerance_m": _WITHIN_M, "timeout_s": 600}}, {"hold": {"seconds": 600}}],
        "land": {"at": "pads"},
        "fence": {"min_m": [-3 * room_m] * 2 + [0], "max_m": [3 * room_m] * 3},
        "vehicles": vehicles,
    }
    return plan_from_record(values, gains.read_bytes(), f"bench law, {name}")


def _room_m(formation: Formation) -> float:
    """Side of the room for starts: at least 3 m, and 0.8 square metres for each vehicle."""
    return max(_ROOM_M, float(np.sqrt(_LEVEL_M2 * formation.size)))


def random_start(rng: np.random.Generator, formation: Formation, *, level: bool) -> FloatArray:
    """Places ENU, 0.5 m from each other at least, on one height or anywhere in the room, shape (n, 3)."""
    room_m = _room_m(formation)
    middle = np.array([0.0, 0.0, 0.5 * room_m + 0.8])
    while True:
        chosen: list[FloatArray] = []
        for _ in range(4000):
            point = rng.uniform(-0.5 * room_m, 0.5 * room_m, 3) * ([1.0, 1.0, 0.0] if level else 1.0) + middle
            if all(np.linalg.norm(point - other) >= _APART_M for other in chosen):
                chosen.append(point)
            if len(chosen) == formation.size:
                return np.array(chosen)


def _races(plan: MissionPlan, profile: str, start: str, name: str, seeds: int) -> Iterator[Race]:
    for seed in range(seeds):
        start_enu_m = random_start(np.random.default_rng(seed), plan.formation, level=start == "planar")
        yield race(plan.formation, Plant(profile, start_enu_m, seed), RIVALS[name](plan, start_enu_m))


def race(formation: Formation, plant: Plant, rival: Rival) -> Race:
    """Flies until the formation has stood for a second, and fifteen more; a minute at most, or that long after it."""
    told: list[FloatArray] = []
    efforts: list[float] = []
    smallest_m, formed = np.inf, None
    for tick in range(round(_LONGEST_S / TICK_S)):
        told.append(rival.steer(plant.see()))
        ticked = plant.tell(told[-1])
        efforts.append(ticked.effort_m2_s3)
        smallest_m = min(smallest_m, ticked.smallest_m)
        stood = formed is not None and (tick - formed) * TICK_S >= _STEADY_S
        if not stood:
            within = formation_error_m(ticked.pos_enu_m, formation.distances_m, rival.roles) <= _WITHIN_M
            formed = (tick if formed is None else formed) if within else None
        elif formed is not None and (tick - formed) * TICK_S >= _STEADY_S + _SETTLING_S + _REST_S:
            break
    stood = formed is not None and (len(told) - 1 - formed) * TICK_S >= _STEADY_S
    until = len(told) if formed is None or not stood else formed + round(_STEADY_S / TICK_S)
    change = np.diff(np.array(told[:until]), axis=0) / TICK_S
    after = np.array(told[until:])
    return Race(
        formed_s=(formed + 1) * TICK_S if formed is not None and stood else None,
        smallest=smallest_m / _RADIUS_M,
        jerkiness_m_s2=float(np.sqrt((change**2).sum(axis=2).mean())),
        effort_m2_s3=float(np.sum(efforts[:until])),
        held_m_s=_rms(after[: round(_HELD_S / TICK_S)]) if stood else None,
        rest_m_s=_rms(after[round(_SETTLING_S / TICK_S) :]) if stood else None,
    )


def _rms(told_m_s: FloatArray) -> float | None:
    """Root mean square of one axis; None where nothing was told."""
    return float(np.sqrt((told_m_s**2).mean())) if len(told_m_s) else None


def _figures(races: Sequence[Race]) -> Figures:
    """Medians of all races; a time to form counts as endless where it did not form."""
    times = [np.inf if item.formed_s is None else item.formed_s for item in races]
    median_s = statistics.median_high(times)
    held = [item.held_m_s for item in races if item.held_m_s is not None]
    rest = [item.rest_m_s for item in races if item.rest_m_s is not None]
    return {
        "races": len(races),
        "formed": sum(item.formed_s is not None for item in races),
        "median_s": round(median_s, 2) if np.isfinite(median_s) else None,
        "smallest_over_r": round(min(item.smallest for item in races), 3),
        "below_r": sum(item.smallest < 1.0 for item in races),
        "change_m_s2": round(statistics.median(item.jerkiness_m_s2 for item in races), 3),
        "effort_m2_s3": round(statistics.median(item.effort_m2_s3 for item in races), 3),
        "held_m_s": round(statistics.median(held), 4) if held else None,
        "rest_m_s": round(statistics.median(rest), 4) if rest else None,
    }


def _words(figures: Figures) -> Iterator[str]:
    yield f"{figures['formed']} of {figures['races']}"
    for key in ("median_s", "smallest_over_r", "below_r", "change_m_s2", "effort_m2_s3", "held_m_s", "rest_m_s"):
        figure = figures[key]
        yield "-" if figure is None else f"{figure:.4g}"
