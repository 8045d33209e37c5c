"""Runs ``gs`` within the tests, as people and scripts call it."""

from __future__ import annotations

import sys
from collections.abc import Sequence

import pytest

from groundstation.app import cli


def gs(
    arguments: Sequence[str], monkeypatch: pytest.MonkeyPatch, captured: pytest.CaptureFixture[str]
) -> tuple[int, str, str]:
    """Runs a command to its end.

    Args:
        arguments: what stands after ``gs``.
        monkeypatch: sets the command line.
        captured: ``capsys``, or ``capfd`` where other programs' words count.

    Returns:
        Exit code, stdout and stderr, these with all that was captured before.
    """
    monkeypatch.setattr(sys, "argv", ["gs", *arguments])
    code = 0
    try:
        cli.main()
    except SystemExit as ended:
        code = int(ended.code or 0)
    out, err = captured.readouterr()
    return code, out, err
