"""docs/architecture.md and CONTRIBUTING.md speak of files and names that exist."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

_ROOT = Path(__file__).parents[1]
_PLACE = re.compile(r"`((?:groundstation|sitl|tests|docs|configs)/[\w./-]*)(?::([\w.]+))?`")
_LINK = re.compile(r"\]\(([\w./-]+\.md)\)")
_PAGES = "docs/architecture.md", "CONTRIBUTING.md"


def _names(path: Path) -> set[str]:
    """Functions, classes and their methods that a module defines."""
    names: set[str] = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        if isinstance(node, ast.ClassDef):
            names |= {f"{node.name}.{item.name}" for item in node.body if isinstance(item, ast.FunctionDef)}
    return names


@pytest.mark.parametrize("page", _PAGES)
def test_places_on_the_map_exist(page: str) -> None:
    text = (_ROOT / page).read_text(encoding="utf-8")
    for path, name in _PLACE.findall(text):
        place = _ROOT / path
        assert place.is_dir() if path.endswith("/") else place.is_file(), f"{page}: {path}"
        assert not name or name in _names(place), f"{page}: {path} has no {name}"
    for link in _LINK.findall(text):
        assert ((_ROOT / page).parent / link).is_file(), f"{page}: {link}"


_QUOTED = (
    ("`vel_ned_m_s = apply_limits(...)`", "flight/guidance.py", "        vel_ned_m_s = apply_limits("),
    ("`REFUSED`", "phases/table.py", "\nREFUSED: "),
    ("`blind`", "monitors/losses.py", "        self.blind: "),
    ("`_monitors`", "monitors/board.py", "        self._monitors: "),
    ("its tag in `Step`", "plan/schema.py", "\nStep = Annotated["),
)
"""What the map quotes of a file of the mission package, and how it stands there."""


@pytest.mark.parametrize(("quoted", "path", "written"), _QUOTED)
def test_what_the_map_quotes_stands_there(quoted: str, path: str, written: str) -> None:
    assert quoted in (_ROOT / "docs/architecture.md").read_text(encoding="utf-8")
    assert (_ROOT / "groundstation/mission" / path).read_text(encoding="utf-8").count(written) == 1


def test_the_map_names_the_way_of_a_packet_and_every_room() -> None:
    text = (_ROOT / "docs/architecture.md").read_text(encoding="utf-8")
    assert len(_PLACE.findall(text)) > 40
    mission = _ROOT / "groundstation" / "mission"
    rooms = [item.name for item in mission.iterdir() if item.is_dir() and item.name != "__pycache__"]
    for room in rooms:
        assert f"`groundstation/mission/{room}/`" in text, f"{room} is not on the map"
    for path in mission.glob("[!_]*.py"):
        assert f"`groundstation/mission/{path.name}" in text, f"{path.name} is not on the map"
    picture = text.split("```")[1]
    packages = {item.name for item in (_ROOT / "groundstation").iterdir() if (item / "__init__.py").is_file()}
    assert {name for name in packages if not re.search(rf"\b{name}\b", picture)} == {"app"}  # which stands above
