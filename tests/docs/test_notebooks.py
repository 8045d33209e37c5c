"""The notebooks run from top to bottom, as they are, beside the files that come with them."""

from __future__ import annotations

import runpy
import shutil
from pathlib import Path

import jupytext
import pytest

from tests.docs.site import ROOT

_FOLDER = ROOT / "docs" / "notebooks"
_MAKES = {
    "design_gains": (),
    "change_the_law": ("laws.svg",),
    "many_simulations": ("time_to_form.pdf",),
    "read_a_log": ("four.tlog",),
}
"""Notebook: what it leaves behind."""


def test_these_are_all() -> None:
    assert {path.stem for path in _FOLDER.glob("*.py")} == set(_MAKES)


@pytest.mark.parametrize("name", _MAKES)
def test_a_notebook_runs(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "notebooks"
    shutil.copytree(_FOLDER, folder)
    monkeypatch.chdir(folder)
    runpy.run_path(str(folder / f"{name}.py"))
    assert all((folder / file).stat().st_size > 0 for file in _MAKES[name])
    read = jupytext.read(folder / f"{name}.py")
    assert next(cell.cell_type for cell in read.cells) == "markdown"
    assert sum(cell.cell_type == "code" for cell in read.cells) >= 3
