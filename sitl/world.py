"""The emulated world: vehicles, their autopilots, their links, one clock; bytes and times in, bytes out.

``receive`` hands in what a ground station sent to a vehicle, ``advance`` moves everything to a time and returns what
the vehicles sent on the way. The same seed and the same calls give the same bytes. Refuses to read a clock, to open
sockets and to draw unseeded numbers.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from groundstation.mavlink.codec import Frame, Splitters, encode_batch, message_id
from sitl import frames, messages_ardupilot
from sitl.ardupilot import ArduCopter
from sitl.autopilot import Autopilot, Boot
from sitl.dynamics import Dynamics
from sitl.environment import Downwash, Wind
from sitl.estimator import MOCAP, Estimator, Noise
from sitl.faults import Fault, FaultDesk
from sitl.frames import Array, Geodesy
from sitl.messages import MAKERS, NEEDS_GPS, NEEDS_ORIGIN, NEEDS_POSITION
from sitl.network import PERFECT, Channel, LinkConfig
from sitl.profiles import PROFILES, Profile
from sitl.protocol import V1_LAST_ID
from sitl.px4 import Px4
from sitl.signing import VehicleSigning
from sitl.telemetry import Streams, View

SECOND = 1_000_000_000
_TICK_NS = 20_000_000
_DATAGRAM_BYTES = 1200
messages_ardupilot.register()
PERSONALITIES: dict[str, type[Px4] | type[ArduCopter]] = {"px4": Px4, "arducopter": ArduCopter}


class Outgoing(NamedTuple):
    """One datagram of one vehicle, at the time at which it arrives at the ground."""

    t_ns: int
    vehicle_index: int
    data: bytes


@dataclass(frozen=True)
class VehicleConfig:
    """One emulated vehicle.

    Attributes:
        sysid: MAVLink system id, 1 to 255.
        autopilot: "px4" or "arducopter".
        profile: name in ``sitl.profiles.PROFILES``.
        pad_enu_m: where it stands, in the world's frame.
        yaw_enu_rad: heading from east counter-clockwise.
        noise: errors of its estimate.
        streams: what it sends unasked: "onboard", "gcs", "radio" (PX4's links), "ardupilot" or "quiet".
        mavlink_version: 1, 2, or 0 for 1 until a MAVLink 2 frame has come in.
        gps: whether it has a GPS receiver.
        signing_key: 32 bytes with which it signs, and without which nobody is obeyed; None for neither.
        params: names and values of parameters that differ from the firmware's defaults.
    """

    sysid: int
    autopilot: str = "px4"
    profile: str = "crazyflie"
    pad_enu_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw_enu_rad: float = 0.0
    noise: Noise = MOCAP
    streams: str = "onboard"
    mavlink_version: int = 2
    gps: bool = True
    signing_key: bytes | None = field(default=None, repr=False)
    params: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class WindConfig:
    """Mean wind, ENU m/s, and gusts."""

    mean_enu_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gust_sigma_m_s: float = 0.0
    gust_tau_s: float = 2.0


@dataclass(frozen=True)
class WorldConfig:
    """Everything about a world but its seed.

    Attributes:
        vehicles: in the order of their indices.
        physics_step_ns: physics step; the autopilots tick every 20 ms.
        start_ns: the clock at power-up of all vehicles.
        uplink, downlink: links to and from each vehicle.
        home_lat_deg, home_lon_deg, home_alt_m: where the world's frame has its origin.
        unix_start_us: date at power-up.
        real_boot: start-up takes as long as the real one.
        wind, downwash: options of the air.
        floor_m: height of the ground beside the pads, which stand on posts then; None: it is everywhere as high as
            each vehicle's pad.
        faults: what goes wrong when; more can be injected at run time.
    """

    vehicles: Sequence[VehicleConfig]
    physics_step_ns: int = 4_000_000
    start_ns: int = 0
    uplink: LinkConfig = PERFECT
    downlink: LinkConfig = PERFECT
    home_lat_deg: float = 47.397742
    home_lon_deg: float = 8.545594
    home_alt_m: float = 488.0
    unix_start_us: int = 1_750_000_000_000_000
    real_boot: bool = False
    wind: WindConfig | None = None
    downwash: bool = False
    floor_m: float | None = None
    faults: tuple[Fault, ...] = ()


@dataclass(frozen=True)
class Truth:
    """What is, whatever the vehicles believe.

    Attributes:
        pos_enu_m, vel_enu_m_s: shape (n, 3).
        quat_ned_from_frd: shape (n, 4), w x y z.
        airborne, armed: shape (n,) bool.
    """

    pos_enu_m: Array
    vel_enu_m_s: Array
    quat_ned_from_frd: Array
    airborne: NDArray[np.bool_]
    armed: NDArray[np.bool_]

    @property
    def quat(self) -> Array:
        """The same as ``quat_ned_from_frd``."""
        return self.quat_ned_from_frd


class _Arrival(NamedTuple):
    """Something under way; ``order`` is never twice the same, so that what follows it is never compared."""

    t_ns: int
    order: int
    vehicle: int
    peer: str
    data: bytes
    stream: bool = False


class World:
    """n vehicles and their clock.

    Args:
        config: see ``WorldConfig``.
        seed: of every random number in it.

    Attributes:
        now_ns: the clock.
        dynamics, estimator, streams, geodesy: its parts.
        autopilots: one per vehicle.
        origin_enu_m, home_enu_m: of each estimator, and home, shape (3, n).
        has_position, has_origin: the estimator has them, shape (n,).
        talking: has sent its first bytes, shape (n,).
        frozen, invalid: position reports stuck, or not numbers (faults), shape (n,).
        motor_share: thrust that the motors can give (faults), 1 when sound, shape (n,).
        signing: signatures of each vehicle.
        frame_errors: frames of each vehicle whose handling failed; they are dropped and end nothing.
    """

    def __init__(self, config: WorldConfig, seed: int) -> None:
        n = len(config.vehicles)
        _check(config)
        self.config, self.n = config, n
        self.now_ns = config.start_ns
        seeds = np.random.SeedSequence(seed).spawn(4 + 2 * n)
        rng_estimate, rng_wind, rng_boot = (np.random.default_rng(s) for s in seeds[:3])
        self.rng_faults = np.random.default_rng(seeds[3])
        step_s = config.physics_step_ns / SECOND
        self.profiles = tuple(PROFILES[vehicle.profile] for vehicle in config.vehicles)
        self.estimator = Estimator([vehicle.noise for vehicle in config.vehicles], step_s, rng_estimate)
        pads = np.array([vehicle.pad_enu_m for vehicle in config.vehicles], dtype=np.float64).T.copy()
        yaws = np.array([vehicle.yaw_enu_rad for vehicle in config.vehicles], dtype=np.float64)
        self.dynamics = Dynamics(
            self.profiles,
            pos_enu_m=pads,
            yaw_enu_rad=yaws,
            estimator=self.estimator,
            step_s=step_s,
            wind=self._wind(rng_wind, step_s),
            downwash=self._downwash(),
            floor_m=config.floor_m,
        )
        self.geodesy = Geodesy(config.home_lat_deg, config.home_lon_deg, config.home_alt_m)
        self.streams = Streams(tuple(MAKERS), n, config.start_ns)
        self.origin_enu_m, self.home_enu_m = pads.copy(), pads.copy()
        self.has_position = np.zeros(n, dtype=bool)
        self.has_origin = np.zeros(n, dtype=bool)
        self.talking = np.zeros(n, dtype=bool)
        self.frozen, self.invalid = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
        self.frozen_pos_enu_m = pads.copy()
        self.motor_share = np.ones(n)
        self.frame_errors = [0] * n
        self.has_gps = np.array([vehicle.gps for vehicle in config.vehicles])
        self.muted = {name: np.zeros(n, dtype=bool) for name in ("HEARTBEAT",)}
        self.clock_offset_ns = np.zeros(n, dtype=np.int64)
        self._clock_slow = np.array([1.0 - profile.clock_rate for profile in self.profiles])
        self._clock_drifts = bool(self._clock_slow.any())
        self._boot_ns = np.full(n, config.start_ns, dtype=np.int64)
        self._uplinks = [Channel(config.uplink, np.random.default_rng(s)) for s in seeds[4 : 4 + n]]
        self._downlinks = [Channel(config.downlink, np.random.default_rng(s)) for s in seeds[4 + n :]]
        self._incoming: list[_Arrival] = []
        self._outgoing: list[_Arrival] = []
        self._order = 0
        self._sent: list[Outgoing] = []
        self._pending: dict[int, list[bytes]] = {}
        self._splitters = Splitters()
        self.signing = [
            VehicleSigning(vehicle.signing_key, self.unix_us() if vehicle.gps else 0) for vehicle in config.vehicles
        ]
        self._view: View | None = None
        self._next_tick_ns = self.now_ns
        self._rng_boot = rng_boot
        self.autopilots: list[Autopilot] = [self._power_up(i) for i in range(n)]
        self.links = list(zip(self._uplinks, self._downlinks, strict=True))
        self._faults = FaultDesk(self, config.faults)
        self._pairs = np.triu_indices(n, 1)
        self._history: list[tuple[Array, NDArray[np.bool_]]] = []
        self._nearest_squared = np.full(len(self._pairs[0]), math.inf)

    # -- interface ----------------------------------------------------------------------------------------------

    def receive(
        self, vehicle_index: int, data: bytes, now_ns: int, ground_station: str = "gcs", *, stream: bool = False
    ) -> None:
        """Takes one datagram from a ground station; it acts at the next physics step after its way up.

        Args:
            vehicle_index: whose link it was sent to.
            data: as received; noise is skipped.
            now_ns: when it was sent, not before the last ``advance``.
            ground_station: any name that tells senders apart.
            stream: the sender's frames may come in pieces (TCP).
        """
        for t_ns, arrived in self._uplinks[vehicle_index].carry(now_ns, data):
            self._order += 1
            heapq.heappush(self._incoming, _Arrival(t_ns, self._order, vehicle_index, ground_station, arrived, stream))

    def advance(self, now_ns: int) -> list[Outgoing]:
        """Moves the world to a time, in whole physics steps.

        Returns:
            What arrived at the ground until then, in order of arrival.
        """
        step_ns = self.config.physics_step_ns
        self._sent = []
        while self.now_ns + step_ns <= now_ns:
            self.now_ns += step_ns
            self._step()
        self._measure_distances()
        return self._sent

    @property
    def truth(self) -> Truth:
        """A copy of the true state."""
        dynamics = self.dynamics
        return Truth(
            pos_enu_m=dynamics.pos_enu_m.T.copy(),
            vel_enu_m_s=dynamics.vel_enu_m_s.T.copy(),
            quat_ned_from_frd=self.true_quat().T.copy(),
            airborne=dynamics.airborne(),
            armed=np.array([pilot.armed for pilot in self.autopilots]),
        )

    @property
    def min_distance_airborne_m(self) -> float:
        """Smallest distance of two vehicles of which one at least was off the ground, wrecks included.

        Infinite before anybody was.
        """
        self._measure_distances()
        return math.sqrt(float(self._nearest_squared.min(initial=math.inf)))

    def min_distance_airborne_of_pairs_m(self) -> Array:
        """The same for each pair, symmetric, infinite on the diagonal, shape (n, n)."""
        self._measure_distances()
        distances = np.full((self.n, self.n), math.inf)
        distances[self._pairs] = distances.T[self._pairs] = np.sqrt(self._nearest_squared)
        return distances

    def reset_min_distance(self) -> None:
        """Forgets the smallest distances."""
        self._history.clear()
        self._nearest_squared[:] = math.inf

    def inject(self, *faults: Fault) -> None:
        """Lets something go wrong now, for as long as the faults say; their ``at_s`` does not count.

        Raises:
            FaultError: one of them concerns a vehicle that is not there; then nothing of it happens.
        """
        self._faults.inject(*faults)

    def clear_faults(self) -> None:
        """Mends everything that is wrong, and forgets the rest of the timetable."""
        self._faults.clear()

    @property
    def active_faults(self) -> tuple[Fault, ...]:
        """What is wrong now."""
        return tuple(fault for fault, _ in self._faults.active)

    @property
    def any_invalid(self) -> bool:
        """Whether any vehicle's position is not a number now."""
        return bool(self.invalid.any())

    # -- what the parts use -------------------------------------------------------------------------------------

    def profile_of(self, index: int) -> Profile:
        """Dynamics profile of a vehicle."""
        return self.profiles[index]

    def vehicle_time_ns(self) -> NDArray[np.int64]:
        """Time since power-up as each vehicle counts it, shape (n,); never below 0, wherever its clock jumped."""
        counted = self.now_ns - self._boot_ns
        if self._clock_drifts:
            counted = counted - np.rint(counted * self._clock_slow).astype(np.int64)
        return np.asarray(np.maximum(counted + self.clock_offset_ns, 0))

    def vehicle_time_of(self, index: int) -> int:
        """The same for one vehicle."""
        return int(self.vehicle_time_ns()[index])

    def unix_us(self) -> int:
        """The date, microseconds."""
        return self.config.unix_start_us + (self.now_ns - self.config.start_ns) // 1000

    def true_quat(self) -> Array:
        """True attitude, FRD to NED, shape (4, n)."""
        yaw = frames.yaw_ned_from_enu(self.dynamics.yaw_enu_rad)
        return frames.quat_from_euler(*frames.euler_from_thrust(self.dynamics.up_enu, yaw), yaw)

    def emit(self, index: int, frame: bytes) -> None:
        """Takes a frame that a vehicle sends now."""
        if self.talking[index]:
            self._pending.setdefault(index, []).append(frame)

    def send_now(self, index: int, name: str) -> bool:
        """Sends one message of a streamed type out of turn. Returns whether it could be made."""
        return self._make(name, np.array([index])) == 1

    def reboot(self, index: int) -> None:
        """Powers a vehicle off and on again."""
        pilot = self.autopilots[index]
        self._flush()
        pilot.disarm()
        self.talking[index] = self.has_position[index] = self.has_origin[index] = False
        self._boot_ns[index] = self.now_ns
        self.clock_offset_ns[index] = 0
        for name in self.streams.names:
            self.streams.set_interval(index, name, 0, self.now_ns)
        fresh = self._power_up(index)
        fresh.params, fresh.mission, fresh.battery = pilot.params, pilot.mission, pilot.battery
        fresh.deny_arming, fresh.ignore_commands = pilot.deny_arming, pilot.ignore_commands
        fresh.landed = bool(self.dynamics.on_ground[index])
        self.autopilots[index] = fresh

    # -- one step -----------------------------------------------------------------------------------------------

    def _step(self) -> None:
        self._view = None
        if self.now_ns >= self._faults.next_ns:
            self._faults.act(self.now_ns)
        self.dynamics.step()
        if not self.dynamics.all_on_ground:
            self._history.append((self.dynamics.pos_enu_m.copy(), self.dynamics.airborne()))
            if len(self._history) >= 64:
                self._measure_distances()
        while self._incoming and self._incoming[0].t_ns <= self.now_ns:
            self._hand_over(heapq.heappop(self._incoming))
        if self.now_ns >= self._next_tick_ns:
            dt_s = _TICK_NS / SECOND
            for pilot in self.autopilots:
                pilot.tick(self.now_ns, dt_s)
            self._next_tick_ns += _TICK_NS
        for name, vehicles in self.streams.take_due(self.now_ns):
            self._make(name, vehicles)
        self._flush()
        while self._outgoing and self._outgoing[0].t_ns <= self.now_ns:
            late = heapq.heappop(self._outgoing)
            self._sent.append(Outgoing(late.t_ns, late.vehicle, late.data))

    def _hand_over(self, arrival: _Arrival) -> None:
        pieces = self._splitters.feed((arrival.vehicle, arrival.peer), arrival.data, stream=arrival.stream)
        for piece in pieces:
            pilot = self.autopilots[arrival.vehicle]  # a reboot in between makes a new one
            if isinstance(piece, Frame) and pilot.powered and self.talking[arrival.vehicle]:
                if not self.signing[arrival.vehicle].accepts(piece):
                    continue
                try:
                    pilot.receive(piece)
                except Exception:  # whatever one sender's frame does, the other vehicles fly on
                    self.frame_errors[arrival.vehicle] += 1

    def _make(self, name: str, vehicles: NDArray[np.int64]) -> int:
        """Makes one message type for some vehicles; returns how many were sent."""
        able = self.talking[vehicles]
        if name in NEEDS_POSITION:
            able &= self.has_position[vehicles]
        elif name in NEEDS_ORIGIN:
            able &= self.has_origin[vehicles]
        if name in NEEDS_GPS:
            able &= self.has_gps[vehicles]
        if name in self.muted:
            able &= ~self.muted[name][vehicles]
        if message_id(name) > V1_LAST_ID:
            able &= np.array([self.autopilots[i].encoder.version == 2 for i in vehicles])
        if not able.all():
            vehicles = vehicles[able]
        if not len(vehicles):
            return 0
        if self._view is None:
            self._view = View(self)
        encoders = [self.autopilots[i].encoder for i in vehicles]
        for i, frame in zip(
            vehicles.tolist(), encode_batch(name, MAKERS[name](self, self._view, vehicles), encoders), strict=True
        ):
            self._pending.setdefault(i, []).append(frame)
        return len(vehicles)

    def _flush(self) -> None:
        """Puts what each vehicle has to send onto its link, as few datagrams as fit."""
        if not self._pending:
            return
        pending, self._pending = self._pending, {}
        for index in sorted(pending):
            signing = self.signing[index]
            if signing.on:
                if self.has_gps[index]:
                    signing.date(self.unix_us())
                pending[index] = [signing.sign(frame) for frame in pending[index]]
            for data in _datagrams(pending[index]):
                channel = self._downlinks[index]
                if channel.config is PERFECT:
                    self._sent.append(Outgoing(self.now_ns, index, data))
                    continue
                for t_ns, arrived in channel.carry(self.now_ns, data):
                    self._order += 1
                    heapq.heappush(self._outgoing, _Arrival(t_ns, self._order, index, "", arrived))

    def _measure_distances(self) -> None:
        if not self._history:
            return
        pos = np.stack([item[0] for item in self._history])
        air = np.stack([item[1] for item in self._history])
        self._history.clear()
        first, second = self._pairs
        counted = air[:, first] | air[:, second]  # whoever stands may be landed on
        if counted.any():
            delta = pos[:, :, first] - pos[:, :, second]
            squared = np.where(counted, (delta * delta).sum(axis=1), math.inf)
            np.minimum(self._nearest_squared, squared.min(axis=0), out=self._nearest_squared)

    # -- making of ----------------------------------------------------------------------------------------------

    def _power_up(self, index: int) -> Autopilot:
        config = self.config.vehicles[index]
        kind = PERSONALITIES[config.autopilot]
        pilot = kind(self, index, config, self._boot_of(config.autopilot))
        for name, value in config.params:
            if name not in pilot.params:
                raise ValueError(f"emulated vehicle {index + 1}: it has no parameter {name}")
            pilot.params.set_value(name, value)
        return pilot

    def _boot_of(self, autopilot: str) -> Boot:
        """Start-up times: short by default, as seen on the real ones with ``real_boot``; spread from the seed."""
        spread = float(self._rng_boot.random())

        def ns(low_s: float, high_s: float) -> int:
            return round((low_s + (high_s - low_s) * spread) * SECOND)

        px4 = autopilot == "px4"
        if not self.config.real_boot:
            position, ready = (ns(1.0, 1.4), ns(1.8, 2.0)) if px4 else (ns(1.8, 2.0), ns(0.9, 1.0))
            return Boot(ns(0.1, 0.1), ns(0.1, 0.1), position, ready, min(position, ns(1.0, 1.4)), ns(0.2, 0.2))
        if px4:
            return Boot(ns(1.0, 1.1), ns(2.1, 2.8), ns(1.2, 1.8), ns(5.0, 7.5), ns(1.2, 1.8), 0)
        return Boot(ns(0.5, 0.6), ns(1.9, 2.1), ns(41.5, 42.5), ns(23.5, 24.5), ns(20.5, 21.5), ns(3.0, 3.0))

    def _wind(self, rng: np.random.Generator, step_s: float) -> Wind | None:
        wind = self.config.wind
        if wind is None:
            return None
        return Wind(
            mean_enu_m_s=wind.mean_enu_m_s,
            gust_sigma_m_s=wind.gust_sigma_m_s,
            gust_tau_s=wind.gust_tau_s,
            n=self.n,
            step_s=step_s,
            rng=rng,
        )

    def _downwash(self) -> Downwash | None:
        if not self.config.downwash:
            return None
        return Downwash(
            np.array([profile.mass_kg for profile in self.profiles]),
            np.array([profile.rotor_span_m for profile in self.profiles]),
        )


def _datagrams(messages: list[bytes]) -> list[bytes]:
    total = sum(map(len, messages))
    if total <= _DATAGRAM_BYTES:
        return [b"".join(messages)]
    out, size, start = [], 0, 0
    for k, message in enumerate(messages):
        if size and size + len(message) > _DATAGRAM_BYTES:
            out.append(b"".join(messages[start:k]))
            size, start = 0, k
        size += len(message)
    out.append(b"".join(messages[start:]))
    return out


def _check(config: WorldConfig) -> None:
    seen: set[int] = set()
    for k, vehicle in enumerate(config.vehicles):
        where = f"emulated vehicle {k + 1}"
        if not 1 <= vehicle.sysid <= 255:
            raise ValueError(f"{where}: sysid is {vehicle.sysid}, limits 1 and 255")
        if vehicle.sysid in seen:
            raise ValueError(f"{where}: sysid {vehicle.sysid} is taken; every vehicle needs its own")
        seen.add(vehicle.sysid)
        if vehicle.profile not in PROFILES:
            raise ValueError(f"{where}: profile is {vehicle.profile!r}, one of {', '.join(PROFILES)} is needed")
        if vehicle.autopilot not in PERSONALITIES:
            names = " or ".join(PERSONALITIES)
            raise ValueError(f"{where}: autopilot is {vehicle.autopilot!r}, {names} is needed")
