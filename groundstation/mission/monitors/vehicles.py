"""Monitors of what the autopilots say of themselves: heartbeats, modes, batteries."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from groundstation.core.quick import some
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.mavlink.vehicle import HEARTBEAT_PATIENCE, LANDED_LANDING, NEVER, Fleet
from groundstation.mission.monitors.findings import Finding, Lasting, Reaction, Sight
from groundstation.mission.plan.links import LinkPlan
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.timing import SECOND_NS

_REPORTS_MISSED = 3.0  # on narrow links batteries are told so rarely that this is longer than the limit
_BATTERY_LOST = 3.0  # times the limit after which the vehicle comes back
_MODE_LOST_S = 2.5  # two heartbeats, so that one from before our last request is not believed
_WAITS_S = 10.0  # for one that its own failsafe holds until it hears setpoints again; told after a moment
_WAITS_TOLD_S = 0.2
_LOOK = "see to its battery monitor and its link"


class Heartbeats:
    """Vehicles of which nothing is heard, or of which nobody knows any more whether they follow."""

    def __init__(self, plan: LinkPlan) -> None:
        self._limit_s = plan.spec.limits.heartbeat_age_s
        self._lasting = Lasting(plan.size)

    def look(self, sight: Sight, ours: BoolArray) -> Iterator[Finding]:
        """Brings back whoever is silent."""
        fleet = sight.fleet
        silent = fleet.silent(sight.now_ns, self._limit_s)
        quiet = fleet.heartbeat_stale(sight.now_ns, self._limit_s)
        for vehicle in self._lasting(quiet & ours, sight.now_ns):
            remedy = "see to its link"
            if silent[vehicle]:
                what = f"nothing heard for {self._limit_s:g} s"
            elif fleet.disarm_doubted[vehicle]:  # heard, and not believed
                what = (
                    f"its heartbeats say disarmed for {HEARTBEAT_PATIENCE * self._limit_s:g} s, its landed state that"
                    " it flies; whether it is armed is not known"
                )
                remedy = "keep away from it, and look whether it stands"
            else:
                what = (
                    f"no heartbeat for {HEARTBEAT_PATIENCE * self._limit_s:g} s, whether it is armed and follows is"
                    " not known any more"
                )
            yield Finding(Reaction.HOME, what, (vehicle,), remedy=remedy)


class Modes:
    """Autopilots that left the mode that follows us, by themselves or by their pilot's hand.

    Attributes:
        foreign: armed, and not in that mode, shape (n,).
        waits: those of them that stand still by their own failsafe until they hear setpoints again, shape (n,).
    """

    def __init__(self, plan: MissionPlan) -> None:
        self._autopilots = plan.autopilots
        self._lasting, self._deaf = Lasting(plan.size, _MODE_LOST_S), Lasting(plan.size, _WAITS_S)
        self._told_deaf = Lasting(plan.size, _WAITS_TOLD_S, again=True)
        self.foreign: BoolArray = np.zeros(plan.size, dtype=np.bool_)
        self.waits: BoolArray = np.zeros(plan.size, dtype=np.bool_)
        self._told: tuple[tuple[int, ...], BoolArray] = ((), self.foreign)  # modes, and which of them stream

    def look(self, sight: Sight, ours: BoolArray) -> Iterator[Finding]:
        """Releases those that have left, for good; those that only wait to hear us again after a longer while."""
        fleet = sight.fleet
        modes = tuple(fleet.custom_mode.tolist())
        if modes != self._told[0]:
            pairs = zip(self._autopilots, modes, strict=True)
            self._told = modes, np.array([autopilot.is_streaming_mode(mode) for autopilot, mode in pairs])
        follows = self._told[1] & fleet.armed
        # The heartbeat tells a new mode up to a second late; that it is landing, EXTENDED_SYS_STATE tells sooner.
        self.foreign = (~follows | (fleet.landed_state == LANDED_LANDING)) & fleet.armed
        # While two senders take turns nobody knows whose mode that is; that there are two is told soon.
        clear = ~fleet.senders.in_doubt(sight.now_ns)
        left = ~follows & ours & ~sight.excused & clear
        self.waits = left & fleet.armed & self._waiting(fleet, left)
        for vehicle in self._told_deaf(self.waits, sight.now_ns):
            mode = self._autopilots[vehicle].mode_name(int(fleet.custom_mode[vehicle]))
            what = f"hears no setpoints, its own failsafe holds it in mode {mode}; it is waited for, {_WAITS_S:g} s"
            yield Finding(Reaction.SAY, what, (vehicle,), remedy="see to the link towards it")
        for vehicle in self._lasting(left & ~self.waits, sight.now_ns) + self._deaf(self.waits, sight.now_ns):
            mode = self._autopilots[vehicle].mode_name(int(fleet.custom_mode[vehicle]))
            what = f"left for mode {mode}" if fleet.armed[vehicle] else "disarmed by itself"
            yield Finding(Reaction.RELEASE, what, (vehicle,))

    def _waiting(self, fleet: Fleet, left: BoolArray) -> BoolArray:
        """Whom its own failsafe holds until setpoints arrive again, of those that have left, shape (n,)."""
        waits: BoolArray = np.zeros(len(fleet), dtype=np.bool_)
        for vehicle in left.nonzero()[0].tolist():
            mode, status = int(fleet.custom_mode[vehicle]), int(fleet.system_status[vehicle])
            waits[vehicle] = self._autopilots[vehicle].waits_for_setpoints(mode, status)
        return waits


class Battery:
    """Batteries: told, then brought back, then landed where it is. Two reports have to say so."""

    def __init__(self, plan: MissionPlan) -> None:
        limits = plan.spec.limits
        self._stages = [
            _Stage(plan.size, Reaction.SAY, "warning below", plan.limits.battery_warn, None),
            _Stage(plan.size, Reaction.HOME, "minimum is", limits.battery_min, limits.battery_min_v),
            _Stage(plan.size, Reaction.LAND, "lands below", plan.limits.battery_land, plan.limits.battery_land_v),
        ]

    def look(self, sight: Sight, ours: BoolArray) -> Iterator[Finding]:
        """Goes through the stages, the hardest first: of two that begin at once the milder one is not told."""
        told: set[int] = set()
        for stage in reversed(self._stages):
            for vehicle, what in stage.look(sight, ours):
                if vehicle not in told:
                    told.add(vehicle)
                    yield Finding(stage.reaction, what, (vehicle,), urgent=stage.reaction is not Reaction.SAY)


_SOONER_S = 0.1  # so long before a report can be too old all of them are looked at


class BatteryAge:
    """Batteries of which nothing is told any more, after it was: nobody would see them run down."""

    def __init__(self, plan: LinkPlan) -> None:
        reports_hz = [plan.rates_of(i).status_hz()["SYS_STATUS"] for i in range(plan.size)]
        self._limit_s: FloatArray = np.maximum(plan.spec.limits.battery_age_s, _REPORTS_MISSED / np.array(reports_hz))
        self._told_ns: IntArray = np.full(plan.size, NEVER, dtype=np.int64)
        self._seen, self._nobody_before_ns = b"", NEVER
        self._first, self._again = Lasting(plan.size, again=True), Lasting(plan.size)

    def look(self, sight: Sight, ours: BoolArray) -> Iterator[Finding]:
        """Tells of it, and brings the vehicle back when it lasts."""
        self._take(sight.fleet)
        if sight.now_ns < self._nobody_before_ns:
            none: BoolArray = np.zeros(len(ours), dtype=np.bool_)
            self._first(none, sight.now_ns)
            self._again(none, sight.now_ns)
            return
        age_s = (sight.now_ns - self._told_ns) / SECOND_NS
        counts = (self._told_ns != NEVER) & sight.airborne & ours & ~sight.excused
        for vehicle in self._first(counts & (age_s > self._limit_s), sight.now_ns):
            what = f"its battery was last told {age_s[vehicle]:.0f} s ago, limit {self._limit_s[vehicle]:.0f} s"
            yield Finding(Reaction.SAY, what, (vehicle,), remedy=_LOOK)
        for vehicle in self._again(counts & (age_s > _BATTERY_LOST * self._limit_s), sight.now_ns):
            limit_s = _BATTERY_LOST * self._limit_s[vehicle]
            what = f"its battery was last told {age_s[vehicle]:.0f} s ago, limit {limit_s:.0f} s"
            yield Finding(Reaction.HOME, what, (vehicle,), remedy=_LOOK)

    def _take(self, fleet: Fleet) -> None:
        """Takes reports that are new, and works out until when nobody's can be too old."""
        seen = fleet.status_ns.tobytes()
        if seen == self._seen:
            return
        self._seen = seen
        known = np.isfinite(fleet.battery_remaining) | np.isfinite(fleet.battery_v)
        self._told_ns = np.where(known, fleet.status_ns, self._told_ns)
        told_ns = self._told_ns[self._told_ns != NEVER]
        if len(told_ns):
            self._nobody_before_ns = int(told_ns.min()) + round((float(self._limit_s.min()) - _SOONER_S) * SECOND_NS)


