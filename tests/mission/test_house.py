"""The house rules that can be measured: no class does everything, no file is endless, nobody imports in a circle."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

import groundstation
import sitl
from groundstation.mission.plan import schema

ROOT = Path(groundstation.__file__).parent
EMULATOR = Path(sitl.__file__).parent
MISSION = ROOT / "mission"
FIELDS_MAX, METHODS_MAX = 15, 20
LINES_MAX, BYTES_MAX = 500, 24_000


def _fields(node: ast.ClassDef) -> set[str]:
    """What a class keeps: annotated names of its body, and what its methods store in ``self``."""
    named = {
        item.target.id for item in node.body if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name)
    }
    stored = {
        item.attr
        for item in ast.walk(node)
        if isinstance(item, ast.Attribute)
        and isinstance(item.ctx, ast.Store)
        and isinstance(item.value, ast.Name)
        and item.value.id == "self"
    }
    return named | stored


def _classes(root: Path) -> Iterator[tuple[str, ast.ClassDef]]:
    for path in sorted(root.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                yield f"{path.relative_to(root)}: {node.name}", node


LARGER = {
    "MissionSpec": "the keys at the top of a mission file",
    "_CourseKeys": "some of them",
    "LimitsSpec": "the keys of limits in a mission file",
    "CheckRow": "the keys of a row of `gs check --json`",
    "MissionPlan": "a value: what is known of a mission before takeoff; who needs its links alone is given a LinkPlan",
    "Roster": "who decides writes by it; who only looks is given its Duties",
    "Runner": "it flies, and flight, dry run and replay drive it; who only looks on is given what it has Told",
}
"""Classes that come to more with what they inherit, and what the parts are for."""
LARGER_IN_THE_EMULATOR = {
    "Autopilot": "one vehicle: how it talks (Conversation), what its kind answers (Traits), what all do alike",
    "Px4": "the same, as PX4: a handler for each command and message that the firmware has one for",
    "ArduCopter": "the same, as ArduCopter",
    "Crazyflie": "the same, as a Crazyflie: what it answers is its Desk's",
}
"""The same in the emulator. An autopilot is handed whole to whoever asks for its ``Traits``; whatever acts by itself
(battery, mission, loops, parameters, streams, vision) is an object beside it."""
FIELDS_INHERITED_MAX, METHODS_INHERITED_MAX = 40, 46


def _sizes(classes: dict[str, ast.ClassDef], name: str) -> tuple[set[str], set[str]]:
    """Fields and methods of a class, with those that it inherits from others of the mission."""
    node = classes[name]
    fields, methods = _fields(node), {item.name for item in node.body if isinstance(item, ast.FunctionDef)}
    for base in node.bases:
        if isinstance(base, ast.Name) and base.id in classes:
            more = _sizes(classes, base.id)
            fields, methods = fields | more[0], methods | more[1]
    return fields, methods


@pytest.mark.parametrize("root", [MISSION, EMULATOR])
def test_no_class_of_the_mission_and_of_the_emulator_keeps_or_does_too_much(root: Path) -> None:
    large = {}
    for name, node in _classes(root):
        fields = len(_fields(node))
        methods = sum(isinstance(item, ast.FunctionDef | ast.AsyncFunctionDef) for item in node.body)
        if fields > FIELDS_MAX or methods > METHODS_MAX:
            large[name] = (fields, methods)
    assert not large, f"more than {FIELDS_MAX} fields or {METHODS_MAX} methods: {large}"


@pytest.mark.parametrize(("root", "larger"), [(MISSION, LARGER), (EMULATOR, LARGER_IN_THE_EMULATOR)])
def test_a_class_that_comes_to_more_by_what_it_inherits_is_named_with_its_reason(
    root: Path, larger: dict[str, str]
) -> None:
    nodes = [node for _, node in _classes(root)]
    classes = {node.name: node for node in nodes}
    bases = {base.id for node in nodes for base in node.bases if isinstance(base, ast.Name)}
    twice = [name for name, count in Counter(node.name for node in nodes).items() if count > 1]
    assert not [name for name in twice if name in bases or classes[name].bases], (
        "two classes that inherit have one name"
    )
    large = {}
    for name in classes:
        fields, methods = _sizes(classes, name)
        if len(fields) > FIELDS_MAX or len(methods) > METHODS_MAX:
            large[name] = (len(fields), len(methods))
    assert large.keys() == larger.keys(), large
    assert max(fields for fields, _ in large.values()) <= FIELDS_INHERITED_MAX, large
    assert max(methods for _, methods in large.values()) <= METHODS_INHERITED_MAX, large


INHERITED = {"Conversation", "Traits", "Autopilot", "Simulator"}
"""What classes of the emulator may stand on; each of them keeps the bounds by itself, its heirs by what they add."""


def test_nobody_in_the_emulator_inherits_but_autopilots_and_simulators() -> None:
    nodes = [node for _, node in _classes(EMULATOR)]
    own = {node.name for node in nodes}
    bases = {base.id for node in nodes for base in node.bases if isinstance(base, ast.Name)}
    assert bases & own == INHERITED


@pytest.mark.parametrize("root", [MISSION, EMULATOR])
def test_no_file_of_the_mission_and_of_the_emulator_is_too_long(root: Path) -> None:
    long = {}
    for path in sorted(root.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        if text.count("\n") > LINES_MAX or len(text.encode()) > BYTES_MAX:
            long[str(path.relative_to(root))] = (text.count("\n"), len(text.encode()))
    assert not long, f"more than {LINES_MAX} lines or {BYTES_MAX} bytes: {long}"


def _imports(path: Path, modules: set[str]) -> set[str]:
    """Modules of the program that a file imports, anywhere in it, for types alone too."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found & modules


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Groups of modules that reach each other, by repeatedly taking away whoever imports nothing that is left."""
    left = {name: set(others) - {name} for name, others in graph.items()}
    while True:
        free = {name for name, others in left.items() if not others & left.keys()}
        if not free:
            break
        left = {name: others - free for name, others in left.items() if name not in free}
    while True:  # and whoever is imported by nothing that is left
        wanted = set().union(*left.values()) if left else set()
        if left.keys() <= wanted:
            return [sorted(left)] if left else []
        left = {name: others for name, others in left.items() if name in wanted}


def _modules(root: Path) -> dict[str, Path]:
    """Every module of a package by its name."""
    paths = {".".join((root.name, *p.relative_to(root).with_suffix("").parts)): p for p in root.rglob("*.py")}
    return {name.removesuffix(".__init__"): path for name, path in paths.items()}


def test_nobody_imports_in_a_circle() -> None:
    for root in (ROOT, EMULATOR):
        paths = _modules(root)
        graph = {name: _imports(path, set(paths)) for name, path in paths.items()}
        assert len(graph) > 20
        assert circles(graph) == []


def test_a_circle_is_found() -> None:
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"a"}}) == [["b", "c"]]
    assert circles({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []


ALLOWED_TO_THE_EMULATOR = {"groundstation.mavlink.codec"}
"""The emulator is the witness of our own flights: it shares no code with them but the bytes on the wire."""


def _outside(path: Path) -> set[str]:
    """Modules of groundstation that a file imports; of what is taken from a module, the module."""
    ours = set(_modules(ROOT))
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            inner = {f"{node.module}.{alias.name}" for alias in node.names} & ours
            found |= inner or {node.module}
    return {name for name in found if name.split(".")[0] == "groundstation"}


def test_every_module_of_the_emulator_sees_nothing_of_groundstation_but_the_codec() -> None:
    seen = {name: _outside(path) for name, path in _modules(EMULATOR).items()}
    assert seen["sitl.wire"] == ALLOWED_TO_THE_EMULATOR  # so that an empty search is no success
    wrong = {name: sorted(others - ALLOWED_TO_THE_EMULATOR) for name, others in seen.items()}
    assert {name: others for name, others in wrong.items() if others} == {}


def test_a_forbidden_import_of_the_emulator_is_found(tmp_path: Path) -> None:
    sly = tmp_path / "sly.py"
    sly.write_text("def f():\n    from groundstation.mavlink import clocks\n    import groundstation.core.frames\n")
    assert _outside(sly) == {"groundstation.mavlink.clocks", "groundstation.core.frames"}


def test_the_codec_is_bytes_and_layouts_alone() -> None:
    """What the emulator shares by way of the codec: how frames are cut and laid out, and nothing that decides."""
    paths, shared = _modules(ROOT), set(ALLOWED_TO_THE_EMULATOR)
    while more := {other for name in shared for other in _outside(paths[name])} - shared:
        shared |= more
    assert shared == {
        f"groundstation.mavlink.{name}" for name in ("checksums", "codec", "dialect", "layouts", "splitting")
    }


def _asks_for_kind(path: Path, kinds: tuple[str, ...]) -> list[int]:
    """Lines of a file in which ``isinstance`` asks for a class of such a name."""
    return [
        node.lineno
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id == "isinstance"
        and any(isinstance(name, ast.Name) and name.id.startswith(kinds) for name in ast.walk(node.args[1]))
    ]


def test_nobody_asks_a_safety_region_for_its_kind(tmp_path: Path) -> None:
    asked = {str(path): _asks_for_kind(path, ("Safety", "Upright")) for path in ROOT.rglob("*.py")}
    assert {name: lines for name, lines in asked.items() if lines} == {}
    sly = tmp_path / "sly.py"
    sly.write_text("if isinstance(region, (int, SafetySphere)):\n    pass\n")
    assert _asks_for_kind(sly, ("Safety",)) == [1]


def test_nobody_asks_a_step_of_a_mission_for_its_kind(tmp_path: Path) -> None:
    """A step answers what is asked of it; which class flies it stands in one place, where all kinds have a case."""
    kinds = tuple(name for name in vars(schema) if name.endswith("Step") and name != "Step")
    assert {"FormStep", "HoldStep", "MoveStep", "PlaceStep", "GoToStep"} <= set(kinds)
    asked = {str(path): _asks_for_kind(path, kinds) for path in ROOT.rglob("*.py")}
    assert {name: lines for name, lines in asked.items() if lines} == {}
    named = {
        str(path.relative_to(MISSION))
        for path in MISSION.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.MatchClass) and ast.unparse(node.cls) in kinds
    }
    assert named == {"flight/steps.py"}
    sly = tmp_path / "sly.py"
    sly.write_text("if isinstance(step, FormStep):\n    pass\n")
    assert _asks_for_kind(sly, kinds) == [1]


ANY = {
    "groundstation/core/files.py: _UniqueKeyLoader": "PyYAML's own signatures",
    "groundstation/core/files.py: read_yaml": "what a file of somebody else holds",
    "groundstation/core/files.py: parse_yaml": "the same",
    "groundstation/core/files.py: parse_yaml_value": "the same",
    "groundstation/core/files.py: validate": "the same, before it is judged",
    "groundstation/design/problem.py: Matrix": "real or complex",
    "groundstation/links/mavsdk_link.py: MavsdkLink": "the objects of a package without types",
    "groundstation/mavlink/codec.py: Encoder": "fields of a message by name: numbers, texts, lists",
    "groundstation/mavlink/codec.py: _flatten": "the same",
    "groundstation/mavlink/station.py: Station": "fields of a message by name",
    "groundstation/mission/plan/overrides.py: override_value": "a mission file before it is judged",
    "groundstation/mission/plan/plan.py: MissionPlan": "the mission as JSON has it",
    "groundstation/mission/plan/plan.py: _plain": "a formation as JSON has it",
    "groundstation/mission/plan/reading.py: plan_from_record": "a mission out of JSON, before it is judged",
    "groundstation/mission/plan/reading.py: _shape_from_record": "a formation out of JSON, before it is judged",
    "groundstation/records/imports.py: import_crazyswarm": "the formation as JSON has it",
    "groundstation/records/imports.py: _positions": "columns of a message",
    "groundstation/records/imports.py: _setpoints": "the same",
    "groundstation/records/manifest.py: Values": "what JSON holds, by key",
    "groundstation/records/manifest.py: _expect": "one of its values",
    "groundstation/records/manifest.py: _plain": "the same",
    "sitl/faults.py: _ShallowLoader": "PyYAML's own signature",
    "sitl/faults.py: parse_fault": "what a file of somebody else holds",
    "sitl/wire.py: Fields": "fields of a message by name: numbers, texts, lists",
}
"""Where ``Any`` stands below the commands and their door for Python, and what for; all else has types."""


def _uses_any(tree: ast.Module) -> set[str]:
    """Names at the top of a file in which ``Any`` is used: functions, classes, aliases."""
    found = set()
    for node in tree.body:
        if any(isinstance(item, ast.Name) and item.id == "Any" for item in ast.walk(node)):
            targets = node.targets if isinstance(node, ast.Assign) else [node]
            found |= {getattr(item, "name", None) or ast.unparse(item) for item in targets}
    return found


def test_any_stands_only_where_the_list_says() -> None:
    used = set()
    for root in (ROOT, EMULATOR):
        for path in root.rglob("*.py"):
            name = path.relative_to(root.parent)
            if name.parts[:2] != ("groundstation", "app") and name.parts[1:] != ("api.py",):
                used |= {f"{name}: {item}" for item in _uses_any(ast.parse(path.read_text(encoding="utf-8")))}
    assert used == set(ANY), used ^ set(ANY)


ANY_IN_THE_APP = {
    "api.py": 0,
    "app/campaign/cases.py": 4,
    "app/campaign/conduct.py": 1,
    "app/campaign/report.py": 11,
    "app/campaign/run.py": 1,
    "app/campaign/spread.py": 5,
    "app/campaign/summary.py": 5,
    "app/campaign/table.py": 8,
    "app/campaign/vary.py": 20,
    "app/check_screen.py": 2,
    "app/commands/bench.py": 1,
    "app/commands/command.py": 4,
    "app/commands/identify.py": 1,
    "app/commands/replay.py": 1,
    "app/flying.py": 5,
    "app/identifying.py": 4,
    "app/key_setup.py": 1,
    "app/keyboard.py": 1,
    "app/killed_flight.py": 2,
    "app/log_tables.py": 3,
    "app/order_client.py": 4,
    "app/order_socket.py": 2,
    "app/output.py": 4,
    "app/picture_style.py": 2,
    "app/replaying.py": 1,
    "app/report.py": 7,
}
"""How often at most ``Any`` stands in a file of the commands and in the door for Python; where no figure is, never.

