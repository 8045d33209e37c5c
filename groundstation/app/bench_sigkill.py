"""SIGKILL at random instants of flights over UDP: is every log readable, does every team stay apart and come home?

The ground station is a process of its own, the emulator another, its failsafes set as preflight sets them. Five seconds
after the kill another ground station takes over whoever is still up. Draws its instants from a seed, so that the same
ones can be had again, as far as a wall clock gives them.
"""

from __future__ import annotations

import math
import multiprocessing
import tempfile
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

from groundstation.app.killed_flight import KilledFlight, fly_and, kill
from groundstation.app.output import Output
from groundstation.app.resources import find_config
from groundstation.mission.plan.reading import load_mission

MISSION = "cube8.yaml"
_WHOLE_FLIGHT_S = 28.0  # of that mission, from the first heartbeat to everybody being down
_AT_ONCE = 2
_LOST_MAX_S = 2.5  # a second is held back at most, and what a loaded machine takes on top


def fly_one(seed: int) -> KilledFlight:
    """One flight, killed at an instant that the seed says."""
    instant_s = float(np.random.default_rng(seed).uniform(0.0, _WHOLE_FLIGHT_S))
    with tempfile.TemporaryDirectory() as folder:
        return fly_and(
            kill,
            lambda watched: watched.flying_s >= instant_s,
            find_config(Path(MISSION), "missions"),
            Path(folder),
            seed=seed,
        )


def readable(flight: KilledFlight) -> bool:
    """Whether the log is whole up to its last record, reaches to the kill, and is found again by a replay."""
    lost = math.isnan(flight.log_lost_s) or flight.log_lost_s <= _LOST_MAX_S
    return not flight.log_message.startswith("not readable") and lost and flight.mismatches == 0


def run(out: Output, runs: int = 50, seed: int = 1) -> dict[str, float | int | str]:
    """Flies and kills; prints a line for each flight."""
    radius_m = load_mission(find_config(Path(MISSION), "missions")).spec.avoidance.radius_m
    logs = safe = 0
    smallest_m, down_s, lost_s = math.inf, 0.0, 0.0
    phases: Counter[str] = Counter()
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(_AT_ONCE, runs), mp_context=context) as pool:
        for number, flight in zip(range(seed, seed + runs), pool.map(fly_one, range(seed, seed + runs)), strict=True):
            is_safe = flight.min_distance_m >= radius_m and not math.isnan(flight.down_s)
            logs, safe = logs + readable(flight), safe + is_safe
            phases[flight.phase] += 1
            smallest_m = min(smallest_m, flight.min_distance_m)
            down_s, lost_s = max(down_s, flight.down_s), float(np.fmax(lost_s, flight.log_lost_s))
            taken = f"held in {', '.join(flight.modes)} and was taken over" if flight.modes else "was down"
            out.console.print(
                f"seed {number}: killed after {flight.after_s:.1f} s in {flight.phase}, {taken}, all down"
                f" {flight.down_s:.1f} s later, smallest distance {flight.min_distance_m:.3f} m"
                f" ({flight.before_m:.3f} m before), log"
                f" {'readable' if readable(flight) else 'BAD'} ({flight.setpoints} setpoints, {flight.log_lost_s:.2f} s"
                f" lost, emulator late {flight.late_s:.1f} s) {flight.log_message}{'' if is_safe else '  NOT SAFE'}"
            )
    return {
        "runs": runs,
        "readable_logs": logs,
        "safe_teams": safe,
        "min_distance_m": smallest_m,
        "safety_radius_m": radius_m,
        "longest_descent_s": down_s,
        "longest_log_lost_s": lost_s,
        "phases": ", ".join(f"{name} {count}" for name, count in phases.most_common()),
    }
