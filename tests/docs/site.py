"""Lays out the pages of the site and builds it; a link that leads nowhere is an error."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import jupytext

ROOT = Path(__file__).parents[2]
_TOP = re.compile(r"\]\((?:\.\./)?((?:CHANGELOG|CONTRIBUTING)\.md)")  # a link to a page at the top
_LAID = ROOT / "build" / "docs"


def menu(nav: Any) -> list[str]:
    """Pages that a menu names, in order."""
    if isinstance(nav, str):
        return [nav]
    if isinstance(nav, dict):
        return [page for value in nav.values() for page in menu(value)]
    return [page for item in nav for page in menu(item)]


def pages() -> list[str]:
    """Pages that the site has in its menu."""
    return menu(tomllib.loads((ROOT / "zensical.toml").read_text(encoding="utf-8"))["project"]["nav"])


def lay_out() -> None:
    """Copies pages and pictures to where the site is built from, with the two at the top, and notebooks as pages."""
    shutil.rmtree(_LAID, ignore_errors=True)
    shutil.copytree(ROOT / "docs", _LAID)
    for name in ("CHANGELOG.md", "CONTRIBUTING.md"):
        text = (ROOT / name).read_text(encoding="utf-8").replace("](docs/", "](")
        (_LAID / name.lower()).write_text(text, encoding="utf-8")
    for notebook in sorted((_LAID / "notebooks").glob("*.py")):
        page = notebook.with_suffix(".md")
        page.write_text(jupytext.writes(jupytext.read(notebook), "md"), encoding="utf-8")
    for page in _LAID.glob("*.md"):
        text = page.read_text(encoding="utf-8")
        page.write_text(_TOP.sub(lambda link: f"]({link[1].lower()}", text).replace(".py)", ".md)"), encoding="utf-8")


def build_site() -> int:
    """Builds the site strictly.

    Returns:
        The builder's exit code.
    """
    lay_out()
    command = [sys.executable, "-m", "zensical", "build", "--clean", "--strict"]
    return subprocess.run(command, cwd=ROOT, check=False).returncode
