"""The values that docs/vehicles.md tells people to set are those that the preflight check wants."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from groundstation.mavlink.autopilots import AUTOPILOTS
from groundstation.mission.ground.failsafe import make_failsafe
from tests.app.flights import mission

_DOC = Path(__file__).parents[2] / "docs" / "vehicles.md"
_MISSIONS = {"px4": "px4_cube8", "arducopter": "arducopter_two_squares8"}


def _told() -> list[tuple[str, float]]:
    """Names with values: of the tables ``| `NAME` | 3 (...) |``, and of ``param set NAME 3``."""
    text = _DOC.read_text(encoding="utf-8")
    rows = re.findall(r"^\| (`[A-Z].*?) \| (-?\d+(?:\.\d+)?)\b", text, flags=re.MULTILINE)
    found = [(name, value) for names, value in rows for name in re.findall(r"`([A-Z_0-9]+)`", names)]
    found += re.findall(r"param set ([A-Z_0-9]+) (-?\d+(?:\.\d+)?)", text)
    found += re.findall(r"`(ARMING_[A-Z]+)`? (\d)", text)
    return [(name, float(value)) for name, value in found]


@pytest.mark.parametrize("autopilot", sorted(_MISSIONS))
def test_what_the_page_says_to_set_is_what_the_check_wants(autopilot: str) -> None:
    wish = make_failsafe(mission(_MISSIONS[autopilot])).wishes[0]
    names, wrong = set(), []
    for name, value in _told():
        for rule in AUTOPILOTS[autopilot].failsafes.rules(wish):
            if name in [known for known, _ in rule.names]:
                names.add(name)
                finding = rule.judge({name: value})
                wrong += [] if finding is None else [finding.text()]
    assert not wrong
    assert {"px4": "COM_OBL_RC_ACT", "arducopter": "FS_GCS_ENABLE"}[autopilot] in names
    assert len(names) >= 5


def test_wrong_values_would_be_noticed() -> None:
    wish = make_failsafe(mission("px4_cube8")).wishes[0]
    rules = AUTOPILOTS["px4"].failsafes.rules(wish)
    assert any((finding := rule.judge({"COM_OBL_RC_ACT": 4.0})) and finding.grave for rule in rules)
