"""Reads a mission file, or a mission out of a manifest, with its formations and their gains."""

from __future__ import annotations

import base64
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from groundstation.core.errors import UserError
from groundstation.core.files import is_file, read_yaml, validate
from groundstation.core.formation import Formation
from groundstation.design.store import (
    FormationFile,
    check_gains,
    load_formation,
    load_gains,
    save_gains,
    to_formation,
)
from groundstation.mission.plan.in_the_way import check_obstacles
from groundstation.mission.plan.judging import build_plan, check_acceleration, check_room_for_wind
from groundstation.mission.plan.overrides import override_value
from groundstation.mission.plan.own_code import CodeSource
from groundstation.mission.plan.own_trial import check_own_code
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.schema import MissionSpec
from groundstation.mission.plan.stages import Shape, no_formation


def read_spec(path: Path, overrides: Sequence[str] = ()) -> MissionSpec:
    """Reads a mission file alone; nothing is judged but its shape.

    Raises:
        UserError: it is no mission file, or an override does not fit it.
    """
    values = read_yaml(path)
    for override in overrides:
        override_value(values, override)
    return validate(MissionSpec, values, str(path))


def load_mission(path: Path, overrides: Sequence[str] = (), code: CodeSource | None = None) -> MissionPlan:
    """Reads a mission file, its formations and their gains; designs the gains where the file names none.

    A law or avoidance of one's own is looked for beside the mission file, then in the current folder, then among what
    is installed.

    Args:
        path: mission file.
        overrides: ``key.path=value``, the value in YAML, list items by number from 0.
        code: where else code of one's own is looked for.

    Raises:
        UserError: anything wrong, with file, key, value, limit and remedy.
    """
    spec = read_spec(path, overrides)
    shapes = _Shapes(path)
    if spec.formation is None:
        first = no_formation(spec)
    else:
        first = shapes.read(spec.formation, spec.gains, spec.formation_scale)
    others = {}
    for number, step in enumerate(spec.steps):
        form = step.form
        if form is not None and form.own_shape:
            # Gains belong to points: those of the mission go with the mission's formation only.
            gains = form.gains if form.formation is not None or form.gains is not None else spec.gains
            size = form.formation_scale if form.formation is not None or form.formation_scale else spec.formation_scale
            others[number] = shapes.read(
                form.formation or spec.formation or "", gains, size, f"steps[{number}].{step.kind}."
            )
    plan = build_plan(spec, first, str(path), others, code or CodeSource((path.parent, Path())))
    check_own_code(plan)
    check_acceleration(plan)
    check_room_for_wind(plan)
    check_obstacles(plan)
    return plan


class _Shapes:
    """Reads formations and gains of one mission, and designs each missing one once."""

    def __init__(self, mission: Path) -> None:
        self._mission = mission
        self._designed: dict[Path, Shape] = {}

    def read(self, formation: str, gains: str | None, size: float | None, key: str = "") -> Shape:
        """Reads a formation, at the size given in place of its own scale, with its gains."""
        formation_path = _relative(self._mission, formation, f"{key}formation")
        as_in_file = load_formation(formation_path)
        factor = 1.0
        if size is not None:
            factor = size / validate(FormationFile, read_yaml(formation_path), str(formation_path)).scale
        sized = as_in_file if size is None else replace(as_in_file, points_enu_m=factor * as_in_file.points_enu_m)
        if gains is None:
            if formation_path not in self._designed:
                self._designed[formation_path] = self._design(as_in_file, formation, key)
            return replace(self._designed[formation_path], formation=sized)
        gains_path = _relative(self._mission, gains, f"{key}gains")
        stored = load_gains(gains_path)
        check_gains(stored, as_in_file)  # gains belong to a shape, whatever its size
        return Shape(sized, stored.gains, gains_path.read_bytes())

    def _design(self, formation: Formation, name: str, key: str) -> Shape:
        from groundstation.design.designer import design  # noqa: PLC0415 - loads solvers that most missions do without

        result = design(formation)
        if result.gains is None or result.certificate is None:
            raise UserError(f"{self._mission}: {key}formation: {name}: no gains exist: {result.reason}")
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "gains.npz"
            save_gains(file, formation, result.gains, result.certificate, result.method)
            return Shape(formation, result.gains, file.read_bytes())


def plan_from_record(
    mission: Mapping[str, Any], gains_npz: bytes, source: str, code: CodeSource | None = None
) -> MissionPlan:
    """Puts a plan together from what ``MissionPlan.record`` gave and the gains file's bytes.

    Args:
        mission: the record.
        gains_npz: the gains file.
        source: for messages.
        code: where a law or avoidance of one's own is looked for; it has to be what the record tells, byte by byte.

    Raises:
        UserError: the record is not one of ours, or what it holds does not fit together.
    """
    # Before setpoints were shaped where a vehicle is known, records said nothing, and they went as they were.
    values = {"compensate_s": 0, **mission}
    without = "formation" in values and values["formation"] is None
    points = values.pop("formation", None)
    if not isinstance(points, Mapping) and not without:
        raise UserError(f"{source}: mission.formation: is missing, the manifest is not one of a mission")
    shapes = values.pop("shapes", [])
    code = replace(code or CodeSource(), flown=values.pop("own_code", {}))
    name = None if points is None else str(points.get("name"))
    spec = validate(MissionSpec, {**values, "formation": name, "gains": None}, f"{source}: mission")
    if points is None:
        first = no_formation(spec)
    else:
        where = f"{source}: mission.formation"
        first = _shape_from_record(points, gains_npz, where, resized=spec.formation_scale is not None)
    others: dict[int, Shape] = {}
    try:
        for item in shapes:
            number = int(item["step"])
            npz = base64.b64decode(item["gains_npz_base64"], validate=True)
            where = f"{source}: mission.shapes[{len(others)}].formation"
            others[number] = _shape_from_record(item["formation"], npz, where, resized=True)
    except (KeyError, TypeError, ValueError) as error:
        raise UserError(f"{source}: mission.shapes: {error}; the manifest is damaged") from error
    wanted = {number for number, step in enumerate(spec.steps) if step.form is not None and step.form.own_shape}
    if wanted != set(others):
        raise UserError(f"{source}: mission.shapes: are for steps {sorted(others)}, expected {sorted(wanted)}")
    return build_plan(spec, first, source, others, code)


def _shape_from_record(points: Any, gains_npz: bytes, where: str, *, resized: bool) -> Shape:
    """A formation and its gains out of a manifest, checked against each other."""
    formation = to_formation(validate(FormationFile, dict(points), where))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "gains.npz"
        file.write_bytes(gains_npz)
        stored = load_gains(file)
    size, stored_size = (float(np.abs(points).max()) for points in (formation.points_enu_m, stored.points_enu_m))
    same_size = formation
    if resized and size > 0.0:
        same_size = replace(formation, points_enu_m=formation.points_enu_m * (stored_size / size))
    check_gains(stored, same_size)
    return Shape(formation, stored.gains, gains_npz)


def _relative(mission: Path, name: str, key: str) -> Path:
    path = Path(name)
    if not path.is_absolute():
        path = mission.parent / path
    if not is_file(path):
        raise UserError(f"{mission}: {key}: {name}: no such file (looked for {path}); correct the path")
    return path
