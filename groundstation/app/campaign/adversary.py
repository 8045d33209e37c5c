"""Missions at random, and what an adversary does to them: all of a run follows from the campaign's seed and its number.

A mission is written as a user would write it, files and all, and read by the same code; one that is refused is drawn
anew, since refusing is right. What is believed about the vehicles is told wrongly, within what the docs take: lag and
delay by a fifth, positions up to as far off as is told. Refuses to fly anything.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
import yaml

from groundstation.app.campaign.plot import PILOTS, STRANGERS, Event
from groundstation.app.campaign.vary import AdversarySpec
from groundstation.app.gateway.emulated import BEHIND_A_GATEWAY
from groundstation.app.resources import packaged_configs
from groundstation.core.errors import UserError
from groundstation.core.types import FloatArray
from groundstation.design.store import load_formation
from groundstation.mavlink.autopilots import AUTOPILOTS
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.profiles import PROFILES
from groundstation.mission.plan.reading import load_mission
from groundstation.records.manifest import Values
from sitl.faults import Fault
from sitl.personalities import PERSONALITIES

_Option = TypeVar("_Option")
_TRIES = 200
_PACKAGED = {
    2: ("pair2",),
    4: ("tetrahedron4",),
    5: ("pyramid5",),
    6: ("pyramid6",),
    8: ("cube8", "two_squares8_low", "two_squares8_high"),
}
_PHASES = ("ground", "takeoff", "form", "hold", "move", "return", "land")
_PHASE_WEIGHTS = (0.06, 0.14, 0.24, 0.2, 0.1, 0.14, 0.12)
_VEHICLE_KINDS: Mapping[str, float] = {
    "position_frozen": 1.0,
    "position_jump": 1.5,
    "position_nan": 1.0,
    "position_drift": 1.0,
    "heartbeat_missing": 1.0,
    "battery_level": 2.5,
    "battery_drain": 1.0,
    "motor_failure": 2.0,
    "reboot": 1.0,
    "arming_refused": 0.5,
    "commands_ignored": 1.0,
    "clock_jump": 1.0,
    "blackout": 2.0,
    "loss": 1.0,
    "burst": 0.5,
    "delay": 1.0,
    "jitter": 0.5,
    "duplicate": 0.5,
    "reorder": 0.5,
    "corrupt": 1.0,
}
_OUTDOOR_KINDS: Mapping[str, float] = {**_VEHICLE_KINDS, "gps_lost": 1.5}
_LINK_KINDS = frozenset({"blackout", "loss", "burst", "delay", "jitter", "duplicate", "reorder", "corrupt"})
_LASTING = frozenset({"position_jump", "reboot", "clock_jump", "battery_level"})
_ORDERS: Mapping[str, float] = {
    "hold": 3.0,
    "return": 1.5,
    "resume": 0.5,
    "land one": 3.0,
    "land all": 1.5,
    "kill one": 1.5,
    "kill all": 0.2,
    "silence": 0.2,
    "Ctrl-C": 0.7,
    "keys": 1.5,
    "nonsense": 0.5,
}
_KEYS = (
    "h",
    "r",
    "b",
    "l{id}\r",
    "la\r",
    "k{id}\rkill\r",
    "k{id}\rno\r",
    "l\x1b[A\x1b",
    "\x1b[Bhhr",
    "lx\r",
    "K9999\r",
)
_NONSENSE = ("lnad 3", "land 999", "kill", "hold 3", "", "land " + "9" * 400, "RETURN NOW", "kill\x00all")


@dataclass(frozen=True)
class Drawn:
    """What was drawn for one run.

    Attributes:
        mission: as ``MissionPlan.record`` gives it; empty where reading it failed by a fault of ours.
        gains_npz: of its first formation.
        emulator: as the key of a vary file has it.
        events: what happens.
        words: in short, for the table.
        error: what reading the mission failed by, "" as a rule.
    """

    mission: Values
    gains_npz: bytes
    emulator: Values
    events: tuple[Event, ...]
    words: Values
    error: str = ""


def draw(spec: AdversarySpec, seed: int, run: int, changes: Sequence[str] = ()) -> Drawn:
    """Draws one run.

    Args:
        spec: how much of what.
        seed: of the campaign.
        run: number of the run.
        changes: ``key.path=value``, of every mission.

    Raises:
        UserError: no mission that can be flown was found; the changes leave no room.
    """
    last: UserError | None = None
    for number in range(_TRIES):
        source = np.random.SeedSequence(seed, spawn_key=(run, number))
        rng, events = (np.random.default_rng(child) for child in source.spawn(2))
        draft = _Draft(spec, rng)
        try:
            plan = draft.plan(changes)
        except UserError as error:
            last = error
            continue
        except Exception as error:  # a traceback at the desk: it is this run's result
            return Drawn({}, b"", {}, (), draft.words, f"{type(error).__name__}: {error}, reading a mission")
        return Drawn(
            plan.record(),
            plan.gains_npz,
            draft.emulator(spec, plan),
            _events(spec, plan, draft.size_m, events),
            draft.words,
        )
    raise UserError(f"adversary: run {run}: no mission can be flown of {_TRIES} drawn; the last one: {last}")


class _Draft:
    """One mission being written."""

    def __init__(self, spec: AdversarySpec, rng: np.random.Generator) -> None:
        self._rng = rng
        self.n = int(rng.integers(2, spec.vehicles + 1))
        self.outdoors = bool(rng.random() < spec.outdoors)
        self._radius_m = self._between(2.0, 3.0) if self.outdoors else self._between(0.3, 0.5)
        self.size_m = self._radius_m / 0.4  # a crazyflie's metre
        self._files: dict[str, dict[str, object]] = {}
        self._sigma_m = self._pick((0.01, 0.02))
        self._delay_s = self._pick((0.0, 0.0, self._between(0.01, 0.06)))
        self._values = self._mission()
        self.words = {
            "vehicles": self.n,
            "outdoors": self.outdoors,
            "autopilots": sorted({vehicle["autopilot"] for vehicle in self._values["vehicles"]}),
            "steps": [next(iter(step)) for step in self._values["steps"]],
            "shape": self._values["avoidance"]["shape"],
            "on_lost": self._values["on_lost"],
        }

    def plan(self, changes: Sequence[str]) -> MissionPlan:
        """Writes the files and reads them.

        Raises:
            UserError: the mission is refused.
        """
        with tempfile.TemporaryDirectory() as folder:
            for name, values in self._files.items():
                (Path(folder) / name).write_text(yaml.safe_dump(values), encoding="utf-8")
            path = Path(folder) / "mission.yaml"
            path.write_text(yaml.safe_dump(self._values), encoding="utf-8")
            return load_mission(path, tuple(changes))

    def _between(self, low: float, high: float) -> float:
        return round(float(self._rng.uniform(low, high)), 3)

    def _pick(self, options: Sequence[_Option], weights: Sequence[float] | None = None) -> _Option:
        share = None if weights is None else np.array(weights) / np.sum(weights)
        return options[int(self._rng.choice(len(options), p=share))]

    def _mission(self) -> Values:
        rng, size = self._rng, self.size_m
        pads = self._pads()
        formation, gains, scale = self._formation("formation")
        height = self._between(3.0, 5.0) if self.outdoors else self._between(0.5, 0.9)
        reach = 1.5 * size
        low, high = pads.min(axis=0) - reach, pads.max(axis=0) + reach
        steps = self._steps()
        values: dict[str, object] = {
            "name": "adversary",
            "formation": formation,
            "rate_hz": self._pick((20.0, 25.0, 50.0), (3, 2, 1)),
            "speed_limit_m_s": self._between(1.0, 2.0) if self.outdoors else self._between(0.4, 1.0),
            "scale": {"kind": self._pick(("arctan", "tanh")), "gain": round(2.5 / size, 3)},
            "avoidance": self._avoidance(),
            "takeoff": {"height_m": height, "timeout_s": 30.0},
            "steps": steps,
            "land": {"at": "pads", "timeout_s": 20.0},
            "on_lost": self._pick(("return_all", "continue_open", "continue_take_over")),
            "assignment": self._pick(("auto", "fixed"), (4, 1)),
            "fence": {
                "min_m": [float(low[0]), float(low[1]), 0.0],
                "max_m": [float(high[0]), float(high[1]), float(pads[:, 2].max() + height + 2.5 * size)],
            },
            "limits": {"hold_s": self._between(3.0, 8.0), "preflight_s": 20.0, "arming_s": 15.0},
            "failsafe": {
                "action": self._pick(("auto", "land", "hold"), (7, 1, 1)),
                "ceiling_m": 60.0 if self.outdoors else 8.0,
                "set_parameters": True,
            },
            "link_delay_s": round(2.0 * self._delay_s * self._between(0.9, 1.5), 4),
        }
        vehicles = self._vehicles(pads)
        values["vehicles"] = vehicles
        values |= {} if gains is None else {"gains": gains}
        values |= {} if scale is None else {"formation_scale": scale}
        if self.outdoors:
            values["positioning"] = "gps"
        else:
            values["position_error_m"] = self._sigma_m
        if rng.random() < 0.5:
            values["profiles"] = self._beliefs(vehicles)
        return values

    def _pads(self) -> FloatArray:
        """On a grid, a little off it; some on posts."""
        side = int(np.ceil(np.sqrt(self.n)))
        spacing = self.size_m * self._between(0.6, 1.3)
        grid = np.array([(i % side, i // side, 0.0) for i in range(side * side)]) - (side - 1) / 2.0
        grid[:, 2] = 0.0
        pads = spacing * grid[self._rng.permutation(side * side)[: self.n]]
        pads[:, :2] += self._rng.uniform(-0.1, 0.1, (self.n, 2)) * spacing
        if not self.outdoors and self._rng.random() < 0.15:
            pads[:, 2] = self._rng.choice([0.0, 0.0, 0.2, 0.4], self.n)
        return np.asarray(np.round(pads, 3))

    def _formation(self, name: str) -> tuple[str, str | None, float | None]:
        """File, gains and size of a packaged formation, or of one with points at random."""
        least = self._radius_m * self._between(1.4, 2.2)
        if self.n in _PACKAGED and self._rng.random() < 0.5:
            which = self._pick(_PACKAGED[self.n])
            path = packaged_configs() / "formations" / f"{which}.yaml"
            shape = load_formation(path)
            first, second = np.triu_indices(self.n, 1)
            shortest = float(np.linalg.norm((shape.points_enu_m[first] - shape.points_enu_m[second]), axis=1).min())
            scale = float(yaml.safe_load(path.read_text(encoding="utf-8")).get("scale", 1.0))
            return str(path), str(packaged_configs() / "gains" / f"{which}.npz"), round(scale * least / shortest, 3)
        points = self._column(least) if self._rng.random() < 0.1 else self._points(least)
        edges: object = "complete"
        if self.n > 4 and self._rng.random() < 0.3:
            pairs = [[i + 1, j + 1] for i in range(self.n) for j in range(i + 1, self.n)]
            gone = set(self._rng.permutation(len(pairs))[: int(self._rng.integers(1, self.n - 2))].tolist())
            edges = [pair for number, pair in enumerate(pairs) if number not in gone]
        file = f"{name}.yaml"
        self._files[file] = {"name": name, "points": points.tolist(), "edges": edges}
        return file, None, None

    def _column(self, least: float) -> FloatArray:
        """One above the other, or nearly."""
        points = np.zeros((self.n, 3))
        points[:, 2] = least * np.arange(self.n)
        points[:, :2] = self._rng.uniform(-1.0, 1.0, (self.n, 2)) * self._pick((0.0, 0.05, 0.3)) * self.size_m
        return np.asarray(np.round(points, 3))

    def _points(self, least: float) -> FloatArray:
        side = least * (1.2 + self.n ** (1 / 3))
        points = np.empty((0, 3))
        for _ in range(2000):
            point = self._rng.uniform(0.0, side, 3)
            if not len(points) or np.linalg.norm(points - point, axis=1).min() >= least:
                points = np.vstack([points, point])
                if len(points) == self.n:
                    break
        return np.asarray(np.round(points, 3))

    def _avoidance(self) -> dict[str, object]:
        radius = self._radius_m
        values: dict[str, object] = {
            "radius_m": radius,
            "activation_m": round(radius * self._between(1.1, 1.4), 3),
            "shape": self._pick(("sphere", "cylinder", "ellipsoid"), (8, 1, 1)),
        }
        if values["shape"] != "sphere":
            values["half_height_m"] = round(radius * self._between(1.0, 1.3), 3)
        return values

    def _steps(self) -> list[dict[str, Mapping[str, object]]]:
        size = self.size_m
        form = {"tolerance_m": 0.5 if self.outdoors else 0.12, "timeout_s": 40.0 if self.outdoors else 20.0}
        steps: list[dict[str, Mapping[str, object]]] = [{"form": dict(form)}]
        for number in range(int(self._rng.integers(0, 4))):
            kind = self._pick(("hold", "move", "form"), (3, 3, 1))
            if kind == "hold":
                steps.append({"hold": {"seconds": self._between(0.5, 3.0)}})
            elif kind == "move":
                by = [self._between(-0.5 * size, 0.5 * size) for _ in range(2)]
                move: dict[str, object] = {"by_m": [*by, self._between(-0.1 * size, 0.3 * size)]}
                if self._rng.random() < 0.4:
                    move["turn_deg"] = self._between(-120.0, 120.0)
                if self._rng.random() < 0.4:
                    move["scale"] = self._between(0.9, 1.3)
                steps.append({"move": move})
            else:
                name, gains, scale = self._formation(f"formation{number}")
                own = {"formation": name, "gains": gains, "formation_scale": scale}
                steps.append({"form": {**form, **{key: value for key, value in own.items() if value is not None}}})
        if len(steps) == 1:
            steps.append({"hold": {"seconds": 1.0}})
        return steps

    def _vehicles(self, pads: FloatArray) -> list[dict[str, object]]:
        ids = np.sort(self._rng.permutation(np.arange(1, 251))[: self.n]).tolist()
        known = tuple(name for name in AUTOPILOTS if name in PERSONALITIES and name not in BEHIND_A_GATEWAY)
        mixed = self._pick((*((name,) for name in known), known))
        links = self._pick((1, 1, 2))
        vehicles: list[dict[str, object]] = []
        for number, (sysid, pad) in enumerate(zip(ids, pads.tolist(), strict=True)):
            autopilot = mixed[number % len(mixed)]
            vehicles.append(
                {
                    "id": sysid,
                    "link": f"udpin://127.0.0.1:{14540 + number % links}",
                    "autopilot": autopilot,
                    "profile": AUTOPILOTS[autopilot].profile if self.outdoors else "crazyflie",
                    "pad_m": pad,
                    "origin": "gps" if self.outdoors else "pad",
                }
            )
        return vehicles

    def _beliefs(self, vehicles: list[dict[str, object]]) -> dict[str, object]:
        """Profiles with a lag and a delay that are not the vehicles' own."""
        profiles: dict[str, object] = {}
        for like in sorted({str(vehicle["profile"]) for vehicle in vehicles}):
            own = PROFILES[like]
            profiles[f"told_{like}"] = {
                "like": like,
                "lag_s": round(own.lag_s * self._between(0.8, 1.3), 3),
                "delay_s": round(own.delay_s * self._between(0.8, 1.5), 3),
            }
        for vehicle in vehicles:
            vehicle["profile"] = f"told_{vehicle['profile']}"
        return profiles

    def emulator(self, spec: AdversarySpec, plan: MissionPlan) -> dict[str, object]:
        """The world that it is flown in: no worse than the mission says, and not always as good."""
        values: dict[str, object] = {}
        if not self.outdoors:
            values["noise"] = {"position_m": round(self._sigma_m * self._between(0.3, 1.0), 4)}
        if self._delay_s or self._rng.random() < 0.3:
            values["link"] = {
                "delay_s": self._delay_s,
                "jitter_s": self._between(0.0, 0.01),
                "loss": self._between(0.0, 0.03),
                "duplicate": self._between(0.0, 0.02),
                "reorder": self._between(0.0, 0.02),
            }
        if self._rng.random() < spec.wind:
            speed, towards = self._between(0.0, plan.wind.mean_m_s), self._between(-np.pi, np.pi)
            values["wind_enu_m_s"] = [round(speed * float(w), 3) for w in (np.cos(towards), np.sin(towards))] + [0.0]
            values["gusts_m_s"] = self._between(0.0, plan.wind.gust_m_s)
        return values


