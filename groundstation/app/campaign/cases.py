"""From a mission and what varies to single cases, each complete in itself: values and bytes, no paths.

A case follows from the mission, the vary file, the campaign's seed and the number of its run alone, so that any
worker anywhere flies the same. Runs of different cells with the same number of round share their random numbers: the
cells are compared on the same starts. Whom a fault strikes, and when, every run draws for itself, so that a matrix of
faults is not always about the same vehicle. Refuses to fly anything.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from groundstation.app.campaign.adversary import described, draw
from groundstation.app.campaign.plot import Event
from groundstation.app.campaign.vary import AdversarySpec, Cell, Setting, StartsSpec, Vary
from groundstation.core.errors import UserError
from groundstation.core.files import read_yaml
from groundstation.core.types import FloatArray
from groundstation.design.store import load_formation
from groundstation.mission.plan.overrides import override_value
from groundstation.mission.plan.own_code import CodeSource
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.reading import load_mission, plan_from_record

_ROOM_M = 1.0  # between the starts and the fence
_SPARE_M = 0.01  # starts are that much further apart than the mission itself demands of pads
_TRIES, _RESTARTS = 100, 30
_FAR_M = 50.0


@dataclass(frozen=True)
class Case:
    """One run.

    Attributes:
        run: its number, from 0.
        cell: name of its cell, "" when there is but one.
        drawn: what ``choose`` drew, as JSON.
        seed: of the emulator.
        mission: as ``MissionPlan.record`` gives it, with this run's pads and fence.
        gains_npz: the gains file.
        setting: the rest of what varies.
        victim: index of the vehicle that a fault strikes.
        delay_s: how long after the phase was entered it strikes.
        events: what an adversary does.
        code: where a law of the mission's own is found; the one thing that is not in the case itself.
        unread: why the mission could not be read, by a fault of ours; "" as a rule.
    """

    run: int
    cell: str
    drawn: str
    seed: int
    mission: Mapping[str, Any]
    gains_npz: bytes
    setting: Setting
    victim: int
    delay_s: float
    events: tuple[Event, ...] = ()
    unread: str = ""
    code: CodeSource | None = None

    def plan(self) -> MissionPlan:
        """Puts the mission together.

        Raises:
            UserError: it does not fit together.
            RuntimeError: reading it failed by a fault of ours.
        """
        if self.unread:
            raise RuntimeError(self.unread)
        return plan_from_record(self.mission, self.gains_npz, f"run {self.run}", self.code)


class Cases:
    """The cases of one campaign, made one by one.

    Args:
        mission: mission file.
        vary: what varies.
        seed: of the campaign.
        changes: ``key.path=value`` for the mission, before what varies.

    Raises:
        UserError: the mission is wrong as it stands, in any of the cells.
    """

    def __init__(self, mission: Path, vary: Vary, seed: int, changes: tuple[str, ...] = ()) -> None:
        self._mission, self._vary, self._seed, self._changes = mission, vary, seed, changes
        self._teams: dict[str, _Team] = {}
        if vary.spec.adversary is None:
            for run in range(len(vary.cells)):
                self.case(run).plan()

    def case(self, run: int) -> Case:
        """Makes the case of one run."""
        cells = self._vary.cells
        cell = cells[run % len(cells)]
        source = np.random.SeedSequence(self._seed, spawn_key=(run // len(cells),))
        choice, starts, _, world = (np.random.default_rng(child) for child in source.spawn(4))
        faults = np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=(run // len(cells), run)))
        values, drawn = self._vary.drawn(cell, choice)
        setting = self._vary.setting(values)
        if setting.adversary is not None:
            return self._against(setting.adversary, run, cell, setting, seed=int(world.integers(2**31)))
        team = self._team(setting)
        return Case(
            run=run,
            cell=cell.name,
            drawn=json.dumps(drawn) if drawn else "",
            seed=int(world.integers(2**31)),
            mission=team.mission(setting.starts, starts),
            gains_npz=team.plan.gains_npz,
            setting=setting,
            victim=int(faults.integers(team.plan.size)),
            delay_s=round(float(faults.random()) * setting.faults.within_s, 3),
            code=CodeSource((self._mission.resolve().parent, Path.cwd())),
        )

    def _against(self, spec: AdversarySpec, run: int, cell: Cell, setting: Setting, *, seed: int) -> Case:
        """The case of a run that an adversary draws."""
        drawn = draw(spec, self._seed, run, self._changes)
        values = {
            **setting.model_dump(exclude_unset=True),
            "emulator": {**cell.values.get("emulator", {}), **drawn.emulator},
        }
        return Case(
            run=run,
            cell=cell.name,
            drawn=described(drawn),
            seed=seed,
            mission=drawn.mission,
            gains_npz=drawn.gains_npz,
            setting=self._vary.setting(values),
            victim=0,
            delay_s=0.0,
            events=drawn.events,
            unread=drawn.error,
        )

    def fingerprint(self) -> str:
        """Hash of all that the cases follow from; a table may only be added to under the same one."""
        teams = [(key, team.plan.record(), team.plan.gains_npz.hex()) for key, team in sorted(self._teams.items())]
        cells = [cell.values for cell in self._vary.cells]
        text = json.dumps([self._seed, cells, self._vary.spec.choose, teams, self._changes])
        return hashlib.sha256(text.encode()).hexdigest()

    def _team(self, setting: Setting) -> _Team:
        key = json.dumps([setting.set, setting.team.model_dump(), setting.starts.kind == "pads"], sort_keys=True)
        if key not in self._teams:
            self._teams[key] = _Team(self._mission, setting, self._changes)
        return self._teams[key]


class _Team:
    """A mission with the vehicles that a setting asks for."""

    def __init__(self, path: Path, setting: Setting, changes: tuple[str, ...]) -> None:
        changes = (*changes, *(f"{key}={json.dumps(value)}" for key, value in setting.set.items()))
        self._random = setting.starts.kind != "pads"
        values = _vehicles(path, setting, changes)
        own = load_values(path, changes)
        if self._random:
            values = [
                {**vehicle, "pad_m": [_FAR_M * number, 0.0, 0.0], "origin": "pad"}
                for number, vehicle in enumerate(values)
            ]
            wide = 1.0e4 + _FAR_M * len(values)
            changes = (*changes, f"fence.min_m={[-wide, -wide, 0.0]}", f"fence.max_m={[wide, wide, wide]}")
        self.plan = load_mission(path, (*changes, f"vehicles={json.dumps(values)}"))
        pads = np.array([vehicle["pad_m"] for vehicle in own["vehicles"]], dtype=np.float64)
        self._centre = pads[:, :2].mean(axis=0)
        self._fence = own["fence"]

    def mission(self, starts: StartsSpec, rng: np.random.Generator) -> dict[str, Any]:
        """The mission's record for one run."""
        record = self.plan.record()
        if not self._random:
            return record
        plan, spec = self.plan, self.plan.spec
        points = plan.formation.points_enu_m
        side = starts.spread * float(np.ptp(points, axis=0).max())
        low = np.array([*(self._centre - side / 2), 0.0])
        high = np.array([*(self._centre + side / 2), side if starts.kind == "volume" else 0.0])
        radius = spec.avoidance.radius_m
        # A wind that the mission leaves open is lowered to what fits, and would differ from one profile to the next.
        stated = spec.wind.mean_m_s is not None or spec.wind.gust_m_s is not None
        margin_m = plan.keep_out_margin_m if stated else plan.margin_m
        apart = max(starts.apart * radius, radius + margin_m + _SPARE_M)
        pads = scattered(plan.size, low, high, apart, rng)
        top = side + spec.takeoff.height_m + spec.takeoff.stagger_m / 2 + _ROOM_M
        fence = {
            "min_m": np.minimum(self._fence["min_m"], [*(low[:2] - _ROOM_M), 0.0]).tolist(),
            "max_m": np.maximum(self._fence["max_m"], [*(high[:2] + _ROOM_M), top]).tolist(),
        }
        vehicles = [{**vehicle, "pad_m": pad.tolist()} for vehicle, pad in zip(record["vehicles"], pads, strict=True)]
        return {**record, "fence": fence, "vehicles": vehicles}


