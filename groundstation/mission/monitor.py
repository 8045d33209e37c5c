"""What can be wrong in the air, each with its limit, its reaction and its words.

Looks at the fleet's state and says what should happen; ``runner`` does it. Keeps, per vehicle, what was already
said, so that an alarm is one line and not fifty a second.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from groundstation.core.limits import Fence
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.mavlink.vehicle import HEARTBEAT_PATIENCE, LANDED_LANDING, NEVER, Fleet
from groundstation.mission.plan import MissionPlan

_SECOND_NS = 1_000_000_000
_FENCE_TOLERANCE_M = 0.3  # a gust may carry a vehicle that far beyond the fence before everybody comes back
_MODE_LOST_NS = 2_500_000_000  # two heartbeats, so that one from before our last request is not believed


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


@dataclass(frozen=True)
class Sight:
    """What the vehicles report, in the team frame.

    Attributes:
        pos_team_ned_m: where they are at this tick, shape (n, 3).
        pose_ns: when position or attitude was measured, whichever is older, shape (n,).
        drift_m: how far local and global positions disagree, by two samples in a row, shape (n,), NaN where not known.
    """

    pos_team_ned_m: FloatArray
    pose_ns: IntArray
    drift_m: FloatArray


class Monitor:
    """Watches the vehicles in the air.

    Attributes:
        hold: vehicles whose pose is too old to be steered by; they are told to stand still, shape (n,).
        blind: vehicles whose position was lost for good: nobody knows where they are now, shape (n,).
        foreign: armed vehicles that do not follow our setpoints at this moment, for whatever reason, shape (n,).
    """

    def __init__(self, plan: MissionPlan) -> None:
        n = plan.size
        self._plan = plan
        self.hold: BoolArray = np.zeros(n, dtype=np.bool_)
        self.blind: BoolArray = np.zeros(n, dtype=np.bool_)
        self.foreign: BoolArray = np.zeros(n, dtype=np.bool_)
        self._silent: BoolArray = np.zeros(n, dtype=np.bool_)
        self._gone: BoolArray = np.zeros(n, dtype=np.bool_)
        self._mode_lost_since_ns = np.full(n, NEVER, dtype=np.int64)
        self._battery_low: BoolArray = np.zeros(n, dtype=np.bool_)
        self._outside: BoolArray = np.zeros(n, dtype=np.bool_)
        self._frame_lost: BoolArray = np.zeros(n, dtype=np.bool_)
        self._twin: BoolArray = np.zeros(n, dtype=np.bool_)
        self._origins_ns = np.full(n, NEVER, dtype=np.int64)
        self._restarts = np.zeros(n, dtype=np.int64)
        self._fence = Fence.from_enu(np.array(plan.spec.fence.min_m), np.array(plan.spec.fence.max_m))

    def begin(self, fleet: Fleet) -> None:
        """Takes what is so now for what should stay so: origins, starts of the autopilots."""
        self._origins_ns = fleet.origin_moved_ns.copy()
        self._restarts = fleet.restarts.copy()

    def look(self, fleet: Fleet, sight: Sight, now_ns: int, landing: BoolArray) -> Findings:
        """Looks at the fleet once per tick.

        Args:
            fleet: what the vehicles report.
            sight: what that comes to in the team frame.
            now_ns: time of the tick.
            landing: vehicles that were told to land, shape (n,); they may leave the streaming mode and disarm.

        Returns:
            What should happen.
        """
        findings = Findings()
        limits = self._plan.spec.limits
        pose_ns = sight.pose_ns
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
        silent = fleet.silent(now_ns, limits.heartbeat_age_s)
        quiet = fleet.heartbeat_stale(now_ns, limits.heartbeat_age_s)
        for vehicle in np.flatnonzero(quiet & ~self._silent & ~self._gone):
            self._silent[vehicle] = True
            if silent[vehicle]:
                what = f"nothing heard for {limits.heartbeat_age_s:g} s"
            else:
                what = (
                    f"no heartbeat for {HEARTBEAT_PATIENCE * limits.heartbeat_age_s:g} s, whether it is armed and"
                    " follows is not known any more"
                )
            findings.alarm(f"vehicle {fleet.sysid[vehicle]}: {what}; everybody comes back", abort=True)
        for vehicle in np.flatnonzero((fleet.battery_remaining < limits.battery_min) & ~self._battery_low):
            self._battery_low[vehicle] = True
            findings.alarm(
                f"vehicle {fleet.sysid[vehicle]}: battery at {fleet.battery_remaining[vehicle]:.0%}, minimum is"
                f" {limits.battery_min:.0%}; everybody comes back",
                abort=True,
            )
        outside_m = self._fence.outside_m(sight.pos_team_ned_m)
        known = ~landing & ~self._gone & ~self.blind
        for vehicle in np.flatnonzero((outside_m > _FENCE_TOLERANCE_M) & ~self._outside & known):
            self._outside[vehicle] = True
            findings.alarm(
                f"vehicle {fleet.sysid[vehicle]}: {outside_m[vehicle]:.2f} m outside the fence, limit"
                f" {_FENCE_TOLERANCE_M:g} m; everybody comes back",
                abort=True,
            )
        self._look_at_frames(fleet, sight.drift_m, now_ns, landing, findings)
        self._look_at_modes(fleet, now_ns, landing, findings)
        return findings

    def _look_at_frames(
        self, fleet: Fleet, drift_m: FloatArray, now_ns: int, landing: BoolArray, findings: Findings
    ) -> None:
        """Positions that no longer mean what they meant: such a vehicle lands by itself, the others come back."""
        drifting = drift_m > self._plan.frame_drift_m  # NaN is not
        restarted, moved = fleet.restarts > self._restarts, fleet.origin_moved_ns > self._origins_ns
        wrong = restarted | moved | drifting
        for vehicle in np.flatnonzero(wrong & ~self._frame_lost & ~self._gone & ~landing).tolist():
            self._frame_lost[vehicle] = self.blind[vehicle] = True
            if restarted[vehicle]:
                what = "its autopilot has started anew"
            elif moved[vehicle]:
                what = f"its origin has moved by {fleet.origin_moved_m[vehicle]:.2f} m"
            else:
                what = (
                    f"its local and global positions are {drift_m[vehicle]:.2f} m apart, limit"
                    f" {self._plan.frame_drift_m:.2g} m"
                )
            findings.alarm(
                f"vehicle {fleet.sysid[vehicle]}: {what}; it lands where it is when nobody is below, the others come"
                " back",
                abort=True,
            )
            findings.land.append(vehicle)
        for vehicle in range(len(fleet)):
            twin = None if self._twin[vehicle] else fleet.twin_behind_one_address(vehicle, now_ns)
            if twin is not None:
                self._twin[vehicle] = True
                findings.alarm(f"vehicle {fleet.sysid[vehicle]}: {twin}; everybody comes back", abort=True)

    def _look_at_modes(self, fleet: Fleet, now_ns: int, landing: BoolArray, findings: Findings) -> None:
        ours = np.array(
            [
                autopilot.is_streaming_mode(int(mode)) and armed
                for autopilot, mode, armed in zip(
                    self._plan.autopilots, fleet.custom_mode, fleet.armed.tolist(), strict=True
                )
            ]
        )
        # The heartbeat tells a new mode up to a second late; that it is landing, EXTENDED_SYS_STATE tells sooner.
        self.foreign = (~ours | (fleet.landed_state == LANDED_LANDING)) & fleet.armed
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
