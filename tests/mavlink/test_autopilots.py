"""What differs from autopilot to autopilot."""

from __future__ import annotations

import pytest

from groundstation.mavlink.autopilots import AUTOPILOTS


@pytest.mark.parametrize(
    ("autopilot", "flags", "usable"),
    [
        # ESTIMATOR_STATUS of PX4 1.16.1 on its simulator: first second, before GPS, at rest, in the air
        ("px4", 0x480, False),
        ("px4", 0xE5, False),
        ("px4", 0x3FF, True),
        ("px4", 0x37F, True),
        # 1.13 to 1.15: "constant position" means "no horizontal velocity", by their source
        ("px4", 0x33F, True),
        ("px4", 0x33F & ~0x31A | 0x80, False),
        # EKF_STATUS_REPORT of ArduCopter 4.7: before 6 s, before GPS is used, after; GPS jumps
        ("arducopter", 0x400, False),
        ("arducopter", 0xA7, False),
        ("arducopter", 0x33F, True),
        ("arducopter", 0x833F, False),
    ],
)
def test_an_estimator_is_judged_by_what_says_on_that_firmware_that_it_is_usable(
    autopilot: str, flags: int, usable: bool
) -> None:
    assert (AUTOPILOTS[autopilot].estimator_trouble(flags) is None) == usable


@pytest.mark.parametrize(
    ("autopilot", "custom_mode", "system_status", "waits"),
    [
        # PX4 1.16.1 whose setpoints had stopped: AUTO.LOITER, status 5; OFFBOARD, status 4 when they came back
        ("px4", 4 << 16 | 3 << 24, 5, True),
        ("px4", 6 << 16, 4, False),
        ("px4", 4 << 16 | 3 << 24, 4, False),  # AUTO.LOITER by a pilot's hand
        ("px4", 3 << 16, 5, False),  # POSCTL: without sticks it sinks
        ("px4", 4 << 16 | 5 << 24, 5, False),  # AUTO.RTL: nothing brings it back
        ("px4", 4 << 16 | 6 << 24, 5, False),
        ("arducopter", 5, 5, False),
    ],
)
def test_who_waits_for_setpoints_is_told_from_who_has_left(
    autopilot: str, custom_mode: int, system_status: int, waits: bool
) -> None:
    assert AUTOPILOTS[autopilot].waits_for_setpoints(custom_mode, system_status) == waits
