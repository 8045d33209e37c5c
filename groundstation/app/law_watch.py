"""Watches how long a law or avoidance of one's own takes in flights on the wall clock, and tells people.

Tells only: what is done about ticks that come late is the monitors' business, which go by the ticks alone and do the
same in a replay. A call that does not come back stops the setpoints, and the autopilots' own failsafe acts; nobody
would know why, so a thread says it.
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

_SHARE = 0.5  # of a tick; the rest is for everything else
_STUCK_S = 1.0


class LawWatch:
    """Looks after the code of one flight.

    Args:
        plan: what is flown.
        clock_ns: the wall clock.

    Attributes:
        plan: the same, with code that is watched.
    """

    def __init__(self, plan: MissionPlan, clock_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self._clock_ns = clock_ns
        self._period_s = 1.0 / plan.spec.rate_hz
        self._longest_s = 0.0
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
                    if took_s > self._longest_s:
                        self._longest_s, self._slowest = took_s, code.use

            return asked

        return replace(code, make=make)

    def __call__(self, session: Session, now_ns: int) -> None:
        """Tells after a tick, once, that the code takes too long."""
        if not self._told and self._longest_s > _SHARE * self._period_s:
            self._told = True
            text = (
                f"{self._slowest} took {1000.0 * self._longest_s:.0f} ms, a tick has {1000.0 * self._period_s:.0f} ms"
                " for everything: make it faster, or lower rate_hz"
            )
            session.remark("alarm", text, now_ns)

    def stuck(self) -> str:
        """Words for a call that does not come back, empty when there is none."""
        within = self._within
        if within is None:
            return ""
        for_s = (self._clock_ns() - within[1]) / 1e9
        if for_s < _STUCK_S:
            return ""
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
