"""What a campaign comes to: rates with their 95 % confidence intervals, distributions, and the worst runs.

Intervals are Clopper and Pearson's, exact: with 1,000 successes of 1,000 the rate may still be 99.63 %. Rows in, plain
values out; refuses to judge anything but the bars that the vary file sets.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from groundstation.app.campaign.run import Row
from groundstation.app.campaign.vary import ExpectSpec
from groundstation.app.campaign.words import KINDS

_WORST = 10
_WHY_MAX = 300


def interval(count: int, of: int) -> tuple[float, float]:
    """Clopper and Pearson's 95 % confidence interval of a rate; 0 to 1 of no runs."""
    from scipy.stats import binomtest  # noqa: PLC0415

    if of == 0:
        return 0.0, 1.0
    found = binomtest(count, of).proportion_ci(confidence_level=0.95, method="exact")
    return float(found.low), float(found.high)


def below_r(row: Row) -> bool:
    """Whether two vehicles that could keep clear of each other came into each other's safety region, by the truth."""
    return bool(row["min_clearance"] < 1.0)


def figures(rows: Sequence[Row]) -> dict[str, Any]:
    """The figures of some runs."""
    count = len(rows)
    values: dict[str, Any] = {"runs": count}
    for name in ("success", "formed", "safe"):
        hits = sum(bool(row[name]) for row in rows)
        low, high = interval(hits, count)
        values |= {f"{name}_rate": hits / count if count else math.nan, f"{name}_low": low, f"{name}_high": high}
    times = np.array([row["time_to_form_s"] for row in rows if math.isfinite(row["time_to_form_s"])])
    slower = np.array([row["time_to_form_s"] / row["kinematic_time_to_form_s"] for row in rows])
    slower = slower[np.isfinite(slower)]
    distances = np.array([row["min_distance_m"] for row in rows if math.isfinite(row["min_distance_m"])])
    radii = {row["safety_radius_m"] for row in rows if math.isfinite(row["safety_radius_m"])}
    clearances = [row["min_distance_m"] - row["safety_radius_m"] for row in rows]
    values |= {
        "min_distance_m": _least(distances),
        "min_distance_median_m": _quantile(distances, 0.5),
        "safety_radius_m": radii.pop() if len(radii) == 1 else math.nan,
        "min_clearance_m": _least(np.array([value for value in clearances if math.isfinite(value)])),
        "below_r": sum(below_r(row) for row in rows),
        "median_time_to_form_s": _quantile(times, 0.5),
        "p95_time_to_form_s": _quantile(times, 0.95),
        "max_time_to_form_s": _quantile(times, 1.0),
        "median_slower": _quantile(slower, 0.5),
        "p95_slower": _quantile(slower, 0.95),
        "kinematic_formed": sum(math.isfinite(row["kinematic_time_to_form_s"]) for row in rows),
        "max_hold_error_m": _quantile(
            np.array([row["formation_error_m"] for row in rows if math.isfinite(row["formation_error_m"])]), 1.0
        ),
        "max_hold_speed_m_s": _quantile(
            np.array([row["hold_speed_m_s"] for row in rows if math.isfinite(row["hold_speed_m_s"])]), 1.0
        ),
        "completed": sum(row["outcome"] == "completed" for row in rows),
        "ended_safely": sum(bool(row["ended_safely"]) for row in rows),
        "errors": sum(bool(row["error"]) for row in rows),
        "tracebacks": sum(row["tracebacks"] > 0 for row in rows),
        "disagreements": sum(row["disagreements"] > 0 for row in rows),
        "disagreed": {kind: count for kind in KINDS if (count := sum(row[kind] > 0 for row in rows))},
        "gridlocks": sum(row["gridlocks"] for row in rows),
        "role_swaps": sum(row["role_swaps"] for row in rows),
        "detours": sum(row["detours"] for row in rows),
        "runs_with_gridlocks": sum(row["gridlocks"] > 0 for row in rows),
    }
    struck = [row for row in rows if row["faults"]]
    if struck:
        values["untold"] = sum(row["outcome"] != "completed" and not row["told"] for row in struck)
        values["not_struck"] = sum(bool(row["fault_phase"]) and not math.isfinite(row["fault_at_s"]) for row in struck)
    verified = [row for row in rows if row["log_mismatches"] >= 0]
    values["logs_wrong"] = sum(row["log_mismatches"] > 0 or not row["log_complete"] for row in verified)
    if verified:
        values["logs_verified"] = len(verified)
    return values


