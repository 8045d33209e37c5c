"""What a link carries, and the rates that fit it: positions and attitudes down, setpoints up.

Sizes are those of whole MAVLink 2 frames. Refuses links on which no formation can be flown, and to fit anything on a
link whose capacity nobody stated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from groundstation.core.errors import UserError
from groundstation.mavlink.codec import layout

_OVERHEAD_BYTES = 12  # header and checksum of MAVLink 2
_SIGNATURE_BYTES = 13
_USABLE = 0.8  # of what the wire carries: bursts, repetitions and texts want room
_POSE_MIN_HZ, _SETPOINT_MIN_HZ = 8.0, 5.0
"""The authors needed 10 Hz or more of positions; 8 Hz is what is left of that with a fifth lost. PX4 takes less than
2 setpoints a second for none; of 5 Hz a fifth may be lost as well."""
_POSE_ENOUGH_HZ = 10.0  # below this everything else is cut down first
_ATTITUDE_LEAN_HZ = 2.0  # attitudes only say how the body axes lie in which the law is reckoned, and are turned back by
_UP = {"COMMAND_LONG": 0.5}
_SHARED_UP = {"HEARTBEAT": 1.0, "TIMESYNC": 0.5}  # once for all behind a link
_BAUDS = (57_600, 115_200, 230_400, 460_800, 921_600)
_SIZES = {"ATTITUDE_QUATERNION": 32, "SYS_STATUS": 31}  # as sent: extensions that are zero are cut off
_UNASKED = {"HEARTBEAT": 1.0, "TIMESYNC": 0.5, "COMMAND_ACK": 0.5}

STATUS_HZ = {"EXTENDED_SYS_STATE": 10.0, "SYS_STATUS": 2.0}
"""Rates of the slow messages where the link carries anything."""
STATUS_NARROW_HZ = {"EXTENDED_SYS_STATE": 2.0, "SYS_STATUS": 1.0}
"""The same on a link of known capacity."""
STATUS_LEAN_HZ = {"EXTENDED_SYS_STATE": 1.0, "SYS_STATUS": 0.2}
"""The same where positions want every byte."""
FIX_HZ, FIX_NARROW_HZ, FIX_LEAN_HZ = 2.0, 0.5, 0.2
"""The same three rates for GPS_RAW_INT, of vehicles whose place comes from GPS."""
CROSS_CHECK_HZ, CROSS_CHECK_LEAN_HZ = 1.0, 0.5
"""Rate of the other position message, which the first is held against."""


@dataclass(frozen=True)
class LinkRates:
    """Rates of one vehicle on a link, and what they come to for all of them.

    Attributes:
        pose_hz: positions.
        attitude_hz: attitudes; as many as positions, unless the link is lean.
        setpoint_hz: velocity setpoints.
        down_bytes_s: all that the vehicles send.
        up_bytes_s: all that we send.
        limit_bytes_s: what the link carries each way; infinite where not known.
        narrow: the limit is what sets the rates.
        lean: attitudes and status are cut down so that positions fit.
    """

    pose_hz: float
    attitude_hz: float
    setpoint_hz: float
    down_bytes_s: float
    up_bytes_s: float
    limit_bytes_s: float
    narrow: bool
    lean: bool

    @property
    def limited(self) -> bool:
        """Whether the link's capacity is known, so that nothing else may be sent over it."""
        return self.limit_bytes_s != float("inf")

    def words(self, link: str, vehicles: int) -> str:
        """One line for people."""
        limit = f" of {self.limit_bytes_s / 1000:.1f}" if self.limit_bytes_s != float("inf") else ""
        poses = f"positions and attitudes at {self.pose_hz:.3g} Hz"
        if self.lean:
            poses = f"positions at {self.pose_hz:.3g} Hz and attitudes at {self.attitude_hz:.3g} Hz"
        return (
            f"{link}: {vehicles} {'vehicle' if vehicles == 1 else 'vehicles'}, {poses}"
            f" ({self.down_bytes_s / 1000:.1f}{limit} kB/s), setpoints at"
            f" {self.setpoint_hz:.3g} Hz ({self.up_bytes_s / 1000:.1f}{limit} kB/s)"
        )

    def status_hz(self) -> dict[str, float]:
        """Rates of the slow messages."""
        return dict(STATUS_LEAN_HZ if self.lean else STATUS_NARROW_HZ if self.limited else STATUS_HZ)

    @property
    def fix_hz(self) -> float:
        """Rate of GPS_RAW_INT."""
        return FIX_LEAN_HZ if self.lean else FIX_NARROW_HZ if self.limited else FIX_HZ

    @property
    def cross_check_hz(self) -> float:
        """Rate of the other position message."""
        return CROSS_CHECK_LEAN_HZ if self.lean else CROSS_CHECK_HZ


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
    cross_check: bool = False,
    gps: bool = False,
    signed: bool = False,
) -> LinkRates:
    """Fits the rates of a link's vehicles to what it carries.

    Where less than 10 Hz of positions with as many attitudes would fit, attitudes and status are cut down first.

    Args:
        link: its address, for messages.
        vehicles: how many share it.
        limit_bytes_s: what it carries each way.
        pose_hz: wanted rate of positions.
        setpoint_hz: wanted rate of setpoints.
        position: message type that positions come in.
        cross_check: the other position message is asked for as well.
        gps: GPS_RAW_INT is asked for as well.
        signed: every frame bears a signature.

    Raises:
        UserError: what fits is too slow to be flown with.
    """

    def fit(count: int, bytes_s: float) -> LinkRates:
        return _fit(count, bytes_s, pose_hz, setpoint_hz, position, cross_check=cross_check, gps=gps, signed=signed)

    rates = fit(vehicles, limit_bytes_s)
    for name, rate, least in (
        ("positions", rates.pose_hz, _POSE_MIN_HZ),
        ("setpoints", rates.setpoint_hz, _SETPOINT_MIN_HZ),
    ):
        if rate < least:

            def fits(count: int, bytes_s: float) -> bool:
                fitted = fit(count, bytes_s)
                return fitted.pose_hz >= _POSE_MIN_HZ and fitted.setpoint_hz >= _SETPOINT_MIN_HZ

            able = max((count for count in range(1, vehicles) if fits(count, limit_bytes_s)), default=0)
            carries = f"{able} would fit" if able else "not even one would fit"
            baud = next((baud for baud in _BAUDS if fits(vehicles, baud / 10.0)), None)
            faster = f" ({baud} baud do)" if baud is not None else ""
            raise UserError(
                f"link {link}: {limit_bytes_s:.0f} bytes/s for {vehicles} vehicles leave {max(rate, 0.0):.1f} Hz for"
                f" {name}, minimum is {least:g} Hz; {carries}: use a faster link{faster}, or put fewer on it"
            )
    return rates


