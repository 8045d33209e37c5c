"""The streams that vehicles are asked for before takeoff, and what arrives of them."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from groundstation.mavlink.station import Station
from groundstation.mavlink.vehicle import NEVER
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.timing import SECOND_NS

_ENOUGH = 0.6  # of the rate asked for: what a lossy link leaves
_RATE_MIN_HZ = 5.0
_TRIES = 3
_ASK_AGAIN_NS = 5 * SECOND_NS
_COUNT_NS = 2 * SECOND_NS


@dataclass
class Rates:
    """How one vehicle's streams are coming on."""

    asked_ns: int = NEVER
    restarts: int = -1
    window_ns: int = NEVER
    at_start: tuple[int, int] = (0, 0)
    hz: tuple[float, float] = (np.nan, np.nan)
    tries: int = 0
    good: bool = False


class Streams:
    """The streams of n vehicles.

    Args:
        plan: rates.
        station: what is asked goes out by it.

    Attributes:
        rates: how each vehicle's are coming on.
    """

    def __init__(self, plan: MissionPlan, station: Station) -> None:
        self._plan, self._station = plan, station
        self.rates = [Rates() for _ in range(plan.size)]
        self._bytes_ns, self._bytes_then = NEVER, Counter[int]()
        self._bytes_s: dict[int, float] = {}

    def wanted_hz(self, vehicle: int) -> dict[str, float]:
        """Streams that a vehicle is asked for."""
        plan = self._plan
        rates = plan.rates_of(vehicle)
        wanted = {plan.position_message(vehicle): rates.pose_hz, "ATTITUDE_QUATERNION": rates.attitude_hz}
        wanted |= rates.status_hz()
        if plan.uses_gps(vehicle):
            if plan.spec.vehicles[vehicle].position == "local":
                wanted["GLOBAL_POSITION_INT"] = rates.cross_check_hz
            wanted["GPS_RAW_INT"] = rates.fix_hz
        return wanted

    def ask(self, vehicle: int, now_ns: int, pose_ns: int, *, every: bool = False) -> None:
        """Asks for the streams that are wanted, and counts them; ``every``: again until the vehicle is well heard."""
        fleet, rates = self._station.fleet, self.rates[vehicle]
        new = rates.restarts != fleet.restarts[vehicle]
        silent = now_ns - max(NEVER if every else pose_ns, rates.asked_ns) > _ASK_AGAIN_NS
        if new:
            self.rates[vehicle] = rates = Rates(restarts=int(fleet.restarts[vehicle]))
        if new or silent:
            self.request(vehicle, now_ns, quiet=every)
            return
        if self._station.commands.pending(vehicle):
            return
        counted = self._counted(vehicle)
        if rates.window_ns == NEVER:
            rates.window_ns, rates.at_start = now_ns, counted
            return
        planned = self._plan.rates_of(vehicle)
        asked_hz = (planned.pose_hz, planned.attitude_hz)
        passed_ns = now_ns - rates.window_ns
        if passed_ns < max(1.0, 8.0 / min(asked_hz)) * SECOND_NS:
            return
        rates.hz = (
            (counted[0] - rates.at_start[0]) * SECOND_NS / passed_ns,
            (counted[1] - rates.at_start[1]) * SECOND_NS / passed_ns,
        )
        as_asked = all(hz >= _ENOUGH * asked for hz, asked in zip(rates.hz, asked_hz, strict=True))
        rates.good = as_asked or (
            rates.tries >= _TRIES
            and not planned.lean
            and all(hz >= max(_RATE_MIN_HZ, 0.2 * asked) for hz, asked in zip(rates.hz, asked_hz, strict=True))
        )
        rates.window_ns, rates.at_start = now_ns, counted
        if not rates.good and now_ns - rates.asked_ns >= SECOND_NS:
            rates.tries += 1
            self.request(vehicle, now_ns)

    def request(self, vehicle: int, now_ns: int, *, quiet: bool = False) -> None:
        """Asks for all streams; ``quiet``: nothing else may be sent, whatever is known of the link."""
        rates, autopilot = self.rates[vehicle], self._plan.autopilots[vehicle]
        rates.asked_ns, rates.window_ns = now_ns, NEVER
        wanted = self.wanted_hz(vehicle)
        if quiet or self._plan.rates_of(vehicle).limited:
            for message in autopilot.chatter:
                if message not in wanted:
                    self._station.commands.request(vehicle, autopilot.silence(message))
        for message, rate_hz in wanted.items():
            self._station.commands.request(vehicle, autopilot.message_interval(message, rate_hz))

    def _counted(self, vehicle: int) -> tuple[int, int]:
        seen = self._station.fleet.seen
        attitudes = max(int(seen[name][vehicle]) for name in ("ATTITUDE_QUATERNION", "ATTITUDE"))
        return int(seen[self._plan.position_message(vehicle)][vehicle]), attitudes

    def slow_words(self, vehicle: int) -> str | None:
        """Words for one that sends less than it was asked for, and with which is flown all the same."""
        rates, planned = self.rates[vehicle], self._plan.rates_of(vehicle)
        if not rates.good or planned.lean or min(rates.hz) >= _ENOUGH * planned.pose_hz:
            return None
        return (
            f"sends {rates.hz[0]:.0f} positions and {rates.hz[1]:.0f} attitudes per second,"
            f" {planned.pose_hz:.0f} were asked for; flying with that"
        )

    def no_heartbeat_words(self, vehicle: int) -> str:
        """Words for one of which everything arrives but heartbeats."""
        plan, link = self._plan, self._plan.link_of_vehicle[vehicle]
        seen = self._bytes_s.get(link)
        limit_bytes_s = plan.rates_of(vehicle).limit_bytes_s
        carries = f" of {limit_bytes_s:.0f}" if plan.rates_of(vehicle).limited else ""
        return (
            f"is heard on {plan.links[link]}, without a heartbeat: its link is overfull or drops them"
            + (f" ({seen:.0f}{carries} bytes/s arrive)" if seen is not None else "")
            + "; lower rates were asked for: lower also what it sends unasked (MAV_n_RATE, SRn_...), put fewer on the"
            " link, or correct link_bytes_per_s"
        )

    def count_bytes(self, now_ns: int) -> None:
        """What arrives on each link, over the last seconds."""
        passed_ns = now_ns - self._bytes_ns
        if passed_ns < _COUNT_NS:
            return
        received = self._station.bytes_received
        if self._bytes_ns != NEVER:
            self._bytes_s = {
                link: (received[link] - self._bytes_then[link]) * SECOND_NS / passed_ns
                for link in range(len(self._plan.links))
            }
        self._bytes_ns, self._bytes_then = now_ns, Counter(received)

    def said_yes(self, vehicle: int) -> bool:
        """Whether it acknowledges what it is asked for; what it does is seen elsewhere."""
        return self.rates[vehicle].tries > 1 and self._station.commands.answered[vehicle]
