"""What people and machines outside read of the project: version, workflow, templates, container."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tarfile
import zipfile
from pathlib import Path

import pytest
import yaml

from groundstation.app import about
from groundstation.mavlink.dialect import from_json, from_pymavlink

_ROOT = Path(__file__).parents[1]


def test_the_version_names_the_commit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if (_ROOT / ".git").exists():
        head = subprocess.run(
            ["/usr/bin/env", "git", "-C", str(_ROOT), "rev-parse", "HEAD"], capture_output=True, text=True, check=True
        ).stdout.strip()
        assert head.startswith(about.commit().rstrip("+"))
        assert re.fullmatch(r"gs \S+ \(commit [0-9a-f]{12,}\+?\)", about.version_words())
    monkeypatch.setattr(about, "_PACKAGE", tmp_path)  # somewhere that is no checkout
    assert about.commit() == ""
    (tmp_path / "commit.txt").write_text("0123456789ab\n")
    assert about.version_words().endswith("(commit 0123456789ab)")


def test_wheel_and_sdist_carry_the_commit_and_all_that_they_need(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from hatchling.builders.sdist import SdistBuilder
    from hatchling.builders.wheel import WheelBuilder

    copy = tmp_path / "source"
    shutil.copytree(
        _ROOT, copy, ignore=shutil.ignore_patterns(".git", ".venv", "__pycache__", "build", "flights", ".*_cache")
    )
    monkeypatch.setenv("GS_COMMIT", "feedfacecafe")
    sdist = Path(next(SdistBuilder(str(copy)).build(directory=str(tmp_path))))
    monkeypatch.delenv("GS_COMMIT")
    with tarfile.open(sdist) as archive:
        archive.extractall(tmp_path / "unpacked", filter="data")
    (unpacked,) = (tmp_path / "unpacked").iterdir()
    wheel = Path(next(WheelBuilder(str(unpacked)).build(directory=str(tmp_path), versions=["standard"])))
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        assert archive.read("groundstation/commit.txt") == b"feedfacecafe\n"
        assert from_json(archive.read("groundstation/mavlink/tables.json").decode()) == from_pymavlink()
    here = {
        path.relative_to(_ROOT).as_posix()
        for folder in ("groundstation", "sitl")
        for path in (_ROOT / folder).rglob("*")
        if path.is_file() and path.suffix in (".py", ".yaml", ".html", ".typed")
    }
    assert here <= names
    configs = {f"groundstation/{path.relative_to(_ROOT).as_posix()}" for path in (_ROOT / "configs").rglob("*.*")}
    assert configs <= names


def test_the_workflow_runs_what_everybody_runs() -> None:
    workflow = yaml.safe_load((_ROOT / ".github/workflows/ci.yml").read_text(encoding="utf-8"))
    jobs = workflow["jobs"]
    assert [step["run"] for step in jobs["test"]["steps"] if "run" in step] == [".ci/run"]
    assert os.access(_ROOT / ".ci/run", os.X_OK)
    assert jobs["installed"]["strategy"]["matrix"]["python"] == ["3.11", "3.12", "3.13"]


def test_issue_templates_are_forms() -> None:
    for name in ("fault", "wish"):
        form = yaml.safe_load((_ROOT / f".github/ISSUE_TEMPLATE/{name}.yml").read_text(encoding="utf-8"))
        assert form["name"]
        assert form["description"]
        assert all(item["type"] in ("markdown", "input", "textarea", "dropdown") for item in form["body"])


def test_readme_says_how_the_container_is_run() -> None:
    readme = (_ROOT / "README.md").read_text(encoding="utf-8")
    container = (_ROOT / "Dockerfile").read_text(encoding="utf-8")
    for line in container.splitlines()[0].removeprefix("# ").split(" && "):
        assert line in readme
    assert 'ENTRYPOINT ["gs"]' in container
