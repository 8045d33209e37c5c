"""What differs from autopilot to autopilot: mode words, commands, streams. One class each, no ``if`` elsewhere.

``autopilots`` has a folder for each. Facts come from the MAVLink definitions and from what the firmware was seen to do
(docs/vehicles.md). Nothing here keeps state or sends bytes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping

from groundstation.mavlink.codec import message_id
from groundstation.mavlink.commands import Command
from groundstation.mavlink.failsafes import Failsafes

CMD_NAV_LAND = 21
CMD_NAV_TAKEOFF = 22
CMD_DO_SET_MODE = 176
CMD_COMPONENT_ARM_DISARM = 400
CMD_RUN_PREARM_CHECKS = 401
CMD_SET_MESSAGE_INTERVAL = 511
CMD_REQUEST_MESSAGE = 512
CUSTOM_MODE_ENABLED = 1.0
STATE_CRITICAL = 5
"""MAV_STATE from which on a failsafe acts."""
_FORCE = 21196.0  # the number that makes COMPONENT_ARM_DISARM act in the air
# What ESTIMATOR_STATUS_FLAGS and EKF_STATUS_FLAGS have in common
_HAS_ATTITUDE, _HAS_VELOCITY_XY, _HAS_VELOCITY_Z, _HAS_POSITION, _HAS_HEIGHT = 0x1, 0x2, 0x4, 0x8 | 0x10, 0x20
_NEEDED = (
    (_HAS_ATTITUDE, "has no attitude"),
    (_HAS_VELOCITY_XY, "has no velocity"),
    (_HAS_VELOCITY_Z, "has no vertical velocity"),
    (_HAS_POSITION, "has no position"),
    (_HAS_HEIGHT, "has no height"),
)

MASK_VELOCITY_AND_YAW = 0x09C7
"""POSITION_TARGET_TYPEMASK that leaves velocity and yaw to us and ignores position, acceleration and yaw rate."""
FRAME_LOCAL_NED = 1  # MAV_FRAME


class Autopilot(ABC):
    """How one kind of autopilot is asked for things."""

    name: str
    """As missions say it; its folder has the same name."""
    usual = False
    """Whether it is meant where a mission does not say; it comes first in lists then."""
    mav_autopilot: int
    profile: str
    """What a vehicle of half a metre under it flies like (``mission.plan.profiles``), where nobody has said."""
    follows: tuple[float, float] | None = None
    """Lag and delay, s, with which its own velocity loop follows, where the mission gives none; None: the profile's."""
    takes_origin = False
    """Whether SET_GPS_GLOBAL_ORIGIN moves the estimator's origin once there is one."""
    chatter: tuple[str, ...] = ()
    """Streams that it may send unasked and that nobody here needs; stopped on narrow links."""
    needs_origin = False
    """Whether its estimator takes no position from outside before it has an origin on earth."""
    behind_a_gateway = False
    """Whether it speaks no MAVLink itself."""
    params_bytewise = False
    """Whether integer parameters lie in the bytes of the float that they travel in; else they are cast to it."""
    by_hand: Mapping[str, tuple[int, int]] = {}
    """Second and third number of DO_SET_MODE with which a pilot takes it over: for sticks, hold and land."""
    estimator_message: str
    """Message that tells how its estimator does."""
    oldest: tuple[int, int]
    """Version before which what is relied on here was not there."""
    tried: tuple[int, int]
    """Version from which on failsafes act as described in docs/preflight.md."""
    failsafes: Failsafes
    """What its parameters should say about flying on without us."""

    def arm(self) -> Command:
        """Command that arms, with the autopilot's own checks."""
        return Command("arm", CMD_COMPONENT_ARM_DISARM, (1.0,))

    def disarm(self) -> Command:
        """Command that disarms on the ground; refused in the air."""
        return Command("disarm", CMD_COMPONENT_ARM_DISARM, (0.0,))

    def kill(self) -> Command:
        """Command that stops the motors at once, in the air too."""
        return Command("kill", CMD_COMPONENT_ARM_DISARM, (0.0, _FORCE))

    def message_interval(self, message: str, rate_hz: float) -> Command:
        """Command that sets the rate of a stream; at most that often, as the vehicle's clock divides."""
        interval_us = round(1e6 / rate_hz)
        return Command(
            f"{rate_hz:.3g} Hz of {message}",
            CMD_SET_MESSAGE_INTERVAL,
            (float(message_id(message)), float(interval_us)),
            asks=True,
        )

    def silence(self, message: str) -> Command:
        """Command that stops a stream."""
        return Command(f"no {message}", CMD_SET_MESSAGE_INTERVAL, (float(message_id(message)), -1.0), asks=True)

    def once(self, message: str) -> Command:
        """Command that asks for one message now."""
        return Command(f"one {message}", CMD_REQUEST_MESSAGE, (float(message_id(message)),), asks=True)

    def run_prearm_checks(self) -> Command:
        """Command that makes it say by STATUSTEXT why it would not be armed; refused when armed, arms nothing.

        ArduCopter tells "PreArm: ..." each time; PX4 reports its failing checks anew.
        """
        return Command("its own checks", CMD_RUN_PREARM_CHECKS, asks=True)

    def takeoff(self, height_m: float) -> Command | None:
        """Command that climbs to a height above where it stands, None where velocity setpoints do it.

        With a command, setpoints begin only when the climb is over: they would end it.
        """
        return None

    @abstractmethod
    def streaming_mode(self) -> Command:
        """Command for the mode that follows our velocity setpoints."""

    @abstractmethod
    def idle_mode(self) -> Command:
        """Command for a mode to stand on the ground in; after a flight the mode may be one that cannot be armed in."""

    @abstractmethod
    def is_streaming_mode(self, custom_mode: int) -> bool:
        """Whether a heartbeat's mode word is that mode."""

    @abstractmethod
    def land(self) -> Command:
        """Command that lands where the vehicle is."""

    @abstractmethod
    def is_landing_mode(self, custom_mode: int) -> bool:
        """Whether a heartbeat's mode word says that it lands."""

    @abstractmethod
    def mode_name(self, custom_mode: int) -> str:
        """A mode word for people."""

    tells_home_locally = True
    """Whether HOME_POSITION says where home is in the vehicle's own frame, too."""

    @abstractmethod
    def is_flown_by_pilot(self, custom_mode: int, system_status: int) -> bool:
        """Whether somebody's sticks fly it; a failsafe that shows a mode for sticks is none."""

    def was_taken_while_landing(self, custom_mode: int, system_status: int) -> bool:
        """Whether one that had begun to land and shows this mode now was taken over.

        Nothing but somebody's hand leads from landing to a mode for sticks, whatever its status; to one in which it
        flies by itself a failsafe may.
        """
        if self.is_landing_mode(custom_mode) or self.is_streaming_mode(custom_mode):
            return False
        return system_status < STATE_CRITICAL or self.is_flown_by_pilot(custom_mode, 0)

    def estimator_trouble(self, flags: int) -> str | None:
        """Why its estimator cannot be flown by, in words; None when it can.

        Args:
            flags: of ``estimator_message``.
        """
        return next((words for needed, words in _NEEDED if not flags & needed), None)

    @abstractmethod
    def is_followed_closely(self, custom_mode: int, system_status: int) -> bool:
        """Whether its mode says that setpoints are arriving at this very time."""

    def waits_for_setpoints(self, custom_mode: int, system_status: int) -> bool:
        """Whether its own failsafe holds it in place and follows again by itself once setpoints arrive."""
        return False