def _events(spec: AdversarySpec, plan: MissionPlan, size_m: float, rng: np.random.Generator) -> tuple[Event, ...]:
    events: list[Event] = []
    ids = [vehicle.id for vehicle in plan.spec.vehicles]
    for _ in range(int(rng.integers(spec.faults + 1))):
        phase, delay_s = _when(rng)
        if events and rng.random() < 0.4:  # at once
            phase, delay_s = events[-1].phase, events[-1].delay_s
        events.append(Event(phase, delay_s, fault=_fault(ids, size_m, rng, outdoors=plan.positioning == "gps")))
    if rng.random() < 0.5:
        for _ in range(int(rng.integers(spec.orders + 1))):
            events += _order(ids, rng)
    if rng.random() < 0.3:
        for _ in range(int(rng.integers(spec.strangers + 1))):
            phase, delay_s = _when(rng)
            kind = STRANGERS[int(rng.integers(len(STRANGERS)))]
            for_s = round(float(rng.uniform(0.2, 1.0 if kind == "flood" else 8.0)), 2)
            events.append(
                Event(
                    phase,
                    delay_s,
                    stranger=kind,
                    vehicle=int(rng.integers(len(ids))),
                    for_s=for_s,
                    seed=int(rng.integers(2**31)),
                )
            )
    able = [row for row, autopilot in enumerate(plan.autopilots) if autopilot.by_hand]
    if able and rng.random() < spec.pilots:  # drawn last: what else happens is the same with and without
        phase, delay_s = _when(rng)
        pilot = PILOTS[int(rng.integers(len(PILOTS)))]
        events.append(Event(phase, delay_s, pilot=pilot, vehicle=able[int(rng.integers(len(able)))]))
    return tuple(events)


