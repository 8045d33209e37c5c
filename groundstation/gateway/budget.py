"""What a Crazyradio carries: packets a second for vehicles, poses, setpoints and logs, and the rate that fits.

One transaction is a packet to a vehicle and its acknowledgement, in which a packet of the vehicle comes back: a vehicle
costs as many as the busier of its two directions. Figures of air and USB time are reckoned from the data sheets
(nRF24: 32 bytes, 130 us to turn round) and not measured; whoever knows his radio gives its own number. Keeps nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from groundstation.core.errors import UserError
from groundstation.gateway.packets import PACKED
from groundstation.mavlink.addresses import RADIO_RATES

_ON_AIR_BYTES = 41  # 32 and preamble, address, control field, checksum
_TURN_S, _USB_S = 130e-6, 500e-6
_BITS_S = dict(zip(RADIO_RATES, (250e3, 1e6, 2e6), strict=True))
USABLE = 0.6
"""Of the transactions: the rest is for losses, which are sent again, and for asking those that have nothing to say."""
_STATUS_HZ, _OTHER_HZ = 2.0, 2.0
_RETRIES_OFF_AND_ON = 1.0
"""What it costs to end the sending again before broadcasts and to begin it after them: two requests by USB, a guess."""
LEAST_HZ = 10.0
"""The authors of the paper needed 10 Hz or more for each vehicle."""


@dataclass(frozen=True)
class Rates:
    """Rates of one vehicle.

    Attributes:
        setpoint_hz: velocities to it.
        log_hz: poses that it logs.
        pose_hz: poses from outside to it; 0 where it has its own positioning.
        broadcast: these go to two vehicles in one packet, which nobody acknowledges.
    """

    setpoint_hz: float
    log_hz: float
    pose_hz: float = 0.0
    broadcast: bool = False

    def scaled(self, share: float) -> Rates:
        """The same, all by a share."""
        return replace(
            self, setpoint_hz=self.setpoint_hz * share, log_hz=self.log_hz * share, pose_hz=self.pose_hz * share
        )


def capacity(data_rate: str) -> float:
    """Transactions a second of a radio at 250K, 1M or 2M; an estimate."""
    air_s = 8.0 * _ON_AIR_BYTES / _BITS_S[data_rate]
    return 1.0 / (2.0 * air_s + 2.0 * _TURN_S + _USB_S)


def transactions(vehicles: int, rates: Rates) -> float:
    """What so many vehicles on one radio cost, transactions a second."""
    up = rates.setpoint_hz + _OTHER_HZ + (0.0 if rates.broadcast else rates.pose_hz)
    down = rates.log_hz + _STATUS_HZ
    shared = rates.pose_hz * (math.ceil(vehicles / PACKED) + _RETRIES_OFF_AND_ON) if rates.broadcast else 0.0
    return vehicles * max(up, down) + shared


def fitting(vehicles: int, rates: Rates, packets_s: float) -> Rates | None:
    """The highest rates of the same proportions that fit; None where not even 10 Hz do.

    Args:
        vehicles: on this radio.
        rates: wanted.
        packets_s: transactions a second that the radio makes.
    """
    room = USABLE * packets_s
    if transactions(vehicles, rates) <= room:
        return rates
    low, high = 0.0, 1.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if transactions(vehicles, rates.scaled(middle)) <= room else (low, middle)
    fits = rates.scaled(low)
    wanted = [hz for hz in (fits.setpoint_hz, fits.log_hz, fits.pose_hz) if hz > 0.0]
    return fits if min(wanted, default=0.0) >= LEAST_HZ else None


def check(radios: dict[str, tuple[int, float]], rates: Rates) -> list[str]:
    """The budget of each radio, a line each.

    Args:
        radios: number: vehicles on it, transactions a second that it makes.
        rates: wanted.

    Raises:
        UserError: one does not carry it, with the rate that fits.
    """
    lines = []
    for radio, (vehicles, packets_s) in sorted(radios.items()):
        needed, room = transactions(vehicles, rates), USABLE * packets_s
        words = (
            f"radio {radio}: {vehicles} {'vehicle' if vehicles == 1 else 'vehicles'}, {needed:.0f} packets/s of"
            f" {room:.0f} usable ({packets_s:.0f} estimated)"
        )
        if needed <= room:
            lines.append(words)
            continue
        fits = fitting(vehicles, rates, packets_s)
        if fits is None:
            most = max((n for n in range(vehicles) if fitting(n, rates, packets_s) is not None), default=0)
            remedy = f"not even {LEAST_HZ:g} Hz fit; at most {most} vehicles on this radio, use more radios"
        else:
            pose = f", poses to them at {math.floor(fits.pose_hz)} Hz" if fits.pose_hz else ""
            hz = math.floor(fits.setpoint_hz), math.floor(fits.log_hz)
            remedy = f"setpoints at {hz[0]} Hz and logs at {hz[1]} Hz{pose} would fit"
        raise UserError(f"{words}; {remedy}")
    return lines


def table(vehicles: int, rates: Rates, packets_s: float, radios: int = 3) -> list[str]:
    """What 1 to so many radios carry of a team, a line each."""
    lines = []
    for count in range(1, radios + 1):
        each = math.ceil(vehicles / count)
        fits = fitting(each, rates, packets_s)
        words = (
            "does not fit"
            if fits is None
            else "fits"
            if fits == rates
            else f"fits with setpoints at {math.floor(fits.setpoint_hz)} Hz, logs at {math.floor(fits.log_hz)} Hz"
        )
        lines.append(
            f"{count} {'radio' if count == 1 else 'radios'}, {each} vehicles each: {transactions(each, rates):.0f} of"
            f" {USABLE * packets_s:.0f} packets/s: {words}"
        )
    return lines
