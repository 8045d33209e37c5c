"""What the ground station says, held against what is: every disagreement is a failure of its own kind.

The witness sees the emulator's truth at every tick and after it, and reads the alarms and the reason as people do: a
vehicle counts as named where its number stands. Nothing that the ground station believes is asked for. Refuses to
judge how words are chosen: that something about the right vehicle was said at the right time is what counts.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.timing import SECOND_NS
from sitl.world import World

KINDS = {
    "completed_untrue": "it was called completed, and somebody crashed, came below r or is not down on its pad",
    "crash_untold": "a vehicle crashed, or came to the ground too fast, and nobody was told",
    "near_untold": "two vehicles came nearer than r, landing included, and neither was named",
    "air_untold": "a vehicle was in the air when the ground station ended, and was not named",
    "armed_untold": "a vehicle stood armed when the ground station ended, and was not named",
    "pad_untold": "a vehicle came down far from its pad, and nobody was told",
    "untold": "the mission was not completed, and no reason was given",
    "said_disarmed": "a vehicle that flew was called disarmed",
    "said_in_the_air": "a vehicle that stood was called in the air",
    "said_hit": "a vehicle that came down as landings do was said to have hit the ground",
    "said_near": "two vehicles that were well apart were called nearer than r",
    "said_sick": "a vehicle with which nothing was wrong was said to fail",
}
"""Kinds of disagreement, by the column of the table that counts them."""

TOUCHDOWN_MAX_M_S = 1.5
"""Landing autopilots come down at 0.3 to 0.7 m/s; a fall from 12 cm ends at 1.5 m/s."""
_SOFT_M_S = 0.9  # who never came to the ground faster has hit nothing
_BEFORE_NS = 6 * SECOND_NS  # what is said of a vehicle that long before it hits the ground still counts as a warning
_BESIDE_PAD_M = 0.4
_APART_NS = 2 * SECOND_NS
_APART_SPARE_M = 0.1
_STOOD_NS = 3 * SECOND_NS  # telemetry tells that one stands seconds after it does
_EVERY_TICKS = 5
# docs/safety.md, "Positions that drift": slower ones nothing aboard tells from a velocity that is a little off
_CREEPS_M_S = {"mocap": 0.1, "rtk": 0.1, "gps": 0.25}
_AT_ONCE_M = 0.01
# The same: in the first 15 s of flight no velocity is known to be good, and what parts is forgotten over three seconds.
_EARLY_NS, _FORGOTTEN_S = 15 * SECOND_NS, 3.0
_SHOWN = 2_000
_NAMES = re.compile(r"\bvehicles? (\d+(?:(?:, | and |, and )(?:vehicle )?\d+)*)")
_TWINS = re.compile(r"say that they are (\d+)")
_APART = re.compile(r"vehicles? (\d+)(?: and |: too near to vehicle )(\d+)[:,] [\d.]+ m apart")
_DISARMED = re.compile(r"vehicle (\d+): disarmed by itself")
_SICK = re.compile(
    r"vehicle (\d+): (does not follow its setpoints|its position (?:is [\d.]+ m from|has not changed)|is tilted by"
    r"|its autopilot has started anew|its origin has moved|left for mode|no heartbeat|nothing heard"
    r"|no position|flies \d+ degrees)"
)
_HIT = re.compile(r"vehicle (\d+): has hit the ground")
_LINK = re.compile(r"link (\S+): nothing heard of anybody")
_KILLED_ALL = "everybody: killed"  # names them all: whoever reads it knows that they fall
_WHOLE_TEAM = ("landed by the operator", _KILLED_ALL, "setpoints end")
_IN_THE_AIR = "still in the air"


@dataclass(frozen=True)
class _Word:
    t_ns: int
    text: str
    named: frozenset[int]  # rows
    team: bool


class Witness:
    """Watches one flight.

    Args:
        plan: the mission.
        world: the emulator.
    """

    def __init__(self, plan: MissionPlan, world: World) -> None:
        n = plan.size
        self._plan, self._world = plan, world
        self._row_of_id = {vehicle.id: row for row, vehicle in enumerate(plan.spec.vehicles)}
        self._words: list[_Word] = []
        self._found: list[tuple[str, str]] = []
        self._radius_m = plan.spec.avoidance.radius_m
        self._near_ns: dict[tuple[int, int], int] = {}
        self._hit_ns: dict[int, int] = {}
        self._stands_since_ns: IntArray = np.zeros(n, dtype=np.int64)
        self._rose_ns: IntArray = np.full(n, -1, dtype=np.int64)
        self._last_far_ns: IntArray = np.full((n, n), -_APART_NS)
        self._last_near_ns: IntArray = np.full((n, n), -_APART_NS)
        self._offset_enu_m: FloatArray = world.state.estimator.offset_enu_m.copy()
        self._offset_max_m: FloatArray = np.zeros(n)
        self._recent_enu_m: FloatArray = np.zeros((3, n))
        self._offset_ns = world.now_ns
        self._drift_m_s: FloatArray = np.zeros(n)
        self._crept: BoolArray = np.ones(n, dtype=np.bool_)
        self._ticks = 0
        self._upset: BoolArray = np.zeros(n, dtype=np.bool_)
        self._crooked = world.config.own_frames is not None  # whose frame is off may well stray
        self._end_ns = 0
        self._at_end: tuple[BoolArray, BoolArray] | None = None

    def upset(self, vehicles: Iterable[int]) -> None:
        """Something goes wrong with these from now on, rows: what is said of them may be so."""
        self._upset[list(vehicles)] = True

    def hear(self, t_ns: int, text: str) -> None:
        """Takes an alarm, or the reason; a reason that was an alarm before was judged then, and is not said anew."""
        anew = not self._end_ns or not any(text in word.text for word in self._words)
        ids = {int(number) for found in _NAMES.findall(text) for number in re.findall(r"\d+", found)}
        ids |= {int(number) for number in _TWINS.findall(text)}
        rows = {self._row_of_id[number] for number in ids if number in self._row_of_id}
        if _KILLED_ALL in text:
            rows |= set(range(self._plan.size))
        for url in _LINK.findall(text):
            behind = self._plan.link_of_vehicle
            rows |= {row for row, link in enumerate(behind) if self._plan.links[link] == url}
        self._words.append(_Word(t_ns, text, frozenset(rows), any(words in text for words in _WHOLE_TEAM)))
        if anew:
            self._judge_now(t_ns, text)

    def look(self, now_ns: int, pairs_m: Callable[[], FloatArray]) -> None:
        """Looks at the truth of a tick; ``pairs_m`` gives the smallest distances of each pair so far, shape (n, n)."""
        motion = self._world.dynamics.motion
        stands = motion.on_ground
        self._stands_since_ns = np.where(stands, np.where(self._stands_since_ns < 0, now_ns, self._stands_since_ns), -1)
        self._rose_ns = np.where(~stands & (self._rose_ns < 0), now_ns, self._rose_ns)
        for row in np.flatnonzero(motion.crashed | (motion.touchdown_m_s > TOUCHDOWN_MAX_M_S)).tolist():
            self._hit_ns.setdefault(row, now_ns)
        self._take_offsets(now_ns)
        self._ticks += 1
        if self._ticks % _EVERY_TICKS == 0:
            self._take_pairs(now_ns, pairs_m())

    def _take_offsets(self, now_ns: int) -> None:
        """How far positions lie, and whether any went faster than a creep."""
        estimator = self._world.state.estimator
        passed_s, self._offset_ns = (now_ns - self._offset_ns) / SECOND_NS, now_ns
        if not estimator.faulty:
            return
        more_m = np.linalg.norm(estimator.offset_enu_m - self._offset_enu_m, axis=0)
        before_m_s, self._drift_m_s = self._drift_m_s, np.linalg.norm(estimator.drift_enu_m_s, axis=0)
        speed_m_s = np.maximum(before_m_s, self._drift_m_s)
        at_once = more_m > speed_m_s * passed_s + _AT_ONCE_M
        moved_m = estimator.offset_enu_m - self._offset_enu_m
        self._recent_enu_m = self._recent_enu_m * np.exp(-passed_s / _FORGOTTEN_S) + moved_m
        little = np.linalg.norm(self._recent_enu_m, axis=0) <= self._plan.limits.pose_jump_m
        early = (self._rose_ns < 0) | (now_ns - self._rose_ns < _EARLY_NS)
        self._crept &= ~at_once & ((early & little) | (speed_m_s <= _CREEPS_M_S[self._plan.positioning]))
        self._offset_enu_m = estimator.offset_enu_m.copy()
        np.fmax(self._offset_max_m, np.linalg.norm(estimator.offset_enu_m, axis=0), out=self._offset_max_m)

    def _unknowable_m(self) -> FloatArray:
        """How far each may be from where it should be without anybody being able to know it, shape (n,).

        That is as far as its position lies, when it crept there, or when that is less than a jump's limit.
        """
        return np.where(self._crept | (self._offset_max_m <= self._plan.limits.pose_jump_m), self._offset_max_m, 0.0)

    def _take_pairs(self, now_ns: int, pairs_m: FloatArray) -> None:
        pos = self._world.dynamics.motion.pos_enu_m.T
        apart_m = np.linalg.norm(pos[:, None] - pos[None], axis=-1)
        limit_m = self._radius_m + self._plan.margin_m + _APART_SPARE_M
        self._last_near_ns[apart_m < limit_m] = now_ns
        for i, j in np.argwhere(np.triu(pairs_m < self._radius_m, 1)).tolist():
            self._near_ns.setdefault((i, j), now_ns)

    def ended(self, now_ns: int) -> None:
        """The ground station has ended: who is in the air now, or armed, flies on without it."""
        world = self._world
        self._end_ns = now_ns
        pilots = world.autopilots
        armed = np.array([pilot.armed and not pilot.stands_ready for pilot in pilots], dtype=np.bool_)
        self._at_end = (~world.dynamics.motion.on_ground, armed)

    def verdict(self, outcome: str, reason: str, pairs_m: FloatArray) -> Verdict:
        """Compares, after the world has come to rest.

        Args:
            outcome: as the ground station has it.
            reason: the same.
            pairs_m: smallest true distance of each pair of which one was in the air, shape (n, n).
        """
        if reason:
            self.hear(self._end_ns, reason)
        said = list(self._found)
        self.look(self._world.now_ns, lambda: pairs_m)
        self._take_pairs(self._world.now_ns, pairs_m)
        if outcome not in ("completed", "late") and not reason:
            self._add("untold", f"{outcome} without a reason")
        if outcome != "refused":
            bad = [*self._crashes(), *self._pairs_below_r(pairs_m), *self._up(), *self._far()]
            if outcome == "completed" and bad:
                self._add("completed_untrue", "; ".join(bad))
        found, self._found = self._found, said
        return Verdict(tuple(dict.fromkeys(found)))

    def _crashes(self) -> Iterable[str]:
        dynamics = self._world.dynamics
        for row, t_ns in sorted(self._hit_ns.items()):
            speed = float(dynamics.motion.touchdown_m_s[row])
            what = f"vehicle {self._id(row)} hit the ground at {speed:.1f} m/s at {t_ns / SECOND_NS:.1f} s"
            if not self._told((row,), t_ns - _BEFORE_NS):
                self._add("crash_untold", what)
            yield what

    def _pairs_below_r(self, pairs_m: FloatArray) -> Iterable[str]:
        unknowable_m = self._unknowable_m()
        for (i, j), t_ns in sorted(self._near_ns.items()):
            if pairs_m[i, j] >= self._radius_m - unknowable_m[i] - unknowable_m[j]:
                continue
            what = f"vehicles {self._id(i)} and {self._id(j)} below r at {t_ns / SECOND_NS:.1f} s"
            # Of one that cannot say where it is nobody can know more than that.
            since_ns = -1 if self._upset[[i, j]].any() else t_ns - _BEFORE_NS
            if not self._told((i, j), since_ns):
                self._add("near_untold", what)
            yield what

    def _up(self) -> Iterable[str]:
        if self._at_end is None:
            return
        for kind, rows, words in (
            ("air_untold", self._at_end[0], "in the air"),
            ("armed_untold", ~self._at_end[0] & self._at_end[1], "armed on the ground"),
        ):
            for row in np.flatnonzero(rows).tolist():
                what = f"vehicle {self._id(row)} {words} when the ground station ended"
                if not self._told((row,), -1):
                    self._add(kind, what)
                yield what

    def _far(self) -> Iterable[str]:
        off_m = np.linalg.norm((self._world.dynamics.motion.pos_enu_m.T - self._plan.pads_enu_m)[:, :2], axis=1)
        limit_m = _BESIDE_PAD_M + self._plan.margin_m + self._unknowable_m()
        for row in np.flatnonzero(off_m > limit_m).tolist():
            what = f"vehicle {self._id(row)} ended {off_m[row]:.2f} m from its pad"
            if not self._told((row,), -1, team=True):
                self._add("pad_untold", what)
            yield what

    def _judge_now(self, t_ns: int, text: str) -> None:
        """What can be wrong about words at the time at which they are said."""
        world = self._world
        up = ~world.dynamics.motion.on_ground
        at = f"at {t_ns / SECOND_NS:.1f} s: {text[:120]}"
        for row in self._rows(_DISARMED.findall(text)):
            if up[row] and world.autopilots[row].armed:
                self._add("said_disarmed", at)
        for row in self._rows(_HIT.findall(text)):
            if world.dynamics.motion.touchdown_m_s[row] <= _SOFT_M_S:
                self._add("said_hit", at)
        for number, _ in _SICK.findall(text):
            if not self._crooked and any(not self._upset[row] for row in self._rows([number])):
                self._add("said_sick", at)
        for pair in _APART.findall(text):
            rows = self._rows(pair)
            if len(rows) == 2 and not self._upset[rows].any() and t_ns - self._last_near_ns[*rows] > _APART_NS:
                self._add("said_near", at)
        if _IN_THE_AIR in text:
            for part in text.split("; "):
                if _IN_THE_AIR in part and "knows" not in part:
                    self._judge_in_the_air(t_ns, part, at)

    def _judge_in_the_air(self, t_ns: int, part: str, at: str) -> None:
        ids = [int(number) for found in _NAMES.findall(part) for number in re.findall(r"\d+", found)]
        for row in self._rows(ids):
            since_ns = int(self._stands_since_ns[row])
            if since_ns >= 0 and t_ns - since_ns > _STOOD_NS and not self._upset[row]:
                self._add("said_in_the_air", at)

    def _rows(self, ids: Iterable[int | str]) -> list[int]:
        return [self._row_of_id[int(number)] for number in ids if int(number) in self._row_of_id]

    def _told(self, rows: tuple[int, ...], since_ns: int, *, team: bool = False) -> bool:
        return any(
            word.t_ns >= since_ns and (bool(word.named & set(rows)) or (team and word.team)) for word in self._words
        )

    def _id(self, row: int) -> int:
        return self._plan.spec.vehicles[row].id

    def _add(self, kind: str, what: str) -> None:
        self._found.append((kind, what))


@dataclass(frozen=True)
class Verdict:
    """What did not agree.

    Attributes:
        found: kind and words, in the order in which they were found.
    """

    found: tuple[tuple[str, str], ...]

    @property
    def untold(self) -> bool:
        """Whether something was left unsaid."""
        return any(kind.endswith("untold") for kind, _ in self.found)

    def columns(self) -> dict[str, int | str]:
        """For the table: how many of each kind, how many in all, and the words."""
        counts: dict[str, int | str] = {kind: sum(item == kind for item, _ in self.found) for kind in KINDS}
        text = "\n".join(f"{kind}: {what}" for kind, what in self.found)
        return {**counts, "disagreements": len(self.found), "disagreed": text[:_SHOWN]}


NOTHING_FOUND = Verdict(())
"""Of a run that was not flown."""
