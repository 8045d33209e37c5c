"""What varies from run to run of a campaign: a YAML file, as strict as a mission.

``grid`` and ``cells`` make a list of cells, each the file's own values with some of them changed; run k flies cell
k modulo their number, so that any number of runs covers them evenly. ``choose`` draws further values per run. Refuses
unknown keys, paths that lead nowhere, and values that the emulator does not know. docs/campaigns.md describes it.
"""

from __future__ import annotations

import copy
import itertools
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from groundstation.core.errors import UserError
from groundstation.core.files import read_yaml, validate
from groundstation.core.findings import no_boolean
from groundstation.mission.timing import SECOND_NS
from sitl.estimator import Noise
from sitl.faults import Fault, FaultError, parse_fault
from sitl.network import LinkConfig
from sitl.own_frame import OwnFrameConfig
from sitl.world import WindConfig

_CELLS_MAX = 100_000
_LABEL_MAX = 40
_OBVIOUS = frozenset({"kind", "profile", "autopilot", "direction"})


Number = Annotated[float, BeforeValidator(no_boolean), Field(allow_inf_nan=False)]
NotNegative = Annotated[Number, Field(ge=0, le=10_000)]
Positive = Annotated[Number, Field(gt=0, le=10_000)]
Probability = Annotated[Number, Field(ge=0, le=1)]
FaultPhase = Literal["ground", "takeoff", "form", "hold", "return", "land"]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class StartsSpec(_Strict):
    """Where the team starts: on the mission's pads, at random on the ground, or at random in a volume."""

    kind: Literal["pads", "planar", "volume"] = "pads"
    spread: Annotated[Number, Field(ge=1, le=100)] = 3.0
    apart: Annotated[Number, Field(ge=1, le=100)] = 1.1


class TeamSpec(_Strict):
    """Profile and autopilot of all vehicles; of a list the vehicles take one after the other."""

    profile: str | tuple[str, ...] | None = None
    autopilot: str | tuple[str, ...] | None = None


class NoiseSpec(_Strict):
    """Errors of the vehicles' estimates, in place of those that the mission's positioning brings along."""

    position_m: NotNegative | None = None
    position_tau_s: Positive | None = None
    white_m: NotNegative | None = None
    velocity_m_s: NotNegative | None = None
    velocity_tau_s: Positive | None = None
    attitude_deg: NotNegative | None = None

    def apply(self, noise: Noise) -> Noise:
        """Returns these errors in place of others, where they are given."""
        attitude = None if self.attitude_deg is None else float(np.radians(self.attitude_deg))
        given: dict[str, Any] = {
            "pos_sigma_m": self.position_m,
            "pos_tau_s": self.position_tau_s,
            "pos_white_m": self.white_m,
            "vel_sigma_m_s": self.velocity_m_s,
            "vel_tau_s": self.velocity_tau_s,
            "att_sigma_rad": attitude,
        }
        return replace(noise, **{key: value for key, value in given.items() if value is not None})


class LinkSpec(_Strict):
    """Every link, each way."""

    delay_s: NotNegative = 0.0
    jitter_s: NotNegative = 0.0
    loss: Probability = 0.0
    duplicate: Probability = 0.0
    reorder: Probability = 0.0

    def config(self) -> LinkConfig:
        """The emulator's terms; the default is a link that carries everything at once."""
        return LinkConfig(
            delay_ns=round(self.delay_s * SECOND_NS),
            jitter_ns=round(self.jitter_s * SECOND_NS),
            loss=self.loss,
            duplicate=self.duplicate,
            reorder=self.reorder,
        )


Angle = Annotated[Number, Field(ge=0, le=180)]


class OwnFrameSpec(_Strict):
    """How far each vehicle's own idea of north and of level is off, for the whole flight."""

    heading_deg: Angle = 0.0
    level_deg: Angle = 0.0
    alike: bool = False

    def config(self) -> OwnFrameConfig | None:
        """The emulator's terms, None where they are right."""
        if not self.heading_deg and not self.level_deg:
            return None
        return OwnFrameConfig(float(np.radians(self.heading_deg)), float(np.radians(self.level_deg)), self.alike)


