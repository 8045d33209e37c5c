"""A ground station in virtual time for the emulator's tests: what it sends, and all that came back, by time.

pymavlink's own classes decode and check every message that a test looks at, so that nothing of the emulator's path
is trusted twice; messages that nobody looks at stay undecoded, which keeps the tests fast.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from groundstation.mavlink.codec import Encoder, Frame, FrameSplitter, message_name
from sitl.world import Outgoing, VehicleConfig, World, WorldConfig

SECOND = 1_000_000_000
TICK = 20_000_000
OFFBOARD, LAND, TAKEOFF_MODE, LOITER, POSCTL = 393216, 100925440, 33816576, 50593792, 196608
VELOCITY, VELOCITY_YAW, VELOCITY_YAW_RATE = 0x0DC7, 0x09C7, 0x05C7
LEAN_RATES_HZ = {
    "ATTITUDE": 50, "ATTITUDE_QUATERNION": 0, "HIGHRES_IMU": 0, "ODOMETRY": 0, "GLOBAL_POSITION_INT": 0, "ALTITUDE": 0,
    "VFR_HUD": 0, "GPS_RAW_INT": 0, "TIMESYNC": 0,
}  # fmt: skip


class Ground:
    """One ground station and a world.

    Attributes:
        world: the emulator.
        raw: (seconds, vehicle index, frame) of all frames, in order of arrival.
        stream: called before every tick while set, to keep setpoints coming.
    """

    def __init__(self, config: WorldConfig, seed: int = 1, sysid: int = 255, version: int = 2) -> None:
        self.world = World(config, seed)
        self.start_ns = config.start_ns
        self.now_ns = config.start_ns
        self.raw: list[tuple[float, int, Frame]] = []
        self.noise: list[bytes] = []
        self.datagrams: list[Outgoing] = []
        self.encoder = Encoder(sysid, 190, version=version)
        self._splitters = [FrameSplitter() for _ in config.vehicles]
        self._decoder = dialect.MAVLink(None)
        self._decoded: dict[int, Any] = {}
        self.stream: Callable[[], None] | None = None

    @property
    def t_s(self) -> float:
        return (self.now_ns - self.start_ns) / SECOND

    def send(self, name: str, vehicle: int = 0, **fields: Any) -> None:
        self.world.receive(vehicle, self.encoder.encode(name, **fields), self.now_ns)

    def command(self, number: int, *params: float, vehicle: int = 0, system: int | None = None) -> None:
        self.send(
            "COMMAND_LONG",
            vehicle,
            target_system=self.world.config.vehicles[vehicle].sysid if system is None else system,
            target_component=1,
            command=number,
            **{f"param{k}": value for k, value in enumerate(params, 1)},
        )

    def velocity(
        self,
        vx: float = 0.0,
        vy: float = 0.0,
        vz: float = 0.0,
        *,
        vehicle: int = 0,
        mask: int = VELOCITY,
        frame: int = 1,
        system: int = 0,
        **more: float,
    ) -> None:
        fields = {"coordinate_frame": frame, "type_mask": mask, "vx": vx, "vy": vy, "vz": vz, **more}
        self.send("SET_POSITION_TARGET_LOCAL_NED", vehicle, target_system=system, **fields)

    def interval(self, name: str, hz: float, vehicle: int = 0) -> None:
        msgid = getattr(dialect, f"MAVLINK_MSG_ID_{name}")
        self.command(511, msgid, 1e6 / hz if hz > 0 else -1, vehicle=vehicle)

    def run(self, seconds: float, each: Callable[[], None] | None = None) -> None:
        """Lets time pass in ticks of 20 ms."""
        for _ in range(round(seconds * SECOND / TICK)):
            if each is not None:
                each()
            elif self.stream is not None:
                self.stream()
            self.now_ns += TICK
            for item in self.world.advance(self.now_ns):
                self.datagrams.append(item)
                for piece in self._splitters[item.vehicle_index].feed(item.data):
                    if isinstance(piece, Frame):
                        self.raw.append(((item.t_ns - self.start_ns) / SECOND, item.vehicle_index, piece))
                    else:
                        self.noise.append(piece)

    def run_until(self, condition: Callable[[], bool], limit_s: float, each: Callable[[], None] | None = None) -> float:
        """Runs until a condition holds; returns how long it took, and fails when it takes too long."""
        start_s = self.t_s
        while not condition():
            assert self.t_s - start_s < limit_s, f"not within {limit_s} s"
            self.run(TICK / SECOND, each)
        return self.t_s - start_s

    def all(self, name: str, vehicle: int = 0, since_s: float = 0.0) -> list[tuple[float, Any]]:
        """Messages of one type from one vehicle with their times."""
        msgid = getattr(dialect, f"MAVLINK_MSG_ID_{name}")
        return [
            (t_s, self._decode(frame))
            for t_s, index, frame in self.raw
            if frame.msgid == msgid and index == vehicle and t_s >= since_s
        ]

    def _decode(self, frame: Frame) -> Any:
        message = self._decoded.get(id(frame))
        if message is None:
            message = self._decoded[id(frame)] = self._decoder.decode(bytearray(frame.raw))
        return message

    def count(self, vehicle: int = 0, since_s: float = 0.0) -> Counter[str]:
        """How many of each type came from a vehicle."""
        return Counter(
            message_name(frame.msgid) or str(frame.msgid)
            for t_s, index, frame in self.raw
            if index == vehicle and t_s >= since_s
        )

    def last(self, name: str, vehicle: int = 0) -> Any:
        msgid = getattr(dialect, f"MAVLINK_MSG_ID_{name}")
        for _, index, frame in reversed(self.raw):
            if frame.msgid == msgid and index == vehicle:
                return self._decode(frame)
        raise AssertionError(f"no {name} from vehicle {vehicle}")

    def acks(self, vehicle: int = 0, since_s: float = 0.0) -> list[tuple[int, int]]:
        return [(m.command, m.result) for _, m in self.all("COMMAND_ACK", vehicle, since_s)]

    def texts(self, vehicle: int = 0, since_s: float = 0.0) -> list[tuple[int, str]]:
        """Texts with their severity, chunks joined."""
        texts: list[tuple[int, str]] = []
        for _, message in self.all("STATUSTEXT", vehicle, since_s):
            if message.id and message.chunk_seq:
                severity, text = texts.pop()
                texts.append((severity, text + message.text))
            else:
                texts.append((message.severity, message.text))
        return texts

    def ask(self, number: int, *params: float, vehicle: int = 0) -> int:
        """Sends a command and returns the result that was acknowledged."""
        before = self.t_s
        self.command(number, *params, vehicle=vehicle)
        self.run(0.04)
        results = [result for command, result in self.acks(vehicle, before) if command == number]
        assert len(results) == 1, f"{len(results)} acknowledgements of command {number}"
        return results[0]

    def height(self, vehicle: int = 0) -> float:
        return float(self.world.dynamics.motion.pos_enu_m[2, vehicle])


def world(n: int = 1, **options: Any) -> WorldConfig:
    """n PX4 vehicles without estimation noise, 5 m apart along east, facing north."""
    from math import pi

    from sitl.estimator import NOISELESS

    extra = {key: options.pop(key) for key in list(options) if key in VehicleConfig.__dataclass_fields__}
    extra.setdefault("noise", NOISELESS)
    vehicles = [VehicleConfig(k + 1, pad_enu_m=(5.0 * k, 0.0, 0.0), yaw_enu_rad=pi / 2, **extra) for k in range(n)]
    return WorldConfig(vehicles=vehicles, **options)


def hovering(height_m: float = 4.0, **options: Any) -> Ground:
    """A PX4 vehicle in OFFBOARD at a height, zero velocity being streamed."""
    ground = Ground(world(**options))
    ground.run(2.5)
    for name, hz in LEAN_RATES_HZ.items():  # the rest of the onboard link would only make the tests slow
        ground.world.state.streams.set_interval(0, name, round(1e9 / hz) if hz else 0, ground.now_ns)
    ground.stream = ground.velocity
    ground.run(0.1)
    assert ground.ask(176, 1, 6) == 0
    assert ground.ask(400, 1) == 0
    ground.run_until(lambda: ground.height() > height_m - 0.3, 20.0, lambda: ground.velocity(vz=-1.0))
    ground.run(2.0)
    return ground


GUIDED, APM_LAND = 4, 9


def arducopter(**options: Any) -> WorldConfig:
    """One ArduCopter without estimation noise, facing north."""
    return world(autopilot="arducopter", streams="ardupilot", profile="arducopter", **options)


def guided_at(height_m: float = 4.0, **options: Any) -> Ground:
    """An ArduCopter hovering in GUIDED at a height, position and attitude streaming at 50 Hz."""
    ground = Ground(arducopter(**options))
    ground.run(2.5)
    for name in ("LOCAL_POSITION_NED", "ATTITUDE", "EXTENDED_SYS_STATE"):
        ground.interval(name, 50)
    ground.run(0.04)
    assert ground.ask(176, 1, GUIDED) == 0
    assert ground.ask(400, 1) == 0
    assert ground.ask(22, 0, 0, 0, 0, 0, 0, height_m) == 0
    ground.run_until(lambda: ground.height() > height_m - 0.05, 20.0)
    ground.run(2.0)
    return ground