def _when(rng: np.random.Generator) -> tuple[str, float]:
    """A phase and a delay in it; often the very tick at which it is entered."""
    phase = str(rng.choice(_PHASES, p=_PHASE_WEIGHTS))
    return phase, 0.0 if rng.random() < 0.35 else round(float(rng.uniform(0.0, 4.0)), 2)


def _weighted(weights: Mapping[str, float], rng: np.random.Generator) -> str:
    share = np.array(list(weights.values()))
    return str(rng.choice(list(weights), p=share / share.sum()))


def _order(ids: Sequence[int], rng: np.random.Generator) -> list[Event]:
    phase, delay_s = _when(rng)
    one = int(rng.choice(np.array(ids)))
    kind = _weighted(_ORDERS, rng)
    if kind == "Ctrl-C":
        return [Event(phase, delay_s, interrupt=True)]
    if kind == "keys":
        return [Event(phase, delay_s, keys=_KEYS[int(rng.integers(len(_KEYS)))].format(id=one))]
    if kind == "nonsense":
        return [Event(phase, delay_s, order=_NONSENSE[int(rng.integers(len(_NONSENSE)))] or " ")]
    events = [Event(phase, delay_s, order=kind.replace("one", str(one)))]
    if kind == "hold" and rng.random() < 0.7:
        events.append(Event(phase, round(delay_s + float(rng.uniform(0.5, 5.0)), 2), order="resume"))
    return events


