"""Things that go wrong, on a timetable or at run time: links, estimates, batteries, motors, clocks, manners.

A timetable is YAML::

    faults:
      - {kind: loss, at_s: 10, for_s: 5, vehicles: [3], probability: 0.3, direction: down}
      - {kind: motor_failure, at_s: 20, vehicles: [2]}

``at_s`` counts from power-up of the world; without ``for_s`` a fault lasts for good; without ``vehicles`` (system ids)
it concerns all. ``KINDS`` says what each kind takes. Everything random comes from the world's seed. Refuses unknown
kinds, unknown keys and numbers out of range.
"""

from __future__ import annotations

import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import yaml

_TIME_MAX_S = 1e6
_WHOLE_MAX = 1 << 62  # beyond this a whole number of a file is a mistake, and may not even fit a float
_BYTES_MAX = 1 << 20
_DEPTH_MAX = 100
_short = reprlib.repr  # people write anything, of any length and depth


class _ShallowLoader(yaml.SafeLoader):
    """Safe loader that does not read what is nested deeply: its time grows with the cube of the depth."""

    def fetch_flow_collection_start(self, TokenClass: Any) -> None:
        if self.flow_level >= _DEPTH_MAX:
            raise RecursionError
        super().fetch_flow_collection_start(TokenClass)


class FaultError(ValueError):
    """A timetable of faults is wrong; the message says where, the value, the limit."""


class Number(NamedTuple):
    """One number that a kind of fault takes: default (None when it has to be given) and limits."""

    default: float | None
    low: float
    high: float


PROBABILITY = Number(None, 0.0, 1.0)
LINK_KINDS: dict[str, dict[str, Number]] = {
    "loss": {"probability": PROBABILITY},
    "burst": {"probability": PROBABILITY, "length_s": Number(0.3, 0.001, 60.0)},
    "duplicate": {"probability": PROBABILITY},
    "reorder": {"probability": PROBABILITY, "by_s": Number(0.03, 0.0, 10.0)},
    "delay": {"seconds": Number(None, 0.0, 60.0)},
    "jitter": {"seconds": Number(None, 0.0, 10.0)},
    "corrupt": {"probability": PROBABILITY},
    "blackout": {},
}
"""Faults of a link; they take ``direction`` too: up (to the vehicle), down, or both."""
VEHICLE_KINDS: dict[str, dict[str, Number]] = {
    "position_frozen": {},
    "position_jump": {axis: Number(0.0, -1e6, 1e6) for axis in ("east_m", "north_m", "up_m")},
    "position_nan": {},
    "position_drift": {axis: Number(0.0, -100.0, 100.0) for axis in ("east_m_s", "north_m_s", "up_m_s")},
    "gps_lost": {"east_m_s2": Number(0.09, -10.0, 10.0), "north_m_s2": Number(-0.09, -10.0, 10.0)},
    "heartbeat_missing": {},
    "battery_drain": {"percent_per_s": Number(None, 0.0, 100.0)},
    "battery_level": {"percent": Number(None, 0.0, 100.0)},
    "motor_failure": {"thrust_share": Number(0.6, 0.0, 1.0)},
    "reboot": {},
    "arming_refused": {},
    "commands_ignored": {},
    "clock_jump": {"seconds": Number(None, -1e6, 1e6)},
}
"""Faults of a vehicle."""
KINDS = {**LINK_KINDS, **VEHICLE_KINDS}
DIRECTIONS = ("up", "down", "both")


@dataclass(frozen=True)
class Fault:
    """One fault.

    Attributes:
        kind: key of ``KINDS``.
        at_s: when it begins, after power-up of the world.
        for_s: how long it lasts; None for good.
        vehicles: system ids; empty for all.
        numbers: what the kind takes.
        direction: of link faults.
    """

    kind: str
    at_s: float = 0.0
    for_s: float | None = None
    vehicles: tuple[int, ...] = ()
    numbers: Mapping[str, float] = field(default_factory=dict)
    direction: str = "both"

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise FaultError(f"kind: {self.kind!r} is unknown; choose one of {', '.join(KINDS)}")
        if self.direction not in DIRECTIONS:
            raise FaultError(f"direction: {self.direction!r} is unknown; choose one of {', '.join(DIRECTIONS)}")
        takes = KINDS[self.kind]
        for name, number in takes.items():
            value = self.numbers.get(name, number.default)
            if value is None:
                raise FaultError(f"{name}: missing; {self.kind} needs a number from {number.low} to {number.high}")
            if not number.low <= value <= number.high:
                raise FaultError(f"{name}: {value}, limits {number.low} and {number.high}")
        unknown = set(self.numbers) - set(takes)
        if unknown:
            raise FaultError(f"{sorted(unknown)[0]}: unknown; {self.kind} takes {', '.join(takes) or 'no numbers'}")
        for name, value in (("at_s", self.at_s), ("for_s", self.for_s)):
            if value is not None and not 0.0 <= value <= _TIME_MAX_S:
                raise FaultError(f"{name}: {value}, has to be 0 or more, up to {_TIME_MAX_S:.0f}")

    def record(self) -> dict[str, object]:
        """As an entry of a timetable, for ``parse_fault``: what has its default and says nothing is left out."""
        values: dict[str, object] = {"kind": self.kind, "at_s": self.at_s, **self.numbers}
        values |= {} if self.for_s is None else {"for_s": self.for_s}
        values |= {"vehicles": list(self.vehicles)} if self.vehicles else {}
        return values | ({} if self.direction == "both" else {"direction": self.direction})

    def number(self, name: str) -> float:
        """A number of this fault, or its default."""
        default = KINDS[self.kind][name].default
        return float(self.numbers[name] if default is None else self.numbers.get(name, default))


