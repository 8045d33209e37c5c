"""Prints belief against truth for the recordings at hand: ``python -m tests.recorded [NAME ...]``."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

from tests.recorded.judging import held_back, judge
from tests.recorded.recording import chosen, listen, load


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")


def main(names: list[str]) -> None:
    """Goes through the recordings whose names contain one of ``names``, or all."""
    for folder in chosen(names):
        with tempfile.TemporaryDirectory() as scratch:
            recording = load(folder, Path(scratch))
        belief = listen(recording)
        _say(f"{folder.name}: {len(belief.t_ns)} ticks, restarts {belief.restarts.tolist()}")
        for text in held_back(belief):
            _say(f"  held back: {text}")
        for t_ns, text in belief.alarms:
            _say(f"  {t_ns / 1e9:7.2f} s {text}")
        for item in judge(recording, belief):
            _say(
                f"  vehicle {item.sysid}: its velocity is said to be off by {item.told_rms_m_s:.3f} m/s and is by"
                f" {np.linalg.norm(item.vel_rms_m_s):.3f}; flown by with {np.linalg.norm(item.steady_rms_m_s):.3f}"
            )
            _say(
                f"  vehicle {item.sysid}: position rms {item.pos_rms_m.round(2)} most {item.pos_max_m.round(2)} m,"
                f" velocity rms {item.vel_rms_m_s.round(2)} most {item.vel_max_m_s.round(2)} m/s, believed aloft"
                f" {item.aloft_early_s:.2f} s early, landed {item.landed_late_s:.2f} s late, ready"
                f" {item.ready_before_arming_s:.2f} s before it was armed; wrong ticks in the air:"
                f" {item.unarmed_in_air} disarmed, {item.landed_in_air} landed"
            )


if __name__ == "__main__":
    main(sys.argv[1:])
