"""Follows the bodies of a room: whose each is, whether it can have come there, and when it was seen.

A body's name is believed on the ground. In flight it is held against where its vehicle flew before: two that have
exchanged their names are followed by their places, one that jumps is not believed, one that has been out of sight is
believed again where it can have come by then and nobody else can. What is not believed leaves its vehicle's position
old, and what follows from that is the monitors' business.

Refuses to guess: where two could be meant, nobody is.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass

import numpy as np

from groundstation.core.quick import finite_rows, norms
from groundstation.core.types import BoolArray, FloatArray, IntArray
from groundstation.mocap.bodies import RoomConfig, RoomFrame
from groundstation.mocap.ground import pads_words
from groundstation.mocap.others import FIRST_ROW, OtherBodies
from groundstation.mocap.stamps import FrameClock

SECOND_NS = 1_000_000_000
NEVER = np.iinfo(np.int64).min // 2
GONE_NS = 300_000_000
"""Without a frame for so long, people are told."""
UNSEEN_NS = 200_000_000
_OTHER_UNSEEN_NS = 500_000_000
_SLACK_M = 0.10  # noise, and what a velocity is off
_REACH_MAX_M = 1.0
_FROZEN_NS = 150_000_000
_VELOCITY_S = 0.05
_RATE_MIN_HZ = 20.0
_FRESH_NS = 500_000_000
_NEAR_PAD_M = 0.5  # by place: who stands further from every pad is nobody's
_LATE_NS = 100_000_000
_UNSEEN_WORDS = "is not in the frames: its markers are covered, lost, or out of the cameras' sight"


@dataclass(frozen=True)
class Seen:
    """Bodies of one frame that are believed.

    Attributes:
        row: vehicles, shape (k,).
        pos_ned_m, vel_ned_m_s: shape (k, 3).
        quat_ned_from_frd: shape (k, 4); NaN where unknown.
        measured_ns: when, on our clock; of all of them.
        t_rx_ns: arrival.
    """

    row: IntArray
    pos_ned_m: FloatArray
    vel_ned_m_s: FloatArray
    quat_ned_from_frd: FloatArray
    measured_ns: int
    t_rx_ns: int


class Room:
    """The bodies of n vehicles.

    Args:
        config: whom to look for.

    Attributes:
        pos_ned_m, vel_ned_m_s: where each was seen last and believed, NaN before, shape (n, 3).
        quat_ned_from_frd: attitude of the same, NaN where unknown, shape (n, 4).
        measured_ns: when that was, NEVER before, shape (n,).
        resets: how often each was followed elsewhere than by its name, shape (n,).
        counts: what was not believed, by why.
        gone: no frame has come for a while, of anybody.
        lateness_ns: of the newest frame, against the quickest that ever came.
        others: bodies that are no vehicles.
    """

    def __init__(self, config: RoomConfig) -> None:
        n = len(config.ids)
        self.config = config
        self.pos_ned_m: FloatArray = np.full((n, 3), np.nan)
        self.vel_ned_m_s: FloatArray = np.zeros((n, 3))
        self.quat_ned_from_frd: FloatArray = np.full((n, 4), np.nan)
        self.measured_ns: IntArray = np.full(n, NEVER, dtype=np.int64)
        self.resets: IntArray = np.zeros(n, dtype=np.int64)
        self.counts: Counter[str] = Counter()
        self.gone = False
        self.others = OtherBodies(len(config.others))
        self._others_lost: BoolArray = np.zeros(len(config.others), dtype=np.bool_)
        self._clock = FrameClock()
        self._held = self._late = False
        self._name: IntArray = np.arange(n, dtype=np.int64)  # by whose name each vehicle's body goes
        self._raw: FloatArray = np.full((n, 7), np.nan)
        self._changed_ns: IntArray = np.full(n, NEVER, dtype=np.int64)
        self._frame_ns = NEVER
        self._stamp_ns = -2
        self._period_s = 0.0
        self._unseen: BoolArray = np.zeros(n, dtype=np.bool_)
        self._why: list[str] = [""] * n
        self._news: list[str] = []

    def __len__(self) -> int:
        """Number of vehicles."""
        return len(self.config.ids)

    @property
    def lateness_ns(self) -> int:
        """How much longer the newest frame took than the quickest."""
        return self._clock.lateness_ns

    def hold(self) -> None:
        """From now on vehicles fly: names are held against places, and nobody jumps."""
        self._held = True

    def flies_from(self, vehicle: int, pos_ned_m: FloatArray, measured_ns: int) -> None:
        """Takes over one that somebody else has followed until now, from where it was seen last, shape (3,)."""
        self.pos_ned_m[vehicle], self.measured_ns[vehicle] = pos_ned_m, measured_ns

    def take(self, frame: RoomFrame) -> Seen | None:
        """Takes a frame; returns who is believed of it, None for nobody.

        Args:
            frame: one instant, or a part of it: frames of one stamp belong together.
        """
        if frame.stamp_ns >= 0 and frame.stamp_ns < self._stamp_ns and self._clock.older(frame.stamp_ns, frame.t_rx_ns):
            self.counts["motion capture: frames older than what was there"] += 1
            return None
        if frame.stamp_ns != self._stamp_ns or frame.stamp_ns < 0:
            self._pace(frame.t_rx_ns)
        self._stamp_ns = frame.stamp_ns
        measured_ns = self._clock.measured_ns(frame.stamp_ns, frame.t_rx_ns)
        others: BoolArray = np.asarray(frame.row <= FIRST_ROW)
        if others.any():
            self.others.take(frame.only(others), measured_ns)
            frame = frame.only(~others)
        frame = self._sound(frame, measured_ns)
        body_of = self._followed(frame, measured_ns) if self._held else self._named(frame)
        row = np.array(sorted(body_of), dtype=np.int64)
        if not len(row):
            return None
        body = np.array([body_of[vehicle] for vehicle in row.tolist()], dtype=np.int64)
        self._move(row, frame.pos_ned_m[body], measured_ns)
        self.quat_ned_from_frd[row] = frame.quat_ned_from_frd[body]
        fresh = frame.t_rx_ns - measured_ns <= UNSEEN_NS
        for vehicle in row[self._unseen[row] & fresh].tolist():
            self._unseen[vehicle] = False
            self._news.append(f"vehicle {self.config.ids[vehicle]}: the motion capture sees it again")
        return Seen(
            row, self.pos_ned_m[row], self.vel_ned_m_s[row], self.quat_ned_from_frd[row], measured_ns, frame.t_rx_ns
        )

    def look(self, now_ns: int) -> None:
        """Finds out who has not been seen for a while, for ``take_news``."""
        gone = self._frame_ns != NEVER and now_ns - self._frame_ns > GONE_NS
        if gone and not self.gone:
            age_s = (now_ns - self._frame_ns) / SECOND_NS
            self._news.append(
                f"motion capture: no frame on {self.config.url} for {age_s:.1f} s, of anybody; see that the system"
                " streams, and to the network between"
            )
        elif self.gone and not gone:
            self._news.append("motion capture: frames come again")
        self.gone = gone
        late = not gone and self._clock.lateness_ns > UNSEEN_NS
        if late and not self._late:
            self._news.append(
                f"motion capture: its frames come {self._clock.lateness_ns / SECOND_NS:.1f} s late; see to the network"
                " between, and to the load of both computers"
            )
        self._late = late
        if self._held:
            self._look_at_others(now_ns)
        if late or not self._held or now_ns - self._frame_ns > UNSEEN_NS:  # then it is not the bodies
            return
        unseen = (self.measured_ns != NEVER) & (now_ns - self.measured_ns > UNSEEN_NS)
        for vehicle in (unseen & ~self._unseen).nonzero()[0].tolist():
            why = self._why[vehicle] or _UNSEEN_WORDS
            age_s = (now_ns - int(self.measured_ns[vehicle])) / SECOND_NS
            self._news.append(f"vehicle {self.config.ids[vehicle]}: its body {why}; last seen {age_s:.2f} s ago")
        self._unseen |= unseen

    def _look_at_others(self, now_ns: int) -> None:
        """Tells of bodies that are obstacles and are not seen any more, and of those that are again."""
        age_ns = now_ns - self.others.measured_ns
        lost: BoolArray = np.asarray(age_ns > _OTHER_UNSEEN_NS)
        for k in (lost & ~self._others_lost).nonzero()[0].tolist():
            self._news.append(
                f"motion capture: body {self.config.others[k]} is not seen; the team keeps away from where it was seen"
                " last, and farther the longer that is ago; see to its markers"
            )
        for k in (~lost & self._others_lost).nonzero()[0].tolist():
            self._news.append(f"motion capture: body {self.config.others[k]} is seen again")
        self._others_lost = lost

    def say(self, text: str) -> None:
        """Passes on what the system says to people."""
        self._news.append(f"motion capture: {text}")

    def take_news(self) -> list[str]:
        """What people should know, since the last call."""
        news, self._news = self._news, []
        return news

    def words(self, vehicle: int, now_ns: int) -> str | None:
        """What keeps a vehicle on the ground, with the remedy; None when its body is seen and stands on its pad."""
        if self._frame_ns == NEVER or now_ns - self._frame_ns > SECOND_NS:
            when = "none yet" if self._frame_ns == NEVER else f"none for {(now_ns - self._frame_ns) / SECOND_NS:.1f} s"
            return (
                f"no frame of the motion capture on {self.config.url}: {when}; start it (gs mocap), or correct"
                " positioning.link"
            )
        if self._period_s > 1.0 / _RATE_MIN_HZ:
            slow = f"frames of the motion capture come at {1.0 / self._period_s:.0f} Hz, least {_RATE_MIN_HZ:g} Hz"
            return f"{slow}; raise its rate there, and see to the network between"
        if self._clock.lateness_ns > _LATE_NS:
            late = f"the motion capture's newest frame came {self._clock.lateness_ns / 1e6:.0f} ms late"
            return f"{late}, limit {_LATE_NS / 1e6:.0f} ms; see to the network between, and to the load of its computer"
        if (missing := (now_ns - self.others.measured_ns > _FRESH_NS)).any():
            names = ", ".join(self.config.others[k] for k in missing.nonzero()[0])
            return (
                f"no body {names} in the motion capture's frames (positioning.obstacles); define it there, see to its"
                " markers, or take it out of the mission"
            )
        seen = now_ns - self.measured_ns <= _FRESH_NS
        if seen.any() and (found := pads_words(self.config, np.where(seen[:, None], self.pos_ned_m, np.nan))[vehicle]):
            return found
        if not seen[vehicle]:
            what = "near its pad" if self.config.by_place else "of its name (vehicles[].body)"
            why = self._why[vehicle] and f": it {self._why[vehicle]}"
            return (
                f"no body {what} in the motion capture's frames{why}; see to its markers, and that it is defined there"
            )
        return None

    # -- one frame ----------------------------------------------------------------------------------------------

    def _pace(self, t_rx_ns: int) -> None:
        if self._frame_ns != NEVER:
            step_s = min(max(0.0, (t_rx_ns - self._frame_ns) / SECOND_NS), 1.0)
            self._period_s += 0.05 * (step_s - self._period_s) if self._period_s else step_s
        self._frame_ns = t_rx_ns

    def _sound(self, frame: RoomFrame, measured_ns: int) -> RoomFrame:
        """Leaves out what is no place, and bodies that have stood still to the last bit for too long."""
        good: BoolArray = finite_rows(frame.pos_ned_m) & (np.abs(frame.pos_ned_m).max(axis=1) < 1e6)
        zero: BoolArray = np.asarray(~frame.pos_ned_m.any(axis=1))
        if not good.all():
            self.counts["motion capture: bodies without a place"] += int((~good).sum())
        raw = np.hstack([frame.pos_ned_m, frame.quat_ned_from_frd])
        for k in range(len(good) if not self.config.by_place else 0):
            vehicle = int(frame.row[k])
            if vehicle < 0 or not good[k]:
                continue
            if not _same(raw[k], self._raw[vehicle]):
                self._raw[vehicle], self._changed_ns[vehicle] = raw[k], measured_ns
                self._why[vehicle] = ""
            elif zero[k] or measured_ns - int(self._changed_ns[vehicle]) > _FROZEN_NS:
                good[k] = False
                self.counts["motion capture: frozen bodies"] += 1
                self._why[vehicle] = "is frozen: its position is the same to the last bit in every frame"
        return frame.only(good)

    def _named(self, frame: RoomFrame) -> dict[int, int]:
        """On the ground: bodies by their names, or by the pads that they stand on: number in the frame by vehicle."""
        if not self.config.by_place:
            return {int(row): k for k, row in enumerate(frame.row) if 0 <= row < len(self)}
        found: dict[int, int] = {}
        if len(frame.row):
            away = np.linalg.norm(frame.pos_ned_m[None] - self.config.pads_ned_m[:, None], axis=-1)
            nearest, whose = away.argmin(axis=1), away.argmin(axis=0)
            for vehicle, k in enumerate(nearest.tolist()):
                if whose[k] == vehicle and away[vehicle, k] <= _NEAR_PAD_M:
                    found[vehicle] = k
        return found

    def _followed(self, frame: RoomFrame, measured_ns: int) -> dict[int, int]:
        """In flight: bodies by where their vehicles can be."""
        known = self.measured_ns != NEVER
        dt_s = np.where(known, np.maximum(0, measured_ns - self.measured_ns), 0) / SECOND_NS
        expected = self.pos_ned_m + self.vel_ned_m_s * np.minimum(dt_s, 0.3)[:, None]
        reach_m = np.minimum(_SLACK_M + self.config.speed_m_s * dt_s, _REACH_MAX_M)
        away = norms(frame.pos_ned_m[None] - expected[:, None])  # NaN where never seen
        inside: BoolArray = np.asarray(np.where(known[:, None], away, np.inf) <= reach_m[:, None])
        found: dict[int, int] = {}
        first = {name: k for k, name in reversed(list(enumerate(frame.row.tolist())))}
        reached, reaching = inside.tolist(), inside.sum(axis=0).tolist()
        for vehicle, name in enumerate(self._name.tolist()):
            k = None if self.config.by_place else first.get(name)
            if k is not None and reached[vehicle][k] and reaching[k] == 1:  # mostly: its own, and nobody else's
                found[vehicle] = k
                continue
            near = inside[vehicle].nonzero()[0]
            own = (frame.row == self._name[vehicle]).nonzero()[0]
            if not self.config.by_place and len(own) and inside[vehicle, own[0]]:
                near = own[:1]
            mine = [k for k in near.tolist() if self._is_nearest(vehicle, k, away, inside)]
            if len(mine) == 1:
                found[vehicle] = mine[0]
            elif not len(near) and len(own):
                self._not_believed(vehicle, float(away[vehicle, own[0]]), float(dt_s[vehicle]))
            elif len(own) and inside[vehicle, own[0]]:
                self._why[vehicle] = "cannot be told from another one that may be there as well"
        self._notice_names(frame, found)
        return found

    @staticmethod
    def _is_nearest(vehicle: int, body: int, away: FloatArray, inside: BoolArray) -> bool:
        """Whether nobody else who can be there is as near."""
        others = inside[:, body].copy()
        others[vehicle] = False
        # One that is followed from frame to frame reaches no further than the slack; half the distance is a tie.
        return not bool((others & (away[:, body] < 2.0 * away[vehicle, body] + 0.02)).any())

    def _not_believed(self, vehicle: int, jump_m: float, dt_s: float) -> None:
        self.counts["motion capture: bodies that jumped"] += 1
        if np.isfinite(jump_m):
            self._why[vehicle] = (
                f"has jumped by {jump_m:.2f} m in {dt_s:.2f} s and is not believed; see to reflections, and that its"
                " markers differ from those of others"
            )

    def _notice_names(self, frame: RoomFrame, found: dict[int, int]) -> None:
        """Tells of those that are followed under another name than before."""
        if self.config.by_place:
            return
        now = {vehicle: int(frame.row[k]) for vehicle, k in found.items() if frame.row[k] >= 0}
        changed = {vehicle: name for vehicle, name in now.items() if name != self._name[vehicle]}
        ids = self.config.ids
        for vehicle, name in changed.items():
            self.resets[vehicle] += 1
            self._name[vehicle] = name
            self.counts["motion capture: names that changed"] += 1
            if name == vehicle:
                self._news.append(f"vehicle {ids[vehicle]}: its body has its own name again")
            elif now.get(name) == vehicle and name in changed:
                if vehicle < name:
                    self._news.append(
                        f"motion capture: the bodies of vehicles {ids[vehicle]} and {ids[name]} have exchanged their"
                        " names; each is followed by where it flew; make their marker patterns differ more"
                    )
            else:
                self._news.append(
                    f"vehicle {ids[vehicle]}: its body is now named as that of vehicle {ids[name]}; it is followed by"
                    " where it flew; make the marker patterns differ more"
                )

    def _move(self, row: IntArray, pos_ned_m: FloatArray, measured_ns: int) -> None:
        before_ns = self.measured_ns[row]
        step_s = np.where(before_ns == NEVER, 0, measured_ns - np.where(before_ns == NEVER, 0, before_ns)) / SECOND_NS
        told = (step_s > 0.0) & (step_s < 0.5)
        step = (pos_ned_m - self.pos_ned_m[row]) / np.where(told, step_s, 1.0)[:, None]
        share = (step_s / (step_s + _VELOCITY_S))[:, None]
        slower = self.vel_ned_m_s[row] + share * (step - self.vel_ned_m_s[row])
        kept = np.where((step_s == 0.0)[:, None], self.vel_ned_m_s[row], 0.0)
        self.vel_ned_m_s[row] = np.where(told[:, None], slower, kept)
        self.pos_ned_m[row] = pos_ned_m
        self.measured_ns[row] = measured_ns


def _same(one: FloatArray, other: FloatArray) -> bool:
    """Whether two rows are the same, what is no number in both included."""
    pairs = zip(one.tolist(), other.tolist(), strict=True)
    return all(a == b or (math.isnan(a) and math.isnan(b)) for a, b in pairs)
