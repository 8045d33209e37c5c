"""Watches how long a law or avoidance of one's own takes by the wall clock, and tells people.

Tells only: what is done about ticks that come late is the monitors' business, which go by the ticks alone and do the
same in a replay. A call that does not come back stops the setpoints, and the autopilots' own failsafe acts; nobody
would know why, so a thread says it.

In a dry run time stands still while the law is asked, so that it is the same flight on every machine, to the bit: the
law's time is told on the screen and in the answer, with what vehicles would have made of it, and is not in the log.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from threading import Event, Thread

from groundstation.app.session import Session
from groundstation.core.law import Answer
from groundstation.mission.plan.own_code import OwnCode
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.runner import Note

_SHARE = 0.5  # of a tick; the rest is for everything else
_STUCK_S = 1.0
_OFTEN = 0.05  # share of ticks; single ones are slow on a machine that has other things to do
_ENOUGH = 5  # ticks


class LawWatch:
    """Looks after the code of one flight.

    Args:
        plan: what is flown.
        clock_ns: the wall clock.
        dry: in virtual time.

    Attributes:
        plan: the same, with code that is watched.
    """

    def __init__(
        self, plan: MissionPlan, clock_ns: Callable[[], int] = time.monotonic_ns, *, dry: bool = False
    ) -> None:
        self._clock_ns = clock_ns
        self._period_s = 1.0 / plan.spec.rate_hz
        self._late_s = plan.spec.limits.late_s
        self._dry = dry
        self._longest_s, self._in_tick_s = 0.0, 0.0
        self._ticks, self._slow, self._late = 0, 0, 0
        self._slowest, self._told = "", False
        self._within: tuple[str, int] | None = None  # who is being asked, and since when
        self.plan = replace(plan, own_code={key: self._watched(code) for key, code in plan.own_code.items()})

    def _watched(self, code: OwnCode) -> OwnCode:
        def make() -> Answer:
            answer = code.make()

            def asked(*given: object) -> object:
                begun_ns = self._clock_ns()
                self._within = code.use, begun_ns
                try:
                    return answer(*given)
                finally:
                    self._within = None
                    took_s = (self._clock_ns() - begun_ns) / 1e9
                    self._in_tick_s += took_s
                    if took_s > self._longest_s:
                        self._longest_s, self._slowest = took_s, code.use

            return asked

        return replace(code, make=make)

    def __call__(self, session: Session, now_ns: int) -> None:
        """Tells after a tick, once, that the code takes too long."""
        if self._dry:
            self._count()
            if not self._told and self.words():
                self._told = True
                session.notes.append(Note("alarm", f"{self._slowest} is too slow for vehicles, see the end"))
            return
        if not self._told and self._longest_s > _SHARE * self._period_s:
            self._told = True
            text = (
                f"{self._slowest} took {1000.0 * self._longest_s:.0f} ms, a tick has {1000.0 * self._period_s:.0f} ms"
                " for everything: make it faster, or lower rate_hz"
            )
            session.remark("alarm", text, now_ns)

    def _count(self) -> None:
        """Takes note of one tick of a dry run."""
        if self._in_tick_s > 0.0:
            self._ticks += 1
            self._slow += self._in_tick_s > _SHARE * self._period_s
            self._late += self._in_tick_s > self._period_s
            self._in_tick_s = 0.0

    def figures(self) -> dict[str, object]:
        """For the answer of a dry run: how long the code took; empty where there is none."""
        if not self.plan.own_code:
            return {}
        took = {"longest_s": self._longest_s, "ticks": self._ticks, "over_half": self._slow, "over_whole": self._late}
        return {"law_time": {**took, "words": self.words()}}

    def words(self) -> str:
        """What vehicles would have made of the time that the code took in a dry run; empty where it is quick."""
        often = max(_ENOUGH, _OFTEN * self._ticks)
        if self._longest_s > self._late_s:
            end = f"one call takes longer than limits.late_s, {self._late_s:g} s: everybody comes back"
        elif self._late > self._ticks / 2 and self._late >= _ENOUGH:
            end = "less than half of the ticks are made in time: everybody comes back"
        elif self._slow >= often:
            end = "ticks are late, and it is said"
        else:
            return ""
        return (
            f"{self._slowest} took {1000.0 * self._longest_s:.0f} ms at most, and more than half of its tick"
            f" ({1000.0 * self._period_s:.0f} ms) in {self._slow} of {self._ticks} ticks. A dry run waits for it; on"
            f" vehicles {end}. Make it faster, or lower rate_hz"
        )

    def stuck(self) -> str:
        """Words for a call that does not come back, empty when there is none."""
        within = self._within
        if within is None:
            return ""
        for_s = (self._clock_ns() - within[1]) / 1e9
        if for_s < _STUCK_S:
            return ""
        if self._dry:
            return f"gs: {within[0]} has not come back for {for_s:.0f} s; the dry run waits for it. Ctrl-\\ ends it"
        return (
            f"gs: {within[0]} has not come back for {for_s:.0f} s: setpoints have ended, the autopilots' own failsafe"
            " acts. gs cannot go on: take over by hand, or end it (Ctrl-\\) and start gs fly --take-over"
        )

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Looks for calls that do not come back while the block runs; prints to stderr, for nothing else can."""
        if not self.plan.own_code:
            yield
            return
        stop = Event()

        def look() -> None:
            while not stop.wait(_STUCK_S):
                words = self.stuck()
                if words:
                    sys.stderr.write(f"{words}\n")
                    sys.stderr.flush()

        thread = Thread(target=look, name="law watch", daemon=True)
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join()
