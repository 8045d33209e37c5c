"""What a gateway is told when it begins, and how that is written: one line of JSON on its standard input.

A gateway that takes the place of one that has died knows nothing of its vehicles; whoever started it does.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from typing import TypeGuard

from groundstation.gateway.orders import Place


@dataclass(frozen=True)
class Handover:
    """What is known of one vehicle.

    Attributes:
        flies: it is in the air by all that is known: it is told to stay where it is, before all else.
        home_enu_m: where it took off, in the room's frame; None where nobody knows.
        settings: of the gateway, by name.
    """

    flies: bool = False
    home_enu_m: Place | None = None
    settings: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class RoomWord:
    """The motion capture that the vehicles fly by, for when the flight is silent.

    Attributes:
        link: where its frames come in.
        by_place: bodies are told apart by their places.
        speed_m_s: no vehicle is faster.
        hz: poses a second that each is to be told.
    """

    link: str
    by_place: bool
    speed_m_s: float
    hz: float


def written(vehicles: Mapping[int, Handover], room: RoomWord | None = None) -> str:
    """One line, by system id."""
    told: dict[str, object] = {
        str(sysid): {"flies": item.flies, "home": item.home_enu_m, "settings": dict(item.settings)}
        for sysid, item in vehicles.items()
    }
    return json.dumps(told if room is None else told | {"room": asdict(room)})


def read_room(line: str) -> RoomWord | None:
    """The room of a line, where it has one."""
    try:
        told = json.loads(line)
    except ValueError:
        return None
    room = told.get("room") if isinstance(told, dict) else None
    if not isinstance(room, dict) or not isinstance(link := room.get("link"), str):
        return None
    speed, hz = room.get("speed_m_s"), room.get("hz")
    if not (_is_number(speed) and _is_number(hz) and float(speed) > 0.0 and float(hz) > 0.0):
        return None
    return RoomWord(link, room.get("by_place") is True, float(speed), float(hz))


def read(line: str) -> dict[int, Handover]:
    """The inverse of ``written``; what is not understood is left out, for a vehicle may wait to be told to stay."""
    try:
        told = json.loads(line)
    except ValueError:
        return {}
    found: dict[int, Handover] = {}
    for sysid, item in told.items() if isinstance(told, dict) else ():
        if not (isinstance(item, dict) and str(sysid).isdecimal()):
            continue
        given = item.get("settings")
        settings = given if isinstance(given, dict) else {}
        found[int(sysid)] = Handover(
            flies=item.get("flies") is True,
            home_enu_m=_place(item.get("home")),
            settings={str(name): float(value) for name, value in settings.items() if _is_number(value)},
        )
    return found


def _place(values: object) -> Place | None:
    if not (isinstance(values, Iterable) and not isinstance(values, str)):
        return None
    numbers = [float(value) for value in values if _is_number(value)]
    return (numbers[0], numbers[1], numbers[2]) if len(numbers) == 3 else None


def _is_number(value: object) -> TypeGuard[int | float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
