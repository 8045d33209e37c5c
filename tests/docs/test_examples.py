"""Files that the documents print are files that load."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

from groundstation.app.campaign.vary import load_vary
from groundstation.mission.plan.reading import load_mission
from tests.app.commands import gs

_ROOT = Path(__file__).parents[2]


def _blocks(page: str) -> list[str]:
    text = (_ROOT / page).read_text(encoding="utf-8")
    return re.findall(r"^```yaml\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)


@pytest.mark.parametrize("page", sorted(path.relative_to(_ROOT).as_posix() for path in _ROOT.glob("docs/*.md")))
def test_yaml_that_is_printed_is_yaml(page: str) -> None:
    for block in _blocks(page):
        assert yaml.safe_load(block) is not None


def test_the_whole_mission_that_is_printed_loads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    whole = [block for block in _blocks("docs/missions.md") if block.startswith("name:")]
    assert len(whole) == 1
    command = re.search(r"gs (new formation [^\n]+)", whole[0])
    assert command is not None
    assert gs(command[1].split(), monkeypatch, capsys)[0] == 0
    Path("mission.yaml").write_text(whole[0], encoding="utf-8")
    assert load_mission(Path("mission.yaml")).size == 3


def test_the_vary_file_that_is_printed_loads(tmp_path: Path) -> None:
    whole = [block for block in _blocks("docs/campaigns.md") if block.startswith("mission:")]
    assert len(whole) == 1
    (tmp_path / "vary.yaml").write_text(whole[0], encoding="utf-8")
    assert len(load_vary(tmp_path / "vary.yaml").cells) == 4
