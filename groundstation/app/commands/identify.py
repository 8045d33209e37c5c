"""``gs identify``: how fast each vehicle follows its setpoints, out of the log of a flight."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table
from rich.text import Text

from groundstation.app.commands.fly import JsonOption
from groundstation.app.output import Output
from groundstation.core.errors import CheckFailed, MissionFailed
from groundstation.core.identify import STEP_S, Response
from groundstation.core.identify import identify as fit
from groundstation.records.manifest import manifest_beside
from groundstation.records.responses import load_motions
from groundstation.records.tlog import read_tlog

_DIRECTIONS = ("east", "north", "up")
DELAY_SHARE_MAX = 0.4
"""Share of t63 from which on a delay is worth a word: profiles that come along have a fifth at most."""


def identify(
    log: Annotated[Path, typer.Argument(help="Log of a flight (.tlog).")],
    *,
    as_json: JsonOption = False,
) -> None:
    """Finds lag and delay of each vehicle's velocity loop in a log, and the lines for a mission file."""
    out = Output(as_json=as_json)
    motions = load_motions(log, STEP_S)
    if not motions:
        for line in read_tlog(log).survey().words():
            out.console.print(Text(line))
        raise CheckFailed(f"{log}: holds no velocity setpoints with velocities beside them; nothing can be identified")
    profile_of = _profiles(log)
    table = Table(title=f"{log.name}: how setpoints are followed")
    for heading in ("vehicle", "direction", "t63", "lag", "delay", "gain", "explained"):
        table.add_column(heading)
    problems: dict[str, None] = {}
    vehicles: list[dict[str, Any]] = []
    for motion in motions:
        asked, done = motion.asked_enu_m_s.T, motion.done_enu_m_s.T
        axes = {name: fit([asked[k]], [done[k]]) for k, name in enumerate(_DIRECTIONS)}
        axes["horizontal"] = fit(list(asked[:2]), list(done[:2]))
        for name in ("horizontal", "up"):
            table.add_row(str(motion.sysid), name, *_cells(axes[name]))
            if axes[name].problem:
                problems[f"vehicle {motion.sysid}, {name}: {axes[name].problem}"] = None
        vehicles.append({"id": motion.sysid, "profile": profile_of.get(motion.sysid), **_slowest(axes),
                         "axes": {name: _values(found) for name, found in axes.items()}})  # fmt: skip
    out.console.print(table)
    for problem in problems:
        out.console.print(problem)
    note = delay_note(vehicles)
    if note:
        out.console.print(note)
    lines = profile_lines(vehicles)
    if lines:
        out.console.print("for the mission file (links included: leave link_delay_s at 0):\nprofiles:")
        for line in lines:
            out.console.print(f"  {line}")
    known = [vehicle for vehicle in vehicles if vehicle["lag_s"] is not None]
    out.result({"log": str(log), "vehicles": vehicles, "identified": len(known), "profiles": lines, "note": note})
    if not known:
        raise MissionFailed(f"{log}: no vehicle could be identified: {vehicles[0]['problem']}")


def profile_lines(vehicles: list[dict[str, Any]]) -> list[str]:
    """One line for each profile that the vehicles fly under: the figures of the slowest vehicle."""
    lines = []
    for name in dict.fromkeys(vehicle["profile"] for vehicle in vehicles if vehicle["profile"]):
        found = [item for item in vehicles if item["profile"] == name and item["lag_s"] is not None]
        if found:
            slowest = max(found, key=lambda item: item["t63_s"])
            lines.append(f"{name}: {{lag_s: {slowest['lag_s']:.2f}, delay_s: {slowest['delay_s']:.2f}}}")
    return lines


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


def _profiles(log: Path) -> dict[int, str]:
    manifest = manifest_beside(log)
    vehicles = () if manifest is None else manifest.mission.get("vehicles") or ()
    return {int(item["id"]): str(item.get("profile", "crazyflie")) for item in vehicles}


def _slowest(axes: dict[str, Response]) -> dict[str, Any]:
    """The vehicle's figures: the slower of horizontal and vertical; none where the horizontal is not known."""
    if axes["horizontal"].problem:
        return {"lag_s": None, "delay_s": None, "t63_s": None, "problem": axes["horizontal"].problem}
    found = [axes[name] for name in ("horizontal", "up") if not axes[name].problem]
    slowest = max(found, key=lambda item: item.t63_s)
    return {"lag_s": slowest.lag_s, "delay_s": slowest.delay_s, "t63_s": slowest.t63_s, "problem": ""}


def _values(found: Response) -> dict[str, Any]:
    return {
        "lag_s": found.lag_s,
        "delay_s": found.delay_s,
        "t63_s": found.t63_s,
        "error_s": found.error_s,
        "gain": found.gain,
        "explained": found.explained,
        "problem": found.problem,
    }


def _cells(found: Response) -> list[str]:
    if found.problem:
        return ["-", "-", "-", "-", "-" if math.isnan(found.explained) else f"{found.explained:.0%}"]
    return [
        f"{found.t63_s:.2f} ± {found.error_s:.2f} s",
        f"{found.lag_s:.2f} s",
        f"{found.delay_s:.2f} s",
        f"{found.gain:.2f}",
        f"{found.explained:.0%}",
    ]