def _fit(
    vehicles: int,
    limit_bytes_s: float,
    pose_hz: float,
    setpoint_hz: float,
    position: str,
    *,
    cross_check: bool,
    gps: bool,
    signed: bool,
) -> LinkRates:
    """What fits, however little."""
    usable = _USABLE * limit_bytes_s

    def size(message: str) -> int:
        return frame_bytes(message, signed=signed)

    def total(rates: Mapping[str, float]) -> float:
        return sum(size(name) * rate for name, rate in rates.items())

    position_bytes, attitude_bytes = size(position), size("ATTITUDE_QUATERNION")
    other = "LOCAL_POSITION_NED" if position == "GLOBAL_POSITION_INT" else "GLOBAL_POSITION_INT"
    other_bytes, fix_bytes = size(other) if cross_check else 0, size("GPS_RAW_INT") if gps else 0
    slow = total(_UNASKED) + total(STATUS_NARROW_HZ) + CROSS_CHECK_HZ * other_bytes + FIX_NARROW_HZ * fix_bytes
    fits_hz = (usable / vehicles - slow) / (position_bytes + attitude_bytes)
    lean = fits_hz < min(_POSE_ENOUGH_HZ, pose_hz)
    pose = attitude = min(pose_hz, fits_hz)
    if lean:
        attitude = _ATTITUDE_LEAN_HZ
        slow = total(_UNASKED) + total(STATUS_LEAN_HZ) + CROSS_CHECK_LEAN_HZ * other_bytes + FIX_LEAN_HZ * fix_bytes
        pose = min(pose_hz, (usable / vehicles - slow - attitude * attitude_bytes) / position_bytes)
    setpoint_bytes = size("SET_POSITION_TARGET_LOCAL_NED")
    setpoint = min(setpoint_hz, ((usable - total(_SHARED_UP)) / vehicles - total(_UP)) / setpoint_bytes)
    return LinkRates(
        pose_hz=pose,
        attitude_hz=attitude,
        setpoint_hz=setpoint,
        down_bytes_s=vehicles * (slow + pose * position_bytes + attitude * attitude_bytes),
        up_bytes_s=total(_SHARED_UP) + vehicles * (total(_UP) + setpoint * setpoint_bytes),
        limit_bytes_s=limit_bytes_s,
        narrow=lean or pose < pose_hz or setpoint < setpoint_hz,
        lean=lean,
    )
