"""Those that no longer fly the formation while the others go on: to their pads, or standing where they are to land."""

from __future__ import annotations

import numpy as np

from groundstation.core.types import FloatArray
from groundstation.mission.flight.guidance import Guide
from groundstation.mission.flight.helm import Helm
from groundstation.mission.flight.landing import Landing
from groundstation.mission.flight.poses import Poses
from groundstation.mission.roster import Roster
from groundstation.mission.timing import HeldEach


class Apart:
    """The ways of those that have dropped out.

    Args:
        guide: makes setpoints.
        n: vehicles.
        roster: who has, and for what.
        landing: told of those that are home.
    """

    def __init__(self, guide: Guide, n: int, roster: Roster, landing: Landing) -> None:
        self._roster, self._landing = roster, landing
        self._helm = Helm(guide, n)  # its setpoints are theirs alone
        self._home = HeldEach(n)

    def step(self, now_ns: int, poses: Poses, home_ned_m: FloatArray, tolerance_m: float) -> FloatArray:
        """One tick; returns setpoints, shape (n, 3), that mean something for those that fly apart.

        Args:
            now_ns: time of the tick.
            poses: of the team.
            home_ned_m: the place above each pad, shape (n, 3).
            tolerance_m: how near to it is home.
        """
        home_ned_m = np.where(self._roster.elsewhere[:, None], self._roster.place_ned_m, home_ned_m)
        near = np.linalg.norm(poses.pos_team_ned_m - home_ned_m, axis=1) < tolerance_m
        arrived = self._home(np.asarray(near & self._roster.homeward), now_ns)
        self._landing.want_here(np.flatnonzero(arrived).tolist(), home_ned_m, now_ns)
        targets = np.where(self._roster.homeward[:, None], home_ned_m, self._roster.place_ned_m)
        return self._helm.to_targets(poses, targets).vel_ned_m_s
