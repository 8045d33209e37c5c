"""The manifest beside a log: what flew, with which gains and versions, from which seed, and how it ended.

``flight.tlog`` goes with ``flight.manifest.json``. Written atomically, once at the start and again at the end. In a
dry run nothing in it depends on the machine's clock or on where the log lies, so that equal flights have equal
manifests. Does not interpret the mission: that is a plain mapping here.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
import platform
import reprlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from groundstation.core.errors import UserError
from groundstation.core.own_files import claim, refuse_links, require_name, write_whole

Values = Mapping[str, Any]
"""Plain values by key, as JSON has them: a mission, a result."""
FORMAT_VERSION = 1
DRY_RUN_EPOCH_UNIX_US = 1_577_836_800_000_000
"""2020-01-01T00:00:00Z: t = 0 of every dry run."""

_BYTES_MAX = 1 << 29
_LATEST_UNIX_US = 4_102_444_800_000_000  # 2100-01-01
_NOT_REPEATABLE = ("wall_s", "log", "law_time")
"""Keys of a result that differ between equal dry runs."""


def system_ids(mission: Values) -> list[int]:
    """MAVLink system id of each vehicle of a mission: the id by which it is named, where nothing else is said."""
    return [vehicle.get("sysid") or vehicle["id"] for vehicle in mission.get("vehicles") or ()]


def shares_system_ids(mission: Values) -> bool:
    """Whether vehicles on different links have the same system id, so that only both together tell who speaks."""
    known = system_ids(mission)
    return len(set(known)) < len(known)


def versions() -> dict[str, str]:
    """Versions that a flight depends on; "unknown" for a copy of this project that was never installed."""
    try:
        gs = metadata.version("gs-groundstation")
    except metadata.PackageNotFoundError:
        gs = "unknown"
    return {"gs": gs, "python": platform.python_version(), "numpy": np.__version__}


@dataclass(frozen=True)
class Manifest:
    """What stands beside a log.

    Attributes:
        mission: the mission with everything resolved (files read, defaults filled in), as plain values; ENU, metres,
            roles and agents from 1. Read here: ``name``, ``vehicles`` (``id``, ``pad_m``, ``origin``), ``formation``
            (``name``, ``points``, ``scale``, ``edges``) and ``avoidance.radius_m``.
        epoch_unix_us: unix time of t = 0, microseconds.
        versions: program name to version.
        seed: of the random numbers; None when none were drawn.
        dry_run: whether the emulator flew in virtual time.
        take_over: the flight began in the air, with vehicles that another ground station had left there.
        gains_npz: the gains file, byte by byte; None when no gains are known.
        result: how it ended; None while it flies, and for ever after a crash.
        faults: timetable of the emulator's faults that struck, as its file has them; empty without.
    """

    mission: Values
    epoch_unix_us: int
    versions: Mapping[str, str] = field(default_factory=dict)
    seed: int | None = None
    dry_run: bool = False
    take_over: bool = False
    gains_npz: bytes | None = None
    result: Values | None = None
    faults: Sequence[Values] = ()

    @property
    def of_vehicles(self) -> bool:
        """Whether vehicles flew it: neither the emulator nor another program, whose record it would be."""
        return not self.dry_run and self.seed is None and "source" not in self.mission

    def same_flight(self, mission: Values, seed: int | None, faults: Sequence[Values] = ()) -> bool:
        """Whether it is of the same mission to the last value, flown in the emulator with the same seed and faults."""
        if seed is None or self.seed != seed:
            return False
        wanted = json.loads(json.dumps(_plain([mission, faults])))
        return bool(wanted == [self.mission, list(self.faults)])

    @property
    def gains_sha256(self) -> str | None:
        """Hash of the gains file in hexadecimal, None without gains."""
        return None if self.gains_npz is None else hashlib.sha256(self.gains_npz).hexdigest()

    def finished(self, result: Values) -> Manifest:
        """Returns the manifest of the finished flight; a dry run leaves out what would differ from run to run."""
        drop = _NOT_REPEATABLE if self.dry_run else ()
        return replace(self, result={key: value for key, value in result.items() if key not in drop})

    def to_json(self) -> str:
        """Encodes as strict JSON with sorted keys; numbers that are not finite become null."""
        values: dict[str, object] = {
            "format": FORMAT_VERSION,
            "mission": self.mission,
            "epoch_unix_us": self.epoch_unix_us,
            "versions": self.versions,
            "seed": self.seed,
            "dry_run": self.dry_run,
            "take_over": self.take_over,
            "gains_sha256": self.gains_sha256,
            "gains_npz_base64": None if self.gains_npz is None else base64.b64encode(self.gains_npz).decode(),
            "result": self.result,
        }
        if self.faults:
            values["faults"] = self.faults
        return json.dumps(_plain(values), allow_nan=False, ensure_ascii=False, indent=1, sort_keys=True) + "\n"


def manifest_path(log: Path) -> Path:
    """Where the manifest of a log lies: ``flight.tlog`` -> ``flight.manifest.json``, in the same folder."""
    return log.with_name((log.stem if log.suffix == ".tlog" else log.name) + ".manifest.json")


def write_manifest(path: Path, manifest: Manifest) -> None:
    """Writes a manifest so that there is always a whole one: into a new file that then takes the name.

    Raises:
        UserError: the file cannot be written; what was there before is left as it was.
    """
    try:
        write_whole(path, manifest.to_json().encode("utf-8"))
    except OSError as error:
        raise UserError(
            f"{path}: cannot write the manifest: {error.strerror or error}; give a folder that can be written to"
        ) from error


def read_manifest(path: Path) -> Manifest:
    """Reads a manifest and checks what this program relies on.

    Raises:
        UserError: missing, not JSON, of a later format, a key missing or of the wrong kind, or the gains are not
            those whose hash it gives.
    """
    try:
        with path.open("rb") as file:
            content = file.read(_BYTES_MAX + 1)
        if len(content) > _BYTES_MAX:
            raise ValueError(f"longer than {_BYTES_MAX >> 20} MB")
        values = json.loads(content.decode("utf-8"))
    except (OSError, ValueError, RecursionError) as error:  # ValueError: not UTF-8, not JSON, a number without end
        raise UserError(
            f"{path}: not a readable manifest: {error}; move it away to read the log without one"
        ) from error
    if not isinstance(values, dict):
        raise UserError(f"{path}: expected a JSON object, found {type(values).__name__}")
    version = _expect(path, values, "format", int)
    if version > FORMAT_VERSION:
        raise UserError(f"{path}: format is {version}, this program reads up to {FORMAT_VERSION}; use a later gs")
    encoded = _expect(path, values, "gains_npz_base64", str, type(None))
    try:
        gains = None if encoded is None else base64.b64decode(encoded, validate=True)
    except ValueError as error:  # binascii.Error is one
        raise UserError(f"{path}: gains_npz_base64: {error}; the manifest is damaged") from error
    manifest = Manifest(
        mission=_expect(path, values, "mission", dict),
        epoch_unix_us=_expect(path, values, "epoch_unix_us", int),
        versions=_expect(path, values, "versions", dict),
        seed=_expect(path, values, "seed", int, type(None)),
        dry_run=_expect(path, values, "dry_run", bool),
        take_over=_expect(path, {"take_over": False} | values, "take_over", bool),  # older ones do not have it
        gains_npz=gains,
        result=_expect(path, values, "result", dict, type(None)),
        faults=tuple(_expect(path, {"faults": []} | values, "faults", list)),
    )
    if not 0 <= manifest.epoch_unix_us <= _LATEST_UNIX_US:
        raise UserError(
            f"{path}: epoch_unix_us is {reprlib.repr(manifest.epoch_unix_us)}, limits 0 and {_LATEST_UNIX_US}; the"
            " manifest is damaged"
        )
    if _expect(path, values, "gains_sha256", str, type(None)) != manifest.gains_sha256:
        raise UserError(f"{path}: gains_sha256 is not the hash of gains_npz_base64; the manifest was changed")
    return manifest


def manifest_beside(log: Path) -> Manifest | None:
    """Reads the manifest beside a log; None when there is none.

    Raises:
        UserError: there is one, and it cannot be used.
    """
    if not log.name:  # "." or "/": whoever reads it as a log says what is wrong
        return None
    path = manifest_path(log)
    return read_manifest(path) if path.exists() else None


def claim_log(log: Path, ours: Callable[[Manifest], bool], *, option: str = "--log", force: bool | None = None) -> bool:
    """Makes sure that a new log may be written to a file, and makes its folder.

    Args:
        log: the file, ending in .tlog.
        ours: says of the manifest of a log that lies there whether the same command would make that log again.
        option: by which another file is named, for messages.
        force: replace what is there, unless vehicles flew it; None where the command has no --force.

    Returns:
        Whether a log that is there will be replaced.

    Raises:
        UserError: another ending, a log that has to be kept, or a folder that cannot be made.
    """
    if log.name and log.name != ".." and log.suffix != ".tlog":
        raise UserError(f"{log}: logs end in .tlog; call it {log.with_suffix('.tlog')}")
    remedy = f"another file with {option}"
    require_name(log, "the log", remedy)
    require_name(manifest_path(log), "the manifest beside the log", remedy)
    refuse_links(manifest_path(log), "the manifest")
    there = _usable_manifest(log)
    if log.exists() and there is not None and there.of_vehicles:
        raise UserError(
            f"{log}: exists, and vehicles flew it: it cannot be had again; name another file with {option}, or move it"
            " away"
        )
    replaced = claim(log, "the log", remedy, ours=lambda: there is not None and ours(there), force=force)
    try:
        log.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{log}: cannot make its folder: {error.strerror or error}; name another one") from error
    return replaced


def _usable_manifest(log: Path) -> Manifest | None:
    """The manifest beside a log; None where there is none that can be read."""
    try:
        return manifest_beside(log)
    except UserError:
        return None


def _expect(path: Path, values: Values, key: str, *kinds: type) -> Any:
    if key not in values:
        raise UserError(f"{path}: {key} is missing; the manifest is not from this program or damaged")
    value = values[key]
    if not isinstance(value, kinds) or (isinstance(value, bool) and bool not in kinds):
        names = " or ".join("null" if kind is type(None) else kind.__name__ for kind in kinds)
        raise UserError(f"{path}: {key} is {reprlib.repr(value)}, expected {names}")
    return value


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
