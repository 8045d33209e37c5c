"""Agents that lock each other in (Section VI of the paper), and the way out.

Each agent judges by its own view: it wishes to move, does not get on, and others stand in its way, for longer than it
has patience. Then, in this order:

1. **Swap.** Two agents of which one stands in the other's way, and each of which finds in its own view that the line
   between them is opposed to the line between their places, take over each other's role. Both squared ways together get
   shorter by that, so swaps come to an end by themselves. An agent swaps at most once at a time, then not for a while;
   a pair that has swapped does not swap back for longer.
2. **Detour.** Where no swap helps, or vehicles are not interchangeable, the agent flies round those in its way, by a
   way planned in its own view (``detour``). Of those that hold each other only one does so at a time.
3. **Backing off.** Where there is no way round, the agent and those in its way that rest back off for a moment.

A swap changes who has which role, never gains. Detours are wishes like any other: avoidance, damper and limits have
the last word. What agents tell each other: roles, that they are locked in and by whom, and that they agree to a swap.
Refuses to know where anybody is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from groundstation.core.detour import back_off, way_round
from groundstation.core.obstacles import Obstacles
from groundstation.core.places import Places
from groundstation.core.quick import some
from groundstation.core.types import BoolArray, FloatArray, IntArray

_IN_THE_WAY = 0.3  # share of the last moments in which somebody stood in the way, from which it counts
_NOTHING = 1e-12
_BACK_OFF = 1.5  # how far an agent backs off, in distances to keep
_WORTH_M = 0.1  # nearer than this share of the distance to keep to its place nobody sets out on a detour


@dataclass(frozen=True)
class GridlockParams:
    """When an agent takes itself for locked in, and how long things last.

    Attributes:
        speed_limit_m_s: largest commanded speed.
        keep_out_m: distance that agents keep from each other.
        tick_s: period of the controller.
        settle_s: lag and delay of a vehicle: nothing shows sooner.
        least_wish: share of the speed limit below which nobody wishes to move; above what noise makes of a wish.
        progress: an agent gets on if it moves at this share of its wish, in the direction of its wish.
        opposed: cosine between actual and desired line below whose negative a pair swaps; 0 would let noise decide.
    """

    speed_limit_m_s: float
    keep_out_m: float
    tick_s: float
    settle_s: float
    least_wish: float = 0.06
    progress: float = 0.25
    opposed: float = 0.15

    @property
    def memory_s(self) -> float:
        """Over how long wish, motion and obstruction are averaged."""
        return 0.5 + 0.8 * self.settle_s

    @property
    def patience_s(self) -> float:
        """How long an agent is stuck before it is locked in."""
        return 0.75 + self.settle_s

    @property
    def detour_s(self) -> float:
        """How long an agent in formation flight is stuck before it sets out on a detour."""
        return 2.5 * self.patience_s

    @property
    def home_detour_s(self) -> float:
        """The same on the way to a point of its own, where gridlocks are rarer and mostly dissolve."""
        return 5.0 * self.patience_s

    @property
    def pause_s(self) -> float:
        """How long an agent that has swapped does not do so again."""
        return 2.0 * self.patience_s

    @property
    def undo_s(self) -> float:
        """How long a pair that has swapped does not swap back."""
        return 6.0 * self.patience_s


@dataclass(frozen=True)
class Sensed:
    """What m = n agents know of themselves at one tick, in their own level axes (east, north, up).

    Attributes:
        rel_m: position of j relative to i, shape (n, k, 3); anything where not visible.
        visible: agent i sees agent j, shape (n, k).
        vel_m_s: own velocity, shape (n, 3).
        wish_m_s: what the agent wishes, before avoidance, shape (n, 3).
        in_the_way: j bounds or blocks what i wishes, shape (n, k).
        low_m: corner of the box that may be flown in, relative to each agent, shape (n, 3).
        high_m: its other corner.
        walled: an obstacle bounds what i wishes, shape (n,); None where there are none.
        pos_m: own place in the axes in which obstacles are known, shape (n, 3); None where there are none.
        who: who stands in the columns of each agent, ascending where visible, shape (n, k); None where j is column j.
    """

    rel_m: FloatArray
    visible: BoolArray
    vel_m_s: FloatArray
    wish_m_s: FloatArray
    in_the_way: BoolArray
    low_m: FloatArray
    high_m: FloatArray
    walled: BoolArray | None = None
    pos_m: FloatArray | None = None
    who: IntArray | None = None

    def of_all(self) -> Sensed:
        """The same with a column for everybody, k = n: as large as the square of the team."""
        if self.who is None:
            return self
        n = len(self.who)
        rows, columns = self.visible.nonzero()
        place = rows, self.who[rows, columns]
        rel_m, visible, in_the_way = np.zeros((n, n, 3)), np.zeros((n, n), np.bool_), np.zeros((n, n), np.bool_)
        rel_m[place], visible[place] = self.rel_m[rows, columns], True
        in_the_way[place] = self.in_the_way[rows, columns]
        return replace(self, rel_m=rel_m, visible=visible, in_the_way=in_the_way, who=None)


class _Held:
    """In which share of the last moments agents stood in each other's way.

    Args:
        n: number of agents.
    """

    def __init__(self, n: int) -> None:
        self._shares: FloatArray = np.zeros((n, n))

    def take(self, sensed: Sensed, keep: float) -> None:
        """Takes who stands in whose way; ``keep`` is what is left of what was before."""
        self._shares = keep * self._shares + (1.0 - keep) * (sensed.in_the_way & sensed.visible)

    def most(self) -> FloatArray:
        """The largest of each agent, shape (n,)."""
        return np.asarray(self._shares.max(axis=1))

    def by_whom(self, agent: int) -> IntArray:
        """Those that have stood in one's way, ascending."""
        return np.asarray((self._shares[agent] > _IN_THE_WAY).nonzero()[0])

    def much(self) -> BoolArray:
        """Who has stood in whose way, shape (n, n)."""
        return np.asarray(self._shares > _IN_THE_WAY)


