"""A motion capture system that sees what the emulator knows: noise, delay, and whatever goes wrong in such rooms.

Its frames are those of a real one: same messages, its own clock. Refuses to open sockets and to read a clock.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from groundstation.core import frames
from groundstation.core.types import BoolArray, FloatArray
from groundstation.mavlink.mocap_frames import RoomEncoder
from groundstation.mission.plan.plan import MissionPlan

SECOND_NS = 1_000_000_000
_STARTED_NS = 3_600 * SECOND_NS  # its clock has run for an hour


@dataclass(frozen=True)
class RoomFault:
    """Something that goes wrong.

    Attributes:
        kind: occlude, gone, swap, jump, freeze, mm, y_up.
        at_s, until_s: when, in the flight's time.
        vehicles: numbers of those concerned; two for a swap, none for all.
    """

    kind: str
    at_s: float = 0.0
    until_s: float = 1e9
    vehicles: tuple[int, ...] = ()


@dataclass(frozen=True)
class FakeConfig:
    """What it is like.

    Attributes:
        hz: frames a second.
        noise_m: standard deviation of a place on one axis.
        noise_rad: of an attitude about one axis.
        delay_s: from exposure to arrival.
        jitter_s: up to so much longer.
        names: bodies carry names; else they are markers without.
        faults: what goes wrong.
        others: where bodies that are obstacles are, NED, at a time in seconds, shape (3,); None where not seen.
    """

    hz: float = 100.0
    noise_m: float = 0.0005
    noise_rad: float = 0.003
    delay_s: float = 0.005
    jitter_s: float = 0.003
    names: bool = True
    faults: Sequence[RoomFault] = ()
    others: Sequence[Callable[[float], FloatArray | None]] = ()


class FakeRoom:
    """n bodies.

    Args:
        config: what it is like.
        sysids: of the vehicles.
        seed: of its noise.
    """

    def __init__(self, config: FakeConfig, sysids: Sequence[int], seed: int) -> None:
        self.config = config
        self.faults = list(config.faults)
        self.period_ns = round(SECOND_NS / config.hz)
        self._sysids = list(sysids)
        self._rng = np.random.default_rng((seed, 0x6D6F))
        self._encoder = RoomEncoder()
        self._frozen: tuple[FloatArray, FloatArray] | None = None

    def sees(self, now_ns: int, pos_ned_m: FloatArray, quat_ned_from_frd: FloatArray) -> tuple[int, bytes] | None:
        """One frame, from the truth; None where there is none.

        Args:
            now_ns: exposure, in the flight's time.
            pos_ned_m: shape (n, 3).
            quat_ned_from_frd: shape (n, 4).

        Returns:
            When it arrives, and the datagram.
        """
        config, rng, n = self.config, self._rng, len(self._sysids)
        pos = pos_ned_m + rng.normal(0.0, config.noise_m, (n, 3))
        quat = quat_ned_from_frd.copy()
        quat[:, 1:] += rng.normal(0.0, 0.5 * config.noise_rad, (n, 3))
        quat /= np.linalg.norm(quat, axis=1)[:, None]
        late_s = config.delay_s + config.jitter_s * float(rng.random())
        whose: list[int | None] = list(self._sysids)
        there: BoolArray = np.ones(n, dtype=np.bool_)
        for fault in self.faults:
            if not fault.at_s <= now_ns / SECOND_NS < fault.until_s:
                continue
            rows = list(fault.vehicles) or list(range(n))
            if fault.kind == "gone":
                return None
            if fault.kind == "occlude":
                there[rows] = False
            elif fault.kind == "swap":
                first, second = rows[:2]
                whose[first], whose[second] = whose[second], whose[first]
            elif fault.kind == "jump":
                pos[rows, 0] += 1.5
            elif fault.kind == "freeze" and self._frozen is not None:
                pos[rows], quat[rows] = self._frozen[0][rows], self._frozen[1][rows]
            elif fault.kind == "mm":
                pos[rows] *= 1000.0
            elif fault.kind == "y_up":  # x stays, y is up, z points south
                north, east, down = pos[rows].T
                pos[rows] = np.stack([-down, east, north], axis=1)
        self._frozen = pos.copy(), quat.copy()
        if not config.names:
            order = rng.permutation(n)
            pos, quat, there = pos[order], np.full((n, 4), np.nan), there[order]
            whose = [None] * n
        kept = there.nonzero()[0].tolist()
        names = [whose[k] for k in kept]
        pos, quat = pos[kept], quat[kept]
        for number, where in enumerate(config.others, start=1):
            place = where(now_ns / SECOND_NS)
            if place is not None:
                names.append(-number)
                pos = np.vstack([pos, place + rng.normal(0.0, config.noise_m, 3)])
                quat = np.vstack([quat, [1.0, 0.0, 0.0, 0.0]])
        data = self._encoder.datagram((now_ns + _STARTED_NS) // 1000, names, pos, quat)
        return now_ns + round(late_s * SECOND_NS), data


def aside(plan: MissionPlan) -> list[Callable[[float], FloatArray | None]]:
    """Obstacles that stand still, beside the fence and out of everybody's way."""
    fence = plan.spec.fence
    pads = plan.pads_enu_m
    low, high = (pads.min(axis=0), pads.max(axis=0)) if fence is None else (fence.min_m, fence.max_m)
    away_m = 2.0 * plan.obstacles.keep_m + plan.spec.avoidance.activation_m
    places = [
        frames.ned_from_enu(np.array([high[0] + 2.0 * item.radius_m + away_m, low[1] - number, 0.0]))
        for number, item in enumerate(plan.moving_bodies)
    ]
    return [lambda _time_s, place=place: place for place in places]  # type: ignore[misc]


Truth = Callable[[], tuple[FloatArray, FloatArray]]
"""Where the vehicles are and how they lie: NED (n, 3), and FRD to NED (n, 4)."""
