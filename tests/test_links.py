"""Links between the project's pages lead somewhere: files, folders, pictures, and headings of pages."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

_ROOT = Path(__file__).parents[1]
_PAGES = sorted(path.relative_to(_ROOT).as_posix() for path in [*_ROOT.glob("*.md"), *_ROOT.glob("docs/**/*.md")])
_CODE = re.compile(r"^```.*?^```$|`[^`\n]*`", re.DOTALL | re.MULTILINE)
_LINK = re.compile(r"\]\(\s*<?([^)\s>]+)>?[^)]*\)|(?:href|src)=\"([^\"]+)\"|^\[[^\]]+\]:\s*(\S+)", re.MULTILINE)
_FENCE = re.compile(r"^```.*?^```$", re.DOTALL | re.MULTILINE)
_HEADING = re.compile(r"^#{1,6} +(.+?) *#*$", re.MULTILINE)


def links(text: str) -> list[str]:
    """Targets of all links of a page that lead into the project."""
    found = ["".join(groups) for groups in _LINK.findall(_CODE.sub("", text))]
    return [target for target in found if not re.match(r"[a-z][a-z0-9+.-]*:", target)]


def anchors(text: str) -> set[str]:
    """What headings are called in links: small letters, no marks, hyphens for blanks, numbered when repeated."""
    names: dict[str, int] = {}
    found: set[str] = set()
    for heading in _HEADING.findall(_FENCE.sub("", text)):
        plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower()
        name = re.sub(r"[^\w\- ]", "", plain).replace(" ", "-")
        times = names.get(name, 0)
        names[name] = times + 1
        found.add(f"{name}-{times}" if times else name)
    return found


def broken(page: Path, text: str) -> list[str]:
    """Links of a page that lead nowhere."""
    bad: list[str] = []
    for target in links(text):
        path, _, anchor = target.partition("#")
        place = page.parent / path if path else page
        there = place.exists() and place.resolve().is_relative_to(_ROOT)
        if there and anchor:
            there = anchor in anchors(text if place == page else place.read_text(encoding="utf-8"))
        if not there:
            bad.append(target)
    return bad


@pytest.mark.parametrize("page", _PAGES)
def test_links_lead_somewhere(page: str) -> None:
    place = _ROOT / page
    assert broken(place, place.read_text(encoding="utf-8")) == []


def test_every_page_is_reached_from_the_readme() -> None:
    seen, todo = set[Path](), [_ROOT / "README.md"]
    while todo:
        page = todo.pop()
        if page in seen:
            continue
        seen.add(page)
        paths = [target.partition("#")[0] for target in links(page.read_text(encoding="utf-8"))]
        todo += [(page.parent / path).resolve() for path in paths if path.endswith(".md")]
    assert {page.relative_to(_ROOT).as_posix() for page in seen} >= set(_PAGES)


def test_links_that_lead_nowhere_are_found() -> None:
    text = (
        "# The team's place\n## `gs` and 2.5 s\n## Twice\n## Twice\n```\n# no heading\n[no](link.md)\n```\n"
        "[a](#the-teams-place) [b](#gs-and-25-s) [c](#twice-1) [d](docs/safety.md#obstacles) [e](https://example.org/x#y)"
        " `[code](nothing.md)` [f](docs/) [g](#no-heading) [h](#twice-2) [i](docs/none.md) [j](docs/safety.md#none)\n"
        '[k](../outside.md)\n<img src="docs/none.png">\n[l]: docs/no.md\n'
    )
    expected = [
        "#no-heading",
        "#twice-2",
        "docs/none.md",
        "docs/safety.md#none",
        "../outside.md",
        "docs/none.png",
        "docs/no.md",
    ]
    assert broken(_ROOT / "README.md", text) == expected
