"""The emulated world: vehicles, their autopilots, their links, one clock; bytes and times in, bytes out.

``receive`` hands in what a ground station sent to a vehicle, ``advance`` moves everything to a time and returns what
the vehicles sent on the way. The same seed and the same calls give the same bytes. Refuses to read a clock, to open
sockets and to draw unseeded numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundstation.mavlink.codec import Frame
from sitl.autopilot import Autopilot
from sitl.body import Body, Radio
from sitl.config import SECOND, VehicleConfig, WindConfig, WorldConfig
from sitl.distances import Distances
from sitl.dynamics import Dynamics
from sitl.fault_desk import FaultDesk
from sitl.faults import Fault
from sitl.frames import Array
from sitl.messages import MESSAGES, in_wire_order
from sitl.messages_hardware import HARDWARE_MESSAGES
from sitl.network import Channel
from sitl.outfit import Outfit
from sitl.personalities import PERSONALITIES, PROFILES, RATES_HZ
from sitl.receiver import Receiver
from sitl.signing import VehicleSigning
from sitl.state import State
from sitl.transmitter import Outgoing, Transmitter

__all__ = ["Outgoing", "Truth", "VehicleConfig", "WindConfig", "World", "WorldConfig"]
_TICK_NS = 20_000_000
_COMMON = {**MESSAGES, **HARDWARE_MESSAGES}


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


class World:
    """n vehicles and their clock.

    Args:
        config: see ``WorldConfig``.
        seed: of every random number in it.

    Attributes:
        state: what is, and what is believed.
        autopilots: one per vehicle.
        links: to and from each vehicle.
        frame_errors: frames of each vehicle whose handling failed; they are dropped and end nothing.
    """

    def __init__(self, config: WorldConfig, seed: int) -> None:
        n = len(config.vehicles)
        _check(config)
        seeds = np.random.SeedSequence(seed).spawn(4 + 2 * n)
        rng_estimate, rng_wind, self._rng_boot, rng_frames = (np.random.default_rng(s) for s in seeds[:4])
        messages = dict(_COMMON)
        for vehicle in config.vehicles:
            messages |= PERSONALITIES[vehicle.autopilot].messages
        profiles = [PROFILES[vehicle.profile] for vehicle in config.vehicles]
        self.state = State(config, profiles, in_wire_order(messages), (rng_estimate, rng_wind, rng_frames))
        uplinks = [Channel(config.uplink, np.random.default_rng(s)) for s in seeds[4 : 4 + n]]
        downlinks = [Channel(config.downlink, np.random.default_rng(s)) for s in seeds[4 + n :]]
        self.links = list(zip(uplinks, downlinks, strict=True))
        plain = frozenset(i for i, vehicle in enumerate(config.vehicles) if _first_port(vehicle) is not None)
        self._transmitter = Transmitter(self.state, downlinks, messages, plain)
        self._radio = Radio(self._transmitter.emit, self._send_now, self.reboot)
        self._receiver = Receiver(uplinks, plain)
        self._next_tick_ns = config.start_ns
        self.frame_errors = [0] * n
        self.autopilots: list[Autopilot] = [self._power_up(i) for i in range(n)]
        self.state.pilots = self.autopilots
        self._faults = FaultDesk(self.state, self.autopilots, self.links, self.reboot, config.faults)
        self._distances = Distances(n)

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
        self._receiver.send(vehicle_index, data, now_ns, ground_station, stream=stream)

    def advance(self, now_ns: int) -> list[Outgoing]:
        """Moves the world to a time, in whole physics steps.

        Returns:
            What arrived at the ground until then, in order of arrival.
        """
        step_ns = self.config.physics_step_ns
        sent = self._transmitter.collect()
        while self.now_ns + step_ns <= now_ns:
            self.state.now_ns += step_ns
            self._step()
        return sent

    @property
    def config(self) -> WorldConfig:
        """Everything about it but its seed."""
        return self.state.config

    @property
    def n(self) -> int:
        """Number of vehicles."""
        return self.state.n

    @property
    def now_ns(self) -> int:
        """The clock."""
        return self.state.now_ns

    @property
    def dynamics(self) -> Dynamics:
        """How the vehicles move."""
        return self.state.dynamics

    @property
    def signing(self) -> list[VehicleSigning]:
        """Signatures of each vehicle."""
        return self.state.signing

    @property
    def truth(self) -> Truth:
        """A copy of the true state."""
        dynamics = self.dynamics
        return Truth(
            pos_enu_m=dynamics.motion.pos_enu_m.T.copy(),
            vel_enu_m_s=dynamics.motion.vel_enu_m_s.T.copy(),
            quat_ned_from_frd=self.state.true_quat().T.copy(),
            airborne=dynamics.motion.airborne(),
            armed=np.array([pilot.armed for pilot in self.autopilots]),
        )

    @property
    def min_distance_airborne_m(self) -> float:
        """Smallest distance of two vehicles of which one at least was off the ground, wrecks included.

        Infinite before anybody was.
        """
        return self._distances.smallest_m()

    def min_distance_airborne_of_pairs_m(self) -> Array:
        """The same for each pair, symmetric, infinite on the diagonal, shape (n, n)."""
        return self._distances.of_pairs_m()

    def reset_min_distance(self) -> None:
        """Forgets the smallest distances."""
        self._distances.reset()

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

    def reboot(self, index: int) -> None:
        """Powers a vehicle off and on again."""
        pilot = self.autopilots[index]
        self._transmitter.flush()
        pilot.disarm()
        self.state.power_off(index)
        fresh = self._power_up(index)
        fresh.params, fresh.battery = pilot.params, pilot.battery
        fresh.mission.items = pilot.mission.items
        fresh.deny_arming, fresh.ignore_commands = pilot.deny_arming, pilot.ignore_commands
        fresh.landed = bool(self.dynamics.motion.on_ground[index])
        self.autopilots[index] = fresh

    # -- one step -----------------------------------------------------------------------------------------------

    def _step(self) -> None:
        state, transmitter = self.state, self._transmitter
        transmitter.begin_step()
        if state.now_ns >= self._faults.next_ns:
            self._faults.act(state.now_ns)
        state.dynamics.step()
        if not state.dynamics.motion.all_on_ground:
            self._distances.note(state.dynamics.motion.pos_enu_m, state.dynamics.motion.airborne())
        self._receiver.deliver(state.now_ns, self._take)
        if state.now_ns >= self._next_tick_ns:
            dt_s = _TICK_NS / SECOND
            for pilot in self.autopilots:
                pilot.tick(state.now_ns, dt_s)
            self._next_tick_ns += _TICK_NS
        for name, vehicles in state.streams.take_due(state.now_ns):
            transmitter.make(name, vehicles)
        transmitter.flush()
        transmitter.deliver()

    def _send_now(self, index: int, name: str) -> bool:
        return self._transmitter.make(name, np.array([index])) == 1

    def _take(self, vehicle: int, frame: Frame | bytes) -> None:
        pilot = self.autopilots[vehicle]  # a reboot in between makes a new one
        if not self.state.talking[vehicle]:
            return
        if isinstance(frame, Frame) and not self.state.signing[vehicle].accepts(frame):
            return
        try:
            if isinstance(frame, Frame):
                pilot.receive(frame)
            else:
                pilot.datagram(frame)
        except Exception:  # whatever one sender's frame does, the other vehicles fly on
            self.frame_errors[vehicle] += 1

    # -- making of ----------------------------------------------------------------------------------------------

    def _power_up(self, index: int) -> Autopilot:
        config = self.config.vehicles[index]
        kind = PERSONALITIES[config.autopilot]
        start_up = kind.real_start if self.config.real_boot else kind.quick_start
        outfit = Outfit(
            boot=start_up.boot(float(self._rng_boot.random())),
            params=kind.parameters(config.sysid),
            rates_hz=RATES_HZ[config.streams],
        )
        body = Body(self.state, index, self._radio, frozenset((*_COMMON, *kind.messages)))
        pilot = kind.autopilot(body, config, outfit)
        for name, value in config.params:
            if name not in pilot.params:
                raise ValueError(f"emulated vehicle {index + 1}: it has no parameter {name}")
            pilot.params.set_value(name, value)
        return pilot


def _first_port(vehicle: VehicleConfig) -> int | None:
    return PERSONALITIES[vehicle.autopilot].first_port


def _check(config: WorldConfig) -> None:
    seen: set[tuple[int, int]] = set()
    for k, vehicle in enumerate(config.vehicles):
        where = f"emulated vehicle {k + 1}"
        if not 1 <= vehicle.sysid <= 255:
            raise ValueError(f"{where}: sysid is {vehicle.sysid}, limits 1 and 255")
        if (vehicle.link, vehicle.sysid) in seen:
            raise ValueError(f"{where}: sysid {vehicle.sysid} is taken; every vehicle needs its own")
        seen.add((vehicle.link, vehicle.sysid))
        for key, value, known in (
            ("profile", vehicle.profile, PROFILES),
            ("autopilot", vehicle.autopilot, PERSONALITIES),
            ("streams", vehicle.streams, RATES_HZ),
        ):
            if value not in known:
                raise ValueError(f"{where}: {key} is {value!r}, one of {', '.join(known)} is needed")
        if vehicle.signing_key is not None and _first_port(vehicle) is not None:
            raise ValueError(f"{where}: {vehicle.autopilot} does not sign, it speaks no MAVLink; leave the key out")
