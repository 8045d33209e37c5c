"""The fuzzer, briefly: ``make fuzz`` throws ten million bytes at each target. Tests elsewhere hold what it found."""

from __future__ import annotations

import pytest

from groundstation.mavlink.codec import Frame, FrameSplitter
from groundstation.mavlink.signing import Signing, Verdict
from tests.fuzz.__main__ import fuzz
from tests.fuzz.targets import TARGETS, Datagrams, SignedLinks, Target


@pytest.mark.parametrize("kind", TARGETS, ids=lambda kind: kind.name)
def test_arbitrary_bytes_break_no_promise(kind: type[Target]) -> None:
    outcome = fuzz(kind, 50_000, seed=7)
    assert outcome.cases > 20
    assert not outcome.findings, "\n".join(lines for _, lines in outcome.findings.values())


@pytest.mark.parametrize("fault", [Verdict.WRONG, Verdict.OLD])
def test_it_notices_a_check_that_is_left_out(fault: Verdict, monkeypatch: pytest.MonkeyPatch) -> None:
    check = Signing.check

    def careless(self: Signing, frame: Frame, clock: int, link: int = 0) -> Verdict:
        verdict = check(self, frame, clock, link)
        return Verdict.GOOD if verdict is fault else verdict

    monkeypatch.setattr(Signing, "check", careless)
    assert fuzz(SignedLinks, 50_000, seed=7).findings


def test_it_notices_a_good_frame_that_noise_takes_along(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FrameSplitter, "_none_inside", lambda *_: True)
    assert fuzz(Datagrams, 1_000_000, seed=1).findings
