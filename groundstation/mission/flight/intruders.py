"""Who flies or walks near the team and is none of it, in the team frame: aircraft, and bodies of a motion capture.

As obstacles they do nothing of their half of a manoeuvre: who flies near one does both (docs/avoidance-why.md). Nothing
here believes more than a mission's ``traffic`` says.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from groundstation.core.quick import finite_rows
from groundstation.core.types import FloatArray
from groundstation.mavlink.traffic import Traffic
from groundstation.mission.flight.placement import Placement
from groundstation.mission.plan.obstacle_spec import TrafficSpec
from groundstation.mission.plan.positioning_spec import MovingBodySpec
from groundstation.mission.timing import SECOND_NS
from groundstation.mocap.others import OtherBodies

_TURNS_M_S = 5.0  # what it may have gone besides its velocity in each second since it was heard
_TINY_M = 1e-9
UNSEEN_S = 0.2
"""A body that was seen within so long is where its velocity has carried it."""


def _none() -> FloatArray:
    return np.zeros((0, 3))


@dataclass(frozen=True)
class Intruders:
    """Where k aircraft are at one instant.

    Attributes:
        pos_team_ned_m: shape (k, 3); the third one is NaN where the height is not known: they are at every height then.
        vel_ned_m_s: shape (k, 3); zero where it is not known.
        radius_m: what is kept from the place by its size, its error and its age, without r, shape (k,).
        names: for people, k of them.
        from_room: the last so many are bodies of the motion capture.
    """

    pos_team_ned_m: FloatArray = field(default_factory=_none)
    vel_ned_m_s: FloatArray = field(default_factory=_none)
    radius_m: FloatArray = field(default_factory=lambda: np.zeros(0))
    names: tuple[str, ...] = ()
    from_room: int = 0

    def __len__(self) -> int:
        """How many, k."""
        return len(self.names)

    def distances(self, pos_team_ned_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """How far positions, shape (n, 3), are from each surface, (n, k), and unit vectors towards it, (n, k, 3)."""
        offset = self.pos_team_ned_m[None] - pos_team_ned_m[:, None]
        offset[..., 2] = np.where(np.isnan(offset[..., 2]), 0.0, offset[..., 2])
        length = np.linalg.norm(offset, axis=2)
        away = np.where((length > _TINY_M)[..., None], offset / np.maximum(length, _TINY_M)[..., None], [1.0, 0.0, 0.0])
        return length - self.radius_m, away


NOBODY = Intruders()


def intruders(spec: TrafficSpec | None, placement: Placement, traffic: Traffic, now_ns: int) -> Intruders:
    """The aircraft that are told, each brought to an instant by its velocity.

    Args:
        spec: the mission's; None where it asks for none.
        placement: where the team is on earth; where that is not known nobody is anywhere.
        traffic: what was heard.
        now_ns: the instant.
    """
    if spec is None or not len(traffic) or placement.anchor_deg_m is None:
        return NOBODY
    heard = traffic.since(now_ns - round(spec.old_s * SECOND_NS))
    if not heard:
        return NOBODY
    places = np.array([item.place_deg_m for item in heard])
    known = np.isfinite(places[:, 2])
    places[~known, 2] = placement.anchor_deg_m[2]
    pos = placement.from_anchor(places)
    vel = np.nan_to_num(np.array([item.vel_ned_m_s for item in heard]))
    age_s = np.maximum((now_ns - np.array([item.measured_ns for item in heard])) / SECOND_NS, 0.0)
    pos += age_s[:, None] * vel
    pos[~known, 2] = np.nan
    near = np.hypot(pos[:, 0], pos[:, 1]) < spec.within_m
    radius = spec.radius_m + _TURNS_M_S * age_s
    names = tuple(item.name for item, shown in zip(heard, near.tolist(), strict=True) if shown)
    return Intruders(pos[near], vel[near], radius[near], names)


def with_bodies(
    flying: Intruders, specs: Sequence[MovingBodySpec], others: OtherBodies | None, most_m: float, now_ns: int
) -> Intruders:
    """The same, and bodies of the motion capture that are obstacles.

    One that is not seen any more stays where it was, and its radius grows as fast as it may move.

    Args:
        flying: aircraft.
        specs: of the bodies, by the mission.
        others: what was seen of them; None without a motion capture.
        most_m: to which a radius grows beyond the body's own.
        now_ns: the instant.
    """
    if others is None or not len(others):
        return flying
    told = finite_rows(others.pos_ned_m).nonzero()[0]
    if not len(told):
        return flying
    known = [specs[k] for k in told.tolist()]
    age_s = np.maximum((now_ns - others.measured_ns[told]) / SECOND_NS, 0.0)
    seen = (age_s <= UNSEEN_S)[:, None]
    vel = np.where(seen, others.vel_ned_m_s[told], 0.0)
    pos = others.pos_ned_m[told] + np.minimum(age_s, UNSEEN_S)[:, None] * others.vel_ned_m_s[told]
    pos[np.array([item.shape == "column" for item in known]), 2] = np.nan
    radii = np.array([item.radius_m for item in known])
    grown = np.minimum(np.array([item.speed_m_s for item in known]) * np.maximum(age_s - UNSEEN_S, 0.0), most_m)
    return Intruders(
        np.concatenate([flying.pos_team_ned_m, pos]),
        np.concatenate([flying.vel_ned_m_s, vel]),
        np.concatenate([flying.radius_m, radii + grown]),
        (*flying.names, *(item.body for item in known)),
        len(told),
    )
