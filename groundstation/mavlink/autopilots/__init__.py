"""The autopilots that can be flown: one folder each, which is found by being here.

A folder is a package of the autopilot's name whose ``AUTOPILOT`` says how it is asked for things
(``groundstation.mavlink.autopilot``). Nothing else in the ground station names a kind of autopilot.
"""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules

from groundstation.mavlink.autopilot import Autopilot

AUTOPILOTS: dict[str, Autopilot] = {}
"""By name; the usual one first, then in the order of their names."""


def discover() -> None:
    """Fills the table with what stands in the folders on this package's path.

    Raises:
        ValueError: an autopilot has another name than its folder.
    """
    found: list[Autopilot] = []
    for folder in iter_modules(__path__):
        found.append(import_module(f"{__name__}.{folder.name}").AUTOPILOT)
        if found[-1].name != folder.name:
            raise ValueError(f"autopilot {found[-1].name}: its folder is {folder.name}; it needs the same name")
    AUTOPILOTS.clear()
    AUTOPILOTS.update({item.name: item for item in sorted(found, key=lambda item: (not item.usual, item.name))})


discover()
