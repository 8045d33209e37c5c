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
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import yaml

from sitl.network import LinkConfig

if TYPE_CHECKING:
    from sitl.world import World

SECOND = 1_000_000_000
_NEVER = 1 << 62
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
_STATES = set(VEHICLE_KINDS) - {"position_jump", "position_drift", "reboot", "battery_level", "clock_jump"}
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


class FaultDesk:
    """Begins and ends the faults of one world.

    Attributes:
        active: what is wrong now, in order of beginning.
        next_ns: when something begins or ends next.
    """

    def __init__(self, world: World, faults: Sequence[Fault]) -> None:
        self._world = world
        self.active: list[tuple[Fault, int]] = []  # with the time of its end
        start_ns = world.config.start_ns
        self._waiting = sorted(
            ((start_ns + round(fault.at_s * SECOND), order, fault) for order, fault in enumerate(faults)), reverse=True
        )
        self._base = [(uplink.config, downlink.config) for uplink, downlink in world.links]
        self._check(faults)
        self._plan()

    def _check(self, faults: Sequence[Fault]) -> None:
        known = {vehicle.sysid for vehicle in self._world.config.vehicles}
        for fault in faults:
            for sysid in fault.vehicles:
                if sysid not in known:
                    raise FaultError(f"{fault.kind}: vehicles: {sysid} is not among the emulated ones")

    def _plan(self) -> None:
        begins = self._waiting[-1][0] if self._waiting else _NEVER
        self.next_ns = min([begins, *(end_ns for _, end_ns in self.active)])

    def act(self, now_ns: int) -> None:
        """Begins and ends what is due."""
        while self._waiting and self._waiting[-1][0] <= now_ns:
            at_ns, _, fault = self._waiting.pop()
            self._begin(fault, at_ns)
        for entry in [entry for entry in self.active if entry[1] <= now_ns]:
            self._end(entry)
        self._plan()

    def inject(self, *faults: Fault) -> None:
        """Begins faults now, whatever their ``at_s``; all, or none when a vehicle is not there (FaultError)."""
        self._check(faults)
        for fault in faults:
            self._begin(fault, self._world.now_ns)
        self._plan()

    def clear(self) -> None:
        """Ends everything that is wrong now; what has not begun is forgotten."""
        self._waiting.clear()
        for entry in list(self.active):
            self._end(entry)
        self._plan()

    def _indices(self, fault: Fault) -> list[int]:
        vehicles = self._world.config.vehicles
        return [i for i, vehicle in enumerate(vehicles) if not fault.vehicles or vehicle.sysid in fault.vehicles]

    def _begin(self, fault: Fault, at_ns: int) -> None:
        end_ns = _NEVER if fault.for_s is None else at_ns + round(fault.for_s * SECOND)
        self.active.append((fault, end_ns))
        self._apply(fault, True)

    def _end(self, entry: tuple[Fault, int]) -> None:
        self.active.remove(entry)
        self._apply(entry[0], False)

    def _apply(self, fault: Fault, on: bool) -> None:
        if fault.kind in LINK_KINDS:
            self._set_links()
            return
        world = self._world
        for i in self._indices(fault):
            self._apply_to(fault, i, on)
        world.estimator.refresh()

    def _apply_to(self, fault: Fault, i: int, on: bool) -> None:
        estimator, kind = self._world.estimator, fault.kind
        if kind == "position_jump":
            jump = [fault.number(axis) for axis in ("east_m", "north_m", "up_m")]
            estimator.offset_enu_m[:, i] += jump if on else [-value for value in jump]
        elif kind == "position_drift":
            drift = [fault.number(axis) for axis in ("east_m_s", "north_m_s", "up_m_s")]
            estimator.drift_enu_m_s[:, i] += drift if on else [-value for value in drift]
        elif kind in _STATES:
            self._set_state(kind, i)
        elif on:
            self._once(fault, i)

    def _set_state(self, kind: str, i: int) -> None:
        """Gives a vehicle what all active faults of one kind add up to."""
        world, pilot = self._world, self._world.autopilots[i]
        faults = [fault for fault, _ in self.active if fault.kind == kind and i in self._indices(fault)]
        on = bool(faults)
        if kind == "position_frozen":
            if on and not world.frozen[i]:
                world.frozen_pos_enu_m[:, i] = pilot.pos_est()
            world.frozen[i] = on
        elif kind == "position_nan":
            world.invalid[i] = on
        elif kind == "heartbeat_missing":
            world.muted["HEARTBEAT"][i] = on
        elif kind == "battery_drain":
            pilot.battery.extra_per_s = sum(fault.number("percent_per_s") for fault in faults) / 100.0
        elif kind == "motor_failure":
            world.dynamics.tumbling[i] = on
            world.motor_share[i] = min((fault.number("thrust_share") for fault in faults), default=1.0)
        elif kind == "arming_refused":
            pilot.deny_arming = on
        elif kind == "commands_ignored":
            pilot.ignore_commands = on

    def _once(self, fault: Fault, i: int) -> None:
        """The faults that happen at one moment."""
        world = self._world
        if fault.kind == "reboot":
            world.reboot(i)
        elif fault.kind == "clock_jump":
            world.clock_offset_ns[i] += round(fault.number("seconds") * SECOND)
        elif fault.kind == "battery_level":
            world.autopilots[i].battery.left = fault.number("percent") / 100.0

    def _set_links(self) -> None:
        """Gives every link what all active faults of it add up to."""
        for i, (channels, base) in enumerate(zip(self._world.links, self._base, strict=True)):
            for channel, config, direction in zip(channels, base, ("up", "down"), strict=True):
                changed = config
                for fault, _ in self.active:
                    concerns = fault.kind in LINK_KINDS and fault.direction in (direction, "both")
                    if concerns and i in self._indices(fault):
                        changed = _worsened(changed, fault)
                channel.config = changed


def _worsened(config: LinkConfig, fault: Fault) -> LinkConfig:
    """A link with one more fault: delays add up, of two probabilities the larger counts."""
    kind = fault.kind
    if kind == "blackout":
        return replace(config, blackout=True)
    if kind == "delay":
        return replace(config, delay_ns=config.delay_ns + round(fault.number("seconds") * SECOND))
    if kind == "jitter":
        return replace(config, jitter_ns=config.jitter_ns + round(fault.number("seconds") * SECOND))
    probability = fault.number("probability")
    if kind == "burst":
        return replace(
            config,
            burst_start=max(config.burst_start, probability),
            burst_ns=round(fault.number("length_s") * SECOND),
        )
    if kind == "reorder":
        return replace(
            config, reorder=max(config.reorder, probability), reorder_ns=round(fault.number("by_s") * SECOND)
        )
    return replace(config, **{kind: max(getattr(config, kind), probability)})