class EmulatorSpec(_Strict):
    """The world that the team flies in."""

    noise: NoiseSpec = NoiseSpec()
    link: LinkSpec = LinkSpec()
    wind_enu_m_s: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)
    gusts_m_s: NotNegative = 0.0
    downwash: bool = False
    own_frames: OwnFrameSpec = OwnFrameSpec()
    streams: Literal["quiet", "usual"] = "quiet"

    def wind(self) -> WindConfig | None:
        """The emulator's terms, None in still air."""
        if not any(self.wind_enu_m_s) and not self.gusts_m_s:
            return None
        return WindConfig(mean_enu_m_s=self.wind_enu_m_s, gust_sigma_m_s=self.gusts_m_s)


class FaultsSpec(_Strict):
    """What goes wrong: on a timetable, or when a phase is really entered, to a vehicle drawn at random."""

    timetable: tuple[dict[str, Any], ...] = ()
    what: tuple[dict[str, Any], ...] = ()
    phase: FaultPhase | None = None
    within_s: NotNegative = 0.0
    who: Literal["one", "all"] = "one"

    @model_validator(mode="before")
    @classmethod
    def _one_is_a_list(cls, value: Any) -> Any:
        if isinstance(value, dict) and isinstance(value.get("what"), dict):
            return {**value, "what": [value["what"]]}
        return value

    @model_validator(mode="after")
    def _whole(self) -> FaultsSpec:
        if bool(self.what) != (self.phase is not None):
            raise ValueError("what (the faults) and phase (in which they strike) go together")
        for fault in self.what:
            if "at_s" in fault or "vehicles" in fault:
                raise ValueError("what: at_s and vehicles are for timetable; here phase, within_s and who decide")
        self.faults()
        self.scheduled()
        return self

    def faults(self) -> tuple[Fault, ...]:
        """What strikes in the phase, of nobody yet."""
        return tuple(_fault(values) for values in self.what)

    def scheduled(self) -> tuple[Fault, ...]:
        """The timetable."""
        return tuple(_fault(values) for values in self.timetable)


def _fault(values: Mapping[str, Any]) -> Fault:
    try:
        return parse_fault(values)
    except FaultError as error:
        raise ValueError(str(error)) from None


class AdversarySpec(_Strict):
    """Missions, faults, orders and strangers at random: how many at most; shares outdoors, in a wind, with a pilot."""

    vehicles: Annotated[int, Field(ge=2, le=8)] = 8
    faults: Annotated[int, Field(ge=0, le=10)] = 3
    orders: Annotated[int, Field(ge=0, le=10)] = 3
    strangers: Annotated[int, Field(ge=0, le=10)] = 2
    outdoors: Probability = 0.25
    wind: Probability = 0.4
    pilots: Probability = 0.0


AtMost = Annotated[int, Field(ge=0)]


class ExpectSpec(_Strict):
    """Bars that the campaign is held to: exit code 1 when one is missed. Rates at least, all others at most."""

    success_rate: Probability | None = None
    formed_rate: Probability | None = None
    safe_rate: Probability | None = None
    below_r: AtMost | None = None
    disagreements: AtMost | None = None
    tracebacks: AtMost | None = None
    logs_wrong: AtMost | None = None
    max_hold_speed_m_s: Positive | None = None


class Setting(_Strict):
    """What one run is flown with: the vary file without what makes many of it."""

    starts: StartsSpec = StartsSpec()
    team: TeamSpec = TeamSpec()
    set: dict[str, Any] = {}
    emulator: EmulatorSpec = EmulatorSpec()
    faults: FaultsSpec = FaultsSpec()
    adversary: AdversarySpec | None = None
    verify: bool = False
    limit_s: Positive = 600.0
    settle_s: NotNegative = 60.0


class VarySpec(Setting):
    """The whole file."""

    @model_validator(mode="after")
    def _one_source_of_missions(self) -> VarySpec:
        if self.adversary is not None:
            for key in ("mission", "starts", "team", "set", "faults"):
                if key in self.model_fields_set:
                    raise ValueError(f"{key}: an adversary draws its own missions, starts, teams and faults")
        return self

    mission: str | None = None
    runs: Annotated[int, Field(ge=1)] | None = None
    grid: dict[str, Annotated[list[Any], Field(min_length=1)]] = {}
    cells: list[dict[str, Any]] = []
    choose: dict[str, Annotated[list[Any], Field(min_length=1)]] = {}
    expect: ExpectSpec = ExpectSpec()


