"""Gives a mission's fence, and the pads as rally points, to the autopilots by the mission protocol; reads them back.

What a vehicle holds is read first; only where it is something else is it sent, and then read again: nothing counts as
uploaded that was not read back. Bytes and times in, bytes out; nothing is sent to a vehicle that is armed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import pymap3d

from groundstation.app.team_talk import TalkedTo, TeamTalk
from groundstation.mavlink.codec import Batch
from groundstation.mavlink.station import GROUND_STATION_COMPID, GROUND_STATION_SYSID, Outgoing
from groundstation.mavlink.vehicle import AUTOPILOT_COMPID
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.timing import SECOND_NS

FENCE, RALLY = 1, 2
"""MAV_MISSION_TYPE."""
_NAMES = {FENCE: "fence", RALLY: "rally point"}
_POLYGON_VERTEX, _RALLY_POINT = 5001, 5100  # MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION, MAV_CMD_NAV_RALLY_POINT
_GLOBAL, _RELATIVE = 0, 3  # MAV_FRAME
_ABOVE_HOME = (3, 6)  # PX4 tells the second of them, ArduPilot the first
_RESULTS = {
    1: "an error", 2: "a frame that it does not know", 3: "an item that it does not know", 4: "no room",
    5: "a wrong parameter", 13: "items out of order", 14: "denied",
}  # fmt: skip
_ANSWERS = ("MISSION_COUNT", "MISSION_REQUEST_INT", "MISSION_REQUEST", "MISSION_ITEM_INT", "MISSION_ACK")
_AGAIN_NS = SECOND_NS
_TRIES = 8
_ITEMS_MAX = 200
_SAME_M = 0.1
_SAME_GPS_M = 3.0  # where the team's place on earth is what its first vehicle's GPS says today
_EARTH_M_PER_UNIT = 0.0111  # of latitude, in 1e-7 degrees


@dataclass(frozen=True)
class Item:
    """One item, as the mission protocol carries it.

    Attributes:
        command: MAV_CMD.
        frame: MAV_FRAME.
        param1: number of the polygon's vertices.
        x: latitude, 1e-7 degrees.
        y: longitude, 1e-7 degrees.
        z: height, m.
    """

    command: int
    frame: int
    param1: float
    x: int
    y: int
    z: float

    def off_m(self, other: Item) -> float:
        """How far away another item is that is meant to be the same; infinite for another kind."""
        if (self.command, round(self.param1)) != (other.command, round(other.param1)):
            return math.inf
        above_home = [item.frame in _ABOVE_HOME for item in (self, other)]
        if self.command == _RALLY_POINT and (len(set(above_home)) > 1 or abs(self.z - other.z) > _SAME_M):
            return math.inf
        east = (self.y - other.y) * math.cos(math.radians(self.x * 1e-7))
        return _EARTH_M_PER_UNIT * math.hypot(self.x - other.x, east)


def corners_m(plan: MissionPlan) -> list[tuple[float, float]]:
    """Corners of what is uploaded, east and north: the fence, so much wider that the ground station acts first."""
    spec = plan.spec
    wider = spec.limits.fence_beyond_m + plan.margin_m + spec.speed_limit_m_s
    (west, south, _), (east, north, _) = spec.fence.min_m, spec.fence.max_m
    west, south, east, north = west - wider, south - wider, east + wider, north + wider
    return [(west, south), (east, south), (east, north), (west, north)]


def items_for(plan: MissionPlan, vehicle: int, anchor_deg_m: tuple[float, float, float]) -> dict[int, list[Item]]:
    """What a vehicle is to hold, by MAV_MISSION_TYPE.

    Args:
        plan: fence and pads.
        vehicle: its number.
        anchor_deg_m: latitude, longitude and height of the team frame's origin.
    """

    def item(command: int, frame: int, east: float, north: float, param1: float = 0.0) -> Item:
        lat, lon, _ = pymap3d.enu2geodetic(east, north, 0.0, *anchor_deg_m)
        return Item(command, frame, param1, round(float(lat) * 1e7), round(float(lon) * 1e7), 0.0)

    corners = corners_m(plan)
    wanted = {FENCE: [item(_POLYGON_VERTEX, _GLOBAL, *corner, float(len(corners))) for corner in corners]}
    if plan.spec.fence.rally:
        east, north, _ = plan.pads_enu_m[vehicle].tolist()
        wanted[RALLY] = [item(_RALLY_POINT, _RELATIVE, east, north)]
    return wanted


@dataclass(kw_only=True)
class _Vehicle(TalkedTo):
    """How one vehicle is coming on; ``kinds`` are those that are still to be looked at, the first one now."""

    kinds: list[int]
    sending: bool = False
    sent: set[int] = field(default_factory=set)
    count: int | None = None
    items: dict[int, Item] = field(default_factory=dict)
    wanted: dict[int, list[Item]] = field(default_factory=dict)
    tries: int = 0
    next_ns: int = 0
    problems: list[str] = field(default_factory=list)
    changed: list[str] = field(default_factory=list)


class FenceTalk(TeamTalk[_Vehicle]):
    """A talk with a mission's vehicles about their fences.

    Args:
        plan: vehicles, links, fence.
        may_set: send what is not as it should be; else it is a problem.
    """

    def __init__(self, plan: MissionPlan, *, may_set: bool) -> None:
        self._plan, self._may_set = plan, may_set
        kinds = [FENCE, *([RALLY] if plan.spec.fence.rally else [])]
        vehicles = zip(plan.spec.vehicles, plan.sysids, plan.link_of_vehicle, strict=True)
        known = [_Vehicle(vehicle.id, sysid, link, kinds=list(kinds)) for vehicle, sysid, link in vehicles]
        super().__init__(plan, known)
        anchor = plan.spec.anchor
        self._anchor = None if anchor is None else (anchor.lat_deg, anchor.lon_deg, anchor.alt_m)
        self._same_m = _SAME_GPS_M if anchor is None else _SAME_M
        # Without an anchor the team hangs on its first vehicle with GPS, as in flight.
        self._hangs_on = next((i for i in range(plan.size) if plan.uses_gps(i)), 0)
        self._answers: list[Outgoing] = []

    # What comes in

    def _take(self, number: int, batch: Batch, now_ns: int) -> None:
        item, values = self._vehicles[number], batch.values[0]
        if batch.name == "GLOBAL_POSITION_INT":
            if self._anchor is None and number == self._hangs_on and (values["lat"] or values["lon"]):
                self._hang(values["lat"] * 1e-7, values["lon"] * 1e-7, values["alt"] * 1e-3)
        elif batch.name in _ANSWERS and self._is_of(item, values):
            self._protocol(number, item, batch.name, values, now_ns)

    def _is_of(self, item: _Vehicle, values: np.void) -> bool:
        """Whether an answer is to us, and of what is being looked at."""
        ours = values["target_system"] == GROUND_STATION_SYSID and values["target_component"] == GROUND_STATION_COMPID
        return bool(ours and item.kinds and int(values["mission_type"]) == item.kinds[0])

    def _hang(self, lat_deg: float, lon_deg: float, alt_m: float) -> None:
        east, north, up = (-self._plan.pads_enu_m[self._hangs_on]).tolist()
        lat, lon, alt = pymap3d.enu2geodetic(east, north, up, lat_deg, lon_deg, alt_m)
        self._anchor = float(lat), float(lon), float(alt)

    def _protocol(self, number: int, item: _Vehicle, name: str, values: np.void, now_ns: int) -> None:
        wanted = self._wanted(number)
        item.tries = 0
        if item.sending:
            if name in ("MISSION_REQUEST_INT", "MISSION_REQUEST") and int(values["seq"]) < len(wanted):
                item.next_ns = now_ns + _AGAIN_NS
                self._answers.append(self._to(item, self._item(item, int(values["seq"]), wanted)))
            elif name == "MISSION_ACK":
                self._ended(item, int(values["type"]), now_ns)
        elif name == "MISSION_COUNT":
            item.count = min(int(values["count"]), _ITEMS_MAX)
            item.next_ns = now_ns
            if item.count == 0:
                self._judge(number, item, now_ns)
        elif name == "MISSION_ITEM_INT" and item.count is not None:
            whole = [int(values[key]) for key in ("command", "frame", "x", "y")]
            command, frame, x, y = whole
            item.items[int(values["seq"])] = Item(command, frame, float(values["param1"]), x, y, float(values["z"]))
            item.next_ns = now_ns
            if all(seq in item.items for seq in range(item.count)):
                self._judge(number, item, now_ns)

    def _ended(self, item: _Vehicle, result: int, now_ns: int) -> None:
        """The vehicle has taken what was sent, or refused it."""
        if result != 0:
            why = _RESULTS.get(result, f"result {result}")
            self._over(item, f"refuses its {_NAMES[item.kinds[0]]}: {why}")
            return
        item.sending, item.count, item.items, item.next_ns = False, None, {}, now_ns

    def _judge(self, number: int, item: _Vehicle, now_ns: int) -> None:
        """What the vehicle holds is known; it is told that nothing more is asked of it, or it would wait."""
        self._answers.append(self._to(item, self._encoder.encode("MISSION_ACK", **self._target(item), type=0)))
        kind, wanted = item.kinds[0], self._wanted(number)
        held = [item.items[seq] for seq in range(item.count or 0)]
        again = kind in item.sent
        same_m = _SAME_M if again else self._same_m
        off_m = max([one.off_m(other) for one, other in zip(held, wanted, strict=False)], default=0.0)
        if len(held) == len(wanted) and off_m <= same_m:
            if again:
                item.changed.append(_NAMES[kind])
            self._over(item)
        elif again:
            self._over(item, f"holds another {_NAMES[kind]} than it was sent ({len(held)} items, {off_m:.2f} m off)")
        elif not self._may_set:
            self._over(item, f"does not hold the mission's {_NAMES[kind]}; `gs check --fix` or `gs fly` uploads it")
        elif item.armed is not False:
            self._over(item, f"is armed, its {_NAMES[kind]} is not uploaded")
        else:
            item.sending = True
            item.sent.add(kind)
            item.next_ns = now_ns

    def _over(self, item: _Vehicle, problem: str = "") -> None:
        """Goes on to the next kind."""
        if problem:
            item.problems.append(problem)
        item.kinds.pop(0)
        item.sending, item.count, item.items, item.tries, item.next_ns = False, None, {}, 0, 0

    # What goes out

    def outgoing(self, now_ns: int) -> list[Outgoing]:
        """What is to be sent now."""
        sent, self._answers = self._answers, []
        greetings = self._greetings(now_ns)
        sent += greetings
        if greetings and self._anchor is None and self._vehicles[self._hangs_on].peer:
            sent.append(self._where())
        for number, item in enumerate(self._vehicles):
            if not item.peer or not item.kinds or self._anchor is None or now_ns < item.next_ns:
                continue
            if item.tries >= _TRIES:
                self._over(item, f"does not answer for its {_NAMES[item.kinds[0]]}")
                continue
            item.tries += 1
            item.next_ns = now_ns + _AGAIN_NS
            sent.append(self._to(item, self._next(number, item)))
        return sent

    def _where(self) -> Outgoing:
        """Asks the vehicle on which the team hangs where on earth it is."""
        item = self._vehicles[self._hangs_on]
        command = self._plan.autopilots[self._hangs_on].once("GLOBAL_POSITION_INT")
        params = {f"param{k}": value for k, value in enumerate(command.padded(), start=1)}
        target = {"target_system": item.sysid, "target_component": AUTOPILOT_COMPID}
        return self._to(item, self._encoder.encode("COMMAND_LONG", **target, command=command.command, **params))

    def _next(self, number: int, item: _Vehicle) -> bytes:
        """The next question, or the begin of an upload."""
        target = self._target(item)
        if item.sending:
            return self._encoder.encode("MISSION_COUNT", **target, count=len(self._wanted(number)))
        if item.count is None:
            return self._encoder.encode("MISSION_REQUEST_LIST", **target)
        missing = next(seq for seq in range(item.count) if seq not in item.items)
        return self._encoder.encode("MISSION_REQUEST_INT", **target, seq=missing)

    def _item(self, item: _Vehicle, seq: int, wanted: list[Item]) -> bytes:
        one = wanted[seq]
        return self._encoder.encode(
            "MISSION_ITEM_INT", **self._target(item), seq=seq, frame=one.frame, command=one.command, autocontinue=1,
            param1=one.param1, x=one.x, y=one.y, z=one.z,
        )  # fmt: skip

    def _target(self, item: _Vehicle) -> dict[str, int]:
        return {"target_system": item.sysid, "target_component": AUTOPILOT_COMPID, "mission_type": item.kinds[0]}

    def _wanted(self, number: int) -> list[Item]:
        item = self._vehicles[number]
        if not item.wanted and self._anchor is not None:
            item.wanted = items_for(self._plan, number, self._anchor)
        return item.wanted.get(item.kinds[0], [])

    # What came of it

    @property
    def done(self) -> bool:
        """Whether there is nothing left to do."""
        return not self._answers and not any(item.kinds for item in self._vehicles)

    def troubles(self) -> list[str]:
        """What is not as it should be, a line each."""
        lines = []
        for item in self._vehicles:
            name = f"vehicle {item.id}"
            lines += [f"{name}: {problem}" for problem in item.problems]
            if not item.peer:
                lines.append(f"{name}: was not heard; its fence is not known")
            elif item.kinds and self._anchor is None:
                hangs = f"vehicle {self._vehicles[self._hangs_on].id} does not tell its place on earth"
                lines.append(f"{name}: its fence is not known: {hangs}")
            elif item.kinds:
                lines.append(f"{name}: its {_NAMES[item.kinds[0]]} was not uploaded in time")
        return lines

    def uploaded(self) -> list[str]:
        """What was uploaded and read back, a line for each vehicle."""
        return [
            f"vehicle {item.id}: {' and '.join(item.changed)} uploaded, and read back"
            for item in self._vehicles
            if item.changed
        ]
