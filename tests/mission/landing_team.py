"""A team in the air without autopilots and links: guidance and landing are the real ones, vehicles are lags that sink.

Some stand, some hover, some cannot be steered. Its truth is its own; nothing here is asked how near anybody came.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from groundstation.core.types import BoolArray, FloatArray
from groundstation.mavlink.commands import Command, CommandQueue
from groundstation.mavlink.vehicle import LANDED_IN_AIR, LANDED_ON_GROUND, Fleet
from groundstation.mission.flight.guidance import Guide
from groundstation.mission.flight.helm import Helm
from groundstation.mission.flight.landing import Around, Landing, landing_distances
from groundstation.mission.flight.poses import Poses
from groundstation.mission.flight.standing import Standing
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.roster import enlist

SECOND_NS = 1_000_000_000
_SINKS_M_S, _DISARMS_S = 0.5, 2.0
_TOLERANCE_M = 0.15


class _Asked(CommandQueue):
    """Commands that arrive at once."""

    def __init__(self, n: int) -> None:
        super().__init__(n)
        self.to: dict[int, set[str]] = {}

    def request(self, vehicle: int, command: Command) -> None:
        self.to.setdefault(vehicle, set()).add(command.name)


@dataclass
class Flown:
    """What became of it.

    Attributes:
        nearest_m: smallest distance of an obedient vehicle to anybody whose place is known, one of them in the air.
        pair: who that was, and when.
        up: obedient vehicles that are in the air at the end.
        news: what was told.
    """

    nearest_m: float = np.inf
    pair: tuple[int, int, float] = (-1, -1, 0.0)
    up: list[int] = field(default_factory=list)
    news: list[str] = field(default_factory=list)


class LandingTeam:
    """One team at its beginning.

    Args:
        plan: mission of n vehicles.
        pos_enu_m: where they are, shape (n, 3); on the ground is who has height 0.
        lost: hovers where it is and is not seen, shape (n,).
        loose: hovers where it is, seen and not steered, shape (n,).
    """

    def __init__(self, plan: MissionPlan, pos_enu_m: FloatArray, lost: BoolArray, loose: BoolArray) -> None:
        n = plan.size
        self.plan, self.pos, self.vel = plan, pos_enu_m.copy(), np.zeros((n, 3))
        self.fleet = Fleet([vehicle.id for vehicle in plan.spec.vehicles], plan.link_of_vehicle)
        self.fleet.armed[:] = pos_enu_m[:, 2] > 0.0
        self.fleet.battery_remaining[:] = 0.8
        self.commands = _Asked(n)
        self.helm = Helm(Guide(plan), n)
        self.roster = enlist(plan)
        distances = landing_distances(plan, self.helm.guide.beside_m, _TOLERANCE_M)
        self.landing = Landing(
            plan, self.fleet, self.commands, self.roster, distances, standing=Standing(plan, self.fleet)
        )
        self.lost, self.loose = lost & self.fleet.armed, loose & self.fleet.armed
        self.roster.release(np.flatnonzero(self.loose).tolist())
        self.down_s = np.full(n, np.inf)
        self.home_ned_m = self._ned(plan.pads_enu_m) - np.array([0.0, 0.0, plan.spec.takeoff.height_m])

    @staticmethod
    def _ned(enu: FloatArray) -> FloatArray:
        return np.asarray(enu[:, [1, 0, 2]] * np.array([1.0, 1.0, -1.0]))

    def fly(self, orders: dict[float, list[int]], home_after_s: float, limit_s: float) -> Flown:
        """Lands some where they are at some times, everybody at a time: ``[]`` is ``land all``; the others go home."""
        plan, fleet, landing, roster, n = self.plan, self.fleet, self.landing, self.roster, self.plan.size
        flown, left = Flown(), dict(orders)
        tick_s = 1.0 / plan.spec.rate_hz
        obedient = ~(self.lost | self.loose)
        seen = self._ned(self.pos)
        coming = np.zeros(n, dtype=np.bool_)
        stays = seen.copy()
        nobody = np.zeros(n, dtype=np.bool_)
        for k in range(round(limit_s / tick_s)):
            now_s = k * tick_s
            now_ns = round(now_s * SECOND_NS)
            up = self.pos[:, 2] > 0.0
            fleet.landed_state[:] = np.where(up, LANDED_IN_AIR, LANDED_ON_GROUND)
            fleet.landed_ns[:] = np.where(self.lost, fleet.landed_ns, now_ns)
            fleet.armed &= ~(now_s - self.down_s >= _DISARMS_S)
            seen = np.where(self.lost[:, None], seen, self._ned(self.pos))
            poses = Poses(
                seen, np.where(self.lost[:, None], 0.0, self._ned(self.vel)), np.tile([1.0, 0, 0, 0], (n, 1)), nobody
            )
            for at_s in [at_s for at_s in left if at_s <= now_s]:
                who = [vehicle for vehicle in left.pop(at_s) if up[vehicle]]
                if who:
                    landing.want_here(who, seen, now_ns)
                else:
                    landing.spots.everybody_here(seen, obedient & up & ~roster.lands_here)
                    coming[:] = True
                    landing.want(np.flatnonzero(obedient).tolist(), now_ns)
            if now_s >= home_after_s and not coming.all():
                coming[:] = True
            home = roster.places_ned_m(self.home_ned_m)
            if now_s >= home_after_s:
                near = np.linalg.norm(seen - home, axis=1) < _TOLERANCE_M
                landing.want(
                    np.flatnonzero(coming & obedient & (near | (now_s >= home_after_s + 20.0))).tolist(), now_ns
                )
            unsteered = self.lost | self.loose | roster.told_to_land
            landing.step(
                now_ns,
                Around(
                    poses,
                    self.home_ned_m,
                    blind=self.lost,
                    unheard=nobody,
                    foreign=self.loose,
                    led=~unsteered,
                    coming=coming & obedient,
                ),
            )
            flown.news += [news.text for news in landing.spots.take_news()]
            extra = np.where((self.lost | self.loose) & fleet.armed, 0.25 * plan.spec.avoidance.radius_m, 0.0)
            extra = np.where(landing.standing(now_ns) & (extra == 0.0), 1e-3, extra)
            sinking = ((self.lost | self.loose) & fleet.armed) | landing.columns()
            targets = roster.places_ned_m(np.where(coming[:, None], self.home_ned_m, stays))
            told = self.helm.to_targets(replace(poses, sinking=sinking, extra_radius_m=extra), targets).vel_ned_m_s
            lands = np.array([bool(self.commands.to.get(vehicle)) for vehicle in range(n)]) & up
            wish = np.asarray(told[:, [1, 0, 2]] * np.array([1.0, 1.0, -1.0]))
            wish[lands | unsteered] = 0.0
            wish[lands, 2] = -_SINKS_M_S
            self.vel += tick_s / max(plan.profile.lag_s, tick_s) * (wish - self.vel)
            self.vel[~up] = 0.0
            self.pos += tick_s * self.vel
            self.pos[:, 2] = np.maximum(self.pos[:, 2], 0.0)
            self.down_s = np.where((self.pos[:, 2] <= 0.0) & ~np.isfinite(self.down_s), now_s, self.down_s)
            self._measure(flown, obedient, now_s)
            if not (obedient & (self.pos[:, 2] > 0.0)).any():
                break
        flown.up = np.flatnonzero(obedient & (self.pos[:, 2] > 0.0)).tolist()
        return flown

    def _measure(self, flown: Flown, obedient: BoolArray, now_s: float) -> None:
        up = self.pos[:, 2] > 0.0
        known = ~self.lost
        counts = (obedient & up)[:, None] & known[None] & ~np.eye(len(up), dtype=bool)
        apart_m = np.where(counts, np.linalg.norm(self.pos[:, None] - self.pos[None], axis=2), np.inf)
        i, j = np.unravel_index(np.argmin(apart_m), apart_m.shape)
        if apart_m[i, j] < flown.nearest_m:
            flown.nearest_m, flown.pair = float(apart_m[i, j]), (int(i), int(j), now_s)
