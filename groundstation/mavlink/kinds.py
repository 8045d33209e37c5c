"""What a heartbeat says its sender is: an autopilot or not, and of which type of vehicle. Keeps nothing.

Only multirotors are flown: what stops in the air and climbs straight up by a velocity setpoint. Names and numbers are
those of MAV_TYPE and MAV_AUTOPILOT, out of the dialect.
"""

from __future__ import annotations

from typing import NamedTuple

from groundstation.mavlink.codec import Frame, message_id
from groundstation.mavlink.dialect import dialect

_number = dialect().number

AUTOPILOT_INVALID = _number("MAV_AUTOPILOT_INVALID")
TYPE_GCS = _number("MAV_TYPE_GCS")
MULTIROTORS = frozenset(
    {
        _number("MAV_TYPE_QUADROTOR"),
        _number("MAV_TYPE_COAXIAL"),
        _number("MAV_TYPE_HEXAROTOR"),
        _number("MAV_TYPE_OCTOROTOR"),
        _number("MAV_TYPE_TRICOPTER"),
        _number("MAV_TYPE_DODECAROTOR"),
        _number("MAV_TYPE_DECAROTOR"),
        _number("MAV_TYPE_GENERIC_MULTIROTOR"),
    }
)
"""Types that are flown. Helicopters are not: their failsafes, landing and motors are others than those tried here."""
_PARTS = frozenset(
    {
        _number("MAV_TYPE_GCS"),
        _number("MAV_TYPE_ONBOARD_CONTROLLER"),
        _number("MAV_TYPE_GIMBAL"),
        _number("MAV_TYPE_ADSB"),
        _number("MAV_TYPE_CAMERA"),
        _number("MAV_TYPE_CHARGING_STATION"),
        _number("MAV_TYPE_FLARM"),
        _number("MAV_TYPE_SERVO"),
        _number("MAV_TYPE_ODID"),
        _number("MAV_TYPE_BATTERY"),
        _number("MAV_TYPE_PARACHUTE"),
        _number("MAV_TYPE_LOG"),
        _number("MAV_TYPE_OSD"),
        _number("MAV_TYPE_IMU"),
        _number("MAV_TYPE_GPS"),
        _number("MAV_TYPE_WINCH"),
        _number("MAV_TYPE_ILLUMINATOR"),
        _number("MAV_TYPE_GRIPPER"),
    }
)
_HEARTBEAT = message_id("HEARTBEAT")
_TYPE_AT, _AUTOPILOT_AT, _LENGTH = 4, 5, 6  # in the payload, behind the mode word


class Kind(NamedTuple):
    """What a heartbeat's sender says it is: MAV_TYPE and MAV_AUTOPILOT."""

    mav_type: int
    mav_autopilot: int

    @property
    def is_autopilot(self) -> bool:
        """Whether it is the autopilot of a vehicle, and no part of one and no ground station."""
        return self.mav_autopilot != AUTOPILOT_INVALID and self.mav_type not in _PARTS

    @property
    def number(self) -> int:
        """Both in one number."""
        return self.mav_type << 8 | self.mav_autopilot

    @classmethod
    def of_number(cls, number: int) -> Kind:
        """The other way round."""
        return cls(number >> 8, number & 0xFF)

    @property
    def words(self) -> str:
        """For people, for example ``fixed wing (MAV_TYPE 1), MAV_AUTOPILOT 3``."""
        return f"{type_words(self.mav_type)}, MAV_AUTOPILOT {self.mav_autopilot}"


def kind_of(frame: Frame) -> Kind | None:
    """What the sender of a heartbeat says it is; None of any other message."""
    if frame.msgid != _HEARTBEAT:
        return None
    payload = frame.payload.ljust(_LENGTH, b"\0")  # trailing zeros are cut off on the wire
    return Kind(payload[_TYPE_AT], payload[_AUTOPILOT_AT])


def unflown_words(mav_type: int) -> str | None:
    """Why a vehicle of this type is not flown; None where it is, and of one that has not told it (below 0)."""
    if mav_type in MULTIROTORS or mav_type < 0:
        return None
    return f"it says that it is a {type_words(mav_type)}, and only multirotors are flown"


def type_words(mav_type: int) -> str:
    """A MAV_TYPE for people, for example ``fixed wing (MAV_TYPE 1)``."""
    known = dialect().enums["MAV_TYPE"].get(mav_type)
    if known is None:
        return f"MAV_TYPE {mav_type}"
    return f"{known.removeprefix('MAV_TYPE_').replace('_', ' ').lower()} (MAV_TYPE {mav_type})"
