"""The site builds strictly, and every page is in its menu once."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from tests.docs import site
from tests.docs.figures import FIGURES


def test_every_page_is_in_the_menu_once() -> None:
    there = {path.name for path in (site.ROOT / "docs").glob("*.md")} | {"changelog.md", "contributing.md"}
    there |= {f"notebooks/{path.stem}.md" for path in (site.ROOT / "docs/notebooks").glob("*.py")}
    assert sorted(site.pages()) == sorted(there)


def test_the_site_builds_and_a_link_that_leads_nowhere_stops_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("docs", "zensical.toml", "CHANGELOG.md", "CONTRIBUTING.md"):
        place = site.ROOT / name
        (shutil.copytree if place.is_dir() else shutil.copy)(place, tmp_path / name)
    monkeypatch.setattr(site, "ROOT", tmp_path)
    monkeypatch.setattr(site, "_LAID", tmp_path / "build" / "docs")
    assert site.build_site() == 0
    built = {path.stem for path in (tmp_path / "build/site").rglob("*.html")}
    assert built >= {Path(page).stem for page in site.pages()}
    with (tmp_path / "docs/law.md").open("a", encoding="utf-8") as page:
        page.write("\n[nowhere](missions.md#no-such-heading)\n")
    assert site.build_site() != 0


def test_every_figure_that_is_drawn_is_shown_and_the_other_way_round() -> None:
    pages = "".join((site.ROOT / "docs" / page).read_text(encoding="utf-8") for page in ("law.md", "robustness.md"))
    shown = set(re.findall(r"\(img/([\w-]+\.svg)\)", pages))
    assert shown == set(FIGURES)
    assert all((site.ROOT / "docs/img" / name).stat().st_size < 100_000 for name in FIGURES)


def test_a_figure_draws_what_the_program_does() -> None:
    figure = FIGURES["law-around.svg"]()
    assert isinstance(figure, Figure)
    assert [text.get_text() for text in figure.axes[0].texts][2:] == ["u", "u turned as little as it takes"]