def parse_fault(data: Any) -> Fault:
    """Makes a fault of one entry of a timetable.

    Raises:
        FaultError: naming the key, the value and the limit.
    """
    if not isinstance(data, Mapping) or "kind" not in data:
        raise FaultError(f"{_short(data)}: a mapping with a kind is needed, like {{kind: blackout, at_s: 5}}")
    if not isinstance(data["kind"], str):
        raise FaultError(f"kind: {_short(data['kind'])} is unknown; choose one of {', '.join(KINDS)}")
    rest = {key: value for key, value in data.items() if key not in ("kind", "at_s", "for_s", "vehicles", "direction")}
    for name in ("at_s", "for_s", *rest):
        value = data.get(name)
        if name in data and name != "for_s" and value is None:
            raise FaultError(f"{_short(name)}: null is no number")
        if value is not None and (isinstance(value, bool) or not isinstance(value, int | float)):
            raise FaultError(f"{name}: {_short(value)} is no number")
        if isinstance(value, int) and abs(value) > _WHOLE_MAX:
            raise FaultError(f"{name}: {_short(value)} is out of all bounds")
    vehicles = data.get("vehicles", ())
    if not isinstance(vehicles, Sequence) or not all(type(v) is int and 1 <= v <= 255 for v in vehicles):
        raise FaultError(f"vehicles: {_short(vehicles)}, a list of system ids from 1 to 255 is needed")
    if "direction" in data and data["kind"] not in LINK_KINDS:
        raise FaultError(f"direction: {data['kind']} has none; only faults of a link do")
    return Fault(
        kind=data["kind"],
        at_s=float(data.get("at_s", 0.0)),
        for_s=None if data.get("for_s") is None else float(data["for_s"]),
        vehicles=tuple(vehicles),
        numbers={str(key): float(value) for key, value in rest.items()},
        direction=str(data.get("direction", "both")),
    )


def parse_faults(text: str, source: str = "faults") -> tuple[Fault, ...]:
    """Reads a timetable.

    Args:
        text: YAML with a list under ``faults``, or the list alone.
        source: name for messages.

    Raises:
        FaultError: naming the entry, the key, the value and the limit.
    """
    try:
        # Aliases of aliases grow beyond all bounds when they are merged or told.
        aliases = any(isinstance(event, yaml.AliasEvent) for event in yaml.parse(text, Loader=_ShallowLoader))
        data = None if aliases else yaml.load(text, Loader=_ShallowLoader)  # noqa: S506 - a SafeLoader
    except yaml.YAMLError as error:
        raise FaultError(f"{source}: is no YAML: {' '.join(str(error).split())}") from error
    except RecursionError as error:
        raise FaultError(f"{source}: is nested too deeply; a list of mappings is needed") from error
    except (OverflowError, ValueError, TypeError, AttributeError, LookupError) as error:
        # numbers and dates that YAML knows and Python cannot hold; and PyYAML's own mistakes
        raise FaultError(f"{source}: holds a value that cannot be read: {error}") from error
    if aliases:
        raise FaultError(f"{source}: aliases (*name) are not taken; write the values out")
    if isinstance(data, Mapping):
        unknown = set(data) - {"faults"}
        if unknown:
            raise FaultError(f"{source}: {sorted(map(str, unknown))[0]}: unknown key; only faults is known")
        data = data.get("faults")
    if data is None:
        return ()
    if not isinstance(data, list):
        raise FaultError(f"{source}: faults: a list is needed, not {type(data).__name__}")
    faults = []
    for k, entry in enumerate(data):
        try:
            faults.append(parse_fault(entry))
        except FaultError as error:
            raise FaultError(f"{source}: faults[{k}].{error}") from error
    return tuple(faults)


def load_faults(path: Path) -> tuple[Fault, ...]:
    """Reads a timetable from a file.

    Raises:
        FaultError: it cannot be read, or is wrong.
    """
    try:
        with path.open("rb") as file:
            content = file.read(_BYTES_MAX + 1)
        if len(content) > _BYTES_MAX:
            raise FaultError(f"{path}: is longer than {_BYTES_MAX} bytes")
        text = content.decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise FaultError(f"{path}: cannot be read: {error}") from error
    return parse_faults(text, str(path))
