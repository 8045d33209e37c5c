"""What monitors look at, and what they may find. Values only."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Protocol

import numpy as np

from groundstation.core.quick import kept, some
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.mavlink.vehicle import Fleet
from groundstation.mission.timing import SECOND_NS, HeldEach

SEE_TO_POSITION = "see to its GPS or motion capture"
OWN_ID = "give each vehicle an id of its own"


class Reaction(Enum):
    """What a finding asks for, from mild to hard."""

    SAY = "say"
    """A line for people."""
    HOLD = "hold"
    """This vehicle is told to stand still as long as it lasts."""
    HOME = "home"
    """This vehicle comes back and lands."""
    LAND = "land"
    """This vehicle lands where it is, when nobody is below."""
    RELEASE = "release"
    """This vehicle is no longer ours: no setpoint, no command."""
    ALL_HOME = "all home"
    """Everybody comes back and lands."""
    FAILED = "failed"
    """Nothing can be done for this vehicle any more; the mission is not completed."""
    SILENCE = "silence"
    """Setpoints stop; the autopilots' own failsafe acts."""


@dataclass(frozen=True)
class Finding:
    """One thing that a monitor found.

    Attributes:
        reaction: what should happen.
        what: in words, without the names of ``vehicles``.
        vehicles: whom it judges; empty for the ground station or a link.
        lost: nobody knows any more where the vehicle is.
        unheard: lost since nothing is heard of it, and for no other reason: once it is heard again it counts again.
        urgent: does not wait for the end of an operator's hold.
        pair: judges two vehicles by what is between them; they are named together.
        fate: judges nobody: it says what has become of a vehicle, whoever has it, and asks for nothing (``SAY``).
        lies: it has come to the ground already, so that it stays there and does not land first.
        remedy: what a person can do about it, now or before the next flight; told, and no part of a reason.
    """

    reaction: Reaction
    what: str
    vehicles: tuple[int, ...] = ()
    lost: bool = False
    unheard: bool = False
    urgent: bool = False
    pair: bool = False
    fate: bool = False
    lies: bool = False
    remedy: str = ""

    def of(self, ours: BoolArray) -> Finding | None:
        """What is left of it when nobody is judged who is not ours; None where it says something of others alone.

        Args:
            ours: neither released nor killed, shape (n,).
        """
        rows = tuple(row for row in self.vehicles if ours[row])
        only_told = self.fate and self.reaction is Reaction.SAY and not self.lost
        if len(rows) == len(self.vehicles) or only_told:
            return self
        return replace(self, vehicles=rows) if rows else None


@dataclass(frozen=True)
class Sight:
    """What monitors see of one tick.

    Attributes:
        fleet: what the vehicles report.
        now_ns: time of the tick.
        pos_team_ned_m: where they report to be at this tick, shape (n, 3).
        vel_ned_m_s: how they report to move, shape (n, 3).
        pose_ns: when position or attitude was measured, whichever is older, shape (n,).
        drift_m: how far local and global positions disagree, by two samples in a row, shape (n,), NaN where not known.
        sent_ned_m_s: the velocities that were sent last, shape (n, 3).
        ours: neither released nor killed, shape (n,): nobody else is judged.
        steered: gets setpoints that it should follow, shape (n,).
        lands_here: lands where it is while others fly, shape (n,).
        excused: told to land, shape (n,): it may leave the streaming mode and disarm.
        blind: position lost for good, shape (n,): nothing is judged by where it says it is.
        airborne: armed, and does not report to stand on the ground, shape (n,).
        going_on: the mission goes on without a vehicle that is lost.
        vel_error_ned_m_s: what velocities that are known to be poor are off by, shape (n, 3); zeros when left out.
    """

    fleet: Fleet
    now_ns: int
    pos_team_ned_m: FloatArray
    vel_ned_m_s: FloatArray
    pose_ns: IntArray
    drift_m: FloatArray
    sent_ned_m_s: FloatArray
    ours: BoolArray
    steered: BoolArray
    lands_here: BoolArray
    excused: BoolArray
    blind: BoolArray
    airborne: BoolArray
    going_on: bool = False
    vel_error_ned_m_s: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))

    def __post_init__(self) -> None:
        """Fills in what was left out."""
        if not len(self.vel_error_ned_m_s):
            object.__setattr__(self, "vel_error_ned_m_s", np.zeros_like(self.vel_ned_m_s))

    @kept
    def in_our_air(self) -> BoolArray:
        """In the air, not told to land, and where they are is known, shape (n,); not to be written."""
        return self.airborne & ~(self.excused | self.blind)

    @kept
    def flown(self) -> BoolArray:
        """Those of them that get setpoints which they should follow, shape (n,); not to be written."""
        return self.steered & self.in_our_air


