"""What an autopilot is to do when nobody steers it any more, as parameters: wanted, read, judged.

A team that stands one above the other must not land where it is. It holds, and after a while its vehicles return one
by one from the top, each at a height of its own, wait above their pads until everybody has arrived, and land: see
``mission.failsafe``, which says what is asked of each. Meanings of values come from the firmware's parameter
definitions (docs/preflight.md); names differ between versions, so a subject may have several. Nothing here keeps state
or sends bytes; a parameter that a firmware does not have is never a refusal.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

HEIGHT_TOLERANCE_M = 0.1
TIME_TOLERANCE_S = 0.5
STATION_SYSID = 255


@dataclass(frozen=True)
class Wish:
    """What is asked of one vehicle.

    Attributes:
        action: return (at a height of its own), land (where it is), hold (until it is taken over), or own (whatever
            the parameters say, as long as it is not dangerous by itself).
        after_s: from the last heartbeat of the ground station to the action.
        height_m: of the return, above its home; NaN for other actions.
        wait_s: above its home, before it lands.
        stacked: landing straight down may end on another vehicle.
        setpoint_s: time between two setpoints.
        speed_m_s: the mission's limit.
        battery_min: share of the battery at which the ground station brings the team home.
    """

    action: str
    after_s: float
    height_m: float
    wait_s: float
    stacked: bool
    setpoint_s: float
    speed_m_s: float
    battery_min: float


@dataclass(frozen=True)
class Finding:
    """A parameter that is not as it should be.

    Attributes:
        name: as the vehicle has it.
        value: as it is, in the parameter's own unit.
        wanted: what to set it to, in the same unit; None where only people can know.
        meaning: of the value, "" where it is a quantity.
        words: what follows from it.
        grave: nothing may fly with it.
    """

    name: str
    value: float
    wanted: float | None
    meaning: str
    words: str
    grave: bool

    def text(self) -> str:
        """One line for people."""
        remedy = "" if self.wanted is None else f"; set {plain(self.wanted)}"
        words = f"{self.meaning}; {self.words}" if self.meaning else self.words
        return f"{self.name} is {plain(self.value)}: {words}{remedy}"

    def short(self) -> str:
        """A few words, for one of many."""
        meaning = f" ({self.meaning})" if self.meaning else ""
        remedy = "" if self.wanted is None else f", should be {plain(self.wanted)}"
        return f"{self.name} is {plain(self.value)}{meaning}{remedy}"


def plain(value: float) -> str:
    """A number as it is written in parameter files."""
    return f"{value:.6g}"


def always(_value: float) -> bool:
    """Any value."""
    return True


def never(_value: float) -> bool:
    """No value."""
    return False


def one_of(*values: int) -> Callable[[float], bool]:
    """Some whole numbers."""
    return lambda value: round(value) in values


def near_to(wanted: float, tolerance: float) -> Callable[[float], bool]:
    """A quantity and a little more or less."""
    return lambda value: abs(value - wanted) <= tolerance


@dataclass(frozen=True)
class Rule:
    """One subject of the parameters.

    Attributes:
        names: those that it has in one version or another, each with what one of our units is in its own.
        wanted: in our units (SI, or the parameter's number); None where only people can know.
        why: what follows when it is not so.
        fine: values that need no word.
        insane: of the others, those that nothing may fly with.
        meanings: of single values, told with them.
        optional: not worth a word where a firmware does not have it.
    """

    names: tuple[tuple[str, float], ...]
    wanted: float | None
    why: str
    fine: Callable[[float], bool]
    insane: Callable[[float], bool] = never
    meanings: Mapping[int, str] | None = None
    optional: bool = False

    def judge(self, values: Mapping[str, float]) -> Finding | None:
        """Judges what was told, None where it is well or not told."""
        for name, factor in self.names:
            value = values.get(name)
            if value is None:
                continue
            own = value / factor
            if math.isfinite(own) and self.fine(own):
                return None
            grave = not math.isfinite(own) or self.insane(own)
            meaning = (self.meanings or {}).get(round(own) if math.isfinite(own) else -1, "")
            wanted = None if self.wanted is None else self.wanted * factor
            return Finding(name, value, wanted, meaning, self.why, grave)
        return None


class Failsafes(ABC):
    """How one kind of autopilot is told what to do on its own."""

    @abstractmethod
    def rules(self, wish: Wish) -> tuple[Rule, ...]:
        """All that is looked at."""

    def settings(self, wish: Wish) -> dict[str, float]:
        """What the parameters should be, by their first names: what is set where all are wrong."""
        return {
            rule.names[0][0]: rule.wanted * rule.names[0][1] for rule in self.rules(wish) if rule.wanted is not None
        }


def named(name: str) -> tuple[tuple[str, float], ...]:
    """One name in every version, in our unit."""
    return ((name, 1.0),)


def setpoint_loss_s(setpoint_s: float) -> float:
    """Time without setpoints after which a vehicle shall stop.

    Until then it flies on by the last one, which two that were about to turn away from each other must not do for long:
    of teams that lost their ground station while forming, with PX4's second, some came nearer than r
    (docs/safety.md).
    """
    return max(0.3, 4.0 * setpoint_s)


BLIND_FLIGHT = "so long it flies on by its last setpoint when they stop, and keeps clear of nobody"
STACKED = "others may be below"
GONE = "the ground station may be gone for good"


def named_in(name: str, factor: float) -> tuple[tuple[str, float], ...]:
    """One name in every version, with what one of our units is in its own."""
    return ((name, factor),)


def none_of(*values: int) -> Callable[[float], bool]:
    """Whole numbers other than some."""
    return lambda value: round(value) not in values


def strict(rule: Rule) -> Rule:
    """The same rule, with all that is not fine refused."""
    return replace(rule, insane=always)


def warning(rule: Rule) -> Rule:
    """The same rule, with nothing refused."""
    return replace(rule, insane=never)
