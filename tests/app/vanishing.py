"""What becomes of a team whose ground station vanishes: nothing is sent any more, the emulator goes on."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import numpy as np

from groundstation.mission.plan.plan import MissionPlan
from sitl.world import World
from tests.app.flights import SECOND_NS, Flight

_LOOK_NS = 20_000_000


class _VanishedError(Exception):
    """Ends the loop as a SIGKILL would."""


class Vanished:
    """A flight whose ground station vanished.

    Attributes:
        flight: as far as it came.
        min_distance_m: smallest true distance from then on of two vehicles of which one at least was off the ground.
        down_s: from the last heartbeat until all were down and disarmed; NaN where somebody was still up in the end.
        modes: names of the modes that each vehicle went through from then on.
        held_m: how far anybody moved in the ten seconds after it had stopped.
    """

    def __init__(
        self,
        plan: MissionPlan,
        when: Callable[[Flight], bool],
        *,
        seed: int = 1,
        watch_s: float = 220.0,
        prepare: Callable[[World], None] | None = None,
    ) -> None:
        kept: list[Flight] = []

        def vanish(flight: Flight) -> bool:
            if when(flight):
                kept.append(flight)
                raise _VanishedError
            return False

        with suppress(_VanishedError):
            Flight(plan, seed=seed, interrupt_when=vanish, prepare=prepare)
        (self.flight,) = kept
        world = self.flight.world
        self.min_distance_m = np.inf
        self.down_s = np.nan
        self.modes: list[list[str]] = [[pilot.mode_name()] for pilot in world.autopilots]
        begin_ns = now_ns = world.now_ns
        first, second = np.triu_indices(plan.size, 1)
        at: dict[int, np.ndarray] = {}
        while now_ns - begin_ns < watch_s * SECOND_NS:
            now_ns += _LOOK_NS
            world.advance(now_ns)
            truth = world.truth
            apart_m = np.linalg.norm(truth.pos_enu_m[first] - truth.pos_enu_m[second], axis=1)
            counts = truth.airborne[first] | truth.airborne[second]
            self.min_distance_m = min(self.min_distance_m, float(np.where(counts, apart_m, np.inf).min()))
            for modes, pilot in zip(self.modes, world.autopilots, strict=True):
                if modes[-1] != pilot.mode_name():
                    modes.append(pilot.mode_name())
            seconds = (now_ns - begin_ns) / SECOND_NS
            if seconds in (8.0, 18.0):
                at[round(seconds)] = truth.pos_enu_m
            if not truth.armed.any() and not truth.airborne.any():
                self.down_s = seconds
                break
        self.held_m = float(np.linalg.norm(at[18] - at[8], axis=1).max()) if len(at) == 2 else np.nan
