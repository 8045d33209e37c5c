"""Where the team is at one instant, as values."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Generic, TypeVar

import numpy as np

from groundstation.core import frames
from groundstation.core.quick import every
from groundstation.core.types import BoolArray, FloatArray
from groundstation.mission.flight.intruders import NOBODY, Intruders

_OUT_OF_SIGHT_M = 1e5
_NOBODY: FloatArray = np.zeros(0)
"""Stands for zeros of whatever size is right."""


@dataclass(frozen=True)
class Poses:
    """Poses of the team at one instant.

    Attributes:
        pos_team_ned_m: shape (n, 3); NaN where never known.
        vel_ned_m_s: shape (n, 3).
        quat_ned_from_frd: shape (n, 4).
        sinking: not steered by us, or its position is lost: it may come down anywhere below, shape (n,).
        extra_radius_m: what is added to r around a vehicle that nobody steers, so that the others do both halves of
            every manoeuvre, shape (n,), >= 0; zero for those we steer. Zeros when left out.
        vel_error_m_s: standard deviation of a velocity that is known to be poor, one axis, shape (n,), >= 0; zero for
            all others, whose error is part of the margin of r. Zeros when left out.
        intruders: aircraft that are none of the team.
        carried_s: for how long positions were carried on by their velocities since they were measured, shape (n,).
            Zeros when left out.
    """

    pos_team_ned_m: FloatArray
    vel_ned_m_s: FloatArray
    quat_ned_from_frd: FloatArray
    sinking: BoolArray
    extra_radius_m: FloatArray = field(default_factory=lambda: _NOBODY)
    vel_error_m_s: FloatArray = field(default_factory=lambda: _NOBODY)
    intruders: Intruders = NOBODY
    carried_s: FloatArray = field(default_factory=lambda: _NOBODY)

    @cached_property
    def rot_ned_from_flu(self) -> FloatArray:
        """Takes each vehicle's own tilted frame to NED, shape (n, 3, 3)."""
        return frames.rot_ned_from_flu(self.quat_ned_from_frd)

    def __post_init__(self) -> None:
        """Fills in what was left out, and refuses arrays of the wrong size."""
        n = len(self.pos_team_ned_m)
        for name in ("extra_radius_m", "vel_error_m_s", "carried_s"):
            given = getattr(self, name)
            if given is _NOBODY:
                object.__setattr__(self, name, np.zeros(n))
            elif given.shape != (n,):
                raise ValueError(f"poses: {name} has shape {given.shape}, expected ({n},)")


def changed(poses: Poses, **parts: FloatArray | BoolArray | Intruders) -> Poses:
    """``replace`` for a tick's poses: new arrays of the same sizes, and nothing that is known is worked out again."""
    others = object.__new__(Poses)
    others.__dict__.update(poses.__dict__)
    if "quat_ned_from_frd" in parts:
        others.__dict__.pop("rot_ned_from_flu", None)
    others.__dict__.update(parts)
    return others


_T = TypeVar("_T")


class OncePerPoses(Generic[_T]):
    """What follows from poses alone, worked out once for each: the same for whoever asks again in the same tick.

    Args:
        work_out: called with poses that were not the ones of the call before; nobody may write into what it returns.
    """

    def __init__(self, work_out: Callable[[Poses], _T]) -> None:
        self._work_out = work_out
        self._last: tuple[Poses, _T] | None = None

    def __call__(self, poses: Poses) -> _T:
        """The answer for these poses, which are known again by being the same object."""
        if self._last is None or self._last[0] is not poses:
            self._last = poses, self._work_out(poses)
        return self._last[1]


def out_of_sight(poses: Poses) -> Poses:
    """Puts whoever was never seen far away from everybody, so that unknown does not spread."""
    parts = (poses.pos_team_ned_m, poses.vel_ned_m_s, poses.quat_ned_from_frd)
    finite: BoolArray = np.isfinite(np.concatenate(parts, axis=1))
    if every(finite):
        return poses
    known = np.asarray(finite.all(axis=1))
    far = _OUT_OF_SIGHT_M * (1.0 + np.arange(len(known)))[:, None] * np.array([1.0, 0.0, 1.0])  # under nobody
    return changed(
        poses,
        pos_team_ned_m=np.where(known[:, None], poses.pos_team_ned_m, far),
        vel_ned_m_s=np.where(known[:, None], poses.vel_ned_m_s, 0.0),
        quat_ned_from_frd=np.where(known[:, None], poses.quat_ned_from_frd, np.array([1.0, 0.0, 0.0, 0.0])),
    )