Tables of a log are those of pandas and polars, which need not be installed: that is what log_tables has it for.
"""


def _count_any(tree: ast.Module) -> int:
    """How often ``Any`` is used in a file; that it is imported does not count."""
    named = (isinstance(item, ast.Name) and item.id == "Any" for item in ast.walk(tree))
    spelled = (isinstance(item, ast.Attribute) and item.attr == "Any" for item in ast.walk(tree))
    return sum(named) + sum(spelled)


def test_any_stands_in_the_commands_no_oftener_than_it_did() -> None:
    used = {
        path.relative_to(ROOT).as_posix(): _count_any(ast.parse(path.read_text(encoding="utf-8")))
        for path in [ROOT / "api.py", *(ROOT / "app").rglob("*.py")]
    }
    assert set(ANY_IN_THE_APP) <= set(used), "a file of the list is gone: name it as it is called now"
    more = {name: count for name, count in used.items() if count > ANY_IN_THE_APP.get(name, 0)}
    assert more == {}


def test_any_is_found_wherever_it_hides() -> None:
    sly = ast.parse("Row = dict[str, Any]\nclass A:\n    def f(self, x: list[Any]) -> None: ...\ndef g() -> Any: ...\n")
    assert _uses_any(sly) == {"Row", "A", "g"}
    assert _count_any(sly) == 3
    assert _count_any(ast.parse("from typing import Any\nx: typing.Any\n")) == 1


_GROWS = frozenset({"append", "extend", "insert", "add", "update", "setdefault", "remove", "discard"})


def _stored(node: ast.AST) -> Iterator[ast.expr]:
    """What a statement writes to, tuples taken apart, and what it makes a container of somebody's grow by."""
    targets: list[ast.expr] = []
    if isinstance(node, ast.Assign | ast.Delete):
        targets = list(node.targets)
    elif isinstance(node, ast.AugAssign | ast.AnnAssign | ast.For):
        targets = [node.target]
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in _GROWS:
        targets = [node.func.value]
    while targets:
        target = targets.pop()
        if isinstance(target, ast.Tuple | ast.List):
            targets += target.elts
        elif isinstance(target, ast.Starred | ast.Subscript):
            targets.append(target.value)
        else:
            yield target


