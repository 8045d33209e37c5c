"""The autopilots that can be emulated: one folder each, which is found by being here.

A folder is a package of the autopilot's name whose ``PERSONALITY`` is its record (``sitl.personality``). Nothing else
in the program names a kind of autopilot that is emulated; the tables below are put together from the records.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pkgutil import iter_modules
from typing import TypeVar

from sitl.estimator import GPS, MOCAP, NOISELESS, Noise
from sitl.personality import Personality
from sitl.profiles import Profile
from sitl.streams import QUIET_RATES_HZ

T = TypeVar("T")
PERSONALITIES: dict[str, Personality] = {}
"""By name; the usual one first, then in the order of their names."""
PROFILES: dict[str, Profile] = {}
"""Ways of flying by name, as the personalities bring them along."""
NOISES: dict[str, Noise] = {}
"""Errors of estimates by name."""
RATES_HZ: dict[str, Mapping[str, float]] = {}
"""Sets of streams by name."""


def discover() -> None:
    """Fills the tables with what stands in the folders on this package's path.

    Raises:
        ValueError: a record has another name than its folder, or two bring something along under the same name.
    """
    records: list[Personality] = []
    for found in iter_modules(__path__):
        records.append(import_module(f"{__name__}.{found.name}").PERSONALITY)
        if records[-1].name != found.name:
            raise ValueError(f"personality {records[-1].name}: its folder is {found.name}; it needs the same name")
    for table in (PERSONALITIES, PROFILES, NOISES, RATES_HZ):
        table.clear()
    NOISES.update(none=NOISELESS, mocap=MOCAP, gps=GPS)
    RATES_HZ["quiet"] = QUIET_RATES_HZ
    for record in sorted(records, key=lambda item: (not item.usual, item.name)):
        _add(PERSONALITIES, {record.name: record}, record)
        _add(PROFILES, {profile.name: profile for profile in record.profiles}, record)
        _add(NOISES, record.noises, record)
        _add(RATES_HZ, record.rates_hz, record)


def _add(table: dict[str, T], more: Mapping[str, T], record: Personality) -> None:
    for name, value in more.items():
        if name in table:
            raise ValueError(f"personality {record.name}: there is another {name}; choose another name for its own")
        table[name] = value


discover()
