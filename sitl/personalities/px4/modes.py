"""PX4's modes: (main mode, sub mode), their names, and what is the same whoever is in them."""

from __future__ import annotations

Mode = tuple[int, int]
MANUAL, ALTCTL, POSCTL, ACRO, OFFBOARD, STABILIZED = (1, 0), (2, 0), (3, 0), (5, 0), (6, 0), (7, 0)
TAKEOFF, LOITER, MISSION, RTL, LAND = (4, 2), (4, 3), (4, 4), (4, 5), (4, 6)
NAMES = {
    MANUAL: "MANUAL", ALTCTL: "ALTCTL", POSCTL: "POSCTL", ACRO: "ACRO", OFFBOARD: "OFFBOARD", STABILIZED: "STABILIZED",
    TAKEOFF: "AUTO.TAKEOFF", LOITER: "AUTO.LOITER", MISSION: "AUTO.MISSION", RTL: "AUTO.RTL", LAND: "AUTO.LAND",
}  # fmt: skip
PREVENT_ARMING = (LAND, RTL)
NEED_POSITION = {POSCTL, OFFBOARD, TAKEOFF, LOITER, MISSION, RTL, LAND}

CRITICAL, ERROR, WARNING, INFO = 2, 3, 4, 6
"""Severities of texts."""


def mode_flags(mode: Mode, *, armed: bool) -> int:
    """MAV_MODE_FLAG bits of the heartbeat."""
    main = mode[0]
    flags = 0x1 | (0x80 if armed else 0)
    if main in (1, 5):
        return flags | 0x40
    if main in (2, 3, 7):
        return flags | 0x40 | 0x10
    if main == OFFBOARD[0]:
        return flags | 0x10
    return flags | 0x10 | 0x8 | 0x4


def mode_word(mode: Mode) -> int:
    """Mode word of the heartbeat: sub mode << 24, main mode << 16."""
    main, sub = mode
    return sub << 24 | main << 16
