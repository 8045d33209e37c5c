"""MAVSDK, as a program of its own would use it: subscriptions turned into waits with a limit."""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

from mavsdk import ComponentType, Configuration, Mavsdk

LIMIT_S = 20.0


@contextlib.contextmanager
def connected(url: str, systems: int) -> Iterator[dict[int, Any]]:
    """Opens a connection and waits for that many systems; system by system id."""
    mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    try:
        found = threading.Event()
        mavsdk.subscribe_on_new_system(lambda _: found.set() if mavsdk.system_count() >= systems else None)
        mavsdk.add_any_connection(url)
        if mavsdk.system_count() < systems:
            assert found.wait(LIMIT_S), f"{mavsdk.system_count()} of {systems} systems found"
        yield {system.get_system_id(): system for system in mavsdk.get_systems()}
    finally:
        mavsdk.destroy()


def wait_for(plugin: Any, what: str, condition: Callable[[Any], bool], limit_s: float = LIMIT_S) -> Any:
    """Waits for a value of a telemetry subscription that meets a condition, and returns it."""
    values: queue.Queue[Any] = queue.Queue()
    handle = getattr(plugin, f"subscribe_{what}")(lambda value, *_: values.put(value))
    deadline = time.monotonic() + limit_s
    value = None
    try:
        while True:
            try:
                value = values.get(timeout=max(deadline - time.monotonic(), 0.001))
            except queue.Empty:
                raise AssertionError(f"{what}: not within {limit_s} s; last {value}") from None
            if condition(value):
                return value
    finally:
        getattr(plugin, f"unsubscribe_{what}")(handle)
