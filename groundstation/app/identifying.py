"""What ``gs identify`` tells: figures of each vehicle's velocity loop, in words and as lines of a mission file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from groundstation.core.identify import Response
from groundstation.core.velocity_loop import VelocityLoop
from groundstation.records.manifest import manifest_beside

DIRECTIONS = ("east", "north", "up")
UP_SHARE = 0.8
"""Share of the lag below which the one upward is worth a figure of its own."""
_AXES = ("horizontal", "up")
_ALIKE = 0.15
"""Of a step: by so much velocities of two vehicles of one profile may differ at any time after it."""
DELAY_SHARE_MAX = 0.4
"""Share of t63 from which on a delay is worth a word: profiles that come along have a fifth at most."""


def profile_lines(vehicles: list[dict[str, Any]], loops: Mapping[int, Mapping[str, VelocityLoop]]) -> list[str]:
    """One line for each profile that is flown: the slowest vehicle's figures, and the quickest one's upward.

    Args:
        vehicles: as ``gs identify --json`` has them.
        loops: second orders of each vehicle, by id and direction.
    """
    lines = []
    for name in dict.fromkeys(vehicle["profile"] for vehicle in vehicles if vehicle["profile"]):
        found = [item for item in vehicles if item["profile"] == name and item["lag_s"] is not None]
        if found:
            slowest = max(found, key=lambda item: item["t63_s"])
            ups = [item["axes"]["up"] for item in found]
            up_s = min((up["lag_s"] for up in ups if not up["problem"]), default=math.inf)
            quicker = f", lag_up_s: {max(up_s, 0.01):.2f}" if up_s < UP_SHARE * slowest["lag_s"] else ""
            figures = f"lag_s: {slowest['lag_s']:.2f}{quicker}, delay_s: {slowest['delay_s']:.2f}"
            response = response_line([loops[item["id"]] for item in found])
            lines.append(f"{name}: {{{figures}{f', response: {response}' if response else ''}}}")
    return lines


def response_line(loops: Sequence[Mapping[str, VelocityLoop]]) -> str:
    """The slowest vehicle's loop as a mission file has it; empty where one lag does as well, or not all answer alike.

    Args:
        loops: of each vehicle of a profile, by direction.
    """
    known = [loop for loop in loops if not any(item.problem for item in loop.values())]
    if not known or sum(loop["horizontal"].needed for loop in known) <= len(known) / 2:
        return ""
    slowest = max(known, key=lambda loop: loop["horizontal"].reached_s())
    for direction in _AXES:
        if max(float(np.abs(loop[direction].step() - slowest[direction].step()).max()) for loop in known) > _ALIKE:
            return ""
    axes = (
        f"{key}: {{p_1_s: {item.p_1_s:.2f}, i_1_s2: {item.i_1_s2:.2f}, drag_1_s: {item.drag_1_s:.2f}}}"
        for key, item in zip(("horizontal", "vertical"), (slowest[name] for name in _AXES), strict=True)
    )
    return f"{{{', '.join(axes)}}}"


def delay_note(vehicles: list[dict[str, Any]]) -> str:
    """What it means that most of the time to 63 % is found as delay; empty where no split says anything unusual."""
    known = [item for item in vehicles if item["lag_s"] is not None]
    shares = {item["id"]: item["delay_s"] / item["t63_s"] for item in known}
    large = {sysid: share for sysid, share in shares.items() if share > DELAY_SHARE_MAX}
    if not large:
        return ""
    who = ", ".join(f"{sysid} ({share:.0%})" for sysid, share in large.items())
    return (
        f"vehicle{'s' if len(large) > 1 else ''} {who}: that much of t63 is delay. Either the links are slow, or it"
        " answers in an S (slowly, then quickly), of which a delay and a lag are a likeness only; then t63 is right and"
        " how it is shared out is not. The pair can be flown with: r is kept with the sum of both, and a delay makes"
        " the team gentler than a lag would"
    )


def profiles(log: Path) -> dict[int, str]:
    """Profile of each vehicle, by id, as the manifest beside a log has it."""
    manifest = manifest_beside(log)
    vehicles = () if manifest is None else manifest.mission.get("vehicles") or ()
    return {int(item["id"]): str(item.get("profile", "crazyflie")) for item in vehicles}


def slowest(axes: dict[str, Response]) -> dict[str, Any]:
    """The vehicle's figures: the slower of horizontal and vertical; none where the horizontal is not known."""
    if axes["horizontal"].problem:
        return {"lag_s": None, "delay_s": None, "t63_s": None, "problem": axes["horizontal"].problem}
    found = [axes[name] for name in ("horizontal", "up") if not axes[name].problem]
    slowest = max(found, key=lambda item: item.t63_s)
    return {"lag_s": slowest.lag_s, "delay_s": slowest.delay_s, "t63_s": slowest.t63_s, "problem": ""}


def values(found: Response) -> dict[str, Any]:
    """One direction in the JSON answer."""
    return {
        "lag_s": found.lag_s,
        "delay_s": found.delay_s,
        "t63_s": found.t63_s,
        "error_s": found.error_s,
        "gain": found.gain,
        "explained": found.explained,
        "problem": found.problem,
    }


def cells(found: Response) -> list[str]:
    """One direction in the table."""
    if found.problem:
        return ["-", "-", "-", "-", "-" if math.isnan(found.explained) else f"{found.explained:.0%}"]
    return [
        f"{found.t63_s:.2f} ± {found.error_s:.2f} s",
        f"{found.lag_s:.2f} s",
        f"{found.delay_s:.2f} s",
        f"{found.gain:.2f}",
        f"{found.explained:.0%}",
    ]


def loop_words(vehicle: int, direction: str, loop: VelocityLoop) -> str:
    """What the second order tells of one direction; empty where one lag does as well, or nothing is known."""
    if loop.problem or not loop.needed:
        return ""
    there_s = loop.reached_s(0.95)
    late = f"95 % after {there_s:.1f} s" if math.isfinite(there_s) else "95 % not within 8 s"
    over = f", {loop.overshoot:.0%} beyond it" if loop.overshoot > 0.02 else ""
    return (
        f"vehicle {vehicle}, {direction}: one lag leaves {1.0 - loop.one_lag_explained:.1%} of the motion unexplained,"
        f" the second order {1.0 - loop.explained:.1%}: p {loop.p_1_s:.2f} 1/s, i {loop.i_1_s2:.2f} 1/s²,"
        f" drag {loop.drag_1_s:.2f} 1/s, {loop.delay_s:.2f} s late;"
        f" a step is 63 % there after {loop.reached_s():.2f} s, {late}{over}"
    )


def loop_values(loop: VelocityLoop) -> dict[str, float | bool | str]:
    """The second order of one direction in the JSON answer."""
    return {
        "p_1_s": loop.p_1_s,
        "i_1_s2": loop.i_1_s2,
        "drag_1_s": loop.drag_1_s,
        "delay_s": loop.delay_s,
        "explained": loop.explained,
        "one_lag_explained": loop.one_lag_explained,
        "step_error": loop.error,
        "needed": loop.needed,
        "problem": loop.problem,
    }
