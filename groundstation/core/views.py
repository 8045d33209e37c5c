"""What each agent sees: relative positions and velocities in its own tilted body frame, and nothing else.

From a view to the setpoint an agent uses its view alone (Section III): no team position, no heading of anybody, no
command of another. What an agent does not see is NaN here, so that nothing can leak by accident: a forgotten mask
shows as NaN in the setpoint, which `limits` refuses.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from groundstation.core import frames
from groundstation.core.quick import every, finite_rows
from groundstation.core.types import BoolArray, FloatArray

_NOBODY: FloatArray = np.zeros((0, 0))
"""Stands for zeros of whatever shape is right."""


@dataclass(frozen=True)
class LocalViews:
    """Views of m agents on a team of n: row i is what agent i sees. All functions of `core` take any m >= 0.

    Attributes:
        rel_pos_flu_m: position of j relative to i, axes of i's body FLU, shape (m, n, 3), NaN where not visible.
        rel_vel_flu_m_s: velocity of j minus velocity of i, same axes, shape (m, n, 3), NaN where not visible or
            where either velocity is unknown.
        visible: agent i sees agent j, shape (m, n); nobody sees itself.
        vel_flu_m_s: own velocity in own axes, shape (m, 3), NaN where unknown.
        extra_m: what is added to the safety radius between i and j because j is an obstacle that nobody steers, shape
            (m, n), >= 0. Where it is above zero, i does both halves of every manoeuvre. Zeros when left out.
        wider_m: what is added to the safety radius between i and j because less is known of j, or of i, than the margin
            reckons with, shape (m, n), >= 0; both do their halves. Zeros when left out.
        up_flu: unit vector upwards in own axes, from the own attitude, shape (m, 3). Level when left out.
    """

    rel_pos_flu_m: FloatArray
    rel_vel_flu_m_s: FloatArray
    visible: BoolArray
    vel_flu_m_s: FloatArray
    extra_m: FloatArray = field(default_factory=lambda: _NOBODY)
    up_flu: FloatArray = field(default_factory=lambda: _NOBODY)
    wider_m: FloatArray = field(default_factory=lambda: _NOBODY)

    def __post_init__(self) -> None:
        """Refuses arrays that do not belong together."""
        m, n = self.visible.shape
        for name in ("extra_m", "wider_m"):
            given = getattr(self, name)
            if given is _NOBODY:
                object.__setattr__(self, name, np.zeros((m, n)))
            elif given.shape != (m, n) or not every((given >= 0.0) & (given < np.inf)):
                raise ValueError(f"views: extra radii must be finite, not negative and of shape ({m}, {n})")
        if self.up_flu is _NOBODY:
            object.__setattr__(self, "up_flu", np.tile([0.0, 0.0, 1.0], (m, 1)))
        elif self.up_flu.shape != (m, 3):
            raise ValueError(f"views: upward vectors have shape {self.up_flu.shape}, expected ({m}, 3)")
        if self.rel_pos_flu_m.shape != (m, n, 3) or self.rel_vel_flu_m_s.shape != (m, n, 3):
            raise ValueError(
                f"views: relative positions {self.rel_pos_flu_m.shape} and velocities "
                f"{self.rel_vel_flu_m_s.shape} do not fit visible {self.visible.shape}"
            )
        if self.vel_flu_m_s.shape != (m, 3):
            raise ValueError(f"views: own velocities have shape {self.vel_flu_m_s.shape}, expected ({m}, 3)")

    @property
    def grown_m(self) -> FloatArray:
        """What is added to the safety radius of each pair, for whatever reason, shape (m, n)."""
        return self.extra_m + self.wider_m

    @property
    def viewers(self) -> int:
        """Number of agents that look, m."""
        return len(self.visible)

    @property
    def team_size(self) -> int:
        """Number of agents that may be seen, n."""
        return int(self.visible.shape[1])

    def agent(self, index: int) -> LocalViews:
        """Cuts out one agent's view: the same thing with m = 1, all that this agent would hold on board."""
        rows = slice(index, index + 1)
        return LocalViews(
            rel_pos_flu_m=self.rel_pos_flu_m[rows],
            rel_vel_flu_m_s=self.rel_vel_flu_m_s[rows],
            visible=self.visible[rows],
            vel_flu_m_s=self.vel_flu_m_s[rows],
            extra_m=self.extra_m[rows],
            up_flu=self.up_flu[rows],
            wider_m=self.wider_m[rows],
        )


def local_views(
    pos_team_ned_m: FloatArray,
    vel_ned_m_s: FloatArray,
    quat_ned_from_frd: FloatArray,
    sensed: BoolArray,
    rot_ned_from_flu: FloatArray | None = None,
) -> LocalViews:
    """Builds every agent's local view.

    Args:
        pos_team_ned_m: positions at one instant, shape (n, 3), team frame NED; NaN rows are unknown positions.
        vel_ned_m_s: velocities, shape (n, 3), NED; NaN rows are unknown.
        quat_ned_from_frd: attitudes w x y z, shape (n, 4).
        sensed: agent i can measure agent j, shape (n, n); the diagonal is ignored.
        rot_ned_from_flu: `frames.rot_ned_from_flu` of the attitudes, where it is known already, shape (n, 3, 3).

    Returns:
        Views of all n agents. An agent whose position is unknown sees nobody and is seen by nobody.

    Raises:
        ValueError: shapes, or an attitude that is none.
    """
    n = len(pos_team_ned_m)
    if pos_team_ned_m.shape != (n, 3) or vel_ned_m_s.shape != (n, 3) or quat_ned_from_frd.shape != (n, 4):
        raise ValueError(
            f"poses of {n} agents have shapes {pos_team_ned_m.shape}, {vel_ned_m_s.shape}, "
            f"{quat_ned_from_frd.shape}, expected (n, 3), (n, 3), (n, 4)"
        )
    if sensed.shape != (n, n):
        raise ValueError(f"sensed has shape {sensed.shape}, expected ({n}, {n})")
    known = finite_rows(pos_team_ned_m)
    visible = np.asarray(sensed & known[None, :] & known[:, None], dtype=np.bool_)
    visible.ravel()[:: n + 1] = False  # the diagonal
    rot = frames.rot_ned_from_flu(quat_ned_from_frd) if rot_ned_from_flu is None else rot_ned_from_flu
    # Positions and velocities go through the rotation together: half the calls.
    state = np.array([pos_team_ned_m, vel_ned_m_s])
    relative = state[:, None, :, :] - state[:, :, None, :]
    relative[:, ~visible] = np.nan
    rel_flu = frames.rotate_back(rot[:, None], relative)
    return LocalViews(
        rel_pos_flu_m=rel_flu[0],
        rel_vel_flu_m_s=rel_flu[1],
        visible=visible,
        vel_flu_m_s=frames.rotate_back(rot, vel_ned_m_s),
        up_flu=-rot[:, 2],  # the third row is down, seen from the body
    )


def alone(views: LocalViews) -> LocalViews:
    """The same agents, none of whom sees anybody."""
    nothing = np.full_like(views.rel_pos_flu_m, np.nan)
    return replace(views, rel_pos_flu_m=nothing, rel_vel_flu_m_s=nothing, visible=np.zeros_like(views.visible))


def distances_m(views: LocalViews) -> FloatArray:
    """Distances to everybody seen, shape (m, n), NaN where not visible."""
    rel = views.rel_pos_flu_m
    x, y, z = rel[..., 0], rel[..., 1], rel[..., 2]
    return np.asarray(np.sqrt(x * x + y * y + z * z), dtype=np.float64)