class _Stage:
    """One limit of the batteries, as a share and, where the mission says so, as a voltage."""

    def __init__(self, n: int, reaction: Reaction, word: str, share: float, volts: float | None) -> None:
        self.reaction, self._word, self._share, self._volts = reaction, word, share, volts
        self._first_ns: IntArray = np.full(n, NEVER, dtype=np.int64)
        self._any_low = False
        self._lasting = Lasting(n)

    def look(self, sight: Sight, ours: BoolArray) -> Iterator[tuple[int, str]]:
        fleet = sight.fleet
        share: FloatArray = fleet.battery_remaining
        low_share = share < self._share  # NaN is not
        low = low_share if self._volts is None else low_share | (fleet.battery_v < self._volts)
        if not (some(low) or self._any_low):
            return
        self._any_low = some(low)
        self._first_ns = np.where(low, np.where(self._first_ns == NEVER, fleet.status_ns, self._first_ns), NEVER)
        for vehicle in self._lasting(low & (fleet.status_ns > self._first_ns) & ours, sight.now_ns):
            if low_share[vehicle]:
                yield vehicle, f"battery at {share[vehicle]:.0%}, {self._word} {self._share:.0%}"
            else:
                yield vehicle, f"battery at {fleet.battery_v[vehicle]:.1f} V, {self._word} {self._volts:g} V"
