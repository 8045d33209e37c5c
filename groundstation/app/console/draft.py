"""A mission that is being edited, with its formation and gains: opened, changed, judged, saved. Shows nothing.

Gains belong to a shape: for another one they are designed anew, when that is asked for or on the spot when the mission
is loaded.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from pathlib import Path

import yaml

from groundstation.app.console.form import Place, Values, put
from groundstation.app.schema_files import schema_line, write_schema
from groundstation.core.errors import UserError
from groundstation.core.files import faults, read_yaml, validate
from groundstation.core.formation import Formation
from groundstation.core.own_files import refuse_links, write_whole
from groundstation.design.designer import DesignResult
from groundstation.design.store import FormationFile, check_edges, save_gains, to_formation
from groundstation.mission.plan.reading import load_mission
from groundstation.mission.plan.schema import MissionSpec

Edge = tuple[int, int]
_FORMATION, _GAINS = "formation.yaml", "gains.npz"
_KEPT_PLACES = "formation", "gains"


class Draft:
    """One mission on the desk.

    Args:
        path: the mission file that it begins with; it stays as it is.

    Attributes:
        values: the mission file, as plain values.
        points: of the formation, as in its file; empty where the mission forms nothing.
        edges: pairs of agents, counted from 1, the smaller first.
        has_gains: there is a gains file for this very shape.

    Raises:
        UserError: it cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.values: Values = read_yaml(path)
        self._folder = path.parent
        self.points: list[list[float]] = []
        self.edges: list[Edge] = []
        self._shape: Values = {}
        self._gains: bytes | None = None
        self._steps_beside()
        name = self.values.get("formation")
        if isinstance(name, str):
            file = self._folder / name
            shape = validate(FormationFile, read_yaml(file), str(file))
            formation = to_formation(shape)
            self._shape = shape.model_dump(exclude={"points", "edges"}, exclude_none=True)
            self.points = [list(map(float, point)) for point in shape.points]
            self.edges = [(i + 1, j + 1) for i, j in formation.edges]
            gains = self.values.get("gains")
            if isinstance(gains, str):
                try:
                    self._gains = (self._folder / gains).read_bytes()
                except OSError as error:
                    raise UserError(f"{path}: gains: {gains}: {error.strerror or error}; correct the path") from None
        self._gains_shape = self._shape_now()

    def _steps_beside(self) -> None:
        """Steps name files beside the mission file: these go along wherever the draft is written."""
        self._along: dict[str, Path] = {}
        steps = self.values.get("steps")
        for step in steps if isinstance(steps, list) else ():
            for inner in step.values() if isinstance(step, dict) else ():
                for key in _KEPT_PLACES if isinstance(inner, dict) else ():
                    if isinstance(name := inner.get(key), str):
                        inner[key] = Path(name).name
                        self._along[Path(name).name] = self._folder / name

    @property
    def has_gains(self) -> bool:
        """Whether there are gains for this very shape: who puts a point back where it was has them again."""
        return self._gains is not None and self._gains_shape == self._shape_now()

    def _shape_now(self) -> str:
        return json.dumps([self.points, self.edges])

    @property
    def vehicles(self) -> int:
        """How many the mission has; 0 where it does not say so."""
        vehicles = self.values.get("vehicles")
        count = vehicles.get("count") if isinstance(vehicles, dict) else None  # the short form
        return len(vehicles) if isinstance(vehicles, list) else count if isinstance(count, int) else 0

    @property
    def name(self) -> str:
        """Of the mission."""
        return str(self.values.get("name"))

    def put(self, place: Place, text: str) -> None:
        """Gives a value of the mission; see ``form.put``."""
        put(self.values, place, text)

    def take_yaml(self, values: Values) -> None:
        """The whole mission file as somebody has written it; formation and gains stay those of the draft."""
        self.values = values

    # The formation

    def move(self, row: int, point: list[float]) -> None:
        """Puts a point, counted from 0, somewhere else."""
        if self.points[row] != point:
            self.points[row] = point

    def add(self, point: list[float]) -> None:
        """Adds a point as the last one; nobody is joined to it yet."""
        self.points.append(point)

    def remove(self, row: int) -> None:
        """Takes a point, counted from 0, out with its edges; those behind it move up.

        Raises:
            UserError: none would be left.
        """
        if len(self.points) == 1:
            raise UserError("point 1 is the only one: a formation has one at least")
        del self.points[row]
        agent = row + 1
        kept = [edge for edge in self.edges if agent not in edge]
        self.edges = [(i - (i > agent), j - (j > agent)) for i, j in kept]

    def toggle(self, one: int, other: int) -> None:
        """Joins two agents, counted from 1, or parts them.

        Raises:
            UserError: there are no such two.
        """
        n = len(self.points)
        if one == other or not (1 <= one <= n and 1 <= other <= n):
            raise UserError(f"edge {one} to {other}: expected two different agents from 1 to {n}")
        edge = (min(one, other), max(one, other))
        if edge in self.edges:
            self.edges.remove(edge)
        else:
            self.edges = sorted([*self.edges, edge])

    def propose(self, formation: Formation) -> None:
        """Takes the edges of another formation."""
        self.edges = [(i + 1, j + 1) for i, j in formation.edges]

    def formation(self) -> Formation:
        """The shape as it is now.

        Raises:
            UserError: it is none.
        """
        file = validate(FormationFile, self._formation_values(), "formation")
        check_edges("formation", file)
        return to_formation(file)

    def keep_gains(self, result: DesignResult) -> None:
        """Takes gains that were designed for the shape as it is now."""
        if result.gains is None or result.certificate is None:
            return
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / _GAINS
            save_gains(file, result.formation, result.gains, result.certificate, result.method)
            self._gains, self._gains_shape = file.read_bytes(), self._shape_now()

    def _formation_values(self) -> Values:
        return {**self._shape, "points": self.points, "edges": [list(edge) for edge in self.edges]}

    # What is wrong, and files

    def faults(self) -> dict[str, str]:
        """What is wrong with the mission file, by key; what values mean together is not looked at."""
        return faults(MissionSpec, self._written())

    def judged(self) -> str:
        """What is wrong with the mission as a whole, "" where nothing is; designs gains where there are none."""
        with tempfile.TemporaryDirectory() as folder:
            try:
                path = self.write(Path(folder))
                load_mission(path)
            except UserError as error:
                return str(error).replace(f"{folder}/", "")
        return ""

    def write(self, folder: Path) -> Path:
        """Writes mission, formation and gains into a folder, in place of what is there of their names.

        Returns:
            The mission file.

        Raises:
            UserError: they cannot be written.
        """
        files = self.files()
        try:
            for name, source in self._along.items():
                if (folder / name).resolve() != source.resolve():
                    shutil.copyfile(source, folder / name)
            for name, content in files.items():
                refuse_links(folder / name, "the mission")
                write_whole(folder / name, content, durable=False)
        except OSError as error:
            raise UserError(f"{error.filename or folder}: cannot be written: {error.strerror or error}") from None
        return folder / f"{self.name}.yaml"

    def save(self, folder: Path, *, replace: bool) -> Path:
        """Keeps the mission in a folder, with the schema that editors look for.

        Args:
            folder: where.
            replace: files that are there.

        Returns:
            The mission file.

        Raises:
            UserError: it does not hold together, or files are there that are to stay.
        """
        if wrong := "\n".join(self.faults().values()):
            raise UserError(wrong)
        there = [name for name in (*self.files(), *self._along) if (folder / name).exists()]
        if there and not replace:
            raise UserError(f"{', '.join(there)}: is there already; give the mission another name, or replace it")
        path = self.write(folder)
        write_schema(folder, "mission")
        return path

    def files(self) -> dict[str, bytes]:
        """Names and contents of the files that it is written as."""
        name = self.name
        head = f"{schema_line('mission')}\n# {name}, written by the mission page of gs console.\n"
        files = {f"{name}.yaml": head.encode() + dumped(self._written())}
        if self.points:
            files[f"{name}.{_FORMATION}"] = dumped(self._formation_values())
            if self._gains is not None and self.has_gains:
                files[f"{name}.{_GAINS}"] = self._gains
        return files

    def _written(self) -> Values:
        """The mission file with the names of its own formation and gains."""
        values = {key: value for key, value in self.values.items() if key not in _KEPT_PLACES}
        if self.points:
            values["formation"] = f"{self.name}.{_FORMATION}"
            if self.has_gains:
                values["gains"] = f"{self.name}.{_GAINS}"
        return values


def dumped(values: object) -> bytes:
    """Plain values as YAML, in the order in which they were given."""
    return yaml.safe_dump(values, sort_keys=False, default_flow_style=None, width=120, allow_unicode=True).encode()
