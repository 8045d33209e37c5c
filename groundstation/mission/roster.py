"""Who does what in the air: one ordered duty per vehicle, and everything that follows from it.

The one owner of every vehicle's fate. A duty only gets harder; what softens it is a transition with a name of its own
(``let_go``, while a take-over is still finding out whom it can hold). Who counts for what is asked here by name and
worked out nowhere else. Arrays that are handed out cannot be written to.

Decides nothing: the runner, the phases and the operator's orders say what becomes of whom.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from enum import IntEnum
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from groundstation.core import frames
from groundstation.core.quick import kept
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.mavlink.vehicle import NEVER
from groundstation.mission.plan.plan import MissionPlan

_T = TypeVar("_T", bound=np.generic)


class Duty(IntEnum):
    """What a vehicle is to do, from mild to hard."""

    UNTAKEN = 0
    """In the air, and not taken over yet: it is asked for things and gets no setpoints."""
    CLIMBS = 1
    """Climbs by command; setpoints would end that."""
    FORMATION = 2
    """Flies with the team."""
    HOMEWARD = 3
    """Flies to its own pad, apart from the formation, and lands there."""
    LANDS = 4
    """Lands with the team, as soon as nobody is below."""
    LANDS_HERE = 5
    """Lands where it is while others fly on: nobody may stay under it."""
    RELEASED = 6
    """No longer ours: no setpoint, no command, no judgement."""
    KILLED = 7
    """Its motors are to stop; no longer ours otherwise."""


# As plain numbers: members of an enumeration cost as much to look up as a comparison of the whole team.
_CLIMBS, _FORMATION, _HOMEWARD, _LANDS, _LANDS_HERE, _RELEASED, _KILLED = map(int, list(Duty)[1:])


class Duties:
    """The duties of n vehicles, and who counts for what; for those that only look.

    Args:
        by_command: those that climb by command, shape (n,).
        untaken: they are in the air already and have to be taken over.
        places_ned_m: where everybody is to begin with, team frame, shape (n, 3).
    """

    def __init__(self, by_command: BoolArray, places_ned_m: FloatArray, *, untaken: bool = False) -> None:
        n = len(by_command)
        start = np.where(by_command, Duty.CLIMBS, Duty.FORMATION)
        self._duty: IntArray = np.full(n, Duty.UNTAKEN, dtype=np.int64) if untaken else start.astype(np.int64)
        self._lands_since_ns: IntArray = np.full(n, NEVER, dtype=np.int64)
        self._told_ns: IntArray = np.full(n, NEVER, dtype=np.int64)
        self._killed_ns: IntArray = np.full(n, NEVER, dtype=np.int64)
        self._place_ned_m: FloatArray = places_ned_m.copy()
        self._elsewhere: BoolArray = np.zeros(n, dtype=np.bool_)

    def _changed(self) -> None:
        """What was worked out of duties holds no longer."""
        for name in _MASKS:
            self.__dict__.pop(name, None)

    def duty(self, vehicle: int) -> Duty:
        """What one vehicle is to do."""
        return Duty(int(self._duty[vehicle]))

    @kept
    def ours(self) -> BoolArray:
        """Neither released nor killed: monitors judge them, commands go to them, shape (n,)."""
        mask: BoolArray = self._duty < _RELEASED
        return mask

    @kept
    def killed(self) -> BoolArray:
        """Motors are to stop, shape (n,)."""
        mask: BoolArray = self._duty == _KILLED
        return mask

    @kept
    def climbing(self) -> BoolArray:
        """Climbs by command and has not arrived, shape (n,)."""
        mask: BoolArray = self._duty == _CLIMBS
        return mask

    @kept
    def in_formation(self) -> BoolArray:
        """Flies with the team, or is on its way up to it, shape (n,)."""
        mask: BoolArray = (self._duty == _FORMATION) | (self._duty == _CLIMBS)
        return mask

    @kept
    def homeward(self) -> BoolArray:
        """Flies home apart from the formation, and does not land yet, shape (n,)."""
        mask: BoolArray = self._duty == _HOMEWARD
        return mask

    @kept
    def steered(self) -> BoolArray:
        """Gets setpoints, shape (n,); while it lands they are to stand still."""
        mask: BoolArray = (self._duty > _CLIMBS) & (self._duty < _RELEASED)
        return mask

    @kept
    def follows(self) -> BoolArray:
        """Is ours and was not told to land, so that it should do what setpoints say, shape (n,)."""
        return self.ours & ~self.told_to_land

    @kept
    def waited_for(self) -> BoolArray:
        """Those that the way home is not over without, as far as their duty tells, shape (n,)."""
        return self.ours & ~self.lands_here

    @kept
    def lands(self) -> BoolArray:
        """Is to land, told or not, shape (n,)."""
        mask: BoolArray = (self._duty == _LANDS) | (self._duty == _LANDS_HERE)
        return mask

    @kept
    def lands_here(self) -> BoolArray:
        """Is to land where it is while others fly, shape (n,): it comes down, and nobody may stay under it."""
        mask: BoolArray = self._duty == _LANDS_HERE
        return mask

    @kept
    def told_to_land(self) -> BoolArray:
        """Was told to land: it may leave the mode that follows us, and disarm, shape (n,)."""
        mask: BoolArray = self._told_ns != NEVER
        return mask

    @property
    def lands_since_ns(self) -> IntArray:
        """When it was first to land, told or not, shape (n,)."""
        return _read_only(self._lands_since_ns)

    @property
    def told_ns(self) -> IntArray:
        """When it was first told to land, shape (n,)."""
        return _read_only(self._told_ns)

    @property
    def killed_ns(self) -> IntArray:
        """When its motors were last to stop, shape (n,)."""
        return _read_only(self._killed_ns)

    @property
    def place_ned_m(self) -> FloatArray:
        """Where those that land here stay until they are told to, and those that were given a place, shape (n, 3)."""
        return _read_only(self._place_ned_m)

    @property
    def elsewhere(self) -> BoolArray:
        """Was given a place to land on that is neither its pad nor simply where it is, shape (n,)."""
        return _read_only(self._elsewhere)

    def places_ned_m(self, others_ned_m: FloatArray) -> FloatArray:
        """The places of those that have one of their own, and those given for the others, shape (n, 3)."""
        return np.where((self.lands_here | self._elsewhere)[:, None], self._place_ned_m, others_ned_m)


# Each is worked out once, until a duty changes.
_MASKS = tuple(name for name, item in vars(Duties).items() if isinstance(item, kept))


class Roster(Duties):
    """The duties of n vehicles, for those that say what becomes of whom."""

    def take(self, vehicle: int) -> None:
        """A take-over holds a vehicle from now on, to bring it home."""
        if self._duty[vehicle] == Duty.UNTAKEN:
            self._duty[vehicle] = Duty.HOMEWARD
            self._changed()

    def let_go(self, vehicle: int) -> None:
        """A take-over holds a vehicle no longer: its pilot has it, or it has come down. The only way to soften."""
        if self._duty[vehicle] == Duty.HOMEWARD:
            self._duty[vehicle] = Duty.UNTAKEN
            self._changed()

    def end_climb(self, vehicles: BoolArray) -> None:
        """Setpoints do the rest of these climbs, shape (n,)."""
        self._duty[vehicles & self.climbing] = Duty.FORMATION
        self._changed()

    def go_home(self, vehicles: Iterable[int]) -> None:
        """They leave the formation for their pads."""
        self._harden(vehicles, Duty.HOMEWARD)

    def land(self, vehicles: Iterable[int], now_ns: int) -> list[int]:
        """They land with the team; returns those that were not to land before."""
        news = self._harden(vehicles, Duty.LANDS)
        self._lands_since_ns[news] = now_ns
        return news

    def land_here(self, vehicles: Iterable[int], places_ned_m: FloatArray, now_ns: int) -> list[int]:
        """They land where they are, while others fly on.

        Args:
            vehicles: which.
            places_ned_m: of everybody, team frame, shape (n, 3).
            now_ns: time of the tick.

        Returns:
            Those that were not to land before.
        """
        ours = [vehicle for vehicle in vehicles if self._duty[vehicle] < Duty.RELEASED]
        if not ours:
            return []
        news = [vehicle for vehicle in ours if self._duty[vehicle] < Duty.LANDS]
        self._place_ned_m[ours] = places_ned_m[ours]
        self._duty[ours] = Duty.LANDS_HERE
        self._changed()
        self._lands_since_ns[news] = now_ns
        return news

    def give_place(self, vehicle: int, place_ned_m: Sequence[float]) -> None:
        """It lands there, team frame, whatever its duty; it flies there at this height."""
        self._place_ned_m[vehicle] = place_ned_m
        self._elsewhere[vehicle] = True

    def tell_to_land(self, vehicle: int, now_ns: int) -> None:
        """The command to land goes out; the first time counts."""
        if not self.lands[vehicle]:
            raise ValueError(f"vehicle in row {vehicle} is told to land, and is to be {self.duty(vehicle).name}")
        if self._told_ns[vehicle] == NEVER:
            self._told_ns[vehicle] = now_ns
            self._changed()

    def release(self, vehicles: Iterable[int]) -> None:
        """They are no longer ours."""
        self._harden(vehicles, Duty.RELEASED)

    def kill(self, vehicles: Iterable[int], now_ns: int) -> None:
        """Their motors are to stop, whatever they were about."""
        for vehicle in vehicles:
            self._duty[vehicle] = Duty.KILLED
            self._killed_ns[vehicle] = now_ns
        self._changed()

    def _harden(self, vehicles: Iterable[int], duty: Duty) -> list[int]:
        """Gives a duty to those that have a milder one; returns them."""
        duties = self._duty.tolist()
        harder = [vehicle for vehicle in vehicles if duties[vehicle] < duty]
        if harder:
            self._duty[harder] = duty
            self._changed()
        return harder


def by_command(plan: MissionPlan) -> BoolArray:
    """Vehicles that lift off by command and not by velocity, shape (n,)."""
    return np.array([autopilot.takeoff(1.0) is not None for autopilot in plan.autopilots])


def enlist(plan: MissionPlan, *, untaken: bool = False) -> Roster:
    """The duties of a mission's vehicles on their pads, or of those that have to be taken over in the air."""
    return Roster(by_command(plan), frames.ned_from_enu(plan.pads_enu_m), untaken=untaken)


def _read_only(values: NDArray[_T]) -> NDArray[_T]:
    view = values.view()
    view.flags.writeable = False
    return view
