"""Reads the parameters of a mission's vehicles, all or some by name, and sets them: bytes and times in, bytes out.

Nothing is set in a vehicle that is armed, or that has not said yet whether it is. Whatever is set is read back; what a
vehicle keeps, or does not know, is told. Reads no clock and opens no link.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from groundstation.app.team_talk import TalkedTo, TeamTalk
from groundstation.mavlink.codec import Batch
from groundstation.mavlink.params import (
    ParamDesk,
    ParamQuestion,
    ParamState,
    ParamValue,
    bits_of_value,
    value_of_bits,
)
from groundstation.mavlink.station import Outgoing
from groundstation.mavlink.vehicle import AUTOPILOT_COMPID
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.timing import SECOND_NS
from groundstation.records.param_file import Param, Team

_QUIET_NS = SECOND_NS  # without another of the list: what is missing is asked for one by one
_AT_ONCE = 10  # of those, in one go
_TRIES = 6
_NO_INDEX = 0xFFFF
_NOT_STORED = ("_HASH_CHECK",)  # PX4's fingerprint of all the others


@dataclass(kw_only=True)
class _Vehicle(TalkedTo):
    """How one vehicle is coming on."""

    bytewise: bool
    count: int = 0
    named: dict[int, str] = field(default_factory=dict)  # by index, of those that were listed
    told: dict[str, Param] = field(default_factory=dict)
    asked: int = 0
    last_ns: int = 0
    kept: dict[str, Param] = field(default_factory=dict)
    written: bool = False


class ParamTalk(TeamTalk[_Vehicle]):
    """A talk with a mission's vehicles about their parameters.

    Args:
        plan: vehicles and links.
        wanted: what to set, by vehicle and name; nothing where None.
        names: which to read, by vehicle; all of them where None.
    """

    def __init__(
        self, plan: MissionPlan, *, wanted: Team | None = None, names: Mapping[int, list[str]] | None = None
    ) -> None:
        vehicles = zip(plan.spec.vehicles, plan.sysids, plan.link_of_vehicle, plan.autopilots, strict=True)
        super().__init__(
            plan,
            [
                _Vehicle(item.id, sysid, link, bytewise=autopilot.params_bytewise)
                for item, sysid, link, autopilot in vehicles
            ],
        )
        self._desk = ParamDesk(len(self._vehicles))
        self._wanted = wanted
        self._listing = names is None and wanted is None
        self._names = {
            item.id: list((wanted or {}).get(item.id, {}) if names is None else names.get(item.id, []))
            for item in self._vehicles
        }
        for number, item in enumerate(self._vehicles):
            for name in self._names[item.id] if not self._listing else ():
                self._desk.read(number, name)

    # What comes in

    def _take(self, number: int, batch: Batch, now_ns: int) -> None:
        if batch.name != "PARAM_VALUE":
            return
        item, values = self._vehicles[number], batch.values[0]
        bits = int(np.ascontiguousarray(batch.values["param_value"]).view(np.uint32)[0])
        name = bytes(values["param_id"]).decode("ascii", "replace")
        kind, index = int(values["param_type"]), int(values["param_index"])
        self._desk.take(ParamValue(number, name, bits, kind, now_ns))
        if name in _NOT_STORED:
            return
        if self._listing and index != _NO_INDEX:
            item.count, item.last_ns = int(values["param_count"]), now_ns
            if item.named.setdefault(index, name) == name:
                item.asked = 0
        item.told[name] = Param(value_of_bits(bits, kind, bytewise=item.bytewise), kind)

    # What goes out

    def outgoing(self, now_ns: int) -> list[Outgoing]:
        """What is to be sent now."""
        sent = self._greetings(now_ns)
        for number, item in enumerate(self._vehicles):
            if not item.peer:
                continue
            if self._listing:
                sent += self._ask_for_list(item, now_ns)
            elif self._wanted is not None and not item.written and self._read(number) and item.armed is False:
                item.written = True
                self._write(number, item)
        for question in self._desk.due(now_ns):
            if self._vehicles[question.vehicle].peer:
                sent.append(self._to(self._vehicles[question.vehicle], self._question(question)))
        return sent

    def _ask_for_list(self, item: _Vehicle, now_ns: int) -> list[Outgoing]:
        """The whole list once, then what has not come of it, one by one."""
        if self._listed(item) or (item.last_ns and now_ns - item.last_ns < _QUIET_NS) or item.asked >= _TRIES:
            return []
        item.last_ns, item.asked = now_ns, item.asked + 1
        target = {"target_system": item.sysid, "target_component": AUTOPILOT_COMPID}
        if not item.count:
            return [self._to(item, self._encoder.encode("PARAM_REQUEST_LIST", **target))]
        missing = [index for index in range(item.count) if index not in item.named][:_AT_ONCE]
        return [
            self._to(item, self._encoder.encode("PARAM_REQUEST_READ", **target, param_id="", param_index=index))
            for index in missing
        ]

    def _write(self, number: int, item: _Vehicle) -> None:
        """Sets what differs, in the type that the vehicle has told."""
        for name, param in (self._wanted or {}).get(item.id, {}).items():
            told = item.told.get(name)
            if told is None or told.same(param):
                continue
            item.kept[name] = told
            try:
                bits = bits_of_value(param.value, told.kind, bytewise=item.bytewise)
            except ValueError:
                continue
            self._desk.write(number, name, bits, told.kind)

    def _question(self, question: ParamQuestion) -> bytes:
        item = self._vehicles[question.vehicle]
        target = {"target_system": item.sysid, "target_component": AUTOPILOT_COMPID, "param_id": question.name}
        if question.bits is None:
            return self._encoder.encode("PARAM_REQUEST_READ", **target, param_index=-1)
        return self._encoder.encode("PARAM_SET", **target, param_value=question.as_float, param_type=question.kind)

    # What came of it

    def _listed(self, item: _Vehicle) -> bool:
        return bool(item.count) and len(item.named) >= item.count

    def _read(self, number: int) -> bool:
        names = self._names[self._vehicles[number].id]
        return all(self._desk.state(number, name) is not ParamState.ASKED for name in names)

    @property
    def done(self) -> bool:
        """Whether there is nothing left to ask."""
        if self._listing:
            return all(self._listed(item) for item in self._vehicles)
        return all(
            self._read(number) and (self._wanted is None or item.written or item.armed or not self._names[item.id])
            for number, item in enumerate(self._vehicles)
        )

    def team(self) -> Team:
        """What was told, by vehicle and name."""
        return {item.id: dict(item.told) for item in self._vehicles if item.told}

    def changed(self) -> dict[int, dict[str, tuple[Param, Param]]]:
        """What was set: value of before and value now, as read back."""
        found: dict[int, dict[str, tuple[Param, Param]]] = {}
        for item in self._vehicles:
            for name, before in item.kept.items():
                if not item.told[name].same(before):
                    found.setdefault(item.id, {})[name] = before, item.told[name]
        return found

    def troubles(self) -> list[str]:
        """What could not be read or set, a line each."""
        lines = []
        for number, item in enumerate(self._vehicles):
            name = f"vehicle {item.id}"
            if not item.peer:
                lines.append(f"{name}: was not heard; is it switched on, and its link right?")
            elif self._listing and not self._listed(item):
                lines.append(f"{name}: told {len(item.named)} of {item.count or 'its'} parameters")
            elif self._wanted is not None and item.armed and not item.written:
                lines.append(f"{name}: is armed, nothing is set; disarm it")
            if self._listing:
                continue
            lines += [f"{name}: does not know {wanted}" for wanted in self._unknown(number)]
            for kept in item.kept:
                wanted = (self._wanted or {})[item.id][kept]
                if item.peer and not item.told[kept].same(wanted):
                    lines.append(f"{name}: keeps {kept} at {item.told[kept].text()}, told was {wanted.text()}")
        return lines

    def _unknown(self, number: int) -> list[str]:
        item = self._vehicles[number]
        return [name for name in self._names[item.id] if item.peer and name not in item.told]
