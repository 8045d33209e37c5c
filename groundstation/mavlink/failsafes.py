"""What an autopilot is to do when nobody steers it any more, as parameters: wanted, read, judged. One class each.

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

_HEIGHT_TOLERANCE_M = 0.1
_TIME_TOLERANCE_S = 0.5
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


def _always(_value: float) -> bool:
    return True


def _never(_value: float) -> bool:
    return False


def _one_of(*values: int) -> Callable[[float], bool]:
    return lambda value: round(value) in values


def _near(wanted: float, tolerance: float) -> Callable[[float], bool]:
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
    insane: Callable[[float], bool] = _never
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


def _simple(name: str) -> tuple[tuple[str, float], ...]:
    return ((name, 1.0),)


def setpoint_loss_s(setpoint_s: float) -> float:
    """Time without setpoints after which a vehicle shall stop.

    Until then it flies on by the last one, which two that were about to turn away from each other must not do for long:
    of teams that lost their ground station while forming, with PX4's second, some came nearer than r
    (docs/safety.md).
    """
    return max(0.3, 4.0 * setpoint_s)


_BLIND_FLIGHT = "so long it flies on by its last setpoint when they stop, and keeps clear of nobody"
_STACKED = "others may be below"
_GONE = "the ground station may be gone for good"


class Px4Failsafes(Failsafes):
    """PX4: a lost stream of setpoints (COM_OBL_RC_ACT) holds, a lost ground station (NAV_DLL_ACT) acts later.

    Of two failsafes the stronger one acts, so a return takes over from a hold. COM_FAIL_ACT_T delays it once more, and
    what PX4 is late by is taken off, so that in a mixed team turns are as far apart as planned.
    """

    _LOST = {  # noqa: RUF012 - never written to
        0: "Position mode, which sinks without sticks", 1: "Altitude mode, which drifts", 2: "Stabilized, by sticks",
        3: "returns at once", 4: "lands at once, straight down", 6: "flight termination: it falls",
        7: "motors off: it falls",
    }  # fmt: skip
    _LINK = {  # noqa: RUF012 - never written to
        0: "does nothing", 1: "holds until the battery is empty", 2: "returns", 3: "lands straight down",
        5: "flight termination: it falls", 6: "motors off: it falls",
    }  # fmt: skip
    _BATTERY = {0: "only warns", 1: "returns", 2: "lands straight down"}  # noqa: RUF012 - never written to
    _ACTION_DELAY_S = 5.0
    _LATE_S = 3.0  # a heartbeat is missed 2.5 s after the last one, and COM_DL_LOSS_T counts from there: 3 s were seen
    _LOSS_MIN_S = 5.0  # of COM_DL_LOSS_T
    _LINK_ACTION = {"return": 2, "land": 3, "hold": 1}  # noqa: RUF012 - never written to

    def rules(self, wish: Wish) -> tuple[Rule, ...]:
        """Setpoint loss, ground station loss, the way home, remote control, battery, speed limits."""
        period_s = wish.setpoint_s
        by_itself = (3, 4, 5) if not wish.stacked else (3, 5)
        falls = (6, 7)
        lost_fine = {"return": (5,), "hold": (5,), "land": (3, 4, 5), "own": by_itself}[wish.action]
        lost_insane = {"return": _not(5), "hold": _not(5), "land": _one_of(*falls), "own": _one_of(*falls)}[wish.action]
        if wish.stacked and wish.action == "own":
            lost_insane = _one_of(0, 1, 2, 4, *falls)
        rules = [
            Rule(
                _simple("COM_OF_LOSS_T"), setpoint_loss_s(period_s), _BLIND_FLIGHT,
                lambda value: max(0.2, 3.0 * period_s) <= value <= max(0.5, 5.0 * period_s),
                lambda value: not 2.0 * period_s <= value <= 5.0,
            ),
            Rule(
                _simple("COM_OBL_RC_ACT"), 5.0, f"that is what it does when setpoints stop, and {_STACKED}"
                if wish.stacked else "that is what it does when setpoints stop",
                _one_of(*lost_fine), lost_insane, self._LOST,
            ),
            *self._station_lost(wish),
            Rule(
                _simple("COM_RCL_EXCEPT"), 4.0, "without a remote control OFFBOARD (4) is a failsafe of its own",
                lambda value: bool(round(value) & 4),
            ),
            Rule(
                _simple("COM_RC_IN_MODE"), None, "no such way of manual control is known", lambda value: 0 <= value <= 8
            ),
            Rule(
                _simple("COM_LOW_BAT_ACT"), 3.0, "nothing happens when the battery is critical"
                if not wish.stacked else f"that is what it does when the battery is critical, and {_STACKED}",
                _one_of(1, 3) if wish.stacked else _one_of(1, 2, 3), _one_of(0), self._BATTERY,
            ),
            Rule(
                _simple("BAT_CRIT_THR"), None,
                f"it acts by itself before the ground station does, at {wish.battery_min:g} (limits.battery_min)",
                lambda value: value < max(wish.battery_min, 1e-9) or wish.battery_min == 0.0,
            ),
            Rule(
                _simple("COM_DISARM_PRFLT"), 10.0, "disarms by itself where takeoff does not follow; arming takes 8 s",
                lambda value: value >= 8.0,
            ),
            Rule(
                _simple("MPC_XY_VEL_MAX"), max(wish.speed_m_s, 12.0), "slower than the mission's speed_limit_m_s",
                lambda value: value >= wish.speed_m_s,
            ),
            Rule(
                _simple("MPC_Z_VEL_MAX_UP"), max(wish.speed_m_s, 3.0), "slower than the mission's speed_limit_m_s",
                lambda value: value >= min(wish.speed_m_s, 3.0),
            ),
        ]  # fmt: skip
        return tuple(rules)

    def _station_lost(self, wish: Wish) -> list[Rule]:
        if wish.action == "own":
            return [
                Rule(_simple("NAV_DLL_ACT"), None, _GONE, _one_of(2, 3), _one_of(5, 6), self._LINK),
                Rule(_simple("COM_DL_LOSS_T"), None, "time without a ground station", lambda value: value <= 120.0),
            ]
        action = self._LINK_ACTION[wish.action]
        counted_s = wish.after_s - self._LATE_S
        after_s = float(max(self._LOSS_MIN_S, round(counted_s - self._ACTION_DELAY_S)))
        delay_s = float(min(self._ACTION_DELAY_S, max(0, round(counted_s - after_s))))
        why = f"that is what it does when the ground station is gone, and {_GONE}"
        fine = {"return": (2,), "land": (2, 3), "hold": (0, 1)}[wish.action]
        rules = [Rule(_simple("NAV_DLL_ACT"), float(action), why, _one_of(*fine), _not(*fine), self._LINK)]
        if wish.action == "hold":
            return rules
        turn = "each vehicle has its own turn"
        rules += [
            Rule(_simple("COM_DL_LOSS_T"), after_s, turn, _near(after_s, _TIME_TOLERANCE_S), _always),
            Rule(
                _simple("COM_FAIL_ACT_T"), delay_s, f"it delays the return, and {turn}",
                _near(delay_s, _TIME_TOLERANCE_S), _always,
            ),
        ]  # fmt: skip
        if wish.action == "land":
            return [*rules[:1], *(_warning(rule) for rule in rules[1:])]
        height = "each vehicle returns at a height of its own"
        near = _near(wish.height_m, _HEIGHT_TOLERANCE_M)
        return [
            *(_strict(rule) for rule in rules),
            _strict(Rule(_simple("RTL_RETURN_ALT"), wish.height_m, height, near)),
            _strict(Rule(_simple("RTL_DESCEND_ALT"), wish.height_m, f"{height}, and waits there", near)),
            _strict(
                Rule(
                    _simple("RTL_LAND_DELAY"), wish.wait_s, "nobody lands before everybody is above its pad",
                    _near(wish.wait_s, _TIME_TOLERANCE_S),
                )
            ),
            _strict(Rule(_simple("RTL_CONE_ANG"), 0.0, f"near its home it would not climb; {height}", _one_of(0))),
            _strict(Rule(_simple("RTL_TYPE"), 0.0, "it has to return to its own pad", _one_of(0))),
            Rule(
                _simple("COM_DLL_EXCEPT"), None, "a ground station lost in OFFBOARD or in Hold does not count",
                lambda value: not round(value) & 6, _always, optional=True,
            ),
        ]  # fmt: skip


class ArduCopterFailsafes(Failsafes):
    """ArduCopter: without setpoints it brakes and hovers (GUID_TIMEOUT); FS_GCS_ENABLE acts when heartbeats end.

    The ground station's system id counts too: heartbeats of another one do not.
    """

    _LINK = {  # noqa: RUF012 - never written to
        0: "does nothing", 2: "continues a mission", 3: "returns the way it came", 4: "returns the way it came",
        5: "lands straight down", 7: "brakes, or lands straight down",
    }  # fmt: skip
    _BATTERY = {0: "does nothing", 1: "lands straight down", 5: "motors off: it falls"}  # noqa: RUF012
    _EKF = {0: "only reports", 2: "flies by sticks"}  # noqa: RUF012 - never written to
    _RADIO = {3: "lands straight down", 5: "lands straight down"}  # noqa: RUF012 - never written to
    _LINK_ACTION = {"return": 1, "land": 5, "hold": 0}  # noqa: RUF012 - never written to

    def rules(self, wish: Wish) -> tuple[Rule, ...]:
        """Setpoint loss, ground station loss, the way home, remote control, battery, estimator, speed limits."""
        rules = [
            Rule(
                _simple("GUID_TIMEOUT"), setpoint_loss_s(wish.setpoint_s), _BLIND_FLIGHT,
                lambda value: max(0.2, 3.0 * wish.setpoint_s) <= value <= max(0.5, 5.0 * wish.setpoint_s),
                lambda value: not 2.0 * wish.setpoint_s <= value <= 3.0,
            ),
            *self._station_lost(wish),
            Rule(
                (("MAV_GCS_SYSID", 1.0), ("SYSID_MYGCS", 1.0)), float(STATION_SYSID),
                "the heartbeats of this ground station do not count for its failsafe",
                _one_of(STATION_SYSID), _not(STATION_SYSID),
            ),
            Rule(
                _simple("FS_THR_ENABLE"), None, f"that is what it does when a remote control is lost, and {_STACKED}",
                lambda value: not (wish.stacked and round(value) in self._RADIO), meanings=self._RADIO,
            ),
            Rule(
                _simple("FS_EKF_ACTION"), 1.0, "that is what it does when its estimator fails", _one_of(1, 3),
                _one_of(0), self._EKF,
            ),
            Rule(
                _simple("BATT_FS_LOW_ACT"), 2.0, "that is what it does when the battery is low"
                + (f", and {_STACKED}" if wish.stacked else ""),
                _one_of(2, 3, 4, 6) if wish.stacked else _one_of(1, 2, 3, 4, 6, 7), _one_of(0, 5), self._BATTERY,
            ),
            Rule(
                _simple("DISARM_DELAY"), 10.0, "disarms by itself where takeoff does not follow; arming takes 8 s",
                lambda value: value >= 8.0,
            ),
            Rule(
                _simple("ARMING_CHECK"), 1.0, "not all of its checks before arming are on", _one_of(1), optional=True
            ),
            Rule(
                _simple("ARMING_SKIPCHK"), 0.0, "some of its checks before arming are off", _one_of(0), optional=True
            ),
            Rule(
                (("WPNAV_SPEED", 100.0), ("WP_SPD", 1.0)), max(wish.speed_m_s, 10.0),
                "slower than the mission's speed_limit_m_s", lambda value: value >= wish.speed_m_s,
            ),
        ]  # fmt: skip
        return tuple(rules)

    def settings(self, wish: Wish) -> dict[str, float]:
        """What the parameters should be; the newer name of the arming checks is left to those that have it."""
        return {name: value for name, value in super().settings(wish).items() if name != "ARMING_SKIPCHK"}

    def _station_lost(self, wish: Wish) -> list[Rule]:
        if wish.action == "own":
            fine = _one_of(1, 3, 4, 6) if wish.stacked else _one_of(1, 3, 4, 5, 6, 7)
            return [Rule(_simple("FS_GCS_ENABLE"), None, _GONE, fine, _one_of(0), self._LINK)]
        action = self._LINK_ACTION[wish.action]
        why = f"that is what it does when the ground station is gone, and {_GONE}"
        allowed = {"return": (1,), "land": (1, 5, 7), "hold": (0,)}[wish.action]
        rules = [Rule(_simple("FS_GCS_ENABLE"), float(action), why, _one_of(*allowed), _not(*allowed), self._LINK)]
        if wish.action == "hold":
            return rules
        timeout = Rule(
            _simple("FS_GCS_TIMEOUT"), wish.after_s, "each vehicle has its own turn",
            _near(wish.after_s, _TIME_TOLERANCE_S),
        )  # fmt: skip
        if wish.action == "land":
            return [*rules, timeout]
        height = "each vehicle returns at a height of its own"
        return [
            *rules,
            _strict(timeout),
            _strict(
                Rule(
                    (("RTL_ALT", 100.0), ("RTL_ALT_M", 1.0)), wish.height_m, height,
                    _near(wish.height_m, _HEIGHT_TOLERANCE_M),
                )
            ),
            _strict(
                Rule(
                    _simple_in("RTL_LOIT_TIME", 1000.0), wish.wait_s, "nobody lands before everybody is above its pad",
                    _near(wish.wait_s, _TIME_TOLERANCE_S),
                )
            ),
            _strict(Rule(_simple("RTL_CONE_SLOPE"), 0.0, f"near its home it would not climb; {height}", _one_of(0))),
            _strict(
                Rule((("RTL_ALT_FINAL", 100.0), ("RTL_ALT_FINAL_M", 1.0)), 0.0, "it does not land", lambda v: v <= 0.0)
            ),
            _strict(
                Rule((("RTL_CLIMB_MIN", 100.0), ("RTL_CLIMB_MIN_M", 1.0)), 0.0, f"it climbs on; {height}", _one_of(0))
            ),
        ]  # fmt: skip


def _simple_in(name: str, factor: float) -> tuple[tuple[str, float], ...]:
    return ((name, factor),)


def _not(*values: int) -> Callable[[float], bool]:
    return lambda value: round(value) not in values


def _strict(rule: Rule) -> Rule:
    """The same rule, with all that is not fine refused."""
    return replace(rule, insane=_always)


def _warning(rule: Rule) -> Rule:
    """The same rule, with nothing refused."""
    return replace(rule, insane=_never)
