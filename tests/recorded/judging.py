"""Compares what was believed of a recording with its truth, message by message and tick by tick.

Decides what counts as agreement; ``python -m tests.recorded [FOLDER ...]`` prints it for all recordings at hand.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from groundstation.core.types import BoolArray, FloatArray
from tests.recorded.recording import Belief, Recording

UP_M = 0.3
"""Who is truly that high flies, whatever anybody says."""
DOWN_M = 0.15
"""Who is truly that low may be called landed."""
_SENT_BY_US = ("two different origins", "was given the team's origin")  # hang on when we send, which here goes nowhere


@dataclass(frozen=True)
class Judgement:
    """One vehicle of one recording.

    Attributes:
        sysid: of the vehicle.
        flew: it was truly in the air.
        pos_rms_m, pos_max_m: believed against true position in the air, axes east, north, up, shape (3,).
        vel_rms_m_s, vel_max_m_s: the same of velocities, axes north, east, down, shape (3,).
        steady_rms_m_s: root mean square of the error of the velocities that are steered by, shape (3,).
        told_rms_m_s: what is said of the error of the reported ones, all axes together, root mean square.
        unarmed_in_air: ticks at which it truly flew and was believed to be disarmed.
        landed_in_air: ticks at which it truly flew and was believed to stand on the ground.
        aloft_early_s: how long it was believed to fly before it truly did.
        landed_late_s: how long it was believed to fly after it truly stood; NaN where the recording ends before.
        ready_before_arming_s: how long preflight had found nothing when the real autopilot agreed to be armed.
    """

    sysid: int
    flew: bool
    pos_rms_m: FloatArray
    pos_max_m: FloatArray
    vel_rms_m_s: FloatArray
    vel_max_m_s: FloatArray
    steady_rms_m_s: FloatArray
    told_rms_m_s: float
    unarmed_in_air: int
    landed_in_air: int
    aloft_early_s: float
    landed_late_s: float
    ready_before_arming_s: float


def judge(recording: Recording, belief: Belief) -> list[Judgement]:
    """Holds belief against truth, vehicle by vehicle."""
    return [_judge(recording, belief, vehicle) for vehicle in range(recording.plan.size)]


def _judge(recording: Recording, belief: Belief, vehicle: int) -> Judgement:
    pos_enu_m, vel_ned_m_s = recording.truth.at(vehicle, belief.t_ns)
    height_m = pos_enu_m[:, 2] - recording.plan.pads_enu_m[vehicle][2]
    aloft: BoolArray = belief.armed[:, vehicle] & ~belief.landed[:, vehicle]
    truly: BoolArray = height_m > UP_M  # not with NaN
    both = aloft & truly & np.isfinite(belief.pos_enu_m[:, vehicle]).all(axis=1)
    pos_m = np.abs(belief.pos_enu_m[both, vehicle] - pos_enu_m[both])
    vel_m_s = np.abs(belief.vel_ned_m_s[both, vehicle] - vel_ned_m_s[both])
    steady_m_s = belief.steady_ned_m_s[both, vehicle] - vel_ned_m_s[both]
    told_m_s = belief.told_error_m_s[both, vehicle]
    flew = bool(both.any())
    nothing = np.zeros((1, 3))
    pos_m, vel_m_s, steady_m_s = (pos_m, vel_m_s, steady_m_s) if flew else (nothing, nothing, nothing)
    on_ground = np.flatnonzero(height_m < DOWN_M)
    lifted_s = _seconds(belief, np.flatnonzero(truly), 0) - _seconds(belief, np.flatnonzero(aloft), 0)
    ended = bool(belief.landed[-1, vehicle])
    stood = on_ground[on_ground > np.flatnonzero(truly)[-1]] if truly.any() else on_ground
    down_s = _seconds(belief, np.flatnonzero(aloft), -1) - _seconds(belief, stood, 0)
    return Judgement(
        sysid=recording.plan.spec.vehicles[vehicle].id,
        flew=flew,
        pos_rms_m=np.sqrt((pos_m**2).mean(axis=0)),
        pos_max_m=pos_m.max(axis=0),
        vel_rms_m_s=np.sqrt((vel_m_s**2).mean(axis=0)),
        vel_max_m_s=vel_m_s.max(axis=0),
        steady_rms_m_s=np.sqrt((steady_m_s**2).mean(axis=0)),
        told_rms_m_s=float(np.sqrt((told_m_s[told_m_s > 0.0] ** 2).mean())) if (told_m_s > 0.0).any() else 0.0,
        unarmed_in_air=int((truly & ~belief.armed[:, vehicle]).sum()),
        landed_in_air=int((truly & belief.landed[:, vehicle]).sum()),
        aloft_early_s=lifted_s,
        landed_late_s=down_s if ended else float("nan"),
        ready_before_arming_s=(int(belief.armed_ns[vehicle]) - int(belief.ready_ns[vehicle])) / 1e9
        if belief.armed_ns[vehicle] >= 0 and belief.ready_ns[vehicle] >= 0
        else float("nan"),
    )


def _seconds(belief: Belief, ticks: np.ndarray, which: int) -> float:
    return float(belief.t_ns[ticks[which]]) / 1e9 if len(ticks) else float("nan")


def held_back(belief: Belief) -> list[str]:
    """What preflight had against vehicles that the real autopilots agreed to arm a moment later."""
    return [text for text in belief.problems if not any(words in text for words in _SENT_BY_US)]
