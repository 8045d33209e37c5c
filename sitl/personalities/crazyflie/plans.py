"""The high-level commander: takeoff, landing, going to a place, along a smooth path; and what it answers.

Paths are polynomials of degree 7 that begin and end at rest, as the firmware plans them; one that begins while another
is flown is planned from where that stood, without its speed. Takes off only at rest, as the firmware does:
not while it flies, nor after setpoints of a client before it was told to stop. Trajectories and spirals are answered
with an error.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

from sitl.body import Place
from sitl.config import SECOND
from sitl.setpoints import Setpoint

_GROUP, _STOP, _GO_TO, _TAKEOFF, _LAND, _GO_TO_2 = 0, 3, 4, 7, 8, 12
_NOT_NOW, _NO_COMMAND, _INVALID = 1, 8, 22
_DURATION_MAX_S = 3600.0


@dataclass(frozen=True)
class Plan:
    """One path: from a place to a place, with headings, in a time; ``lands``: the motors stop at its end."""

    begun_ns: int
    duration_s: float
    start_enu_m: Place
    end_enu_m: Place
    yaws_enu_rad: tuple[float, float]
    lands: bool

    def finished(self, now_ns: int) -> bool:
        """Whether its time is over."""
        return now_ns - self.begun_ns >= self.duration_s * SECOND

    def at(self, now_ns: int) -> Setpoint:
        """Where it wants the vehicle now, and how fast."""
        s = min(max((now_ns - self.begun_ns) / SECOND / self.duration_s, 0.0), 1.0)
        share = s**4 * (35.0 - 84.0 * s + 70.0 * s**2 - 20.0 * s**3)
        rate = 140.0 * s**3 * (1.0 - s) ** 3 / self.duration_s
        way = [end - start for start, end in zip(self.start_enu_m, self.end_enu_m, strict=True)]
        x, y, z = (start + share * part for start, part in zip(self.start_enu_m, way, strict=True))
        yaw = self.yaws_enu_rad[0] + share * (self.yaws_enu_rad[1] - self.yaws_enu_rad[0])
        return Setpoint(now_ns, (x, y, z), (rate * way[0], rate * way[1], rate * way[2]), yaw, None)


@dataclass(frozen=True)
class _Wish:
    """What a packet asks for: a height alone, or a place that may be relative; a heading, or None for the present."""

    duration_s: float
    to_m: tuple[float | None, float | None, float]
    yaw_rad: float | None
    relative: bool
    takes_off: bool = False
    lands: bool = False


def _read(data: bytes) -> _Wish | None:
    if data[0] in (_TAKEOFF, _LAND):
        height, yaw, keep, duration = struct.unpack("<ff?f", data[2:])
        to_m, lands = (None, None, height), data[0] == _LAND
        return _Wish(duration, to_m, None if keep else yaw, relative=False, takes_off=not lands, lands=lands)
    if data[0] in (_GO_TO, _GO_TO_2):
        relative, rest = bool(data[2]), data[3:] if data[0] == _GO_TO else data[4:]
        x, y, z, yaw, duration = struct.unpack("<fffff", rest)
        return _Wish(duration, (x, y, z), yaw, relative)
    return None


class HighLevel:
    """One vehicle's.

    Attributes:
        plan: what is being flown, or was flown last; None when it does nothing.
        enabled: it is heard; low-level setpoints take that away.
    """

    def __init__(self) -> None:
        self.plan: Plan | None = None
        self.enabled = True
        self._groups = 0

    def forget(self) -> None:
        """Gives up what it was doing."""
        self.plan, self.enabled = None, False

    def bits(self, now_ns: int) -> int:
        """Bits 8 to 10 of the supervisor's state: flies, has finished, is disabled."""
        done = self.plan is None or self.plan.finished(now_ns)
        flies = self.plan is not None and not (done and self.plan.lands)
        return flies << 8 | done << 9 | (not self.enabled) << 10

    def obey(self, data: bytes, now_ns: int, place_enu_m: Place, yaw_enu_rad: float) -> int:
        """Does what a packet asks for; returns the error number that it is answered with, 0 for none."""
        if len(data) < 2:
            return _NO_COMMAND
        if data[0] == _GROUP:
            self._groups = data[1]
            return 0
        if data[1] and not data[1] & self._groups:
            return 0
        if data[0] == _STOP:
            self.plan, self.enabled = None, True
            return 0
        try:
            wish = _read(data)
        except (struct.error, IndexError):
            return _INVALID
        if wish is None:
            return _NO_COMMAND
        return self._begin(wish, now_ns, place_enu_m, yaw_enu_rad)

    def _begin(self, wish: _Wish, now_ns: int, place_enu_m: Place, yaw_enu_rad: float) -> int:
        numbers = [v for v in (*wish.to_m, wish.yaw_rad) if v is not None]
        if not all(map(math.isfinite, numbers)) or not 0.0 < wish.duration_s <= _DURATION_MAX_S:
            return _INVALID
        rests = self.enabled and (self.plan is None or (self.plan.lands and self.plan.finished(now_ns)))
        if wish.takes_off and not rests:
            return _NOT_NOW
        if wish.lands and self.plan is not None and self.plan.lands and not self.plan.finished(now_ns):
            return _NOT_NOW
        start, yaw = place_enu_m, yaw_enu_rad
        if self.plan is not None and not self.plan.lands:
            point = self.plan.at(now_ns)
            x, y, z = (v or 0.0 for v in point.pos_enu_m)
            start, yaw = (x, y, z), point.yaw_enu_rad or 0.0
        base = start if wish.relative else (0.0, 0.0, 0.0)
        x, y, z = (
            here if wanted is None else wanted + offset
            for here, wanted, offset in zip(start, wish.to_m, base, strict=True)
        )
        turn = 0.0 if wish.yaw_rad is None else wish.yaw_rad - (0.0 if wish.relative else yaw)
        end_yaw = yaw + math.remainder(turn, math.tau)
        self.plan = Plan(now_ns, wish.duration_s, start, (x, y, z), (yaw, end_yaw), wish.lands)
        self.enabled = True
        return 0
