"""What a link carries, and the rates that fit it: positions and attitudes down, setpoints up.

Sizes are those of whole MAVLink 2 frames. Refuses links on which no formation can be flown, and to fit anything on a
link whose capacity nobody stated.
"""

from __future__ import annotations

from dataclasses import dataclass

from groundstation.core.errors import UserError
from groundstation.mavlink.codec import layout

_OVERHEAD_BYTES = 12  # header and checksum of MAVLink 2
_SIGNATURE_BYTES = 13
_USABLE = 0.8  # of what the wire carries: bursts, repetitions and texts want room
_POSE_MIN_HZ, _SETPOINT_MIN_HZ = 8.0, 5.0  # the authors needed 10 Hz indoors; PX4 wants more than 2 setpoints a second
_SLOW_DOWN = {"HEARTBEAT": 1.0, "SYS_STATUS": 1.0, "EXTENDED_SYS_STATE": 2.0, "TIMESYNC": 1.0, "COMMAND_ACK": 0.5}
_SLOW_UP = {"COMMAND_LONG": 0.5}
_SHARED_UP = {"HEARTBEAT": 1.0, "TIMESYNC": 1.0}  # once for all behind a link
_SIZES = {"ATTITUDE_QUATERNION": 32, "SYS_STATUS": 31}  # as sent: extensions that are zero are cut off


@dataclass(frozen=True)
class LinkRates:
    """Rates of one vehicle on a link, and what they come to for all of them.

    Attributes:
        pose_hz: positions, and as many attitudes.
        setpoint_hz: velocity setpoints.
        down_bytes_s: all that the vehicles send.
        up_bytes_s: all that we send.
        limit_bytes_s: what the link carries each way; infinite where not known.
        narrow: the limit is what sets the rates.
    """

    pose_hz: float
    setpoint_hz: float
    down_bytes_s: float
    up_bytes_s: float
    limit_bytes_s: float
    narrow: bool

    @property
    def limited(self) -> bool:
        """Whether the link's capacity is known, so that nothing else may be sent over it."""
        return self.limit_bytes_s != float("inf")

    def words(self, link: str, vehicles: int) -> str:
        """One line for people."""
        limit = f" of {self.limit_bytes_s / 1000:.1f}" if self.limit_bytes_s != float("inf") else ""
        return (
            f"{link}: {vehicles} {'vehicle' if vehicles == 1 else 'vehicles'}, positions and attitudes at"
            f" {self.pose_hz:.3g} Hz ({self.down_bytes_s / 1000:.1f}{limit} kB/s), setpoints at"
            f" {self.setpoint_hz:.3g} Hz ({self.up_bytes_s / 1000:.1f}{limit} kB/s)"
        )


def frame_bytes(message: str, *, signed: bool = False) -> int:
    """Size of a message on the wire as it is usually sent."""
    return _SIZES.get(message, layout(message).size) + _OVERHEAD_BYTES + (_SIGNATURE_BYTES if signed else 0)


def fit_rates(
    link: str,
    vehicles: int,
    limit_bytes_s: float,
    *,
    pose_hz: float,
    setpoint_hz: float,
    position: str,
    signed: bool = False,
) -> LinkRates:
    """Fits the rates of a link's vehicles to what it carries.

    Args:
        link: its address, for messages.
        vehicles: how many share it.
        limit_bytes_s: what it carries each way.
        pose_hz: wanted rate of positions.
        setpoint_hz: wanted rate of setpoints.
        position: message type that positions come in.
        signed: every frame bears a signature.

    Raises:
        UserError: what fits is too slow to be flown with.
    """
    usable = _USABLE * limit_bytes_s
    pose_bytes = frame_bytes(position, signed=signed) + frame_bytes("ATTITUDE_QUATERNION", signed=signed)
    slow_down = sum(frame_bytes(name, signed=signed) * rate for name, rate in _SLOW_DOWN.items())
    slow_up = sum(frame_bytes(name, signed=signed) * rate for name, rate in _SLOW_UP.items())
    shared_up = sum(frame_bytes(name, signed=signed) * rate for name, rate in _SHARED_UP.items())
    setpoint_bytes = frame_bytes("SET_POSITION_TARGET_LOCAL_NED", signed=signed)
    pose_fits = (usable / vehicles - slow_down) / pose_bytes
    setpoint_fits = ((usable - shared_up) / vehicles - slow_up) / setpoint_bytes
    pose, setpoint = min(pose_hz, pose_fits), min(setpoint_hz, setpoint_fits)
    for name, rate, least in (("positions", pose, _POSE_MIN_HZ), ("setpoints", setpoint, _SETPOINT_MIN_HZ)):
        if rate < least:
            raise UserError(
                f"link {link}: {limit_bytes_s:.0f} bytes/s for {vehicles} vehicles leave {max(rate, 0.0):.1f} Hz for"
                f" {name}, minimum is {least:g} Hz; use a faster link, or give each vehicle its own"
            )
    return LinkRates(
        pose_hz=pose,
        setpoint_hz=setpoint,
        down_bytes_s=vehicles * (slow_down + pose * pose_bytes),
        up_bytes_s=shared_up + vehicles * (slow_up + setpoint * setpoint_bytes),
        limit_bytes_s=limit_bytes_s,
        narrow=pose < pose_hz or setpoint < setpoint_hz,
    )
