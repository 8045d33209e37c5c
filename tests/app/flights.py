"""Flies missions against the emulator in virtual time, with something going wrong on the way."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from groundstation.app.emulator import TruthMeter, world_config
from groundstation.app.gateway.emulated import GatewayWorld, RadioConfig
from groundstation.app.loop import Interrupts, fly_virtual
from groundstation.app.mocap.emulated import emulated_team
from groundstation.app.mocap.fake import FakeConfig
from groundstation.app.opening import LogPlan, open_flight
from groundstation.app.resources import packaged_configs
from groundstation.app.session import Session
from groundstation.mission import timing
from groundstation.mission.plan.plan import MissionPlan
from groundstation.mission.plan.reading import load_mission
from groundstation.mission.purpose import Purpose
from groundstation.mission.runner import Note, Phase
from groundstation.records.manifest import manifest_path, write_manifest
from sitl.world import Outgoing, World, WorldConfig

SECOND_NS = timing.SECOND_NS
CUBE8 = packaged_configs() / "missions" / "cube8.yaml"
HALF_RATE = "rate_hz=25"
"""A tick costs the same at every rate, so this nearly halves what a flight costs."""
FULL_RATE = "rate_hz=50"
"""The rate of the missions that come along, for flights and figures that are about them as they are."""
Tamper = Callable[[Outgoing, "Flight"], list[Outgoing]]
"""What the network makes of one datagram on its way to the ground."""


def without_chatter(config: WorldConfig) -> WorldConfig:
    """Vehicles that send nothing unasked but heartbeats: a third less to compute, for flights that are not about it."""
    return replace(config, vehicles=tuple(replace(item, streams="quiet") for item in config.vehicles))


class Flight:
    """One dry run, kept for looking at."""

    def __init__(
        self,
        plan: MissionPlan,
        *,
        seed: int = 1,
        tamper: Tamper | None = None,
        intrude: Callable[[Flight], tuple[str, bytes] | None] | None = None,
        interrupt_when: Callable[[Flight], bool] | None = None,
        log: Path | None = None,
        limit_s: float = 200.0,
        config: WorldConfig | None = None,
        world: World | None = None,
        change: Callable[[WorldConfig], WorldConfig] | None = None,
        prepare: Callable[[World], None] | None = None,
        take_over: bool = False,
        chatter: bool = False,
        room: FakeConfig | None = None,
        radio: RadioConfig | None = None,
    ) -> None:
        self.plan = plan
        self.take_over = take_over
        if config is None:
            config = world_config(plan, seed) if chatter else without_chatter(world_config(plan, seed))
        self.world = world or World(config if change is None else change(config), seed)
        if prepare is not None:
            prepare(self.world)
        self._gateway = emulated_team(plan, self.world, seed, room, radio)
        self.notes: list[Note] = []
        self.now_ns = 0
        self.phase_seen: list[Phase] = []
        self.setpoints_when_silent: int | None = None
        self.meter = TruthMeter(self.world)
        self._tamper = tamper
        self._intrude = intrude
        self._interrupt_when = interrupt_when
        self._interrupts = Interrupts()
        self._begin_ns = self.world.now_ns
        self._limit_ns = round(limit_s * SECOND_NS)
        recorded = None if log is None else LogPlan(log, {}, 1, dry_run=True, replace=True)
        with ExitStack() as stack:
            purpose = Purpose.TAKE_OVER if take_over else Purpose.FLY
            opened = open_flight(stack, plan, purpose, log=recorded, make=Session)
            self.session, self.gate = opened.session, opened.gate
            self.runner = self.session.runner
            fly_virtual(
                self.session,
                self,
                period_ns=round(SECOND_NS / plan.spec.rate_hz),
                watchers=(self._watch, self.meter),
                interrupts=self._interrupts,
            )
            if opened.log is not None and opened.manifest is not None and log is not None:
                opened.log.close()
                ended = {"outcome": self.runner.outcome, "local_origins_enu_m": self.runner.local_origins_enu_m}
                write_manifest(manifest_path(log), opened.manifest.finished(ended))

    def advance(self, now_ns: int) -> list[Outgoing]:
        """The emulator's side of the loop, with the network's mischief."""
        sent = [
            item._replace(t_ns=item.t_ns - self._begin_ns) for item in self._gateway.advance(now_ns + self._begin_ns)
        ]
        if self._tamper is None:
            return sent
        return [arrived for datagram in sent for arrived in self._tamper(datagram, self)]

    def receive(self, vehicle_index: int, data: bytes, now_ns: int) -> None:
        """What the ground station sends, untouched."""
        self._gateway.receive(vehicle_index, data, now_ns + self._begin_ns)

    @property
    def gateway(self) -> GatewayWorld:
        """What Crazyflies stand behind."""
        return self._gateway if isinstance(self._gateway, GatewayWorld) else self._gateway.team

    def texts(self, kind: str) -> list[str]:
        """What was noted, of one kind."""
        return [note.text for note in self.notes if note.kind == kind]

    def _watch(self, session: Session, now_ns: int) -> None:
        self.now_ns = now_ns
        self.notes += session.take_notes()
        if not self.phase_seen or self.phase_seen[-1] is not self.runner.phase:
            self.phase_seen.append(self.runner.phase)
        intruder = self._intrude(self) if self._intrude is not None else None
        if intruder is not None:
            session.deliver(0, *intruder, now_ns)
        if self._interrupt_when is not None and self._interrupt_when(self):
            self._interrupts.interrupt()
        if now_ns >= self._limit_ns:
            raise AssertionError(f"still in {self.runner.phase} after {now_ns / SECOND_NS:.0f} s: {self.notes[-5:]}")


def cube8(*changes: str) -> MissionPlan:
    """The packaged cube8 mission, changed, at half its rate (``HALF_RATE``)."""
    return load_mission(CUBE8, (HALF_RATE, *changes))


def four(*changes: str) -> MissionPlan:
    """Four vehicles with one above the others, small enough to be flown often."""
    return cube8(
        "formation=../formations/tetrahedron4.yaml",
        "gains=../gains/tetrahedron4.npz",
        f"vehicles={_vehicles(4)}",
        "steps.1.hold.seconds=3",
        *changes,
    )


def _vehicles(count: int) -> str:
    listed = (
        f"{{id: {i + 1}, link: 'udpin://127.0.0.1:14540', pad_m: [{i % 2}.0, {i // 2}.0, 0.0]}}" for i in range(count)
    )
    return f"[{', '.join(listed)}]"


def mission(name: str, *changes: str) -> MissionPlan:
    """One of the packaged missions, changed; those of eight at half their rate (``HALF_RATE``)."""
    rate = () if name == "first_flight2" else (HALF_RATE,)
    return load_mission(packaged_configs() / "missions" / f"{name}.yaml", (*rate, *changes))


def pair(*changes: str, autopilots: tuple[str, str] = ("px4", "arducopter")) -> MissionPlan:
    """The first flight, of two vehicles, under these autopilots."""
    profiles = {"px4": "px4_quad", "arducopter": "arducopter"}
    kinds = [
        f"vehicles.{number}.{key}={value}"
        for number, autopilot in enumerate(autopilots)
        for key, value in (("autopilot", autopilot), ("profile", profiles[autopilot]))
    ]
    return mission("first_flight2", *kinds, "steps.1.hold.seconds=2", *changes)


def after(phase: Phase, for_s: float = 0.1) -> Callable[[Flight], bool]:
    """When that much time has passed since a phase was seen first, whatever the phase is by then."""
    since: list[int] = []

    def reached(flight: Flight) -> bool:
        if flight.runner.phase is phase and not since:
            since.append(flight.now_ns)
        return bool(since) and flight.now_ns - since[0] >= for_s * SECOND_NS

    return reached


def still_in(phase: Phase, for_s: float = 0.0) -> Callable[[Flight], bool]:
    """When that much time has passed since a phase was seen first, and the team is in it."""
    reached = after(phase, for_s)
    return lambda flight: reached(flight) and flight.runner.phase is phase
