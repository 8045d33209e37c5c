"""The vehicles' parameters before arming: asked for, judged, and set where the mission or the operator says so.

Nothing is set in a vehicle that is armed, and nothing that the mission does not ask for. What was set is told, with the
value of before. A vehicle that answers no such question is flown all the same, with a word about it: nobody knows what
it does when it is left alone.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from groundstation.mavlink.failsafes import Finding, Rule, plain
from groundstation.mavlink.params import ParamState, bits_of_value, value_of_bits
from groundstation.mavlink.station import Station
from groundstation.mission.ground.failsafe import FailsafePlan
from groundstation.mission.plan.budget import frame_bytes
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.timing import SECOND_NS

_SPARE = 0.1  # of a link that these questions may use: the streams have the rest
_TRIES = 2
REMEDY, REMEDY_MANY = "`gs check --fix` sets it", "`gs check --fix` sets them"
_IN_FULL = 2  # more than that are told in short


@dataclass
class _Vehicle:
    """How one vehicle's parameters are coming on."""

    restarts: int = -1
    before: dict[str, float] = field(default_factory=dict)
    tries: dict[str, int] = field(default_factory=dict)
    changed: dict[str, tuple[float, float]] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    told: int = 0
    judged: int = -1
    done: bool = False


class ParameterCheck:
    """The parameters of n vehicles.

    Args:
        plan: autopilots, links, whether to set what is wrong.
        station: what is asked goes out by it.
        failsafe: what is asked of each vehicle.
        look_only: set nothing, also where the mission says so; what a flight would set is told and not refused.

    Attributes:
        before: of each vehicle, value and MAV_PARAM_TYPE of what was set, as they were before anything was.
    """

    def __init__(self, plan: MissionPlan, station: Station, failsafe: FailsafePlan, *, look_only: bool = False) -> None:
        self._plan, self._station = plan, station
        self._sets = plan.spec.failsafe.set_parameters and not look_only
        self._sets_later = plan.spec.failsafe.set_parameters and look_only
        self._look_only = look_only
        self.before: list[dict[str, tuple[float, int]]] = [{} for _ in range(plan.size)]
        self._vehicles = [_Vehicle() for _ in range(plan.size)]
        self._rules = [plan.autopilots[i].failsafes.rules(failsafe.wishes[i]) for i in range(plan.size)]
        for vehicle in range(plan.size):
            rates = plan.rates_of(vehicle)
            shared = plan.link_of_vehicle.count(plan.link_of_vehicle[vehicle])
            spacing_s = shared * frame_bytes("PARAM_VALUE") / (_SPARE * rates.limit_bytes_s)
            station.parameters.pace(
                vehicle,
                spacing_ns=round(spacing_s * SECOND_NS),
                delay_ns=round(plan.spec.link_delay_s * SECOND_NS),
            )

    def step(self, vehicle: int) -> None:
        """Asks for what is missing, judges what is there."""
        desk, of = self._station.parameters, self._vehicles[vehicle]
        restarts = int(self._station.fleet.restarts[vehicle])
        if of.restarts != restarts:
            desk.forget(vehicle)
            changed = of.changed
            of = self._vehicles[vehicle] = _Vehicle(restarts=restarts, changed=changed)
            for rule in self._rules[vehicle]:
                for name, _ in rule.names:
                    desk.read(vehicle, name)
        if not of.done and of.judged != desk.changes[vehicle]:
            of.judged = desk.changes[vehicle]
            self._judge(vehicle, of)

    def why_not_fix(self) -> str | None:
        """Why nothing more is to be set by order, None when there may be."""
        if self._look_only:
            return "this run only looks; `gs check --fix` sets parameters"
        return "whatever is wrong of them is set already" if self._sets else None

    def fix(self) -> None:
        """Sets what is wrong from now on, though the mission does not say so."""
        self._sets = True
        for of in self._vehicles:
            of.done, of.judged = False, -1

    def stop(self, vehicle: int) -> None:
        """Asks and sets nothing any more: the vehicle is armed."""
        self._station.parameters.forget(vehicle)

    def waiting(self, vehicle: int) -> str | None:
        """What is not known yet, None when everything is."""
        of = self._vehicles[vehicle]
        if of.done:
            return None
        if of.tries:
            return f"parameters are being set: {', '.join(sorted(of.tries))}"
        return f"its parameters are being read, {of.told} of {len(self._rules[vehicle])} told"

    def answers(self, vehicle: int) -> bool:
        """Whether a vehicle tells any parameter."""
        return any(self._told(vehicle, rule) is not None for rule in self._rules[vehicle])

    def findings(self, vehicle: int) -> list[Finding]:
        """What is not as it should be, when everything is known."""
        of = self._vehicles[vehicle]
        return of.findings if of.done else []

    def later(self, vehicle: int) -> list[Finding]:
        """What the flight will set before arming, since the mission says so; empty where this run may set it itself."""
        return [finding for finding in self.findings(vehicle) if self._sets_later and finding.wanted is not None]

    def grave_findings(self, vehicle: int) -> list[Finding]:
        """What nothing may fly with, and what the flight will not set by itself."""
        later = self.later(vehicle)
        return [finding for finding in self.findings(vehicle) if finding.grave and finding not in later]

    def grave(self, vehicle: int) -> list[str]:
        """What nothing may fly with, each with its remedy."""
        of = self._vehicles[vehicle]
        grave = self.grave_findings(vehicle)
        stubborn = [finding for finding in grave if of.tries.get(finding.name)]
        by_hand = [finding for finding in grave if finding.wanted is None and finding not in stubborn]
        settable = [finding for finding in grave if finding not in stubborn and finding not in by_hand]
        lines = [f"{finding.text()}; it was told to, and keeps it: set it by hand" for finding in stubborn]
        lines += [f"{finding.text()}; set it by hand" for finding in by_hand]
        if len(settable) <= _IN_FULL:
            return lines + [f"{finding.text()}; {REMEDY}" for finding in settable]
        return [
            *lines,
            f"{len(settable)} parameters are not as they have to be: {', '.join(item.short() for item in settable)};"
            f" {REMEDY_MANY}",
        ]

    def notes(self, vehicle: int) -> list[str]:
        """What is worth a word: what was set, what is unusual, what this firmware does not know."""
        of = self._vehicles[vehicle]
        if not of.done:
            return []
        lines = []
        if of.changed:
            changes = (f"{name} from {plain(old)} to {plain(new)}" for name, (old, new) in of.changed.items())
            lines.append(f"parameters were set: {', '.join(changes)}")
        if not self.answers(vehicle):
            lines.append(
                "answers no question for its parameters; what it does when setpoints, heartbeats or battery end is not"
                " known: look at it by hand"
            )
            return lines
        later = self.later(vehicle)
        if later:
            changes = (f"{item.name} from {plain(item.value)} to {plain(item.wanted or 0.0)}" for item in later)
            lines.append(f"to be set before arming, by `gs fly` or `gs check --fix`: {', '.join(changes)}")
        unusual = [finding for finding in of.findings if not finding.grave and finding not in later]
        lines += [f"unusual: {finding.text()}" for finding in unusual]
        if of.missing:
            lines.append(f"its firmware has no {', '.join(of.missing)}; look up what it does instead")
        return lines

    # Judging

    def _told(self, vehicle: int, rule: Rule) -> str | None:
        """The name under which a vehicle has told a parameter."""
        desk = self._station.parameters
        return next((name for name, _ in rule.names if desk.value(vehicle, name) is not None), None)

    def _judge(self, vehicle: int, of: _Vehicle) -> None:
        desk = self._station.parameters
        of.told, of.missing, values, settled = 0, [], {}, True
        for rule in self._rules[vehicle]:
            name = self._told(vehicle, rule)
            if name is None:
                asked = any(desk.state(vehicle, other) is ParamState.ASKED for other, _ in rule.names)
                settled &= not asked
                of.told += not asked
                if not rule.optional:
                    of.missing.append(rule.names[0][0])
                continue
            for other, _ in rule.names:
                if other != name:
                    desk.drop(vehicle, other)
            settled &= desk.state(vehicle, name) is not ParamState.ASKED
            of.told += 1
            value = desk.value(vehicle, name)
            if value is not None:
                bytewise = self._plan.autopilots[vehicle].params_bytewise
                values[name] = value_of_bits(value.bits, value.kind, bytewise=bytewise)
        if not settled:
            return
        of.findings = [finding for rule in self._rules[vehicle] if (finding := rule.judge(values)) is not None]
        for name, before in of.before.items():
            if name in values and values[name] != before:
                of.changed[name] = (of.changed.get(name, (before, before))[0], values[name])
        of.done = not (self._sets and self._set(vehicle, of, values))

    def _set(self, vehicle: int, of: _Vehicle, values: dict[str, float]) -> bool:
        """Sets what is wrong; returns whether there is anything to wait for."""
        desk, busy = self._station.parameters, False
        for finding in of.findings:
            if finding.wanted is None or of.tries.get(finding.name, 0) >= _TRIES:
                continue
            told = desk.value(vehicle, finding.name)
            if told is None:
                continue
            try:
                bits = bits_of_value(finding.wanted, told.kind, bytewise=self._plan.autopilots[vehicle].params_bytewise)
            except ValueError:
                of.tries[finding.name] = _TRIES
                continue
            of.before.setdefault(finding.name, values[finding.name])
            self.before[vehicle].setdefault(finding.name, (values[finding.name], told.kind))
            of.tries[finding.name] = of.tries.get(finding.name, 0) + 1
            desk.write(vehicle, finding.name, bits, told.kind)
            busy = True
        return busy