@dataclass(frozen=True)
class Cell:
    """One point of the grid.

    Attributes:
        name: its values in words, "" when there is but one cell.
        values: of a ``Setting``, as YAML says them.
    """

    name: str
    values: dict[str, Any]


@dataclass(frozen=True)
class Vary:
    """A vary file that has been read.

    Attributes:
        spec: the file's values.
        source: its name, for messages.
        cells: at least one.
    """

    spec: VarySpec
    source: str
    cells: tuple[Cell, ...]

    def setting(self, values: Mapping[str, Any]) -> Setting:
        """Checks the values of one run.

        Raises:
            UserError: as for the file.
        """
        return validate(Setting, dict(values), self.source)

    def drawn(self, cell: Cell, rng: np.random.Generator) -> tuple[dict[str, Any], dict[str, Any]]:
        """Draws what ``choose`` leaves to each run: the run's values, and the drawn ones by path."""
        values = cell.values
        picked = {path: options[int(rng.integers(len(options)))] for path, options in self.spec.choose.items()}
        for path, value in picked.items():
            values = changed(values, path, value, self.source)
        return values, picked


def load_vary(path: Path | None) -> Vary:
    """Reads a vary file; without one every run is the mission as it stands, with another seed.

    Raises:
        UserError: with file, key, value and what is allowed.
    """
    source = "campaign" if path is None else str(path)
    values = {} if path is None else read_yaml(path)
    spec = validate(VarySpec, values, source)
    base = {key: value for key, value in values.items() if key in Setting.model_fields}
    cells = _cells(spec, base, source)
    vary = Vary(spec, source, cells)
    for cell in cells:
        vary.setting(cell.values)
    for name, options in spec.choose.items():
        for option in options:
            vary.setting(changed(cells[0].values, name, option, source))
    return vary


def _cells(spec: VarySpec, base: dict[str, Any], source: str) -> tuple[Cell, ...]:
    own: list[dict[str, Any]] = spec.cells or [{}]
    count = len(own) * int(np.prod([len(options) for options in spec.grid.values()], dtype=np.int64))
    if count > _CELLS_MAX:
        raise UserError(f"{source}: grid: {count} cells, limit {_CELLS_MAX}; use choose for some of the keys")
    cells = []
    for changes in own:
        for picked in itertools.product(*spec.grid.values()):
            values = base
            changes_here = {key: value for key, value in changes.items() if key != "name"}
            pairs = {**changes_here, **dict(zip(spec.grid, picked, strict=True))}
            for path, value in pairs.items():
                values = changed(values, path, value, source)
            words = [str(changes["name"])] if "name" in changes else [_words(value) for value in changes_here.values()]
            words += [_words(value) for value in picked]
            cells.append(Cell(", ".join(words), values))
    return tuple(cells)


def changed(values: dict[str, Any], path: str, value: Any, source: str) -> dict[str, Any]:
    """Returns values with one of them changed.

    Args:
        values: of a ``Setting``; left as they are.
        path: keys with dots between; what follows ``set.`` is a mission's key, dots and all.
        value: new value.
        source: for messages.

    Raises:
        UserError: the path leads through something that is no mapping.
    """
    keys = ["set", path.removeprefix("set.")] if path.startswith("set.") else path.split(".")
    if keys[0] not in Setting.model_fields:
        raise UserError(f"{source}: {path}: leads nowhere; begin with one of {', '.join(Setting.model_fields)}")
    out = copy.deepcopy(values)
    place = out
    for key in keys[:-1]:
        if place.get(key) is None:
            place[key] = {}
        place = place[key]
        if not isinstance(place, dict):
            raise UserError(f"{source}: {path}: there are no keys below a single value")
    place[keys[-1]] = copy.deepcopy(value)
    return out


def _words(value: Any) -> str:
    if isinstance(value, dict):
        return " ".join(_words(item) if key in _OBVIOUS else f"{key} {_words(item)}" for key, item in value.items())
    if isinstance(value, str):
        return Path(value).stem if value.endswith(".yaml") else value
    text = json.dumps(value)
    return text if len(text) <= _LABEL_MAX else text[: _LABEL_MAX - 3] + "..."
