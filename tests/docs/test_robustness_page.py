"""docs/robustness.md and its pictures are those of the runs that are committed beside it."""

from __future__ import annotations

import numpy as np

from groundstation.app.campaign.vary import load_vary
from groundstation.app.resources import packaged_configs
from tests.docs.robustness import ROWS, cells, flown, pictures, table

PAGE = ROWS.with_suffix(".md").read_text(encoding="utf-8")


def test_every_row_of_the_table_is_what_the_runs_come_to() -> None:
    assert [line for line in table() if line not in PAGE] == []


def test_the_runs_are_those_of_the_campaign_that_comes_along() -> None:
    vary = load_vary(packaged_configs() / "campaigns" / "robustness.yaml")
    named = [(cell.name.rsplit(" ", 1)[0], float(cell.name.rsplit(" ", 1)[1])) for cell in vary.cells]
    assert list(cells(flown())) == named


def test_the_pictures_show_every_run_that_formed() -> None:
    figure = pictures()
    dots = [line for axes in figure.axes[4:] for line in axes.lines if line.get_marker() == "."]
    shown = sum(np.size(line.get_ydata()) for line in dots)
    unshown = ("level", "view")
    assert shown >= sum(run.formed for run in flown() if run.sweep not in unshown) > 30
