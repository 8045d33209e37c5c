"""Who comes down where, and when its column is clear: nobody on top of anybody.

Each vehicle has a place: its pad when it comes home, where it is when it lands there. Where that is taken it gets
another one, in the order that docs/safety.md states. Whoever stands stays an obstacle of known place for all who land
later. Reads no clock and sends nothing; ``landing`` asks the autopilots, and the roster keeps the places.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from groundstation.core.quick import some
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.mavlink.vehicle import NEVER
from groundstation.mission.flight.columns import Columns, Scene
from groundstation.mission.flight.places import Box, Taken, allot, farthest, nearest_free, taken_at
from groundstation.mission.roster import Roster
from groundstation.mission.timing import SECOND_NS, AskAgain, Since

_CROWDED_NS = 20 * SECOND_NS  # so long those who fly below are given to get out of the way
_PATIENCE_NS = 60 * SECOND_NS  # so long a vehicle waits for a place, where its battery allows that
_UNHEARD_NS = 5 * SECOND_NS  # so long it stands still: heard again it is led, and comes down where that is known
_LOST_WAY_NS, _LATE_HOME_NS = 30 * SECOND_NS, 10 * SECOND_NS
_LOOK_AGAIN_NS = SECOND_NS // 2
_SAME_M = 1e-6


@dataclass(frozen=True)
class News:
    """Something that people should know: of whom, in words; ``elsewhere`` when it does not land on its pad."""

    vehicle: int
    text: str
    elsewhere: bool = False


class Spots:
    """Places of one team.

    Args:
        ids: system ids, for words.
        roster: keeps who lands, and where.
        columns: who is in whose.
        box: the inside of the fence.
    """

    def __init__(self, ids: IntArray, roster: Roster, columns: Columns, box: Box) -> None:
        n = len(ids)
        self._ids, self._roster, self._columns, self._box = ids, roster, columns, box
        self._news: list[News] = []
        self._told: set[tuple[int, str]] = set()
        self._goals_m: FloatArray = np.full((n, 2), np.nan)  # where each is going to come down, as of this tick
        self._given, self._blocked = Since(n), Since(n)
        self._look, self._look_home = AskAgain(n, _LOOK_AGAIN_NS), AskAgain(1, _LOOK_AGAIN_NS)

    def take_news(self) -> list[News]:
        """Hands out what has not been told yet."""
        news, self._news = self._news, []
        return news

    def everybody_here(self, rest_ned_m: FloatArray, ours: BoolArray) -> list[News]:
        """Gives all of ours a place: where they are, beside that where somebody is below, their pads where all is full.

        Args:
            rest_ned_m: where everybody comes to rest, shape (n, 3).
            ours: those that shall land and can be led, shape (n,).

        Returns:
            Of whom people should know; ``elsewhere`` for those that find no place but their pads.
        """
        distances, pads_ned_m = self._columns.distances, self._columns.pads_ned_m
        others = taken_at(np.flatnonzero(~ours), rest_ned_m, distances.beside_m)
        places_m, to_pad = allot(
            rest_ned_m,
            pads_ned_m,
            ours,
            others,
            need_m=distances.beside_m,
            wish_m=distances.wish_m,
            box=self._box,
        )
        told = []
        for vehicle in np.flatnonzero(ours).tolist():
            aside_m = float(np.linalg.norm(places_m[vehicle] - rest_ned_m[vehicle, :2]))
            down_m = rest_ned_m[vehicle, 2]
            self._roster.give_place(vehicle, [*places_m[vehicle], self._high(down_m) if aside_m > 0.0 else down_m])
            words = f"moves {aside_m:.2f} m aside before it lands; somebody is below"
            if to_pad[vehicle]:
                words = "lands on its pad: the fence holds no place for everybody to land where they are"
            if to_pad[vehicle] or aside_m > 0.0:
                told.append(News(vehicle, f"vehicle {self._ids[vehicle]}: {words}", elsewhere=bool(to_pad[vehicle])))
        return told

    def step(self, now_ns: int, scene: Scene | None) -> BoolArray:
        """Looks after everybody's place; returns who may come down now, shape (n,).

        Args:
            now_ns: time of the tick.
            scene: where everybody is; None while nobody is to land, or on its way home.
        """
        ready: BoolArray = np.zeros(len(self._ids), dtype=np.bool_)
        home_too = self._look_home.due(0, now_ns)  # large teams are on their way for long, and nothing changes fast
        if home_too:
            self._look_home.asked(0, now_ns)
        if scene is None:
            return ready
        looked_after = ~(scene.down | scene.sinks) & (scene.wanted | scene.coming)
        if not some(looked_after):
            return ready
        roster = self._roster
        goals_ned_m = np.where(roster.lands_here[:, None], scene.pos_ned_m, scene.home_ned_m)
        self._goals_m = np.where(roster.elsewhere[:, None], roster.place_ned_m, goals_ned_m)[:, :2].copy()
        settled: list[int] = []
        lowest_first = (-scene.pos_ned_m[:, 2]).argsort(kind="stable")
        for vehicle in lowest_first[looked_after[lowest_first]].tolist():
            if scene.led[vehicle]:
                if scene.wanted[vehicle] or home_too:
                    ready[vehicle] = self._lead(vehicle, now_ns, scene, settled)
                settled.append(vehicle)
            elif scene.lost[vehicle] or scene.loose[vehicle]:  # one that holds for a moment is looked at again
                ready[vehicle] = scene.wanted[vehicle] and self._drop(vehicle, now_ns, scene)
        return ready

    # One vehicle

    def _lead(self, vehicle: int, now_ns: int, scene: Scene, settled: list[int]) -> bool:
        """Sees to it that a vehicle that can be steered has a free place; returns whether it may come down now."""
        goal_m = self._goals_m[vehicle]
        taken = self._columns.taken(vehicle, scene, goal_m).beside(self._chosen(vehicle, settled, goal_m))
        who = taken.in_the_way(goal_m)
        aside_m = float(np.linalg.norm(scene.pos_ned_m[vehicle, :2] - goal_m))
        arrived = aside_m <= self._columns.distances.tolerance_m
        # Above its pad preflight has looked: an obstacle may hang higher than it flies there.
        at_home = float(np.linalg.norm(goal_m - self._columns.pads_ned_m[vehicle, :2])) < _SAME_M
        covered = not (at_home or self._box.free(goal_m[None])[0])
        if who is not None or covered or self._is_late(vehicle, now_ns, scene, arrived=arrived):
            if self._look.due(vehicle, now_ns):
                self._look.asked(vehicle, now_ns)
                self._look_elsewhere(vehicle, now_ns, scene, settled, who, covered=covered)
            return False
        if not scene.wanted[vehicle] or not arrived:
            return False
        clear_here = taken.in_the_way(scene.pos_ned_m[vehicle, :2]) is None
        if clear_here and not self._columns.below(vehicle, scene).any():
            self._blocked.forget(vehicle)
            return True
        self._blocked.note(vehicle, now_ns)
        return False

    def _drop(self, vehicle: int, now_ns: int, scene: Scene) -> bool:
        """Whether one that cannot be steered may be told to land where it is."""
        at_m = scene.pos_ned_m[vehicle, :2]
        if self._roster.told_to_land[vehicle] or not np.isfinite(at_m).all():
            return True
        waited_ns = self._waited_ns(vehicle, now_ns)
        if scene.unheard[vehicle] and waited_ns < _UNHEARD_NS and not scene.hurries[vehicle]:
            return False
        who = self._columns.taken(vehicle, scene, at_m, but_higher_ones=True).in_the_way(at_m)
        if who is None:
            return not self._columns.below(vehicle, scene).any() or waited_ns >= _CROWDED_NS
        if scene.lost[vehicle] and (scene.hurries[vehicle] or waited_ns >= _PATIENCE_NS):
            self._tell(vehicle, f"comes down all the same; keep away: {self._stands(who)} where it was last seen")
            return True
        place = "where it was last seen" if scene.lost[vehicle] else "where it would come down"
        self._tell(vehicle, f"is not told to land yet: {self._stands(who)} {place}, and it cannot be led elsewhere")
        return False

    def _waited_ns(self, vehicle: int, now_ns: int) -> int:
        """Since a vehicle was to land; 0 for one that is not."""
        since_ns = int(self._roster.lands_since_ns[vehicle])
        return 0 if since_ns == NEVER else now_ns - since_ns

    def _is_late(self, vehicle: int, now_ns: int, scene: Scene, *, arrived: bool) -> bool:
        """Whether a vehicle has tried in vain for too long: to arrive, or to have nobody below."""
        if self._blocked.held(vehicle, now_ns, _CROWDED_NS):
            return True
        if arrived or not scene.wanted[vehicle]:
            return False
        late_ns = _LOST_WAY_NS if self._roster.elsewhere[vehicle] else _LATE_HOME_NS
        return self._waited_ns(vehicle, now_ns) >= late_ns and not self._given.began(vehicle, now_ns, late_ns)

    def _look_elsewhere(
        self, vehicle: int, now_ns: int, scene: Scene, settled: list[int], who: int | None, *, covered: bool
    ) -> None:
        """Gives a vehicle the next place that is free, or lets it wait."""
        place_m = self._next_place(vehicle, scene, settled, at_home=who is not None or covered)
        impatient = scene.hurries[vehicle] or self._waited_ns(vehicle, now_ns) >= _PATIENCE_NS
        if impatient and (place_m is None or (who is None and not covered)):
            place_m = self._last_resort(vehicle, scene, settled)
        because = "its place was not clear in time"
        if covered:
            because = "an obstacle is where it would have landed"
        if who is not None:
            because = f"{self._stands(who)} where it would have landed"
        if place_m is None:
            self._tell(vehicle, f"no place inside the fence is free for it to land on, {because}; it waits in the air")
            return
        self._blocked.forget(vehicle)
        self._given.again(vehicle, now_ns)
        self._roster.give_place(vehicle, [*place_m, self._high(float(scene.pos_ned_m[vehicle, 2]))])
        self._goals_m[vehicle] = place_m
        off_m = float(np.linalg.norm(place_m - self._columns.pads_ned_m[vehicle, :2]))
        on_pad = off_m < _SAME_M
        at = f"{off_m:.2f} m from its pad, at {place_m[1]:.2f} {place_m[0]:.2f} m (east, north)"
        text = f"vehicle {self._ids[vehicle]}: lands {'on its pad' if on_pad else at}, since {because}"
        self._news.append(News(vehicle, text, elsewhere=not on_pad))

    def _next_place(self, vehicle: int, scene: Scene, settled: list[int], *, at_home: bool) -> FloatArray | None:
        """The nearest place with room to all, its own pad, or the nearest with room to those who come before it."""
        distances, pad_m = self._columns.distances, self._columns.pads_ned_m[vehicle, :2]
        own_pad = at_home and not (self._roster.lands_here[vehicle] or self._roster.elsewhere[vehicle])
        start_m = pad_m if own_pad else scene.pos_ned_m[vehicle, :2]
        fixed = self._columns.taken(vehicle, scene, None)
        if self._blocked.noted(vehicle):  # they were given time to leave
            stay = np.flatnonzero(self._columns.below(vehicle, scene))
            fixed = fixed.beside(taken_at(stay, scene.pos_ned_m, distances.beside_m))
        fixed = fixed.wider(distances.wish_m - distances.beside_m)
        steered = ~(scene.down | scene.sinks | scene.lost | scene.loose)
        steered[vehicle] = False
        land = scene.wanted | scene.coming
        away = (scene.lost | scene.loose) & ~scene.down
        away[vehicle] = False
        theirs = (
            taken_at(np.flatnonzero(steered & land), self._goals_m, distances.wish_m)
            .beside(taken_at(np.flatnonzero(steered & ~land), self._goals_m, distances.beside_m))
            .beside(taken_at(np.flatnonzero(away), self._columns.pads_ned_m, distances.beside_m))
        )
        place_m = nearest_free(start_m, fixed.beside(theirs), self._box)
        if place_m is not None:
            return place_m
        own = self._columns.taken(vehicle, scene, pad_m).beside(self._chosen(vehicle, settled, pad_m))
        if own.in_the_way(pad_m) is None:
            return np.asarray(pad_m)
        return nearest_free(start_m, fixed.beside(taken_at(settled, self._goals_m, distances.wish_m)), self._box)

    def _last_resort(self, vehicle: int, scene: Scene, settled: list[int]) -> FloatArray | None:
        """A place that keeps r and nothing more: where it is, or the one that is farthest from everybody."""
        self._columns.content_with_r(vehicle)
        here_m = scene.pos_ned_m[vehicle, :2]
        taken = self._columns.taken(vehicle, scene, here_m).beside(self._chosen(vehicle, settled, here_m))
        if taken.in_the_way(here_m) is None and self._box.free(here_m[None])[0]:
            return np.asarray(here_m)
        place_m, room_m = farthest(here_m, taken, self._box)
        return place_m if room_m >= 0.0 else None

    def _chosen(self, vehicle: int, settled: list[int], place_m: FloatArray) -> Taken:
        """Places of those that come before this vehicle, with the distance that a place of its own has to have."""
        return taken_at(settled, self._goals_m, self._columns.need_m(vehicle, self._goals_m, place_m))

    def _high(self, down_m: float) -> float:
        """At this height or above: over all who stand."""
        return min(down_m, float(self._columns.pads_ned_m[:, 2].min()) - self._columns.distances.height_m)

    # In words

    def _stands(self, who: int) -> str:
        return f"vehicle {self._ids[who]} stands or comes down"

    def _tell(self, vehicle: int, text: str) -> None:
        key = (vehicle, text.split("vehicle", maxsplit=1)[0])  # once, whoever it is that stands there
        if key not in self._told:
            self._told.add(key)
            self._news.append(News(vehicle, f"vehicle {self._ids[vehicle]}: {text}"))