def load_values(path: Path, changes: tuple[str, ...]) -> dict[str, Any]:
    """The mission file's own values after changes, before they are judged."""
    values = read_yaml(path)
    for change in changes:
        override_value(values, change)
    return values


def _vehicles(path: Path, setting: Setting, changes: tuple[str, ...]) -> list[dict[str, Any]]:
    """The mission's vehicles, as many as the formation has points, of the profiles and autopilots asked for."""
    values = load_values(path, changes)
    vehicles = values.get("vehicles")
    if not isinstance(vehicles, list) or not vehicles or not all(isinstance(item, dict) for item in vehicles):
        raise UserError(f"{path}: vehicles: expected a list of vehicles")
    vehicles = [dict(vehicle) for vehicle in vehicles]
    if setting.starts.kind != "pads" and isinstance(values.get("formation"), str):
        size = load_formation(path.parent / values["formation"]).size
        vehicles = vehicles[:size]
        used = {vehicle.get("id") for vehicle in vehicles}
        free = (number for number in range(1, 251) if number not in used)
        while len(vehicles) < size:
            vehicles.append({**vehicles[-1], "id": next(free)})
    for key in ("profile", "autopilot"):
        wanted = getattr(setting.team, key)
        if wanted is not None:
            names = (wanted,) if isinstance(wanted, str) else wanted
            for number, vehicle in enumerate(vehicles):
                vehicle[key] = names[number % len(names)]
    return vehicles


def scattered(count: int, low: FloatArray, high: FloatArray, apart_m: float, rng: np.random.Generator) -> FloatArray:
    """Draws points in a box, none nearer to another than a distance: one by one, anew where no room is left.

    Args:
        count: how many.
        low: lower corner, shape (3,).
        high: upper corner, shape (3,).
        apart_m: smallest distance.
        rng: draws.

    Returns:
        Shape (count, 3).

    Raises:
        UserError: the box has no room for them.
    """
    for _ in range(_RESTARTS):
        points = np.empty((0, 3))
        for _ in range(_TRIES * count):
            point = rng.uniform(low, high)
            if not len(points) or np.linalg.norm(points - point, axis=1).min() >= apart_m:
                points = np.vstack([points, point])
                if len(points) == count:
                    return points
    size = " x ".join(f"{length:.3g}" for length in high - low)
    raise UserError(f"starts: no room for {count} vehicles {apart_m:.3g} m apart in {size} m; raise spread")
