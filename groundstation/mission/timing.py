"""Small ideas about time, once: seconds in ns, what has held for a while, what is asked again now and then."""

from __future__ import annotations

import numpy as np

from groundstation.core.quick import some
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.mavlink.vehicle import NEVER

SECOND_NS = 1_000_000_000
_LEAVES = 2.0  # times the tolerance: who is farther than that is there no more


def age_s(now_ns: int, then_ns: int) -> float:
    """Seconds since a time; infinite since ``NEVER``."""
    return float("inf") if then_ns <= NEVER else (now_ns - then_ns) / SECOND_NS


class SinceBefore:
    """Seconds since it was asked before.

    Args:
        at_ns: when that was, at first; the first answer is 0 where it is left out.
    """

    def __init__(self, at_ns: int = NEVER) -> None:
        self._at_ns = at_ns

    def __call__(self, now_ns: int) -> float:
        """Takes the time of this tick."""
        passed_s = (now_ns - self._at_ns) / SECOND_NS if self._at_ns != NEVER else 0.0
        self._at_ns = now_ns
        return passed_s

    def forget(self) -> None:
        """The next answer is 0."""
        self._at_ns = NEVER


class Held:
    """How long a condition has held without a break."""

    def __init__(self) -> None:
        self.since_ns = NEVER

    def __call__(self, condition: bool, now_ns: int, for_ns: int = SECOND_NS) -> bool:
        """Takes the condition of this tick; returns whether it has held for so long."""
        if not condition:
            self.since_ns = NEVER
            return False
        if self.since_ns == NEVER:
            self.since_ns = now_ns
        return now_ns - self.since_ns >= for_ns

    def forget(self) -> None:
        """It counts from anew."""
        self.since_ns = NEVER


class HeldEach:
    """The same of n conditions."""

    def __init__(self, n: int) -> None:
        self.since_ns: IntArray = np.full(n, NEVER, dtype=np.int64)
        self._any = False

    def __call__(self, conditions: BoolArray, now_ns: int, for_ns: int = SECOND_NS) -> BoolArray:
        """Takes the conditions of this tick, shape (n,); returns which have held for so long."""
        was, self._any = self._any, some(conditions)
        if not (was or self._any):  # nothing was so, nothing is
            return conditions.copy()
        started_ns = np.where(self.since_ns == NEVER, now_ns, self.since_ns)
        self.since_ns = np.where(conditions, started_ns, NEVER)
        return np.asarray(conditions & (now_ns - self.since_ns >= for_ns))


class There:
    """Who of n has come to its place: for a while within a tolerance, and since then not out of twice of it."""

    def __init__(self, n: int) -> None:
        self._near = HeldEach(n)
        self._there: BoolArray = np.zeros(n, dtype=np.bool_)

    def __call__(self, offset_m: FloatArray, tolerance_m: float, now_ns: int, for_ns: int = SECOND_NS) -> BoolArray:
        """Takes how far from its place each is, shape (n,); returns who is there.

        Args:
            offset_m: from their places, shape (n,); an unknown one is not there.
            tolerance_m: within it is there.
            now_ns: time of the tick.
            for_ns: how long it has to be within the tolerance.
        """
        near = self._near(np.asarray(offset_m < tolerance_m), now_ns, for_ns)
        self._there = np.asarray((near | self._there) & (offset_m < _LEAVES * tolerance_m))
        return self._there

    def forget(self) -> None:
        """It counts from anew."""
        self._near = HeldEach(len(self._there))
        self._there = np.zeros(len(self._there), dtype=np.bool_)


class Since:
    """Since when something is so of each of n vehicles, where they are looked at one by one, now and then."""

    def __init__(self, n: int) -> None:
        self._since_ns = [NEVER] * n

    def note(self, vehicle: int, now_ns: int) -> None:
        """It is so now; the first time counts."""
        if self._since_ns[vehicle] == NEVER:
            self._since_ns[vehicle] = now_ns

    def again(self, vehicle: int, now_ns: int) -> None:
        """It counts from now on, whatever was before."""
        self._since_ns[vehicle] = now_ns

    def forget(self, vehicle: int) -> None:
        """It is not so."""
        self._since_ns[vehicle] = NEVER

    def noted(self, vehicle: int) -> bool:
        """Whether it is so."""
        return self._since_ns[vehicle] != NEVER

    def held(self, vehicle: int, now_ns: int, for_ns: int) -> bool:
        """Whether it has been so for so long."""
        return self.noted(vehicle) and now_ns - self._since_ns[vehicle] >= for_ns

    def began(self, vehicle: int, now_ns: int, within_ns: int) -> bool:
        """Whether it is so, and has been for less than that."""
        return self.noted(vehicle) and now_ns - self._since_ns[vehicle] < within_ns


class AskAgain:
    """When each of n vehicles was asked last, and whether it is time to ask again.

    Args:
        n: vehicles.
        every_ns: no sooner than this.
    """

    def __init__(self, n: int, every_ns: int = SECOND_NS) -> None:
        self._every_ns = every_ns
        self._asked_ns: IntArray = np.full(n, NEVER, dtype=np.int64)

    def due(self, vehicle: int, now_ns: int) -> bool:
        """Whether it may be asked again."""
        return bool(now_ns - self._asked_ns[vehicle] >= self._every_ns)

    def all_due(self, now_ns: int) -> BoolArray:
        """The same of everybody, shape (n,)."""
        return np.asarray(now_ns - self._asked_ns >= self._every_ns)

    def asked(self, vehicle: int, now_ns: int) -> None:
        """It is asked now."""
        self._asked_ns[vehicle] = now_ns

    def lately(self, vehicle: int, now_ns: int, within_ns: int) -> bool:
        """Whether it was asked less than so long ago."""
        return bool(now_ns - self._asked_ns[vehicle] < within_ns)

    def at_once(self, vehicle: int) -> None:
        """It may be asked again at once."""
        self._asked_ns[vehicle] = NEVER


def vehicle_list(sysids: list[int]) -> str:
    """``vehicle 1, vehicle 3``: a list of vehicles in words."""
    return ", ".join(f"vehicle {sysid}" for sysid in sysids)
