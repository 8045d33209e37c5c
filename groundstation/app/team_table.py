"""The team as a table for a terminal: what each vehicle does, where it is, how old that is, and its last alarm.

Draws only; ``progress`` shows it. Where there are more vehicles than lines, those with something wrong come first.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

import numpy as np
from rich.table import Table
from rich.text import Text

from groundstation.app.session import Session
from groundstation.core import frames
from groundstation.core.quick import norms
from groundstation.mavlink.vehicle import UNKNOWN
from groundstation.mission.roster import Duty
from groundstation.mission.timing import SECOND_NS
from groundstation.mission.told import Look

ROWS_MIN = 4
_RECENT_NS = 20 * SECOND_NS  # so long an alarm counts as something that is wrong
_LOW_SHARE = 1.5  # of battery_min: yellow
_DOES = {
    Duty.UNTAKEN: "not taken yet",
    Duty.CLIMBS: "climbs",
    Duty.FORMATION: "with the team",
    Duty.HOMEWARD: "comes home",
    Duty.LANDS: "lands",
    Duty.LANDS_HERE: "lands here",
    Duty.RELEASED: "released",
    Duty.KILLED: "killed",
}
_NAMED = re.compile(r"vehicles? (\d+)(?: and (\d+))?: (.*)", re.DOTALL)
_HEADS = ("id", "does", "mode", "height", "speed", "pose", "battery", "radio", "last alarm")


class LastAlarms:
    """The last alarm about each vehicle, of the notes as they come.

    Args:
        ids: system ids.
    """

    def __init__(self, ids: Sequence[int]) -> None:
        self._row = {sysid: row for row, sysid in enumerate(ids)}
        self._text, self._at_ns = [""] * len(ids), [-_RECENT_NS] * len(ids)

    def take(self, text: str, now_ns: int) -> None:
        """Takes an alarm."""
        named = _NAMED.match(text)
        for sysid in filter(None, named.groups()[:2]) if named is not None else ():
            row = self._row.get(int(sysid))
            if row is not None and named is not None:
                self._text[row], self._at_ns[row] = named[3], now_ns

    def text(self, row: int) -> str:
        """Of one vehicle, "" where there was none."""
        return self._text[row]

    def recent(self, row: int, now_ns: int) -> bool:
        """Whether that was lately."""
        return bool(self._text[row]) and now_ns - self._at_ns[row] < _RECENT_NS


def team_table(session: Session, look: Look, alarms: LastAlarms, now_ns: int, lines: int) -> Table:
    """The team at this instant.

    Args:
        session: the flight.
        look: the team, as ``runner.look`` has it.
        alarms: what was said of whom.
        now_ns: time of the tick.
        lines: rows that there is room for; one of them says how many are left out.
    """
    runner = session.runner
    plan, fleet, airborne = runner.plan, runner.fleet, runner.airborne
    limits = plan.spec.limits
    pads_m = plan.pads_enu_m
    height_m = frames.enu_from_ned(look.poses.pos_team_ned_m)[:, 2] - pads_m[:, 2]
    speed_m_s = norms(look.poses.vel_ned_m_s)
    age_s = (now_ns - look.pose_ns) / SECOND_NS
    fresh = age_s <= limits.pose_age_s
    low = fleet.battery_remaining < _LOW_SHARE * limits.battery_min
    ours = look.duty < Duty.RELEASED
    recent = np.array([alarms.recent(row, now_ns) for row in range(plan.size)])
    left = look.foreign & (look.duty < Duty.LANDS)
    wrong = recent | look.lost | look.held | low | ~fresh | ~ours | left
    order = np.lexsort((np.arange(plan.size), ~wrong))
    shown = order if plan.size <= lines else order[: max(lines - 1, ROWS_MIN - 1)]
    radio = bool(np.isfinite(fleet.link_heard).any())
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim", show_edge=False)
    for head in _HEADS if radio else [head for head in _HEADS if head != "radio"]:
        right = head in ("id", "height", "speed", "pose", "battery")
        table.add_column(head, justify="right" if right else "left", no_wrap=True, overflow="ellipsis")
    for row in np.sort(shown).tolist():
        does, style = _DOES[Duty(int(look.duty[row]))], ""
        if look.lost[row]:
            does, style = "position lost", "bold red"
        elif left[row]:
            does, style = "does not follow", "bold red"
        elif look.held[row]:
            does, style = "held still", "yellow"
        elif not ours[row]:
            style = "red"
        elif not fleet.armed[row]:
            does = "disarmed"
        elif not airborne[row]:
            does = "stands, armed"
        mode = int(fleet.custom_mode[row])
        table.add_row(
            str(fleet.ids[row]),
            Text(does, style),
            plan.autopilots[row].mode_name(mode) if mode != UNKNOWN else "-",
            _number(height_m[row], "m"),
            _number(speed_m_s[row], "m/s"),
            Text(_number(age_s[row], "s"), "" if fresh[row] else "yellow"),
            Text(_percent(float(fleet.battery_remaining[row])), "yellow" if low[row] else ""),
            *([_radio(float(fleet.link_heard[row]), float(fleet.link_trip_s[row]))] if radio else []),
            Text(alarms.text(row).split(";")[0], "red" if recent[row] else "dim"),
        )
    rest = plan.size - len(shown)
    if rest:
        hidden = int(wrong[np.setdiff1d(order, shown)].sum())
        table.add_row("", Text(f"and {rest} more, {hidden or 'nothing'} of them with an alarm", "dim"))
    return table


def _number(value: float, unit: str) -> str:
    return f"{value:z.2f} {unit}" if math.isfinite(value) and abs(value) < 1e4 else "-"


def _radio(heard: float, trip_s: float) -> Text:
    """How a vehicle's radio link is, as its gateway measures it."""
    trip = f" {trip_s * 1000.0:.0f} ms" if math.isfinite(trip_s) else ""
    return Text(f"{_percent(heard)}{trip}", "yellow" if heard < 0.7 or trip_s > 0.15 else "")


def _percent(share: float) -> str:
    return f"{share:.0%}" if math.isfinite(share) else "-"
