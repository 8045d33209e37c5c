"""Steers by a guide and keeps what it told last, from which the slope of setpoints is limited. Guides keep nothing."""

from __future__ import annotations

import numpy as np

from groundstation.core.control import Task
from groundstation.core.types import FloatArray
from groundstation.mission.flight.guidance import Course, Guide, Setpoints
from groundstation.mission.flight.poses import Poses


class Helm:
    """One course of setpoints for a team.

    Args:
        guide: makes them.
        n: vehicles.

    Attributes:
        guide: makes the setpoints.
        told_ned_m_s: the last ones, shape (n, 3).
        last: what they came with; None while everybody stands still.
    """

    def __init__(self, guide: Guide, n: int) -> None:
        self.guide = guide
        self.told_ned_m_s: FloatArray = np.zeros((n, 3))
        self.last: Setpoints | None = None

    def rest(self) -> None:
        """Everybody was told to stand still."""
        self.told_ned_m_s = np.zeros_like(self.told_ned_m_s)
        self.last = None

    def formation(self, poses: Poses, task: Task, course: Course) -> Setpoints:
        """One tick of formation flight, see ``Guide.formation``."""
        return self._told(self.guide.formation(poses, task, course, self.told_ned_m_s))

    def to_targets(
        self, poses: Poses, target_team_ned_m: FloatArray, detour_enu_m_s: FloatArray | None = None
    ) -> Setpoints:
        """One tick towards a point for each vehicle, see ``Guide.to_targets``."""
        return self._told(self.guide.to_targets(poses, target_team_ned_m, self.told_ned_m_s, detour_enu_m_s))

    def _told(self, setpoints: Setpoints) -> Setpoints:
        self.told_ned_m_s, self.last = setpoints.vel_ned_m_s, setpoints
        return setpoints