def written_elsewhere(tree: ast.Module) -> list[str]:
    """Fields of other objects that a file writes, unless a class with such a field stands in the same file.

    What belongs to Python itself (``sys.modules``, ``module.__file__``, flags of arrays) is nobody's field.
    """
    own = {name for node in ast.walk(tree) if isinstance(node, ast.ClassDef) for name in _fields(node)}
    modules = {name.name for node in ast.walk(tree) if isinstance(node, ast.Import) for name in node.names}
    return [
        f"line {target.lineno}: {ast.unparse(target)}"
        for node in ast.walk(tree)
        for target in _stored(node)
        if isinstance(target, ast.Attribute)
        and not (isinstance(target.value, ast.Name) and target.value.id == "self")
        and target.attr not in own
        and not ast.unparse(target).endswith((".flags.writeable", "__"))
        and ast.unparse(target.value) not in modules
    ]


def test_nobody_writes_the_fields_of_another_one() -> None:
    wrong = {
        str(path.relative_to(MISSION)): found
        for path in MISSION.rglob("*.py")
        if (found := written_elsewhere(ast.parse(path.read_text(encoding="utf-8"))))
    }
    assert wrong == {}


def test_a_field_written_from_outside_is_found() -> None:
    sly = """
class Mine:
    def __init__(self): self.own, self._list = 0, []
    def fine(self, other): self._list.append(1); other.own = 2
    def sly(self, other):
        other.theirs, self.own = 1, 2
        self.friend.rows[3] += 1
        other.names.append("x")
"""
    found = written_elsewhere(ast.parse(sly))
    assert [line.split(": ")[1] for line in found] == ["other.theirs", "self.friend.rows", "other.names"]