def _fault(ids: Sequence[int], size_m: float, rng: np.random.Generator, *, outdoors: bool) -> Fault:
    kind = _weighted(_OUTDOOR_KINDS if outdoors else _VEHICLE_KINDS, rng)
    numbers = {name: round(float(value), 3) for name, value in _numbers(kind, size_m, rng).items()}
    for_s = None if kind in _LASTING or rng.random() < 0.5 else round(float(rng.uniform(0.2, 4.0)), 2)
    everybody = kind in _LINK_KINDS and rng.random() < 0.15
    whom = () if everybody else (int(rng.choice(np.array(ids))),)
    direction = str(rng.choice(("both", "up", "down"))) if kind in _LINK_KINDS else "both"
    return Fault(kind, 0.0, for_s, whom, numbers, direction)


def _numbers(kind: str, size_m: float, rng: np.random.Generator) -> dict[str, float]:
    """What a kind of fault takes."""
    uniform = rng.uniform
    if kind == "position_jump":
        return {
            "east_m": size_m * uniform(-2, 2),
            "north_m": size_m * uniform(-2, 2),
            "up_m": size_m * uniform(-0.5, 0.5),
        }
    if kind == "position_drift":
        return {"east_m_s": size_m * uniform(-0.3, 0.3), "up_m_s": size_m * uniform(-0.05, 0.05)}
    if kind == "reorder":
        return {"probability": uniform(0.1, 0.5), "by_s": uniform(0.01, 0.2)}
    if kind == "burst":
        return {"probability": uniform(0.005, 0.03), "length_s": uniform(0.2, 0.8)}
    spans = {
        "battery_level": ("percent", 3.0, 30.0),
        "battery_drain": ("percent_per_s", 1.0, 10.0),
        "motor_failure": ("thrust_share", 0.2, 0.9),
        "delay": ("seconds", 0.05, 0.4),
        "jitter": ("seconds", 0.02, 0.2),
        "loss": ("probability", 0.05, 0.5),
        "duplicate": ("probability", 0.1, 0.5),
        "corrupt": ("probability", 0.02, 0.3),
    }
    if kind == "clock_jump":
        return {"seconds": float(rng.choice((-3600.0, -30.0, -1.0, 1.0, 30.0, 3600.0)))}
    if kind not in spans:
        return {}
    name, low, high = spans[kind]
    return {name: uniform(low, high)}


def described(drawn: Drawn) -> str:
    """What was drawn, as JSON for the table."""
    return json.dumps({**drawn.words, "events": [event.words for event in drawn.events]})
