"""What an adversary does to one flight, faults, orders, keys, strangers, pilots, each when a phase is really entered.

An event waits for its phase and then for its delay; one whose phase never comes does not happen. Strangers put
datagrams on a vehicle's link, from an address of their own. Everything random was drawn before, or comes from the
event's own seed. Refuses to judge what comes of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from groundstation.app.keyboard import KeyDialogue
from groundstation.app.loop import Interrupts
from groundstation.app.session import Session
from groundstation.core.phases import Phase
from groundstation.mavlink.autopilot import CMD_DO_SET_MODE, CUSTOM_MODE_ENABLED
from groundstation.mavlink.codec import Encoder
from groundstation.mavlink.vehicle import AUTOPILOT_COMPID
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.timing import SECOND_NS
from sitl.faults import Fault

_GROUND = frozenset({Phase.CONNECT, Phase.ARM})
_MAV_TYPE_QUADROTOR, _MAV_TYPE_GCS, _MAV_TYPE_ONBOARD = 2, 6, 18
_AUTOPILOT_INVALID, _AUTOPILOT_PX4 = 8, 12
_STRANGER_IDS = (251, 252)
_PILOT_IDS = (250, 190)
PILOTS = ("sticks", "hold")
"""What pilots do: fly by sticks, which they leave in the middle, or have it hold its place."""
_GARBAGE_BYTES, _FLOOD_BYTES, _FLOOD_DATAGRAMS = 120, 280, 4
STRANGERS = ("garbage", "flood", "vehicle", "ground_station", "companion", "invalid_heartbeat")
"""What strangers do: bytes at random, more of them, another vehicle, another ground station, a companion computer under
a vehicle's system id, a heartbeat under a vehicle's own ids that is no autopilot's."""


@dataclass(frozen=True)
class Event:
    """One thing that happens.

    Attributes:
        phase: in which; ``ground`` is before takeoff.
        delay_s: after it was entered first.
        fault: what goes wrong, with its vehicles; None for nothing.
        order: a line of the operator's, "" for none.
        keys: what is typed at the keyboard.
        interrupt: a Ctrl-C.
        stranger: one of ``STRANGERS``, "" for none.
        pilot: what a pilot switches a vehicle to, one of ``PILOTS``, "" for none.
        vehicle: index of that vehicle, or of the one on whose link the stranger is.
        for_s: how long the stranger stays.
        seed: of its bytes.
    """

    phase: str
    delay_s: float
    fault: Fault | None = None
    order: str = ""
    keys: str = ""
    interrupt: bool = False
    stranger: str = ""
    pilot: str = ""
    vehicle: int = 0
    for_s: float = 0.0
    seed: int = 0

    @property
    def words(self) -> str:
        """For the table."""
        if self.fault is not None:
            whom = " ".join(map(str, self.fault.vehicles)) or "all"
            lasting = "" if self.fault.for_s is None else f" for {self.fault.for_s:g} s"
            numbers = "".join(f" {name} {value:g}" for name, value in self.fault.numbers.items())
            return f"{self.fault.kind} {whom}{numbers}{lasting}"
        if self.stranger:
            return f"stranger: {self.stranger} {self.vehicle + 1}"
        if self.pilot:
            return f"pilot: {self.pilot} {self.vehicle + 1}"
        return f"order: {self.order or repr(self.keys) if not self.interrupt else 'Ctrl-C'}"


