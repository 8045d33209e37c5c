"""Laws and avoidance of one's own in place of the paper's: what they are given, and what is made of their answers.

A law is called once a tick with what each agent sees, and answers with a velocity for each; avoidance turns such
velocities away from others. Whatever they answer, the damper and the limits come after them. What they raise, or answer
in numbers that are none, is an ``OwnCodeError``. They are given copies that cannot be written to, so that
nobody else steers by what they change. Refuses to judge whether a law is any good.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TypeVar

import numpy as np

from groundstation.core.avoidance import Avoided, avoid
from groundstation.core.control import ScaleFunction, Task
from groundstation.core.regions import SafetyRegion
from groundstation.core.types import BoolArray, ComplexArray, FloatArray
from groundstation.core.views import LocalViews

Answer = Callable[..., object]
"""A law or avoidance as its author wrote it: anything that can be called."""

_Array = TypeVar("_Array", BoolArray, FloatArray)
_LONG = 200  # characters of somebody else's message


class OwnCodeError(Exception):
    """A law or avoidance of one's own has failed; the message is a sentence for people."""


@dataclass(frozen=True)
class Seen:
    """What a law is given each tick: row i is what agent i sees and was told before the flight, of n agents.

    Everything is in the agent's own body axes, forward, left, up, tilted as it is. A law makes row i of its answer
    from row i alone; then each agent could run it on board. Whoever is not seen as a neighbour is 0 everywhere, and
    ``neighbours`` says so.

    Attributes:
        rel_pos_flu_m: position of j relative to i, shape (n, n, 3).
        rel_vel_flu_m_s: velocity of j relative to i, shape (n, n, 3); 0 where unknown.
        neighbours: j is a neighbour of i and is seen, shape (n, n).
        distances_m: desired distances d*_ij, shape (n, n).
        rise_m: how much higher j is to be than i, shape (n, n).
        gains_xy: a_ij + i b_ij of equation (3), shape (n, n), 1/s.
        gains_z: c_ij of equation (3), shape (n, n), 1/s.
        vel_flu_m_s: own velocity, shape (n, 3); 0 where unknown.
        up_flu: unit vector upwards, shape (n, 3).
        control_gain: k of (14), fitted to the vehicles' lag.
        lead_s: how far ahead the paper's law looks to make up for the lag.
        upright_1_s: weight of the term that keeps a formation right side up.
        scale: f of (14).
        speed_limit_m_s: longer velocities are shortened.
        period_s: of a tick.
    """

    rel_pos_flu_m: FloatArray
    rel_vel_flu_m_s: FloatArray
    neighbours: BoolArray
    distances_m: FloatArray
    rise_m: FloatArray
    gains_xy: ComplexArray
    gains_z: FloatArray
    vel_flu_m_s: FloatArray
    up_flu: FloatArray
    control_gain: float
    lead_s: float
    upright_1_s: float
    scale: ScaleFunction
    speed_limit_m_s: float
    period_s: float

    @property
    def range_m(self) -> FloatArray:
        """Distances to neighbours, shape (n, n); 0 for everybody else."""
        return np.asarray(np.linalg.norm(self.rel_pos_flu_m, axis=2))

    @property
    def height_m(self) -> FloatArray:
        """How much higher neighbours are, shape (n, n); 0 for everybody else."""
        return np.asarray(np.einsum("ijk,ik->ij", self.rel_pos_flu_m, self.up_flu))


def seen_by(
    views: LocalViews,
    task: Task,
    scale: ScaleFunction,
    control_gain: float,
    *,
    lead_s: float,
    upright_1_s: float,
    speed_limit_m_s: float,
    period_s: float,
) -> Seen:
    """What a law is given of these views; all of it copies that cannot be written to.

    Args:
        views: what n agents see.
        task: their rows of gains and distances.
        scale: f.
        control_gain: k.
        lead_s: of the paper's law.
        upright_1_s: of the paper's law.
        speed_limit_m_s: of the mission.
        period_s: of a tick.
    """
    near = task.neighbours & views.visible
    seen = Seen(
        rel_pos_flu_m=_of(views.rel_pos_flu_m, near),
        rel_vel_flu_m_s=_of(views.rel_vel_flu_m_s, near),
        neighbours=near,
        distances_m=task.distances_m.copy(),
        rise_m=task.rise_m.copy(),
        gains_xy=task.gains_xy.copy(),
        gains_z=task.gains_z.copy(),
        vel_flu_m_s=np.nan_to_num(views.vel_flu_m_s),
        up_flu=views.up_flu.copy(),
        control_gain=control_gain,
        lead_s=lead_s,
        upright_1_s=upright_1_s,
        scale=scale,
        speed_limit_m_s=speed_limit_m_s,
        period_s=period_s,
    )
    for field in fields(seen):
        value = getattr(seen, field.name)
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
    return seen


def _of(rel_flu: FloatArray, near: BoolArray) -> FloatArray:
    """Relative vectors (n, n, 3) of neighbours; 0 for everybody else, and where unknown."""
    return np.nan_to_num(np.where(near[..., None], rel_flu, 0.0))


