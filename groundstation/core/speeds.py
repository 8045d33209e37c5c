"""How wrong reported velocities are, measured against the positions that come with them; and better ones from both.

For each vehicle an observer carries its position on by its velocity less an error b, and is pulled to where it reports
to be:

    p' = v - b + 2 zeta w (reported - p),    b' = -w^2 (reported - p),

so that b follows what velocity and change of position differ by, with the rate w: quick enough for an error that lasts
seconds, slow enough to take no part in the noise of positions. The root mean square of b over seconds says how far a
velocity is to be trusted. Between a velocity that agrees with the positions and one that does not it is left, or taken
less b: where positions are the noisier ones the filter would only spoil it.

Measured on recordings of real firmware (docs/vehicles.md): w = 3 halves the errors of PX4's simulator. Refuses to say
which of the two is right: b is the same for a position that drifts. Whoever asks has to know.
"""

from __future__ import annotations

import math

import numpy as np

from groundstation.core.quick import any_of, between, finite_rows, norms, renewed, some, squares
from groundstation.core.types import BoolArray, FloatArray

_RATE_1_S, _DAMPING = 3.0, 0.7
_FORGETS_S = 5.0
_OVER_S, _ENOUGH_S = 10.0, 2.0
_GAP_S = 0.5
_MOST_M_S = 3.0
AGREES_M_S, DISAGREES_M_S = 0.12, 0.24
"""Root mean square of b, all three axes: below the first a velocity is as good as its positions, above the second it
is taken less b, in between in proportion. Seen: 0.025 with ArduCopter, 0.065 with a
quiet PX4, 0.16 with its shaken simulator whose estimator knows of it, 0.25 with one that does not."""
_LEFT = 0.62
"""Error that is left on the worst axis of a velocity less b, against the root mean square of b: 0.155 of 0.25 m/s."""


class Speeds:
    """The errors of n vehicles' velocities.

    Args:
        n: vehicles.

    Attributes:
        error_ned_m_s: b, shape (n, 3).
        rms_m_s: its root mean square over the last seconds, all axes together, shape (n,); 0 until it is known.
        share: how much of b is taken off each velocity, 0 to 1, shape (n,).
    """

    def __init__(self, n: int) -> None:
        self.error_ned_m_s: FloatArray = np.zeros((n, 3))
        self.rms_m_s: FloatArray = np.zeros(n)
        self.share: FloatArray = np.zeros(n)
        self._pos: FloatArray = np.full((n, 3), np.nan)
        self._square: FloatArray = np.zeros(n)
        self._counted_s: FloatArray = np.zeros(n)
        self._gap_s: FloatArray = np.zeros(n)

    def take(self, pos_ned_m: FloatArray, vel_ned_m_s: FloatArray, passed_s: float, counts: BoolArray) -> None:
        """Takes what is reported at a tick.

        Args:
            pos_ned_m: shape (n, 3).
            vel_ned_m_s: shape (n, 3).
            passed_s: since the tick before, > 0.
            counts: in the air, and reported of late, shape (n,).
        """
        known = counts & finite_rows(pos_ned_m) & finite_rows(vel_ned_m_s)
        self._gap_s = np.where(known, 0.0, self._gap_s + passed_s)
        fresh = known & ~np.isfinite(self._pos[:, 0])
        stays = any_of(~known | fresh)
        rows = None if stays is None else stays[:, None]
        ahead = self._pos + passed_s * (vel_ned_m_s - self.error_ned_m_s)
        off = renewed(rows, 0.0, pos_ned_m - ahead)
        pull = min(1.0, 2.0 * _DAMPING * _RATE_1_S * passed_s)
        error = self.error_ned_m_s - min(0.25, _RATE_1_S**2 * passed_s**2) / passed_s * off
        error = error * math.exp(-passed_s / _FORGETS_S)
        size = norms(error)[..., None]
        error = error * np.minimum(1.0, _MOST_M_S / np.maximum(size, 1e-12))
        self.error_ned_m_s = renewed(rows, self.error_ned_m_s, error)
        pulled = renewed(rows, self._pos, ahead + pull * off)
        self._pos = pulled if stays is None else np.where(fresh[:, None], pos_ned_m, pulled)
        # Plain means at first, then those of the last seconds.
        self._counted_s = renewed(stays, self._counted_s, self._counted_s + passed_s)
        share = passed_s / between(self._counted_s, passed_s, _OVER_S)
        self._square += renewed(stays, 0.0, share * (squares(self.error_ned_m_s) - self._square))
        gone = self._gap_s > _GAP_S
        if some(gone):
            self.forget(gone)
        self.rms_m_s = np.where(self._counted_s >= _ENOUGH_S, np.sqrt(self._square), 0.0)
        self.share = between((self.rms_m_s - AGREES_M_S) / (DISAGREES_M_S - AGREES_M_S), 0.0, 1.0)

    def forget(self, rows: BoolArray) -> None:
        """Positions count from anew, as after a gap, shape (n,); how good the velocities were stays known."""
        self._pos[rows] = np.nan
        self.error_ned_m_s[rows] = 0.0

    @property
    def known_error_ned_m_s(self) -> FloatArray:
        """What is taken off the velocities, shape (n, 3); zero where they agree with the positions."""
        return np.asarray(self.share[:, None] * self.error_ned_m_s)

    @property
    def left_m_s(self) -> FloatArray:
        """Standard deviation on the worst axis of what stays wrong, shape (n,); zero where velocities agree."""
        share = self.share
        return np.asarray(np.minimum(1.0, 4.0 * share) * (1.0 - (1.0 - _LEFT) * share) * self.rms_m_s)