class Monitor(Protocol):
    """A monitor."""

    def look(self, sight: Sight, ours: BoolArray) -> Iterable[Finding]:
        """Looks once per tick; ``ours`` are those neither released nor killed, shape (n,).

        What it finds of others all the same is dropped by the board.
        """


@dataclass
class Findings:
    """What the monitors ask for in one tick.

    Attributes:
        alarms: lines for people, each said once.
        home: vehicles that shall come back and land.
        land: vehicles that shall land where they are, as soon as nobody is below.
        release: vehicles that are no longer ours; no setpoint, no command.
        failed: why the mission is not completed, though nothing can be done about it.
        gone: why somebody is no longer part of the formation while the mission goes on.
        aborts: why the team shall come back, by subject (``vehicle 3``), the first for each; empty when it need not.
        urgent: the team shall come back even from an operator's hold.
        silence: why setpoints shall end, None when they need not.
    """

    alarms: list[str] = field(default_factory=list)
    home: list[int] = field(default_factory=list)
    land: list[int] = field(default_factory=list)
    release: list[int] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)
    gone: list[str] = field(default_factory=list)
    aborts: dict[str, str] = field(default_factory=dict)
    urgent: bool = False
    silence: str | None = None

    def concern(self, rows: list[int], reaction: Reaction) -> None:
        """Takes whom a finding concerns, for what is to be done about them."""
        if reaction is Reaction.LAND:
            self.land += rows
        elif reaction is Reaction.RELEASE:
            self.release += rows
        elif reaction is Reaction.HOME:
            self.home += rows

    def tell(
        self, text: str, subject: str, reaction: Reaction, *, going_on: bool, urgent: bool, remedy: str = ""
    ) -> None:
        """Takes the words of a finding: an alarm always, and a reason where something follows.

        Args:
            text: the words.
            subject: whom or what it is about; the first reason of each counts.
            reaction: what is done.
            going_on: the mission goes on without a vehicle that drops out.
            urgent: everybody comes back, even from an operator's hold.
            remedy: what a person can do.
        """
        self.alarms.append(f"{text}; {remedy}" if remedy else text)
        if reaction in (Reaction.SAY, Reaction.HOLD):
            return
        if reaction is Reaction.FAILED:
            self.failed.append(text)
            return
        if reaction is Reaction.SILENCE:
            self.silence = text
        if going_on and reaction in (Reaction.LAND, Reaction.RELEASE, Reaction.HOME):
            self.gone.append(text)
        else:
            self.aborts.setdefault(subject, text)
        self.urgent |= urgent

    @property
    def abort(self) -> str | None:
        """Everything of ``aborts`` in one line, None when there is nothing."""
        return "; ".join(self.aborts.values()) or None


def _single(condition: bool) -> BoolArray:
    row: BoolArray = np.array([condition])
    row.flags.writeable = False
    return row


SINGLE = (_single(False), _single(True))
"""A condition of one row, false and true."""


class Lasting:
    """Conditions, one per row, that are believed when they have lasted, and are then told once.

    Args:
        n: rows.
        for_s: how long without a break; 0 at once.
        again: told again when the condition has ended in between.
    """

    def __init__(self, n: int, for_s: float = 0.0, *, again: bool = False) -> None:
        self._for_ns, self._again = round(for_s * SECOND_NS), again
        self._held = HeldEach(n)
        self._told: BoolArray = np.zeros(n, dtype=np.bool_)
        self._any_since = False

    def __call__(self, condition: BoolArray, now_ns: int) -> list[int]:
        """Takes the condition of this tick, shape (n,); returns the rows that are to be told now."""
        if not self._any_since and b"\1" not in condition.tobytes():  # ``some``: this is asked most often of all
            return []
        held = self._held(condition, now_ns, self._for_ns)
        self._any_since = some(condition)
        if self._again:
            self._told &= condition
        news = held & ~self._told
        self._told |= news
        return [int(row) for row in news.nonzero()[0]]


class LastingOf:
    """The same of conditions that are few out of very many, by their numbers; each is told once.

    Args:
        for_s: how long without a break; 0 at once.
    """

    def __init__(self, for_s: float = 0.0) -> None:
        self._for_ns = round(for_s * SECOND_NS)
        self._since_ns: dict[int, int] = {}
        self._told: set[int] = set()

    def __call__(self, numbers: list[int], now_ns: int) -> list[int]:
        """Takes the numbers of those that are so in this tick, ascending; returns those that are to be told now."""
        if not numbers:
            self._since_ns.clear()
            return []
        self._since_ns = {number: self._since_ns.get(number, now_ns) for number in numbers}
        lasting = [number for number, since_ns in self._since_ns.items() if now_ns - since_ns >= self._for_ns]
        news = [number for number in lasting if number not in self._told]
        self._told.update(news)
        return news