class OwnLaw:
    """A law of one's own, held to the shape and kind of its answers.

    Args:
        name: for messages, ``law my_law:MyLaw``.
        answer: the law.
        ids: of the vehicles, for messages.
    """

    def __init__(self, name: str, answer: Answer, ids: Sequence[int]) -> None:
        self._name, self._answer, self._ids = name, answer, tuple(ids)
        self._told = False
        self._words: list[str] = []

    def __call__(self, seen: Seen) -> FloatArray:
        """Velocities, shape (n, 3), body FLU of each agent, m/s; finite, and not yet limited.

        Raises:
            OwnCodeError: the law raised, or answered with something else.
        """
        vel_flu_m_s = _answered(self._name, self._answer, self._ids, (seen,))
        speed_m_s = np.linalg.norm(vel_flu_m_s, axis=1)
        fastest = int(np.argmax(speed_m_s))
        if speed_m_s[fastest] > seen.speed_limit_m_s and not self._told:
            self._told = True
            self._words.append(
                f"{self._name} asks for {speed_m_s[fastest]:.3g} m/s of vehicle {self._ids[fastest]}, speed_limit_m_s"
                f" is {seen.speed_limit_m_s:g}: what is longer is shortened"
            )
        return vel_flu_m_s

    def take_words(self) -> list[str]:
        """What people should know of it, each thing once."""
        words, self._words = self._words, []
        return words


class OwnAvoidance:
    """Avoidance of one's own in place of Algorithm 2, held to the shape and kind of its answers.

    Args:
        name: for messages.
        answer: called with views, desired velocities and region; answers with velocities.
        ids: of the vehicles, for messages.
    """

    def __init__(self, name: str, answer: Answer, ids: Sequence[int]) -> None:
        self._name, self._answer, self._ids = name, answer, tuple(ids)

    def __call__(self, views: LocalViews, desired_flu_m_s: FloatArray, region: SafetyRegion) -> Avoided:
        """As ``core.avoidance.avoid``; who is in the way is told by that.

        Raises:
            OwnCodeError: the avoidance raised, or answered with something else.
        """
        theirs = avoid(views, desired_flu_m_s, region)
        given = LocalViews(
            rel_pos_flu_m=_sealed(views.rel_pos_flu_m),
            rel_vel_flu_m_s=_sealed(views.rel_vel_flu_m_s),
            visible=_sealed(views.visible),
            vel_flu_m_s=_sealed(views.vel_flu_m_s),
            extra_m=_sealed(views.extra_m),
            up_flu=_sealed(views.up_flu),
            wider_m=_sealed(views.wider_m),
        )
        vel = _answered(self._name, self._answer, self._ids, (given, _sealed(desired_flu_m_s), region))
        wanted, left = np.linalg.norm(desired_flu_m_s, axis=1), np.linalg.norm(vel, axis=1)
        # Nobody is faster than it wished to be: turning away adds no speed.
        vel = vel * np.minimum(1.0, wanted / np.maximum(left, 1e-12))[:, None]
        blocked = np.asarray((wanted > 0.0) & (left <= 1e-9))
        cosine = np.einsum("ij,ij->i", vel, desired_flu_m_s) / np.maximum(wanted**2, 1e-12)
        angle_rad = np.where(wanted > 0.0, np.arccos(np.clip(cosine, -1.0, 1.0)), 0.0)
        return Avoided(vel, blocked, angle_rad, theirs.in_the_way)


def _sealed(array: _Array) -> _Array:
    """A copy that cannot be written to."""
    copy = array.copy()
    copy.flags.writeable = False
    return copy


def _answered(name: str, answer: Answer, ids: Sequence[int], given: tuple[object, ...]) -> FloatArray:
    """Calls somebody else's code and looks at what it gives back; shape (n, 3), finite, a copy of our own."""
    try:
        with np.errstate():  # what it sets of numpy's errors is its own affair
            raw = np.asarray(answer(*given))
            if np.iscomplexobj(raw):
                raise TypeError("velocities are complex numbers")
            vel_flu_m_s = np.array(raw, dtype=np.float64)
    except BaseException as error:  # sys.exit() too: a law does not end a flight's process
        raise OwnCodeError(f"{name} failed: {in_words(error)}") from error
    if vel_flu_m_s.shape != (len(ids), 3):
        raise OwnCodeError(f"{name} answered with an array of shape {vel_flu_m_s.shape}, expected ({len(ids)}, 3)")
    bad = [ids[int(row)] for row in np.flatnonzero(~np.isfinite(vel_flu_m_s).all(axis=1))]
    if bad:
        listed = f"vehicle {bad[0]}" if len(bad) == 1 else f"vehicles {', '.join(map(str, bad))}"
        raise OwnCodeError(f"{name} answered with velocities that are no finite numbers for {listed}")
    return vel_flu_m_s


def in_words(error: BaseException) -> str:
    """An exception of somebody else's code: its kind, its message in one line, and where it was raised."""
    message = " ".join(str(error).split())[:_LONG]
    places = traceback.extract_tb(error.__traceback__)
    where = f" ({Path(places[-1].filename).name}, line {places[-1].lineno})" if places else ""
    return f"{type(error).__name__}{': ' if message else ''}{message}{where}"
