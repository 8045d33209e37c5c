"""The emulator against a recording of real firmware: what differs is in docs/emulator.md, with a reason."""

from __future__ import annotations

from pathlib import Path

from tests.recorded.comparing import compare
from tests.recorded.recording import OURS, load

_DOC = Path(__file__).parents[2] / "docs" / "emulator.md"


def _told() -> str:
    text = _DOC.read_text(encoding="utf-8")
    return text.partition("## Compared with recordings")[2].partition("\n## ")[0]


def test_whatever_the_emulator_does_otherwise_is_told_with_a_reason(tmp_path: Path) -> None:
    recording = load(OURS / "px4_first_flight2_from_power_up", tmp_path)
    told = _told()
    found = compare(recording, tmp_path)["px4"]
    assert [item for item in found if f"`{item.subject}`" not in told] == []
    assert len(found) > 5  # else it has looked at nothing


def test_the_real_one_compared_with_itself_shows_nothing(tmp_path: Path) -> None:
    from tests.recorded.comparing import differences, hear

    recording = load(OURS / "px4_first_flight2_from_power_up", tmp_path)
    heard = hear(recording.records, (1, 2))
    assert differences(heard[1], heard[1]) == []
