"""What can be wrong, on the ground and in the air, each with its limit, its reaction and its words.

Looks at the fleet's state and says what should happen; ``runner`` does it. Keeps, per vehicle, what was already
said, so that an alarm is one line and not fifty a second.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

import numpy as np

from groundstation.core.limits import Fence
from groundstation.core.types import BoolArray, FloatArray
from groundstation.mavlink.vehicle import LANDED_ON_GROUND, NEVER, Fleet
from groundstation.mission.plan import MissionPlan

_SECOND_NS = 1_000_000_000
_FENCE_TOLERANCE_M = 0.3  # a gust may carry a vehicle that far beyond the fence before everybody comes back
_MODE_LOST_NS = 2_500_000_000  # two heartbeats, so that one from before our last request is not believed


def ground_problems(
    plan: MissionPlan, fleet: Fleet, now_ns: int, unanswered: Collection[int], refusals: Mapping[int, str]
) -> tuple[list[str], list[str]]:
    """Looks at vehicles that stand on their pads, before arming.

    Args:
        plan: limits and pads.
        fleet: what the vehicles report.
        now_ns: time of this look.
        unanswered: vehicles that have not answered all requests yet.
        refusals: what vehicles refused or warned of, by vehicle.

    Returns:
        What is not well yet and may pass with time, and what will not pass by waiting; a line for each vehicle.
    """
    waiting: list[str] = []
    fatal: list[str] = []
    limits = plan.spec.limits
    for vehicle, spec in enumerate(plan.spec.vehicles):
        name = f"vehicle {spec.id}"
        if fleet.heartbeat_ns[vehicle] == NEVER:
            waiting.append(f"{name}: no heartbeat on {spec.link}; switch it on, or correct its id or link")
            continue
        twin = fleet.twin(vehicle, now_ns)
        if twin is not None:
            fatal.append(f"{name}: {twin}; give each vehicle its own id (MAV_SYS_ID, SYSID_THISMAV)")
            continue
        wrong = fleet.autopilot[vehicle] != plan.autopilots[vehicle].mav_autopilot
        if wrong:
            fatal.append(
                f"{name}: its heartbeat says MAV_AUTOPILOT {fleet.autopilot[vehicle]}, {spec.autopilot} is"
                f" {plan.autopilots[vehicle].mav_autopilot}; correct vehicles[{vehicle}].autopilot"
            )
            continue
        if fleet.armed[vehicle]:
            fatal.append(f"{name}: is armed already; disarm it before the mission")
            continue
        heartbeat_s = _age_s(now_ns, int(fleet.heartbeat_ns[vehicle]))
        pose_s = _age_s(now_ns, int(min(fleet.pose_ns[vehicle], fleet.attitude_ns[vehicle])))
        if heartbeat_s > limits.heartbeat_age_s:
            waiting.append(f"{name}: last heartbeat {heartbeat_s:.1f} s ago, limit {limits.heartbeat_age_s:g} s")
        elif vehicle in unanswered:
            waiting.append(f"{name}: message rates asked for, not answered yet")
        elif pose_s > limits.pose_age_s:
            age = "none yet" if pose_s == np.inf else f"{pose_s:.2f} s old"
            waiting.append(
                f"{name}: position and attitude: {age}, limit {limits.pose_age_s:g} s;"
                " check its estimator and the message rates"
            )
        elif not fleet.prearm_ok[vehicle]:
            said = refusals.get(vehicle)
            waiting.append(f"{name}: not ready to arm{': ' + said if said else ''}; see what the autopilot asks for")
        elif fleet.landed_state[vehicle] != LANDED_ON_GROUND:
            waiting.append(
                f"{name}: does not report to stand on the ground (landed state {fleet.landed_state[vehicle]})"
            )
        elif fleet.battery_remaining[vehicle] < limits.battery_min:
            fatal.append(
                f"{name}: battery at {fleet.battery_remaining[vehicle]:.0%}, minimum is {limits.battery_min:.0%};"
                " charge it"
            )
        else:
            pad_ned = np.array([spec.pad_m[1], spec.pad_m[0], -spec.pad_m[2]]) if spec.origin == "team" else np.zeros(3)
            off_m = float(np.linalg.norm(fleet.pos_local_ned_m[vehicle] - pad_ned))
            if off_m > limits.pad_error_m:
                waiting.append(
                    f"{name}: reports a position {off_m:.2f} m from its pad, limit {limits.pad_error_m:g} m;"
                    " put it on its pad, restart it there, or correct pad_m"
                )
    return waiting, fatal


def _age_s(now_ns: int, then_ns: int) -> float:
    return float("inf") if then_ns == NEVER else (now_ns - then_ns) / _SECOND_NS


@dataclass
class Findings:
    """What the monitors ask for in one tick.

    Attributes:
        alarms: lines for people, each said once.
        land: vehicles that shall land where they are, as soon as nobody is below.
        release: vehicles that are no longer ours; no setpoint, no command.
        abort: why the team shall come back, None when it need not.
    """

    alarms: list[str] = field(default_factory=list)
    land: list[int] = field(default_factory=list)
    release: list[int] = field(default_factory=list)
    abort: str | None = None

    def alarm(self, text: str, *, abort: bool) -> None:
        """Adds a line, and the reason to come back where there is none yet."""
        self.alarms.append(text)
        if abort and self.abort is None:
            self.abort = text


class Monitor:
    """Watches the vehicles in the air.

    Attributes:
        hold: vehicles whose pose is too old to be steered by; they are told to stand still, shape (n,).
        blind: vehicles whose position was lost for good: nobody knows where they are now, shape (n,).
    """

    def __init__(self, plan: MissionPlan) -> None:
        n = plan.size
        self._plan = plan
        self.hold: BoolArray = np.zeros(n, dtype=np.bool_)
        self.blind: BoolArray = np.zeros(n, dtype=np.bool_)
        self._silent: BoolArray = np.zeros(n, dtype=np.bool_)
        self._gone: BoolArray = np.zeros(n, dtype=np.bool_)
        self._mode_lost_since_ns = np.full(n, NEVER, dtype=np.int64)
        self._battery_low: BoolArray = np.zeros(n, dtype=np.bool_)
        self._outside: BoolArray = np.zeros(n, dtype=np.bool_)
        self._fence = Fence.from_enu(np.array(plan.spec.fence.min_m), np.array(plan.spec.fence.max_m))

    def look(self, fleet: Fleet, pos_team_ned_m: FloatArray, now_ns: int, landing: BoolArray) -> Findings:
        """Looks at the fleet once per tick.

        Args:
            fleet: what the vehicles report.
            pos_team_ned_m: where they are at this tick, shape (n, 3).
            now_ns: time of the tick.
            landing: vehicles that were told to land, shape (n,); they may leave the streaming mode and disarm.

        Returns:
            What should happen.
        """
        findings = Findings()
        limits = self._plan.spec.limits
        pose_ns = np.minimum(fleet.pose_ns, fleet.attitude_ns)
        too_old = (now_ns - pose_ns > limits.pose_age_s * _SECOND_NS) & ~self._gone
        for vehicle in np.flatnonzero(too_old & ~self.hold):
            age_s = (now_ns - int(pose_ns[vehicle])) / _SECOND_NS
            findings.alarm(
                f"vehicle {fleet.sysid[vehicle]}: position is {age_s:.2f} s old, limit {limits.pose_age_s:.2f} s;"
                " holding",
                abort=False,
            )
        self.hold = too_old
        for vehicle in np.flatnonzero((now_ns - pose_ns > limits.pose_lost_s * _SECOND_NS) & ~self.blind & ~landing):
            self.blind[vehicle] = True
            findings.alarm(
                f"vehicle {fleet.sysid[vehicle]}: no position for {limits.pose_lost_s:g} s; it lands where it is"
                " when nobody is below, the others come back",
                abort=True,
            )
            findings.land.append(int(vehicle))
        for vehicle in np.flatnonzero(
            (now_ns - fleet.heartbeat_ns > limits.heartbeat_age_s * _SECOND_NS) & ~self._silent & ~self._gone
        ):
            self._silent[vehicle] = True
            findings.alarm(
                f"vehicle {fleet.sysid[vehicle]}: no heartbeat for {limits.heartbeat_age_s:g} s; everybody comes back",
                abort=True,
            )
        for vehicle in np.flatnonzero((fleet.battery_remaining < limits.battery_min) & ~self._battery_low):
            self._battery_low[vehicle] = True
            findings.alarm(
                f"vehicle {fleet.sysid[vehicle]}: battery at {fleet.battery_remaining[vehicle]:.0%}, minimum is"
                f" {limits.battery_min:.0%}; everybody comes back",
                abort=True,
            )
        outside_m = self._fence.outside_m(pos_team_ned_m)
        for vehicle in np.flatnonzero((outside_m > _FENCE_TOLERANCE_M) & ~self._outside & ~landing & ~self._gone):
            self._outside[vehicle] = True
            findings.alarm(
                f"vehicle {fleet.sysid[vehicle]}: {outside_m[vehicle]:.2f} m outside the fence, limit"
                f" {_FENCE_TOLERANCE_M:g} m; everybody comes back",
                abort=True,
            )
        self._look_at_modes(fleet, now_ns, landing, findings)
        return findings

    def _look_at_modes(self, fleet: Fleet, now_ns: int, landing: BoolArray, findings: Findings) -> None:
        ours = np.array(
            [
                autopilot.is_streaming_mode(int(mode)) and armed
                for autopilot, mode, armed in zip(
                    self._plan.autopilots, fleet.custom_mode, fleet.armed.tolist(), strict=True
                )
            ]
        )
        away = ~ours & ~landing & ~self._gone
        self._mode_lost_since_ns = np.where(
            away, np.where(self._mode_lost_since_ns == NEVER, now_ns, self._mode_lost_since_ns), NEVER
        )
        for vehicle in np.flatnonzero(away & (now_ns - self._mode_lost_since_ns >= _MODE_LOST_NS)):
            self._gone[vehicle] = True
            mode = self._plan.autopilots[vehicle].mode_name(int(fleet.custom_mode[vehicle]))
            what = f"left for mode {mode}" if fleet.armed[vehicle] else "disarmed by itself"
            findings.alarm(
                f"vehicle {fleet.sysid[vehicle]}: {what}; it is released and not fought over, the others come back",
                abort=True,
            )
            findings.release.append(int(vehicle))
