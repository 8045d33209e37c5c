"""What a safety officer looks at before arming: firmware, estimator, neighbours, battery, failsafes.

Asks through the station it is given, at most a few times for each thing; what a vehicle does not tell is told and not
waited for. Refuses a mission only for what is known to be dangerous.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from groundstation.core import frames
from groundstation.core.types import FloatArray
from groundstation.mavlink.station import Station
from groundstation.mavlink.vehicle import NEVER, UNKNOWN
from groundstation.mission.ground.battery_need import battery_needs
from groundstation.mission.ground.failsafe import FailsafePlan, OutOfTurn, make_failsafe
from groundstation.mission.ground.on_the_pads import pad_words, too_near
from groundstation.mission.ground.parameters import ParameterCheck
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.timing import SECOND_NS, AskAgain, Since

_ASK_NS = 2 * SECOND_NS
_PATIENCE_NS = 8 * SECOND_NS  # for what is only nice to know; asked for longer than that it is not
_VELOCITY_RATIO_MAX = 1.0  # from there on estimators throw a measurement away; 0.03 was seen at rest
_ESTIMATOR_OLD_NS = 3 * SECOND_NS
_AHRS = 0x200000  # MAV_SYS_STATUS_AHRS
_RELEASES = {0: "dev", 64: "alpha", 128: "beta", 192: "rc", 255: ""}  # FIRMWARE_VERSION_TYPE


@dataclass(frozen=True)
class Checked:
    """What one vehicle's checks come to besides its problems, for a table.

    Attributes:
        firmware: version, "" where it is not told.
        estimator: "good", what is wrong with it, or "not told".
        battery: what is left, 0 to 1, NaN where it is not told.
        battery_need: what has to be, 0 to 1.
        failsafe: "as planned", how many parameters are wrong, unusual or set by the flight, or "not told".
    """

    firmware: str
    estimator: str
    battery: float
    battery_need: float
    failsafe: str


class Checks:
    """The checks of n vehicles.

    Args:
        plan: limits, pads.
        station: what is asked goes out by it.
        look_only: set nothing, whatever the mission says.

    Attributes:
        failsafe: what the team does by itself.
        turns: tells when that no longer fits the roles.
    """

    def __init__(self, plan: MissionPlan, station: Station, *, look_only: bool = False) -> None:
        self._plan, self._station = plan, station
        self.failsafe: FailsafePlan = make_failsafe(plan)
        self._needs = battery_needs(plan, self.failsafe)
        self._parameters = ParameterCheck(plan, station, self.failsafe, look_only=look_only)
        self._ids = [vehicle.id for vehicle in plan.spec.vehicles]
        self.turns = OutOfTurn(self.failsafe, self._ids)
        self._pads_ned_m = frames.ned_from_enu(plan.pads_enu_m)
        self._asking = {name: AskAgain(plan.size, _ASK_NS) for name in ("version", "estimator")}
        self._first = Since(plan.size)

    def team_problem(self) -> str | None:
        """What is wrong with the mission's failsafes as such."""
        return self.failsafe.problem

    def team_notes(self) -> list[str]:
        """What the team does by itself."""
        return [self.failsafe.words]

    def ask(self, vehicle: int, now_ns: int) -> None:
        """Asks a vehicle for what it has not told yet; it stands disarmed."""
        fleet, autopilot = self._station.fleet, self._plan.autopilots[vehicle]
        self._first.note(vehicle, now_ns)
        if fleet.firmware[vehicle] == UNKNOWN and not self._given_up(vehicle, now_ns):
            self._ask_once("version", "AUTOPILOT_VERSION", vehicle, now_ns)
        known = fleet.estimator_ns[vehicle] != NEVER
        old = now_ns - fleet.estimator_ns[vehicle] > _ESTIMATOR_OLD_NS
        if old and (known or not self._given_up(vehicle, now_ns)):
            self._ask_once("estimator", autopilot.estimator_message, vehicle, now_ns)
        self._parameters.step(vehicle)

    def why_not_fix(self) -> str | None:
        """Why parameters cannot be set by order, None when they can."""
        return self._parameters.why_not_fix()

    def fix(self) -> None:
        """Sets parameters from now on, though the mission does not say so."""
        self._parameters.fix()

    @property
    def parameters_before(self) -> list[dict[str, tuple[float, int]]]:
        """What was set in each vehicle, as it was before, see ``ParameterCheck.before``."""
        return self._parameters.before

    def armed(self, vehicle: int) -> None:
        """Takes note that a vehicle is armed: nothing is set in it any more."""
        self._parameters.stop(vehicle)

    def _ask_once(self, what: str, message: str, vehicle: int, now_ns: int) -> None:
        asking = self._asking[what]
        if not asking.due(vehicle, now_ns) or self._station.commands.pending(vehicle):
            return
        asking.asked(vehicle, now_ns)
        self._station.commands.request(vehicle, self._plan.autopilots[vehicle].once(message))

    def _given_up(self, vehicle: int, now_ns: int) -> bool:
        """Whether a vehicle had time enough to tell what is only nice to know."""
        patience_ns = _PATIENCE_NS + round(self._plan.spec.link_delay_s * SECOND_NS)
        return self._first.held(vehicle, now_ns, patience_ns)

    # What is wrong

    def waiting(self, vehicle: int, now_ns: int, pos_team_ned_m: FloatArray) -> str | None:
        """What may become well with time, in words, None when nothing is left."""
        return (
            self._estimator(vehicle, now_ns)
            or self._neighbours(vehicle, pos_team_ned_m)
            or self._version(vehicle, now_ns)
            or self._parameters.waiting(vehicle)
        )

    def grave(self, vehicle: int) -> list[str]:
        """What will not, each with its remedy."""
        fleet, lines = self._station.fleet, []
        firmware, autopilot = self._firmware(vehicle), self._plan.autopilots[vehicle]
        if firmware is not None and firmware[:2] < autopilot.oldest:
            lines.append(
                f"its firmware is {version_words(int(fleet.firmware[vehicle]))}, {autopilot.oldest[0]}."
                f"{autopilot.oldest[1]} at least is needed; update it"
            )
        left, need = float(fleet.battery_remaining[vehicle]), self._needs[vehicle]
        if left < need.share:  # not with NaN
            remedy = "charge it" if need.share <= 1.0 else "make the mission shorter"
            lines.append(f"battery at {left:.0%}, {need.words()}; {remedy}")
        return lines + self._parameters.grave(vehicle)

    def notes(self, vehicle: int, now_ns: int) -> list[str]:
        """What is worth a word."""
        fleet, lines = self._station.fleet, []
        firmware, autopilot = self._firmware(vehicle), self._plan.autopilots[vehicle]
        if firmware is None and self._given_up(vehicle, now_ns):
            lines.append("does not tell its firmware's version")
        elif firmware is not None and autopilot.oldest <= firmware[:2] < autopilot.tried:
            lines.append(
                f"its firmware {version_words(int(fleet.firmware[vehicle]))} is older than"
                f" {autopilot.tried[0]}.{autopilot.tried[1]}, from which on its failsafes are known"
            )
        if self._given_up(vehicle, now_ns) and fleet.estimator_ns[vehicle] == NEVER:
            lines.append(
                f"does not tell how its estimator does ({autopilot.estimator_message}); its own arming checks are"
                " relied on"
            )
        if np.isnan(fleet.battery_remaining[vehicle]) and fleet.status_ns[vehicle] != NEVER:
            need = self._needs[vehicle].share
            lines.append(f"does not tell what is left in its battery; {need:.0%} have to be, look at it by hand")
        return lines + self._parameters.notes(vehicle)

    def place_words(self, vehicle: int, pos_team_ned_m: FloatArray) -> str | None:
        """On whose pad a vehicle stands, where it is not its own."""
        return pad_words(vehicle, self._ids, pos_team_ned_m, self._pads_ned_m, self._plan.limits.pad_error_m)

    def checked(self, vehicle: int, now_ns: int) -> Checked:
        """What the checks come to, for a table."""
        fleet, findings = self._station.fleet, self._parameters.findings(vehicle)
        version = int(fleet.firmware[vehicle])
        told = fleet.estimator_ns[vehicle] != NEVER
        later = len(self._parameters.later(vehicle))
        grave = len(self._parameters.grave_findings(vehicle))
        if self._parameters.waiting(vehicle) is not None:
            failsafe = "not read"
        elif not self._parameters.answers(vehicle):
            failsafe = "not told"
        else:
            counts = ((grave, "wrong"), (later, "to be set"), (len(findings), "unusual"))
            failsafe = next((f"{count} {word}" for count, word in counts if count), "as planned")
        return Checked(
            firmware="" if version == UNKNOWN else version_words(version),
            estimator=(self._estimator_trouble(vehicle) or "good") if told else "not told",
            battery=float(fleet.battery_remaining[vehicle]),
            battery_need=self._needs[vehicle].share,
            failsafe=failsafe,
        )

    def _firmware(self, vehicle: int) -> tuple[int, int, int] | None:
        version = int(self._station.fleet.firmware[vehicle])
        return None if version in (UNKNOWN, 0) else (version >> 24 & 0xFF, version >> 16 & 0xFF, version >> 8 & 0xFF)

    def _version(self, vehicle: int, now_ns: int) -> str | None:
        if self._station.fleet.firmware[vehicle] != UNKNOWN or self._given_up(vehicle, now_ns):
            return None
        return "its firmware's version was asked for, not told yet"

    def _estimator(self, vehicle: int, now_ns: int) -> str | None:
        fleet = self._station.fleet
        if fleet.sensors_enabled[vehicle] & ~fleet.sensors_healthy[vehicle] & _AHRS:
            return "says that its estimator is not well (SYS_STATUS); let it stand still, or restart it"
        if fleet.estimator_ns[vehicle] == NEVER:
            return None if self._given_up(vehicle, now_ns) else "was asked how its estimator does"
        trouble = self._estimator_trouble(vehicle)
        remedy = "let it stand still, see to its GPS or motion capture, or restart it"
        return None if trouble is None else f"its estimator: {trouble}; {remedy}"

    def _estimator_trouble(self, vehicle: int) -> str | None:
        fleet = self._station.fleet
        trouble = self._plan.autopilots[vehicle].estimator_trouble(int(fleet.estimator_flags[vehicle]))
        ratio = float(fleet.velocity_ratio[vehicle])
        if trouble is None and ratio >= _VELOCITY_RATIO_MAX:
            return f"its velocity is {ratio:.1f} times as far off what it measures as it takes for possible"
        return trouble

    def _neighbours(self, vehicle: int, pos_team_ned_m: FloatArray) -> str | None:
        radius_m = self._plan.spec.avoidance.radius_m
        near = too_near(vehicle, pos_team_ned_m, radius_m)
        if near is None:
            return None
        return (
            f"stands {near[1]:.2f} m from vehicle {self._ids[near[0]]}, minimum is {radius_m:g} m"
            " (avoidance.radius_m); put them on their pads"
        )


def version_words(version: int) -> str:
    """flight_sw_version for people, for example 1.17.0 dev."""
    numbers = f"{version >> 24 & 0xFF}.{version >> 16 & 0xFF}.{version >> 8 & 0xFF}"
    return f"{numbers} {_RELEASES.get(version & 0xFF, str(version & 0xFF))}".strip()
