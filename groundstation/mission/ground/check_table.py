"""What preflight found, a row for each vehicle, as plain values for a screen or a script. Judges nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from groundstation.mavlink.station import Station
from groundstation.mavlink.vehicle import NEVER, UNKNOWN
from groundstation.mission.flight.team_frame import TeamFrame
from groundstation.mission.ground.checks import Checks
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.timing import SECOND_NS


@dataclass(frozen=True)
class Reported:
    """What one vehicle is and says; what is not known is None, "" or NaN.

    Attributes:
        id: system id.
        role: point of the formation that it will take, from 1.
        link: where it is heard.
        firmware: kind and version.
        mode: flight mode.
        heartbeat_age_s: since the last one.
        estimator: good, or what is wrong.
        position_age_s: of position and attitude, whichever is older.
        off_pad_m: how far from its pad it reports to stand.
        off_pad_limit_m: how far it may.
        positions_hz: counted.
        attitudes_hz: counted.
        asked_hz: of both.
    """

    id: int
    role: int
    link: str
    firmware: str
    mode: str
    heartbeat_age_s: float
    estimator: str
    position_age_s: float
    off_pad_m: float
    off_pad_limit_m: float
    positions_hz: float
    attitudes_hz: float
    asked_hz: float


@dataclass(frozen=True)
class CheckRow(Reported):
    """One vehicle before arming: what it says, and what that comes to.

    Attributes:
        round_trip_s: of TIMESYNC.
        clock_s: how far off the times of its measurements may be.
        battery: share that is left.
        battery_need: share that the mission takes, reserve included.
        failsafe: as planned, or how many of its parameters are not.
        checked: every check of it came to an end; where the mission was refused before, nothing is known.
        problems: why it is not ready.
        notes: what else is worth a word.
    """

    round_trip_s: float
    clock_s: float
    battery: float
    battery_need: float
    failsafe: str
    checked: bool
    problems: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def ready(self) -> bool:
        """Whether nothing speaks against arming it."""
        return self.checked and not self.problems


def check_rows(
    plan: MissionPlan,
    station: Station,
    frame: TeamFrame,
    checks: Checks,
    *,
    rates_hz: Sequence[tuple[float, float]],
    checked: Sequence[bool],
    problems: Sequence[str],
    now_ns: int,
) -> list[CheckRow]:
    """Puts the rows together.

    Args:
        plan: the mission.
        station: with the fleet's state.
        frame: places in the team frame.
        checks: firmware, estimator, battery, failsafes.
        rates_hz: positions and attitudes counted, by vehicle.
        checked: whose checks came to an end, by vehicle.
        problems: lines that begin with the vehicle's name.
        now_ns: time of the last tick.
    """
    fleet = station.fleet
    off_m = frame.off_pad_m(frame.poses(fleet, now_ns).pos_team_ned_m)
    pose_ns = frame.pose_ns(fleet)
    uncertain_s = fleet.clocks.uncertainty_s()
    rows = []
    for i, spec in enumerate(plan.spec.vehicles):
        checked_now = checks.checked(i, now_ns)
        heard = fleet.heartbeat_ns[i] != NEVER
        mode = int(fleet.custom_mode[i])
        prefix = f"vehicle {spec.id}: "
        rows.append(
            CheckRow(
                id=spec.id,
                role=int(checks.failsafe.roles[i]) + 1,
                link=spec.link,
                firmware=f"{spec.autopilot} {checked_now.firmware}".strip() if heard else "",
                mode=plan.autopilots[i].mode_name(mode) if mode != UNKNOWN else "",
                heartbeat_age_s=_age_s(now_ns, int(fleet.heartbeat_ns[i])),
                estimator=checked_now.estimator if heard else "",
                position_age_s=_age_s(now_ns, int(pose_ns[i])),
                off_pad_m=float(off_m[i]),
                off_pad_limit_m=plan.limits.pad_error_m,
                positions_hz=rates_hz[i][0],
                attitudes_hz=rates_hz[i][1],
                asked_hz=plan.rates_of(i).pose_hz,
                round_trip_s=float(fleet.clocks.round_trip_s[i]),
                clock_s=float(uncertain_s[i]),
                battery=checked_now.battery,
                battery_need=checked_now.battery_need,
                failsafe=checked_now.failsafe if heard else "",
                checked=checked[i],
                problems=tuple(text.removeprefix(prefix) for text in problems if text.startswith(prefix)),
                notes=tuple(checks.notes(i, now_ns)) if heard else (),
            )
        )
    return rows


def _age_s(now_ns: int, then_ns: int) -> float:
    return float(np.nan) if then_ns <= NEVER else max(now_ns - then_ns, 0) / SECOND_NS
