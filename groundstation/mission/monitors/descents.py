"""Vehicles that come down at our word, watched until they lie still: nothing can be done any more, people must know.

Told to land, a vehicle may leave its mode, sink and disarm. It may not roll over, fall, disarm in the air, or end
elsewhere than where it was told to land.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from groundstation.core import frames
from groundstation.core.quick import between, norms, some
from groundstation.core.types import BoolArray, FloatArray
from groundstation.mission.monitors.findings import SEE_TO_POSITION, Finding, Lasting, Reaction, Sight
from groundstation.mission.monitors.speeds import PoorSpeeds
from groundstation.mission.monitors.wind import Wind
from groundstation.mission.plan.plan import MissionPlan

_TILTED_S, _FALLS_S, _ENDED_S = 0.1, 0.1, 0.5  # a fall from half a metre lasts no longer
_SINKS_M_S, _SINKS_LOW_M_S = 2.5, 1.5  # autopilots sink at 1.5 m/s at most, and at 0.5 to 0.7 near the ground
_LOW_M = 3.0
_ABOVE_M, _BESIDE_M = 0.5, 0.3
KEEP = "keep people away and look after it"


class Descents:
    """Landings that do not go as landings do."""

    def __init__(self, plan: MissionPlan, wind: Wind, speeds: PoorSpeeds) -> None:
        n = plan.size
        self._wind, self._speeds = wind, speeds
        self._tilt_deg = plan.spec.limits.tilt_deg
        self._above_m, self._beside_m = _ABOVE_M + plan.margin_m, _BESIDE_M + plan.margin_m
        self._ground_ned_m: FloatArray = frames.ned_from_enu(plan.pads_enu_m)[:, 2]
        self._from_ned_m: FloatArray = np.full((n, 3), np.nan)
        self._was_armed: BoolArray = np.zeros(n, dtype=np.bool_)
        self._tilted, self._falls = Lasting(n, _TILTED_S), Lasting(n, _FALLS_S)
        self._ended, self._cut = Lasting(n, _ENDED_S), Lasting(n)

    def look(self, sight: Sight, ours: BoolArray) -> Iterator[Finding]:
        """Tells of those that fall, roll over, disarm in the air or end elsewhere."""
        fleet, now_ns = sight.fleet, sight.now_ns
        lands = sight.excused & ours & ~sight.blind
        if not some(lands):
            self._was_armed = fleet.armed.copy()
            for nobody in (self._tilted, self._falls, self._cut, self._ended):
                nobody(lands, now_ns)
            return
        first = lands & np.isnan(self._from_ned_m[:, 0])
        self._from_ned_m[first] = sight.pos_team_ned_m[first]
        quat = fleet.quat_ned_from_frd
        tilt_deg = np.degrees(np.arccos(between(1.0 - 2.0 * (quat[:, 1] ** 2 + quat[:, 2] ** 2), -1.0, 1.0)))
        sinks_m_s = sight.vel_ned_m_s[:, 2]
        height_m = self._ground_ned_m - sight.pos_team_ned_m[:, 2]
        off_m = norms((sight.pos_team_ned_m - self._from_ned_m)[:, :2])
        ended = lands & ~sight.airborne
        cut = lands & self._was_armed & ~fleet.armed & (height_m > self._above_m)
        cut &= ~fleet.senders.in_doubt(now_ns)  # whose word "disarmed" is nobody knows; that there are two is told
        self._was_armed = fleet.armed.copy()
        for vehicle in self._tilted(lands & (tilt_deg > self._tilt_deg), now_ns):
            tilt = f"is tilted by {tilt_deg[vehicle]:.0f} degrees while it lands, limit {self._tilt_deg:g} degrees"
            yield Finding(Reaction.FAILED, f"{tilt}; {KEEP}", (vehicle,))
        limit_m_s = np.where(height_m < _LOW_M, _SINKS_LOW_M_S, _SINKS_M_S)
        for vehicle in self._falls(lands & (sinks_m_s > limit_m_s), now_ns):
            sinks = f"comes down at {sinks_m_s[vehicle]:.1f} m/s, limit {limit_m_s[vehicle]:g} m/s"
            yield Finding(Reaction.FAILED, f"{sinks}; {KEEP}", (vehicle,))
        for vehicle in self._cut(cut, now_ns):
            height = f"has disarmed {height_m[vehicle]:.1f} m above its pad's ground, limit {self._above_m:.2g} m"
            yield Finding(Reaction.FAILED, f"{height}; {KEEP}", (vehicle,))
        beside_m = self._beside_m + self._wind.sway_m + self._speeds.sway_m
        for vehicle in self._ended(ended & (off_m > beside_m), now_ns):
            away = f"has landed {off_m[vehicle]:.2f} m from where it was told to, limit {beside_m:.2g} m"
            yield Finding(Reaction.FAILED, away, (vehicle,), remedy=SEE_TO_POSITION)