def summarise(rows: Sequence[Row], cells: Sequence[str], command: Callable[[int], str]) -> dict[str, Any]:
    """All figures of a campaign.

    Args:
        rows: in order of run.
        cells: their names, in order.
        command: the command that replays a run.

    Returns:
        Figures over all runs, ``cells`` with those of each, ``matrix`` of faults by phase, and ``worst``: run, seed,
        why and replay, worst first.
    """
    values = figures(rows)
    values["cells"] = []
    if len(cells) > 1:
        values["cells"] = [
            {"cell": cell, **figures([row for row in rows if row["run"] % len(cells) == number])}
            for number, cell in enumerate(cells)
        ]
    values["matrix"] = matrix(rows)
    values["worst"] = [
        {"run": row["run"], "seed": row["seed"], "cell": row["cell"], "why": why(row), "replay": command(row["run"])}
        for row in sorted(rows, key=_badness)[:_WORST]
    ]
    return values


def matrix(rows: Sequence[Row]) -> dict[str, dict[str, list[int]]]:
    """Faults by phase: of how many runs in which they struck the team was safe, and how many there were."""
    out: dict[str, dict[str, list[int]]] = {}
    for row in rows:
        if row["fault_phase"]:
            cell = out.setdefault(row["faults"], {}).setdefault(row["fault_phase"], [0, 0])
            cell[0] += bool(row["safe"] and (row["outcome"] == "completed" or row["told"]))
            cell[1] += 1
    return out


def missed(values: dict[str, Any], expect: ExpectSpec) -> list[str]:
    """The bars that were missed, in words."""
    words = []
    for key, bar in expect.model_dump(exclude_none=True).items():
        value = values[key]
        rate = key.endswith("_rate")
        if not value >= bar if rate else value > bar:
            words.append(f"{key} is {value:.4g}, expected {bar:g} at {'least' if rate else 'most'}")
    return words


def why(row: Row) -> str:
    """What was wrong with a run, or what was least good about it."""
    words = []
    if row["error"]:
        words.append(f"error: {row['error']}")
    elif row["min_distance_m"] < row["safety_radius_m"]:
        pair = f" between {row['nearest_pair']}" if row["nearest_pair"] else ""
        words.append(f"distance {row['min_distance_m']:.3f} m{pair}, r is {row['safety_radius_m']:g} m")
    elif below_r(row):
        words.append(f"two vehicles at {row['min_clearance']:.0%} of what their safety region asks for")
    if row["disagreed"]:
        words.append(row["disagreed"].split("\n")[0])
    if not row["error"] and not row["ended_safely"]:
        words.append(f"ended with {row['end']}")
    if row["outcome"] not in ("completed", "") or not row["formed"]:
        words.append(row["reason"] or row["outcome"])
    if not words:
        words.append(f"formed after {row['time_to_form_s']:.1f} s, smallest distance {row['min_distance_m']:.3f} m")
    return "; ".join(word for word in words if word)[:_WHY_MAX]


def _badness(row: Row) -> tuple[Any, ...]:
    """Sorts the worst first: errors, too near, unsafe ends, not formed, slow."""
    clearance = row["min_distance_m"] - row["safety_radius_m"]
    time_s = row["time_to_form_s"]
    return (
        not row["error"],
        not row["tracebacks"],
        not below_r(row),
        not row["disagreements"],
        bool(row["ended_safely"]),
        not clearance < 0.0,
        bool(row["formed"]) and row["outcome"] == "completed",
        -time_s if math.isfinite(time_s) else -math.inf,
        row["run"],
    )


def _least(values: np.ndarray) -> float:
    return float(values.min()) if len(values) else math.nan


def _quantile(values: np.ndarray, share: float) -> float:
    return float(np.quantile(values, share)) if len(values) else math.nan
