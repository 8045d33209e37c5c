"""Velocities that disagree with the positions beside them: told, flown by both, and brought home when hopeless.

A vehicle steers by its own velocity, so when that is wrong by b, it moves by what it was told less b. Where its
velocity has been seen to disagree for seconds, everybody reckons with it less b, it is told b more than it is wanted to
do, the others keep farther from it, and places and distances count as reached a little sooner. Where velocities agree
nothing changes, to the last bit.

Which of the two is wrong, a single disagreement does not tell. A velocity that came and went in its error before is the
one that is wrong; a position that leaves a velocity that was good until then is not believed (``positions.PoseJump``).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

import numpy as np

from groundstation.core.quick import norms
from groundstation.core.speeds import DISAGREES_M_S, Speeds
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.mission.flight.poses import Poses, changed
from groundstation.mission.monitors.findings import SEE_TO_POSITION, Finding, Lasting, Reaction, Sight
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.timing import SECOND_NS, HeldEach, SinceBefore

_LASTS_S = 1.0
_SWAY_DEVIATIONS = 2.0
_GOOD_M_S, _KNOWN_S = 0.09, 15.0  # the emulator's by GPS: 0.09 at most; of one that is shaken 0.1 and more from then on
_BEFORE_NS, _BEFORE_EVERY_NS = 9 * SECOND_NS // 2, SECOND_NS // 2  # a drift of 0.3 m/s is found in 4 s
_CALM_M_S, _CALM_NS = 0.12, 6 * SECOND_NS  # of a velocity that is shaken hardly ever so long
_FRESH_S = 0.3  # older positions are carried on by the very velocity that is judged


class PoorSpeeds:
    """How good the vehicles' velocities are.

    Attributes:
        calm: whose velocity has agreed with its positions for seconds without a break, shape (n,).
        rms_m_s: ``told_error_m_s`` as far as it is reckoned with: zero where velocities are good, shape (n,).
    """

    def __init__(self, plan: MissionPlan) -> None:
        self._limit_m_s, self._fastest_m_s = plan.spec.limits.velocity_error_m_s, plan.spec.speed_limit_m_s
        self._settle_s = plan.profile.lag_s + plan.profile.delay_s
        self._speeds = Speeds(plan.size)
        self._since_before = SinceBefore()
        self.rms_m_s: FloatArray = np.zeros(plan.size)
        self._known_s: FloatArray = np.zeros(plan.size)
        self._calm = HeldEach(plan.size)
        self.calm: BoolArray = np.zeros(plan.size, dtype=np.bool_)
        self._before: deque[tuple[int, FloatArray]] = deque()
        self._poor, self._hopeless = Lasting(plan.size, _LASTS_S), Lasting(plan.size, _LASTS_S)

    def take(self, poses: Poses, pose_ns: IntArray, counts: BoolArray, now_ns: int) -> None:
        """Takes the poses of a tick, as reported; ``counts``: in the air and not suspect, shape (n,)."""
        passed_s = self._since_before(now_ns)
        if not passed_s > 0.0:
            return
        fresh = now_ns - pose_ns <= _FRESH_S * SECOND_NS
        counts = np.asarray(counts & fresh, dtype=np.bool_)
        self._speeds.take(poses.pos_team_ned_m, poses.vel_ned_m_s, passed_s, counts)
        self.rms_m_s = np.asarray(self._speeds.share * self._speeds.rms_m_s)
        self._known_s += passed_s * counts
        calm = counts & (norms(self._speeds.error_ned_m_s) <= _CALM_M_S)
        self.calm = self._calm(np.asarray(calm, dtype=np.bool_), now_ns, _CALM_NS)
        if not self._before or now_ns - self._before[-1][0] >= _BEFORE_EVERY_NS:
            self._before.append((now_ns, self._speeds.rms_m_s))
            while now_ns - self._before[0][0] > _BEFORE_NS:
                self._before.popleft()

    @property
    def known_error_ned_m_s(self) -> FloatArray:
        """What poor velocities are off by at the moment, shape (n, 3); zero where they agree with the positions."""
        return self._speeds.known_error_ned_m_s

    @property
    def told_error_m_s(self) -> FloatArray:
        """Root mean square of each velocity's error over 10 s, all axes; 0 until it is known, shape (n,)."""
        return self._speeds.rms_m_s

    @property
    def good(self) -> BoolArray:
        """Whose velocity has been known to agree with its positions until a few seconds ago, shape (n,).

        What parts from its velocity now is its position, then.
        """
        rms_m_s = self._before[0][1] if self._before else self._speeds.rms_m_s
        return np.asarray((self._known_s >= _KNOWN_S) & (rms_m_s <= _GOOD_M_S))

    @property
    def sway_m(self) -> float:
        """How far distances may sway by what stays wrong; 0 where all velocities agree."""
        return float(_SWAY_DEVIATIONS * self._settle_s * self._speeds.left_m_s.max(initial=0.0))

    def steady(self, poses: Poses, suspect: BoolArray) -> Poses:
        """Poses to steer by: velocities less their error, with what stays wrong of them.

        Args:
            poses: as they are trusted.
            suspect: whose velocity is not the reported one, shape (n,); it stays.
        """
        if not np.count_nonzero(self._speeds.share):
            return poses
        return changed(
            poses,
            vel_ned_m_s=poses.vel_ned_m_s - np.where(suspect[:, None], 0.0, self._speeds.known_error_ned_m_s),
            vel_error_m_s=self._speeds.left_m_s,
        )

    def told(self, velocity_ned_m_s: FloatArray) -> FloatArray:
        """What vehicles are told so that they move as wanted, shape (n, 3), within the speed limit."""
        share = self._speeds.share
        if not np.count_nonzero(share):
            return velocity_ned_m_s
        told = velocity_ned_m_s + self._speeds.known_error_ned_m_s
        most = np.maximum(self._fastest_m_s, 1e-12) / np.maximum(norms(told), 1e-12)
        return np.asarray(np.where((share > 0.0)[:, None], told * np.minimum(1.0, most)[:, None], velocity_ned_m_s))

    def look(self, sight: Sight, ours: BoolArray) -> Iterator[Finding]:
        """Tells of poor velocities, and brings those home that are hopeless."""
        rms_m_s = self._speeds.rms_m_s
        judged = sight.in_our_air & ours
        for vehicle in self._hopeless(judged & (rms_m_s > self._limit_m_s), sight.now_ns):
            what = f"its velocity is wrong: {rms_m_s[vehicle]:.2f} m/s off what its positions do"
            yield Finding(Reaction.HOME, f"{what}, limit {self._limit_m_s:.2g} m/s", (vehicle,), remedy=SEE_TO_POSITION)
        for vehicle in self._poor(judged & (rms_m_s > DISAGREES_M_S), sight.now_ns):
            what = f"its velocity is poor: {rms_m_s[vehicle]:.2f} m/s off what its positions do; it is flown by both"
            yield Finding(Reaction.SAY, what, (vehicle,), remedy=SEE_TO_POSITION)
