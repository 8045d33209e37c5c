"""The fuzzer, briefly: ``make fuzz`` throws ten million bytes at each target. Tests elsewhere hold what it found."""

from __future__ import annotations

import pytest

from tests.fuzz.__main__ import fuzz
from tests.fuzz.targets import TARGETS, Target


@pytest.mark.parametrize("kind", TARGETS, ids=lambda kind: kind.name)
def test_arbitrary_bytes_break_no_promise(kind: type[Target]) -> None:
    outcome = fuzz(kind, 50_000, seed=7)
    assert outcome.cases > 20
    assert not outcome.findings, "\n".join(lines for _, lines in outcome.findings.values())
