"""What a Crazyflie is told, as values: whoever holds its link turns them into packets.

Frame: the room's, as the vehicle itself has it (x east, y north, z up, m; yaw from x counter-clockwise).
"""

from __future__ import annotations

from dataclasses import dataclass

Place = tuple[float, float, float]
VALID_MS = 100
"""So long the last velocity still counts after ``SetpointsStop``."""


@dataclass(frozen=True)
class Velocity:
    """A velocity in the room's frame, m/s, and a yaw rate, rad/s, counter-clockwise seen from above."""

    vel_enu_m_s: Place
    yaw_rate_rad_s: float


@dataclass(frozen=True)
class SetpointsStop:
    """The stream of velocities ends: from now on the high-level commander is heard."""


@dataclass(frozen=True)
class TakeOff:
    """Climbs by the high-level commander to a height in the room's frame, in a time."""

    height_m: float
    duration_s: float


@dataclass(frozen=True)
class LandAt:
    """Sinks by the high-level commander to a height in the room's frame, in a time; there the motors stop."""

    height_m: float
    duration_s: float


@dataclass(frozen=True)
class GoTo:
    """Flies to a place by the high-level commander, in a time.

    Attributes:
        place_enu_m: in the room's frame, or from where the vehicle believes to be.
        relative: the latter; the yaw stays then.
        yaw_enu_rad: heading at the end; ignored when relative.
        duration_s: of the way.
    """

    place_enu_m: Place
    relative: bool
    yaw_enu_rad: float
    duration_s: float


@dataclass(frozen=True)
class HighLevelStop:
    """The high-level commander gives up what it does and lets the motors stand: for vehicles on the ground."""


@dataclass(frozen=True)
class Arm:
    """Arms or disarms by the supervisor.

    Attributes:
        arm: arms.
        old: as firmware before version 12 of CRTP wants to be told, which has no supervisor's port.
    """

    arm: bool
    old: bool = False


@dataclass(frozen=True)
class Recover:
    """After a crash, once it stands upright: the supervisor begins anew. One that is locked stays so.

    Attributes:
        old: as for ``Arm``.
    """

    old: bool = False


@dataclass(frozen=True)
class EmergencyStop:
    """Motors off at once; the vehicle is locked until it is restarted.

    Attributes:
        old: as for ``Arm``.
    """

    old: bool = False


@dataclass(frozen=True)
class SetParam:
    """Writes a parameter, by its full name."""

    name: str
    value: float


@dataclass(frozen=True)
class ExternalPose:
    """Where it is and how it lies, as somebody outside sees it.

    Attributes:
        pos_enu_m: in the room's frame.
        quat_enu_from_flu: x y z w, as the firmware has it; None where only the place is known.
    """

    pos_enu_m: Place
    quat_enu_from_flu: tuple[float, float, float, float] | None


@dataclass(frozen=True)
class Ping:
    """Asks for an echo, by its number (16 bits)."""

    number: int


@dataclass(frozen=True)
class LogRate:
    """Poses a second that it is to log from now on."""

    hz: float


Order = (
    Ping
    | LogRate
    | ExternalPose
    | Velocity
    | SetpointsStop
    | TakeOff
    | LandAt
    | GoTo
    | HighLevelStop
    | Arm
    | Recover
    | EmergencyStop
    | SetParam
)
