"""Emulated Crazyflies behind the gateway in virtual time, and a ground station that speaks MAVLink to one of them."""

from __future__ import annotations

import math

import numpy as np

from groundstation.app.gateway.emulated import GatewayWorld
from groundstation.gateway.bridge import Bridge
from groundstation.mavlink.codec import Encoder, Frame, FrameSplitter, StructuredArray, decode
from sitl.faults import Fault, parse_faults
from sitl.fleet import fleet
from sitl.world import World, WorldConfig

VELOCITY, HOLD, LAND = 1, 2, 3


class Room:
    """n of them on pads; ``heard`` is what the first one has told since it was emptied."""

    def __init__(self, n: int = 1, *, faults: str | None = None, world: World | None = None) -> None:
        struck: tuple[Fault, ...] = tuple(parse_faults(faults, "test")) if faults else ()
        self.world = world or World(WorldConfig(vehicles=fleet(n, autopilot="crazyflie"), faults=struck), 1)
        self.gateway = GatewayWorld(self.world)
        self.heard: list[tuple[str, StructuredArray]] = []
        self.now_ns = 0
        self.station_lives = True
        self.setpoint: tuple[float, float, float, float | None] | None = None
        self._encoder, self._splitter = Encoder(255, 190), FrameSplitter()
        self.run(2.0)

    def send(self, name: str, **fields: float | bytes) -> None:
        self.gateway.receive(0, self._encoder.encode(name, **fields), self.now_ns)

    def run(self, seconds: float) -> None:
        """Lets time pass, with a heartbeat a second and the setpoint, if there is one, every 40 ms."""
        end_ns = self.now_ns + round(seconds * 1e9)
        while self.now_ns < end_ns:
            if self.station_lives and self.now_ns % 1_000_000_000 == 0:
                self.send("HEARTBEAT", type=6, autopilot=8)
            if self.setpoint is not None:
                self.steer(*self.setpoint)
            self.now_ns += 40_000_000
            for item in self.gateway.advance(self.now_ns):
                if item.vehicle_index == 0:
                    frames = [piece for piece in self._splitter.feed(item.data) if isinstance(piece, Frame)]
                    self.heard += [(batch.name, batch.values[0]) for batch in decode(frames)]

    def steer(self, north: float, east: float, down: float, yaw_ned_rad: float | None = None, frame: int = 1) -> None:
        self.send(
            "SET_POSITION_TARGET_LOCAL_NED", target_system=1, target_component=1, coordinate_frame=frame,
            type_mask=0x0DC7 if yaw_ned_rad is None else 0x09C7, vx=north, vy=east, vz=down, yaw=yaw_ned_rad or 0.0,
        )  # fmt: skip

    def command(self, number: int, *params: float) -> int:
        """Sends a command; returns its MAV_RESULT."""
        self.heard.clear()
        fields = {f"param{k}": value for k, value in enumerate(params, start=1)}
        self.send("COMMAND_LONG", target_system=1, target_component=1, command=number, **fields)
        self.run(0.04)
        return int(self.last("COMMAND_ACK")["result"])

    def all(self, name: str) -> list[StructuredArray]:
        return [values for kind, values in self.heard if kind == name]

    def last(self, name: str) -> StructuredArray:
        found = self.all(name)
        assert found, f"no {name} among {sorted({kind for kind, _ in self.heard})}"
        return found[-1]

    def texts(self) -> str:
        return "".join(bytes(values["text"]).decode() + "|" for values in self.all("STATUSTEXT"))

    def fly(self, height_m: float = 1.0) -> None:
        """Arms, takes off by command and stands in the air, without a setpoint yet."""
        assert self.command(176, 1.0, VELOCITY) == 0
        assert self.command(400, 1.0) == 0
        assert self.command(22, 0, 0, 0, math.nan, 0, 0, height_m) == 0
        self.run(height_m / 0.5 + 2.0)

    @property
    def bridge(self) -> Bridge:
        return self.gateway.bridges[0]

    @property
    def place_enu_m(self) -> np.ndarray:
        return np.asarray(self.world.truth.pos_enu_m[0])

    @property
    def stage(self) -> str:
        return self.world.autopilots[0].mode_name()