class Plot:
    """The events of one flight under way.

    Args:
        plan: the mission.
        events: in any order.
        interrupts: Ctrl-C of the flight.
        strike: lets a fault strike.
        kill: takes the rows of those that an order leaves to fall, or to themselves.
        radio: takes a vehicle's row and a frame that a pilot's own ground station sends it.

    Attributes:
        happened: what has happened so far, a line each.
    """

    def __init__(
        self,
        plan: MissionPlan,
        events: Sequence[Event],
        interrupts: Interrupts,
        *,
        strike: Callable[[Fault], None],
        kill: Callable[[Sequence[int]], None],
        radio: Callable[[int, bytes], None],
    ) -> None:
        self.happened: list[str] = []
        self._plan, self._interrupts, self._strike, self._kill = plan, interrupts, strike, kill
        self._radio, self._piloted, self._pilot = radio, set[int](), Encoder(*_PILOT_IDS)
        self._waiting = list(events)
        self._due: list[tuple[int, int, Event]] = []
        self._strangers: list[_Stranger] = []
        self._keys = KeyDialogue([vehicle.id for vehicle in plan.spec.vehicles])
        self._entered: set[str] = set()

    def step(self, session: Session, now_ns: int) -> None:
        """After every tick."""
        phase = "ground" if session.runner.phase in _GROUND else session.runner.phase.value
        if phase not in self._entered:
            self._entered.add(phase)
            for number, event in enumerate(self._waiting):
                if event.phase == phase:
                    self._due.append((now_ns + round(event.delay_s * SECOND_NS), number, event))
            self._due.sort(key=lambda item: item[:2])
        while self._due and self._due[0][0] <= now_ns:
            event = self._due.pop(0)[2]
            self.happened.append(f"{now_ns / SECOND_NS:.2f} s: {event.words}")
            self._do(event, session, now_ns)
        for stranger in self._strangers:
            stranger.speak(session, now_ns)

    def _do(self, event: Event, session: Session, now_ns: int) -> None:
        if event.fault is not None:
            self._strike(event.fault)
        elif event.pilot:
            self._kill([event.vehicle])  # from now on nobody but the pilot steers it
            self._piloted.add(event.vehicle)
            self._switch(event.vehicle, event.pilot)
        elif event.stranger:
            self._strangers.append(_Stranger(self._plan, event, now_ns))
        elif event.interrupt:
            self._interrupts.interrupt()
            if self._interrupts.count > 1:
                self._kill(range(self._plan.size))
        else:
            lines = [event.order] if event.order else self._keys.feed(event.keys.encode("latin-1"))
            for line in lines:
                self._order(line, session, now_ns)

    def end(self) -> None:
        """The ground station has ended: pilots land what they have."""
        for row in sorted(self._piloted):
            self._switch(row, "land")

    def _switch(self, row: int, to: str) -> None:
        main, sub = self._plan.autopilots[row].by_hand[to]
        frame = self._pilot.encode(
            "COMMAND_LONG", target_system=self._plan.sysids[row], target_component=AUTOPILOT_COMPID,
            command=CMD_DO_SET_MODE, param1=CUSTOM_MODE_ENABLED, param2=float(main), param3=float(sub),
        )  # fmt: skip
        self._radio(row, frame)

    def _order(self, line: str, session: Session, now_ns: int) -> None:
        try:
            said = session.operator(line, now_ns)
        except ValueError as error:
            session.remark("alarm", str(error), now_ns)
            return
        word, *whom = said.split()
        if word == "kill":
            rows = {vehicle.id: row for row, vehicle in enumerate(self._plan.spec.vehicles)}
            self._kill(range(self._plan.size) if whom == ["all"] else [rows[int(name)] for name in whom])
        elif word == "silence":
            self._kill(range(self._plan.size))


class _Stranger:
    """Somebody else on the link of a vehicle, speaking after every tick."""

    def __init__(self, plan: MissionPlan, event: Event, now_ns: int) -> None:
        self._event = event
        self._link = plan.link_of_vehicle[event.vehicle]
        self._rng = np.random.default_rng(event.seed)
        self._end_ns = now_ns + round(event.for_s * SECOND_NS)
        self._next_ns = now_ns
        own = plan.spec.vehicles[event.vehicle].id
        ids = {
            "vehicle": (_STRANGER_IDS[event.seed % len(_STRANGER_IDS)], 1),
            "ground_station": (255, 190),
            "companion": (own, 191),
            "invalid_heartbeat": (own, 1),
        }
        self._encoder = Encoder(*ids.get(event.stranger, (1, 1)))
        # Half of the second senders speak behind the vehicle's own address, as a router has it.
        same = event.stranger in ("companion", "invalid_heartbeat") and event.seed % 2 == 0
        self._peer = f"emulator:{own}" if same else f"stranger:{event.seed}"

    def speak(self, session: Session, now_ns: int) -> None:
        """Puts on the link what is due."""
        if now_ns >= self._end_ns or now_ns < self._next_ns:
            return
        kind = self._event.stranger
        quick = kind in ("garbage", "flood")
        self._next_ns = now_ns + (0 if kind == "flood" else SECOND_NS // (10 if quick else 4))
        for data in self._datagrams(kind, now_ns):
            session.deliver(self._link, self._peer, data, now_ns)

    def _datagrams(self, kind: str, now_ns: int) -> list[bytes]:
        if kind == "garbage":
            return [self._rng.bytes(_GARBAGE_BYTES)]
        if kind == "flood":
            magic = bytes([0xFE, 0xFD][self._rng.integers(2)] for _ in range(_FLOOD_BYTES // 2))
            return [magic + self._rng.bytes(_FLOOD_BYTES // 2) for _ in range(_FLOOD_DATAGRAMS)]
        return [b"".join(self._frames(kind, now_ns))]

    def _frames(self, kind: str, now_ns: int) -> list[bytes]:
        make = self._encoder.encode
        types = {
            "vehicle": (_MAV_TYPE_QUADROTOR, _AUTOPILOT_PX4, 0x81),
            "ground_station": (_MAV_TYPE_GCS, _AUTOPILOT_INVALID, 0),
        }
        vehicle_type, autopilot, base_mode = types.get(kind, (_MAV_TYPE_ONBOARD, _AUTOPILOT_INVALID, 0))
        frames = [
            make("HEARTBEAT", type=vehicle_type, autopilot=autopilot, base_mode=base_mode, system_status=4,
                 mavlink_version=3)
        ]  # fmt: skip
        if kind in ("vehicle", "companion"):
            x, y, z = self._rng.normal(0.0, 1.0, 3)
            frames.append(
                make("LOCAL_POSITION_NED", time_boot_ms=now_ns // 1_000_000, x=float(x), y=float(y), z=float(z))
            )
        return frames