def test_guidance_keeps_no_memory() -> None:
    """What is told by way of ``self`` stands in the constructor; no other method of the file writes anything there."""
    tree = ast.parse((MISSION / "flight" / "guidance.py").read_text(encoding="utf-8"))
    methods = [
        method
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef)
        for method in node.body
        if isinstance(method, ast.FunctionDef) and method.name != "__init__"
    ]
    assert len(methods) > 5
    written = [ast.unparse(t) for method in methods for node in ast.walk(method) for t in _stored(node)]
    assert [name for name in written if name.startswith("self.")] == []


WITHOUT_REMEDY = {
    "BeyondFence": "1: everybody comes back, and nothing is left to be done",
    "Distance": "2: the same",
    "Following": "1: what can be done was said when it was found",
    "Losses": "1: good news",
    "PoseAge": "1: it is held for a moment; what can be done is said when its position is lost",
    "Modes": "1: its pilot has it",
    "Battery": "1: it comes back by itself",
    "Descents": "3: the words say it, for they are the reason of the result too",
    "PoseJump": "1: the same",
    "Restarts": "2: the same",
    "Resting": "1: the same",
    "Sinking": "2: the same",
    "Touchdowns": "2: the same",
    "TrafficNear": "1: the same",
}
"""Monitors: how many of their findings name no remedy beside the words, and why."""


def test_a_finding_says_what_a_person_can_do_or_is_named_with_its_reason() -> None:
    found: Counter[str] = Counter()
    for _, node in _classes(MISSION / "monitors"):
        for call in ast.walk(node):
            if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "Finding":
                found[node.name] += not any(keyword.arg == "remedy" for keyword in call.keywords)
    assert len(found) > len(WITHOUT_REMEDY)
    assert {name: count for name, count in found.items() if count} == {
        name: int(words.partition(":")[0]) for name, words in WITHOUT_REMEDY.items()
    }
