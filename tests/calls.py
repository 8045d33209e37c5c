"""Counts what is done, or worked out for the whole team, twice in one tick.

Two calls count as the same when object, method and all arguments are. Questions about one vehicle, answered by a word
or a number, may be asked by whoever wants to know.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterator
from types import FunctionType

import numpy as np
import pytest

import groundstation.mission
from groundstation.mavlink.vehicle import Fleet
from groundstation.mission.flight.guidance import Guide
from groundstation.mission.flight.poses import Poses
from groundstation.mission.flight.surroundings import Surroundings
from groundstation.mission.monitors.resting import Resting
from groundstation.mission.runner import Runner

KEPT = {
    "Standing.at": "kept by the tick's time; what it asks of the fleet is counted",
    "Standing.airborne": "the same",
    "Killing.not_shown": "the same; whoever is killed in the tick is looked at anew",
}
MAY = {
    "Fleet.silent": "by the fleet itself too, which tells silence from missing heartbeats",
    "Columns.need_m": "of one vehicle that is about to land: for its place, and for who is below",
    "Fleet.heartbeat_stale": "by the monitor of heartbeats, and by who waits until everybody is down",
    "Placement.from_anchor": "the same place, compared with the pad and with the local position",
    "TeamFrame.pose_ns": "while vehicles are taken over: for who hits the ground, and for whom to hold",
    "Team.absent": "before landings are asked for, which changes who follows, and after that",
}
"""What may be asked twice, and why."""
INSIDE: dict[type, tuple[str, ...]] = {
    Guide: ("_look_near",),
    Surroundings: ("_look_around", "_find_reach_m", "_find_wider_m"),
    Resting: ("_take",),
}
"""What is counted although only its own class asks for it: the work for all pairs, twice when somebody flies apart."""


def _value(item: object) -> Hashable:
    if isinstance(item, np.ndarray):
        return item.shape, item.tobytes()
    return item if isinstance(item, int | float | str | bool | None) else id(item)


class Calls:
    """Counts calls within a tick.

    Attributes:
        twice: how often what was called a second time, but for what ``MAY`` be.
        counted: everything that was called.
    """

    def __init__(self) -> None:
        self.twice: dict[str, int] = defaultdict(int)
        self.counted: set[str] = set()
        self._seen: set[Hashable] = set()
        self._alive: list[object] = []  # so that no identity is given to another object within the tick

    def counting(self, name: str, function: FunctionType) -> Callable[..., object]:
        """The function, with its calls counted."""

        acts = function.__annotations__.get("return") == "None"

        def call(*args: object, **more: object) -> object:
            key = (name, tuple(map(_value, args)), tuple((word, _value(item)) for word, item in sorted(more.items())))
            again = key in self._seen
            self._seen.add(key)
            self._alive += (*args, *more.values())
            result = function(*args, **more)
            self.counted.add(name)
            inside = name.partition(".")[2].startswith("_")
            if again and (acts or inside or isinstance(result, np.ndarray | Poses)) and name not in KEPT | MAY:
                self.twice[name] += 1
            return result

        return call

    def ticking(self, step: Callable[[Runner, int], object]) -> Callable[[Runner, int], object]:
        """A tick, at whose beginning everything is forgotten."""

        def tick(runner: Runner, now_ns: int) -> object:
            self._seen.clear()
            self._alive.clear()
            return step(runner, now_ns)

        return tick


def _classes() -> Iterator[type]:
    """Those of the mission package that act in flight, and the fleet."""
    yield Fleet
    for module in pkgutil.walk_packages(groundstation.mission.__path__, "groundstation.mission."):
        if not module.name.startswith(("groundstation.mission.plan", "groundstation.mission.timing")):
            for _, found in inspect.getmembers(importlib.import_module(module.name), inspect.isclass):
                if found.__module__ == module.name:
                    yield found


def count_calls(monkeypatch: pytest.MonkeyPatch) -> Calls:
    """Counts from now on, until the test is over."""
    calls = Calls()
    for found in _classes():
        for name, method in list(vars(found).items()):
            counts = not name.startswith("_") or name in INSIDE.get(found, ())
            if isinstance(method, FunctionType) and counts and (found, name) != (Runner, "step"):
                monkeypatch.setattr(found, name, calls.counting(f"{found.__name__}.{name}", method))
    monkeypatch.setattr(Runner, "step", calls.ticking(Runner.step))
    return calls
