"""What the law is shown: smoothed places, and of these what agents' own sensors see or remember, where that is less.

For the law of a formation alone. Avoidance, the damper, detours and the team's place go on by the positions that all
others are flown by: r is kept whatever a sensor loses.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from groundstation.core import frames
from groundstation.core.quick import finite_rows, some
from groundstation.core.sensing import cameras, noise_m, sensed
from groundstation.core.smoothing import Smoother
from groundstation.core.types import BoolArray, FloatArray
from groundstation.core.views import LocalViews, local_views
from groundstation.mission.flight.poses import Poses
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.positioning import DEVIATIONS, SMOOTHED_1_S
from groundstation.mission.plan.sensing_spec import SensingSpec
from groundstation.mission.timing import SECOND_NS

_TELL_AFTER_S = 5.0


@dataclass(frozen=True)
class Sight:
    """What the law is shown at one tick.

    Attributes:
        views: of every agent.
        waits: misses a neighbour and does not move by the law until it has it again, shape (n,).
    """

    views: LocalViews
    waits: BoolArray


class Eyes:
    """What the law of one team is shown.

    Args:
        plan: positioning, sensors.
        tell: takes a line for the log.
    """

    def __init__(self, plan: MissionPlan, tell: Callable[[str], None]) -> None:
        most_m = DEVIATIONS * plan.profile.position_error_m
        self._smoothed = Smoother(plan.size, SMOOTHED_1_S[plan.positioning], most_m)
        sensing, ids = plan.spec.sensing, [vehicle.id for vehicle in plan.spec.vehicles]
        self._sensing = None if sensing is None else Sensing(sensing, ids, tell)

    def places_ned_m(self, now_ns: int, poses: Poses) -> FloatArray:
        """Where it is shown everybody at a tick, shape (n, 3)."""
        poor = poses.vel_error_m_s > 0.0
        return self._smoothed(now_ns / SECOND_NS, poses.pos_team_ned_m, poses.vel_ned_m_s, poses.carried_s, poor)

    def sight(self, now_ns: int, poses: Poses, places_ned_m: FloatArray, neighbours: BoolArray) -> Sight | None:
        """What agents' own sensors see of those places, shape (n, n); None where they see all neighbours."""
        if self._sensing is None:
            return None
        return self._sensing.look(now_ns, replace(poses, pos_team_ned_m=places_ned_m), neighbours)


class Sensing:
    """The sensors of one team.

    Args:
        spec: what they see.
        ids: of the vehicles.
        tell: takes a line for the log.
    """

    def __init__(self, spec: SensingSpec, ids: Sequence[int], tell: Callable[[str], None]) -> None:
        n = len(ids)
        self._spec, self._sensor, self._ids, self._tell = spec, spec.sensor, tuple(ids), tell
        self._turned = bool(spec.heading_deg or spec.level_deg)
        self._cameras = cameras(self._sensor, n)
        self._memory_ns = round(spec.memory_s * SECOND_NS)
        self._seen_ns = np.full((n, n), -1, dtype=np.int64)
        self._place_ned_m: FloatArray = np.full((n, n, 3), np.nan)
        self._waits_since_ns = np.full(n, -1, dtype=np.int64)
        self._told: BoolArray = np.zeros(n, dtype=np.bool_)

    def look(self, now_ns: int, poses: Poses, neighbours: BoolArray) -> Sight:
        """What every agent has of its neighbours, shape (n, n), at a tick."""
        n, now_s = len(self._ids), now_ns / SECOND_NS
        everybody = np.ones((n, n), dtype=np.bool_)
        whole = local_views(
            poses.pos_team_ned_m, poses.vel_ned_m_s, poses.quat_ned_from_frd, everybody, poses.rot_ned_from_flu
        )
        seen = neighbours & whole.visible & sensed(self._sensor, whole.rel_pos_flu_m, now_s)
        views = replace(
            whole,
            visible=seen,
            rel_pos_flu_m=np.where(seen[..., None], whole.rel_pos_flu_m, np.nan),
            rel_vel_flu_m_s=np.where(seen[..., None], whole.rel_vel_flu_m_s, np.nan),
        )
        if self._memory_ns:
            views = self._remember(now_ns, poses, neighbours, views)
        if self._spec.noise_m:
            views = replace(views, rel_pos_flu_m=views.rel_pos_flu_m + noise_m(self._sensor, n, now_s))
        if self._turned:
            turn = self._cameras[:, None]
            views = replace(
                views,
                rel_pos_flu_m=frames.rotate(turn, views.rel_pos_flu_m),
                rel_vel_flu_m_s=frames.rotate(turn, views.rel_vel_flu_m_s),
            )
        missing: BoolArray = np.asarray(neighbours & ~views.visible, dtype=np.bool_)
        waits = missing.any(axis=1) if self._spec.unseen == "wait" else np.zeros(n, dtype=np.bool_)
        self._tell_of(now_ns, missing, whole)
        return Sight(views, np.asarray(waits, dtype=np.bool_))

    def _remember(self, now_ns: int, poses: Poses, neighbours: BoolArray, views: LocalViews) -> LocalViews:
        """Views with those who were seen a moment ago where they were then, at rest."""
        seen, pos_ned_m = views.visible, poses.pos_team_ned_m
        self._seen_ns = np.where(seen, now_ns, self._seen_ns)
        self._place_ned_m = np.where(seen[..., None], pos_ned_m[None], self._place_ned_m)
        fresh = (self._seen_ns >= 0) & (now_ns - self._seen_ns <= self._memory_ns)
        kept = neighbours & ~seen & fresh & finite_rows(pos_ned_m)[:, None]
        if not some(kept):
            return views
        # How it has moved itself since then an agent knows; of the other one it knows nothing.
        rot = poses.rot_ned_from_flu[:, None]
        rel_flu_m = frames.rotate_back(rot, self._place_ned_m - pos_ned_m[:, None])
        still_flu_m_s = np.broadcast_to(-views.vel_flu_m_s[:, None], rel_flu_m.shape)
        return replace(
            views,
            visible=seen | kept,
            rel_pos_flu_m=np.where(kept[..., None], rel_flu_m, views.rel_pos_flu_m),
            rel_vel_flu_m_s=np.where(kept[..., None], still_flu_m_s, views.rel_vel_flu_m_s),
        )

    def _tell_of(self, now_ns: int, missing: BoolArray, whole: LocalViews) -> None:
        """Tells once of each agent that has missed a neighbour for long."""
        misses = missing.any(axis=1)
        self._waits_since_ns = np.where(misses, np.where(self._waits_since_ns < 0, now_ns, self._waits_since_ns), -1)
        self._told &= misses
        long = misses & ~self._told & (now_ns - self._waits_since_ns > _TELL_AFTER_S * SECOND_NS)
        for agent in np.flatnonzero(long).tolist():
            self._told[agent] = True
            others = np.flatnonzero(missing[agent])
            away_m = np.linalg.norm(whole.rel_pos_flu_m[agent, others], axis=1)
            listed = ", ".join(f"{self._ids[j]} ({far:.2f} m away)" for j, far in zip(others, away_m, strict=True))
            waits = "it waits" if self._spec.unseen == "wait" else "it goes on with the others"
            self._tell(
                f"vehicle {self._ids[agent]} has not sensed all neighbours at once for {_TELL_AFTER_S:g} s, not at"
                f" this moment {listed}; {waits}"
            )
