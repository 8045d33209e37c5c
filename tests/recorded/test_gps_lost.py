"""Real autopilots that lose their GPS in the air, recorded: what they say of themselves, and who says so first."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from groundstation.mission.timing import SECOND_NS
from groundstation.records.notes import Event
from tests.recorded.recording import OURS, listen, load

FIRST_OF_TWO = 0


@pytest.mark.parametrize(
    ("name", "words", "own_words"),
    [
        ("px4_first_flight2_gps_lost", "no receiver", "vehicle 1 says: Failsafe activated"),
        ("arducopter_first_flight2_gps_lost", "no fix", "vehicle 1 says: EKF Failsafe"),
    ],
)
def test_the_receivers_word_is_taken_long_before_the_autopilot_says_one(
    name: str, words: str, own_words: str, tmp_path: Path
) -> None:
    recording = load(OURS / name, tmp_path)
    belief = listen(recording)
    told_ns, alarm = belief.alarms[0]
    assert alarm.startswith(f"vehicle 1: its GPS has had {words} for 1 s, so that its position is a guess; it lands")
    assert not [text for _, text in belief.alarms if text.startswith("vehicle 2")]
    itself_ns = next(
        item.t_ns for item in recording.records if isinstance(item, Event) and item.text.endswith(own_words)
    )
    assert itself_ns - told_ns > 3 * SECOND_NS

    def astray_m(t_ns: int) -> float:
        """How far it is from where it says to be, since it was told to land."""
        row = int(np.searchsorted(belief.t_ns, t_ns))
        true_enu_m, _ = recording.truth.at(FIRST_OF_TWO, belief.t_ns[[row]])
        return float(np.linalg.norm((belief.pos_enu_m[row, FIRST_OF_TWO] - true_enu_m[0])[:2]))

    before_m = astray_m(told_ns - 3 * SECOND_NS)
    assert abs(astray_m(told_ns) - before_m) < 0.35
    assert astray_m(itself_ns) - before_m > 0.5
