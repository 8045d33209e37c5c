"""How long a move of the formation takes: as the mission says where that will do, else as fast as the limits allow."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from groundstation.core.errors import UserError
from groundstation.core.motion import MovePlan, least_seconds
from groundstation.core.types import FloatArray
from groundstation.mission.plan.schema import MoveStep

MOVE_SHARE = 0.5
"""Share of the speed and acceleration limits that a move may ask for; the rest is for keeping the formation."""

_LEAST_MOVE_S = 1.0


def timed(step: MoveStep, points_m: FloatArray, speed_limit_m_s: float, accel_m_s2: float, key: str) -> MovePlan:
    """A move with its duration, which must leave the vehicles room to keep the formation.

    Args:
        step: the move.
        points_m: the formation before it, about its middle, shape (n, 3).
        speed_limit_m_s: of the mission.
        accel_m_s2: how fast setpoints may change.
        key: for messages.

    Raises:
        UserError: it asks for nothing, or for too much in its time.
    """
    by = np.array(step.by_m, dtype=np.float64)
    turn = math.radians(step.turn_deg)
    if not by.any() and turn == 0.0 and step.scale == 1.0:
        raise UserError(f"{key}: neither by_m, turn_deg nor scale is given; give one, or hold in its place")
    move = MovePlan(by, turn, step.scale, step.seconds or 1.0)
    least = _least_s(move, points_m, speed_limit_m_s, accel_m_s2)
    if step.seconds is None:
        return in_good_time(move, points_m, speed_limit_m_s, accel_m_s2)
    if step.seconds < least - 1e-9:
        raise UserError(
            f"{key}.seconds: {step.seconds:g} s is too short, at least {math.ceil(10.0 * least) / 10.0:g} s are needed"
            f" with half of the speed limit of {speed_limit_m_s:g} m/s and half of the acceleration of"
            f" {accel_m_s2:g} m/s^2; take more time, or leave it out"
        )
    return move


def in_good_time(move: MovePlan, points_m: FloatArray, speed_limit_m_s: float, accel_m_s2: float) -> MovePlan:
    """The same move as fast as half of the limits allow whoever it carries farthest.

    Args:
        move: what is to be done; its own duration does not matter.
        points_m: the formation before it, about its middle, shape (n, 3).
        speed_limit_m_s: of the mission.
        accel_m_s2: how fast setpoints may change.
    """
    least = _least_s(move, points_m, speed_limit_m_s, accel_m_s2)
    return replace(move, seconds=max(_LEAST_MOVE_S, math.ceil(10.0 * least) / 10.0))


def _least_s(move: MovePlan, points_m: FloatArray, speed_limit_m_s: float, accel_m_s2: float) -> float:
    level = float(np.linalg.norm(points_m[:, :2], axis=1).max())
    radius = float(np.linalg.norm(points_m, axis=1).max())
    return least_seconds(move, level, radius, MOVE_SHARE * speed_limit_m_s, MOVE_SHARE * accel_m_s2)
