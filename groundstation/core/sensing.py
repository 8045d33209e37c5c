"""What agents' own sensors leave of their views: range, field of view, edges lost for a while, noise, a turned camera.

Everything random follows from a seed and the time, by whole slots, so that a log flown again senses the same. Keeps
nothing. Avoidance is not fed from here: it has to know whoever is near, whatever the sensor sees.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from groundstation.core.quick import norms
from groundstation.core.types import BoolArray, FloatArray

Sharing = Literal["either", "both", "own"]
NOISE_EVERY_S = 0.2
"""Noise goes from one draw to the next in that time: filters of a sensor leave none that is faster."""
_EDGES, _PHASES, _NOISE, _CAMERAS = range(4)  # streams of the seed


@dataclass(frozen=True)
class Sensor:
    """What every agent of a team senses its neighbours with.

    Attributes:
        range_m: how far it sees.
        field_of_view_rad: opening of the cone around its nose, 2 pi for all around.
        share: an edge is there when ``either`` end sees the other and tells it, when ``both`` do, or for each end by
            what it sees on its ``own``.
        loss: share of the time for which an edge is lost; with ``own`` each direction by itself.
        lost_for_s: for how long at a time.
        noise_m: standard deviation of relative positions on each axis.
        heading_rad, level_rad: by how much each sensor is turned against its body, to a side that is drawn.
        seed: of all that is random.
    """

    range_m: float = np.inf
    field_of_view_rad: float = 2.0 * np.pi
    share: Sharing = "either"
    loss: float = 0.0
    lost_for_s: float = 1.0
    noise_m: float = 0.0
    heading_rad: float = 0.0
    level_rad: float = 0.0
    seed: int = 1


def sensed(sensor: Sensor, rel_flu_m: FloatArray, now_s: float) -> BoolArray:
    """Who has the relative position of whom, shape (n, n).

    Args:
        sensor: of every agent.
        rel_flu_m: relative positions, shape (n, n, 3), body FLU of the one that looks; NaN is not seen.
        now_s: time, which edges are lost follows from.
    """
    distance_m = norms(rel_flu_m)
    near = distance_m <= sensor.range_m  # NaN is not
    if sensor.field_of_view_rad < 2.0 * np.pi:
        near &= rel_flu_m[..., 0] >= np.cos(0.5 * sensor.field_of_view_rad) * distance_m
    if sensor.share == "either":
        near = near | near.T
    elif sensor.share == "both":
        near = near & near.T
    return np.asarray(near & ~lost(sensor, len(near), now_s), dtype=np.bool_)


def lost(sensor: Sensor, n: int, now_s: float) -> BoolArray:
    """Which edges are lost at a time, shape (n, n): each for whole slots that begin at a time of its own."""
    if sensor.loss <= 0.0:
        return np.zeros((n, n), dtype=np.bool_)
    slot, part = divmod(now_s / sensor.lost_for_s, 1.0)
    phase = _drawn(sensor.seed, _PHASES, 0).random((n, n))
    draws = [_drawn(sensor.seed, _EDGES, int(slot) - back).random((n, n)) for back in (0, 1)]
    gone = np.where(phase <= part, *draws) < sensor.loss
    if sensor.share == "own":
        return np.asarray(gone, dtype=np.bool_)
    upper = np.triu(gone, 1)
    return np.asarray(upper | upper.T, dtype=np.bool_)


def noise_m(sensor: Sensor, n: int, now_s: float) -> FloatArray:
    """What is added to relative positions at a time, shape (n, n, 3): lines between draws."""
    slot, part = divmod(now_s / NOISE_EVERY_S, 1.0)
    before, after = (_drawn(sensor.seed, _NOISE, int(slot) + on).standard_normal((n, n, 3)) for on in (0, 1))
    # Halfway between two draws their mean is smaller than either: kept at one standard deviation throughout.
    mixed = ((1.0 - part) * before + part * after) / np.hypot(1.0 - part, part)
    return np.asarray(sensor.noise_m * mixed, dtype=np.float64)


def cameras(sensor: Sensor, n: int) -> FloatArray:
    """Takes body FLU to what each sensor takes for it, shape (n, 3, 3)."""
    rng = _drawn(sensor.seed, _CAMERAS, 0)
    heading = sensor.heading_rad * (2.0 * rng.integers(0, 2, n) - 1.0)
    towards = rng.uniform(-np.pi, np.pi, n)
    c, s = np.cos(heading), np.sin(heading)
    zero, one = np.zeros(n), np.ones(n)
    about_z = np.array([[c, -s, zero], [s, c, zero], [zero, zero, one]]).transpose(2, 0, 1)
    x, y, tilt_c, tilt_s = np.cos(towards), np.sin(towards), np.cos(sensor.level_rad), np.sin(sensor.level_rad)
    about_level = np.array(
        [
            [tilt_c + x * x * (1.0 - tilt_c), x * y * (1.0 - tilt_c), y * tilt_s],
            [x * y * (1.0 - tilt_c), tilt_c + y * y * (1.0 - tilt_c), -x * tilt_s],
            [-y * tilt_s, x * tilt_s, tilt_c * one],
        ]
    ).transpose(2, 0, 1)
    return np.asarray(about_level @ about_z, dtype=np.float64)


def _drawn(seed: int, stream: int, slot: int) -> np.random.Generator:
    return np.random.default_rng([seed, stream, slot + 1])  # a time before 0 is none