class _HeldByFew:
    """The same where most agents are far from most others: shares of pairs that are not zero."""

    def __init__(self, n: int) -> None:
        self._n = n
        self._pairs: IntArray = np.zeros(0, dtype=np.int64)
        self._shares: FloatArray = np.zeros(0)

    def take(self, sensed: Sensed, keep: float) -> None:
        """See ``_Held``; shares that have faded to nothing are forgotten."""
        rows, columns = (sensed.in_the_way & sensed.visible).nonzero()
        others = columns if sensed.who is None else sensed.who[rows, columns]
        now = rows * self._n + others
        self._shares *= keep
        both = np.union1d(self._pairs, now)
        shares = np.zeros(len(both))
        shares[np.searchsorted(both, self._pairs)] = self._shares
        shares[np.searchsorted(both, now)] += 1.0 - keep
        kept = shares > _NOTHING
        self._pairs, self._shares = both[kept], shares[kept]

    def most(self) -> FloatArray:
        """See ``_Held``."""
        most = np.zeros(self._n)
        np.maximum.at(most, self._pairs // self._n, self._shares)
        return most

    def by_whom(self, agent: int) -> IntArray:
        """See ``_Held``."""
        mine = self._pairs[self._shares > _IN_THE_WAY]
        return np.asarray(mine[mine // self._n == agent] % self._n)

    def much(self) -> BoolArray:
        """See ``_Held``."""
        mine, much = self._pairs[self._shares > _IN_THE_WAY], np.zeros((self._n, self._n), dtype=np.bool_)
        much[mine // self._n, mine % self._n] = True
        return much


class Gridlocks:
    """What n agents remember of being stuck, and what they do about it.

    Args:
        n: number of agents.
        params: see there.
        obstacles: what stands in the way and is no agent.

    Attributes:
        locked: agents that are locked in, shape (n,).
        begun: agents that have just been found locked in, shape (n,).
        detours: agents on a detour or backing off, shape (n,).
    """

    def __init__(self, n: int, params: GridlockParams, obstacles: Obstacles | None = None) -> None:
        self.params = params
        self._obstacles = obstacles if obstacles is not None and len(obstacles) else None
        self._n = n
        self.forget()

    def forget(self) -> None:
        """Begins anew: nobody is stuck, nobody has swapped."""
        n = self._n
        self.locked: BoolArray = np.zeros(n, dtype=np.bool_)
        self.begun: BoolArray = np.zeros(n, dtype=np.bool_)
        self.detours: BoolArray = np.zeros(n, dtype=np.bool_)
        self._wish: FloatArray = np.zeros((n, 3))
        self._vel: FloatArray = np.zeros((n, 3))
        self._held: _Held | _HeldByFew | None = None
        self._walled: FloatArray = np.zeros(n)
        self._stuck_s: FloatArray = np.zeros(n)
        self._pause_s: FloatArray = np.zeros(n)
        self._undo_s: dict[tuple[int, int], float] = {}
        self._ways: list[FloatArray] = [np.zeros((0, 3))] * n
        self._left_s: FloatArray = np.zeros(n)
        self._tries: IntArray = np.zeros(n, dtype=np.int64)
        self._sent: IntArray = np.zeros(n, dtype=np.int64)

    def wishes(self, vel_m_s: FloatArray) -> FloatArray:
        """What agents on a detour wish in place of their own law; NaN rows for all others.

        Args:
            vel_m_s: own velocities, by which agents reckon how far they have come, shape (n, 3).
        """
        wish = np.full((self._n, 3), np.nan)
        tick_s, reach_m = self.params.tick_s, 0.25 * self.params.keep_out_m
        self._left_s = np.maximum(self._left_s - tick_s, 0.0)
        for i in self.detours.nonzero()[0]:
            way = self._ways[i] - np.nan_to_num(vel_m_s[i]) * tick_s
            # A corner counts as reached early, the end when it is near.
            while len(way) > 1 and float(np.linalg.norm(way[0])) < 2.0 * reach_m:
                way = way[1:]
            self._ways[i] = way
            distance = float(np.linalg.norm(way[0]))
            if self._left_s[i] == 0.0 or (len(way) == 1 and distance < reach_m):
                self.detours[i] = False
                continue
            speed = self.params.speed_limit_m_s * min(1.0, distance / (2.0 * reach_m))
            wish[i] = way[0] * (speed / max(distance, 1e-9))
        return wish

    def sense(self, sensed: Sensed, absent: BoolArray) -> None:
        """Takes one tick: who is stuck, by whom, and for how long; ``absent`` agents do not follow, shape (n,)."""
        params = self.params
        keep = np.exp(-params.tick_s / params.memory_s)
        self._wish = keep * self._wish + (1.0 - keep) * sensed.wish_m_s
        self._vel = keep * self._vel + (1.0 - keep) * np.where(np.isfinite(sensed.vel_m_s), sensed.vel_m_s, 0.0)
        if self._held is None:
            self._held = _Held(self._n) if sensed.who is None else _HeldByFew(self._n)
        self._held.take(sensed, float(keep))
        if sensed.walled is not None:
            self._walled = keep * self._walled + (1.0 - keep) * sensed.walled
        square = (self._wish * self._wish).sum(axis=1)
        along = (self._vel * self._wish).sum(axis=1)
        stuck = square > (params.least_wish * params.speed_limit_m_s) ** 2
        stuck &= along < params.progress * square
        stuck &= (np.maximum(self._held.most(), self._walled) > _IN_THE_WAY) & ~absent
        self.detours &= ~absent
        self._stuck_s = np.where(stuck, self._stuck_s + params.tick_s, 0.0)
        locked = self._stuck_s >= params.patience_s
        self.begun = locked & ~self.locked
        self.locked = locked
        self._pause_s = np.maximum(self._pause_s - params.tick_s, 0.0)
        self._undo_s = {pair: left_s - params.tick_s for pair, left_s in self._undo_s.items() if left_s > params.tick_s}
        free = ~self.detours & ~locked & (self._stuck_s == 0.0)
        self._tries = np.where(free & (along > 0.5 * square), 0, self._tries)

    def swaps(self, sensed: Sensed, places: Places, may: BoolArray) -> list[tuple[int, int]]:
        """Pairs that swap their roles now, each agent in one pair at most.

        Args:
            sensed: this tick, of all.
            places: what each agent makes of its view.
            may: agents whose roles are theirs to give away, shape (n,).

        Returns:
            Pairs i < j; their roles are to be exchanged.
        """
        if self._held is None or not some(self.locked):
            return []
        asks = self.locked[:, None] & self._held.much()
        asks |= asks.T
        may = may & (self._pause_s == 0.0)
        asks &= may[:, None] & may[None] & sensed.visible & sensed.visible.T
        for i, j in self._undo_s:
            asks[i, j] = asks[j, i] = False
        if not some(asks):
            return []
        rel = np.where(sensed.visible[..., None], sensed.rel_m, 0.0)
        dot = (rel * places.wanted_m).sum(axis=2)
        size = np.linalg.norm(rel, axis=2) * np.linalg.norm(places.wanted_m, axis=2)
        gain_m2 = np.where(asks & (dot < -self.params.opposed * size), -2.0 * dot, 0.0)
        gain_m2 = np.minimum(gain_m2, gain_m2.T)  # both have to agree
        pairs: list[tuple[int, int]] = []
        while gain_m2.max() > 0.0:
            i, j = (int(k) for k in np.unravel_index(int(np.argmax(gain_m2)), gain_m2.shape))
            pairs.append((min(i, j), max(i, j)))
            gain_m2[[i, j]] = 0.0
            gain_m2[:, [i, j]] = 0.0
            both = [i, j]
            self._undo_s[i, j] = self.params.undo_s
            self._pause_s[both] = self.params.pause_s
            self._stuck_s[both] = 0.0
            self._tries[both] = self._sent[both] = 0
            self.detours[both] = False
            self.locked[both] = False
        return pairs

    def begin_detours(
        self, sensed: Sensed, to_goal_m: FloatArray, absent: BoolArray, patience_s: float, *, rarer: bool
    ) -> list[int]:
        """Sends agents that are locked in on detours; one at most in a tick, for planning takes time.

        Args:
            sensed: this tick, of all.
            to_goal_m: from each agent to where it belongs, shape (n, 3).
            absent: agents that do not follow, shape (n,).
            patience_s: how long an agent is stuck before it sets out; most gridlocks dissolve by themselves.
            rarer: whoever has been sent off k times before takes max(1, k) times as long: where many are near each
                other one's way out is the next one's gridlock.

        Returns:
            Agents that begin a detour, or back off, now.
        """
        if self._held is None:
            return []
        over_s = self._stuck_s - patience_s * (np.maximum(self._sent, 1) if rarer else 1)
        for i in np.argsort(-over_s, kind="stable").tolist():
            if over_s[i] < 0.0:
                break
            if float(np.linalg.norm(to_goal_m[i])) < _WORTH_M * self.params.keep_out_m:
                continue
            holders = self._held.by_whom(i)
            # Those who hold each other move one after the other.
            if self.detours[holders].any() and not self.detours[i]:
                continue
            others = sensed.rel_m[i][sensed.visible[i]]
            bodies = None
            if self._obstacles is not None and sensed.pos_m is not None:
                bodies = self._obstacles.seen_from(sensed.pos_m[i])
            way = way_round(
                to_goal_m[i], others, self.params.keep_out_m, sensed.low_m[i], sensed.high_m[i], obstacles=bodies
            )
            if way is not None and self._tries[i] % 3 < 2:
                self._send(i, way)
                return [i]
            # Every other agent that holds this one and rests gives way too.
            rests = [int(j) for j in holders if not (self.detours[j] or self.locked[j] or absent[j])]
            for j in [i, *rests]:
                away = back_off(sensed.rel_m[j][sensed.visible[j]])
                target = np.clip(_BACK_OFF * self.params.keep_out_m * away, sensed.low_m[j], sensed.high_m[j])
                self._send(j, target[None])
            return [i, *rests]
        return []

    def _send(self, agent: int, way_m: FloatArray) -> None:
        length = float(np.linalg.norm(np.diff(way_m, axis=0, prepend=np.zeros((1, 3))), axis=1).sum())
        self._ways[agent] = way_m
        self._left_s[agent] = 2.0 * length / self.params.speed_limit_m_s + 2.0 * self.params.patience_s
        self.detours[agent] = True
        self._stuck_s[agent] = 0.0
        self._tries[agent] += 1
        self._sent[agent] += 1
