"""docs/emulator.md tells the truth about tests, faults and options."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from groundstation.app.commands.sitl import sitl
from sitl.faults import KINDS
from sitl.personalities import PROFILES

HERE = Path(__file__).parent
DOC = HERE.parents[1] / "docs" / "emulator.md"

pytestmark = pytest.mark.skipif(not DOC.exists(), reason="the documentation is not part of this distribution")


def test_every_test_that_is_named_exists() -> None:
    names = set()
    for path in HERE.glob("test_*.py"):
        names |= set(re.findall(r"^def (test_\w+)", path.read_text(), re.MULTILINE))
    named = re.findall(r"`(test_\w+)(\.\.\.)?`", DOC.read_text())
    assert len(named) > 50
    for name, dots in named:
        assert name in names or (dots and any(item.startswith(name) for item in names)), name
    for path in re.findall(r"`(?:tests/sitl/)?(test_\w+\.py)`", DOC.read_text()):
        assert (HERE / path).exists(), path


def test_every_fault_and_every_profile_is_in_it() -> None:
    text = DOC.read_text()
    for kind, numbers in KINDS.items():
        assert f"`{kind}`" in text
        for name in numbers:
            assert name in text or name.endswith("_s"), (kind, name)
    for profile in PROFILES:
        assert f"`{profile}`" in text


def test_every_option_is_in_it() -> None:
    text = DOC.read_text()
    hints = {
        str(item) for annotation in sitl.__annotations__.values() for item in re.findall(r"--[a-z-]+", str(annotation))
    }
    for option in hints - {"--spacing", "--gps"}:
        assert option in text, option
