"""The house rules that can be measured: no class does everything, no file is endless, nobody imports in a circle."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import groundstation

ROOT = Path(groundstation.__file__).parent
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


def _classes() -> Iterator[tuple[str, ast.ClassDef]]:
    for path in sorted(MISSION.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                yield f"{path.relative_to(MISSION)}: {node.name}", node


def test_no_class_of_the_mission_keeps_or_does_too_much() -> None:
    large = {}
    for name, node in _classes():
        fields = len(_fields(node))
        methods = sum(isinstance(item, ast.FunctionDef | ast.AsyncFunctionDef) for item in node.body)
        if fields > FIELDS_MAX or methods > METHODS_MAX:
            large[name] = (fields, methods)
    assert not large, f"more than {FIELDS_MAX} fields or {METHODS_MAX} methods: {large}"


def test_no_file_of_the_mission_is_too_long() -> None:
    long = {}
    for path in sorted(MISSION.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        if text.count("\n") > LINES_MAX or len(text.encode()) > BYTES_MAX:
            long[str(path.relative_to(MISSION))] = (text.count("\n"), len(text.encode()))
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


def test_nobody_imports_in_a_circle() -> None:
    paths = {".".join(("groundstation", *p.relative_to(ROOT).with_suffix("").parts)): p for p in ROOT.rglob("*.py")}
    paths = {name.removesuffix(".__init__"): path for name, path in paths.items()}
    graph = {name: _imports(path, set(paths)) for name, path in paths.items()}
    assert circles(graph) == []


def test_a_circle_is_found() -> None:
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"a"}}) == [["b", "c"]]
    assert circles({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []
