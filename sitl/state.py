"""The state of all vehicles of a world: bodies, beliefs, clocks, what is known and what is broken.

Structures of arrays, one column for each vehicle. Refuses to move anything and to send anything: ``world`` steps it,
autopilots reach it through their ``Body``, messages are made from it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sitl import frames
from sitl.config import SECOND, WorldConfig
from sitl.dynamics import Dynamics
from sitl.environment import Downwash, Wind
from sitl.estimator import Estimator
from sitl.frames import Array, Geodesy
from sitl.own_frame import OwnFrames
from sitl.pilot import Pilot
from sitl.profiles import Profile
from sitl.signing import VehicleSigning
from sitl.streams import Streams

HAS_FIX = 1 << 62
"""In place of the time since which a GPS receiver has none."""


class Clocks:
    """What time the vehicles think it is.

    Attributes:
        boot_ns: when each was powered up, shape (n,).
        offset_ns: by which each clock has jumped (faults), shape (n,).
    """

    def __init__(self, config: WorldConfig, profiles: Sequence[Profile]) -> None:
        n = len(profiles)
        self.boot_ns = np.full(n, config.start_ns, dtype=np.int64)
        self.offset_ns = np.zeros(n, dtype=np.int64)
        self._own_ns: tuple[int, NDArray[np.int64]] | None = None
        self._own_ms: tuple[NDArray[np.int64], NDArray[np.int64]] | None = None
        self._slow = np.array([1.0 - profile.manners.clock_rate for profile in profiles])
        self._drifts = bool(self._slow.any())
        self._unix_at_0_us = config.unix_start_us, config.start_ns

    def own_ns(self, now_ns: int) -> NDArray[np.int64]:
        """Time since power-up as each vehicle counts it, shape (n,); never below 0, wherever its clock jumped.

        Kept for the step, in which every message asks for it: not to be written.
        """
        if self._own_ns is not None and self._own_ns[0] == now_ns:
            return self._own_ns[1]
        counted = now_ns - self.boot_ns
        if self._drifts:
            counted = counted - np.rint(counted * self._slow).astype(np.int64)
        own_ns: NDArray[np.int64] = np.maximum(counted + self.offset_ns, 0)
        self._own_ns = now_ns, own_ns
        return own_ns

    def own_ms(self, now_ns: int) -> NDArray[np.int64]:
        """The same in whole milliseconds, shape (n,)."""
        own_ns = self.own_ns(now_ns)
        if self._own_ms is None or self._own_ms[0] is not own_ns:
            self._own_ms = own_ns, own_ns // 1_000_000
        return self._own_ms[1]

    def start(self, index: int, now_ns: int) -> None:
        """A vehicle is powered up."""
        self.boot_ns[index], self.offset_ns[index], self._own_ns = now_ns, 0, None

    def jump(self, index: int, by_ns: int) -> None:
        """A vehicle's clock jumps."""
        self.offset_ns[index] += by_ns
        self._own_ns = None

    def unix_us(self, now_ns: int) -> int:
        """The date, microseconds."""
        begun_us, start_ns = self._unix_at_0_us
        return begun_us + (now_ns - start_ns) // 1000


class Known:
    """What the estimators know.

    Attributes:
        origin_enu_m, home_enu_m: of each, and home, shape (3, n).
        has_position, has_origin: whether they have them, shape (n,).
        has_gps: whether there is a GPS receiver, shape (n,).
    """

    def __init__(self, config: WorldConfig, pads_enu_m: Array) -> None:
        n = len(config.vehicles)
        self.origin_enu_m, self.home_enu_m = pads_enu_m.copy(), pads_enu_m.copy()
        self.has_position = np.zeros(n, dtype=bool)
        self.has_origin = np.zeros(n, dtype=bool)
        self.has_gps = np.array([vehicle.gps for vehicle in config.vehicles])


class Broken:
    """What faults have done.

    Attributes:
        frozen, invalid: position reports stuck, or not numbers, shape (n,).
        frozen_pos_enu_m: where they are stuck, shape (3, n).
        no_fix_ns: since when a GPS receiver has no fix, ``HAS_FIX`` where it has one, shape (n,).
        motor_share: thrust that the motors can give, 1 when sound, shape (n,).
        muted: message types that some do not send, shape (n,) each.
    """

    def __init__(self, pads_enu_m: Array) -> None:
        n = pads_enu_m.shape[1]
        self.frozen, self.invalid = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
        self.frozen_pos_enu_m = pads_enu_m.copy()
        self.no_fix_ns: NDArray[np.int64] = np.full(n, HAS_FIX)
        self.motor_share = np.ones(n)
        self.muted = {name: np.zeros(n, dtype=bool) for name in ("HEARTBEAT",)}


class State:
    """What is, and what is believed, of n vehicles.

    Args:
        config: see ``WorldConfig``.
        profiles: how each vehicle flies.
        streamed: message types that can be streamed, in the order in which they are sent.
        rngs: of the estimates' errors, of gusts, and of own frames.

    Attributes:
        now_ns: the clock.
        dynamics, estimator, streams, geodesy: its parts.
        own_frames: what the vehicles take for north and level; None: they are right.
        pilots: one per vehicle, once they are powered up.
        clocks, known, broken: what time they think it is, what their estimators know, what is wrong with them.
        talking: has sent its first bytes, shape (n,).
        signing: signatures of each vehicle.
    """

    def __init__(
        self,
        config: WorldConfig,
        profiles: Sequence[Profile],
        streamed: Sequence[str],
        rngs: tuple[np.random.Generator, np.random.Generator, np.random.Generator],
    ) -> None:
        n, (rng_estimate, rng_wind, rng_frames) = len(config.vehicles), rngs
        self.own_frames = None if config.own_frames is None else OwnFrames(config.own_frames, n, rng_frames)
        self.config, self.n = config, n
        self.now_ns = config.start_ns
        step_s = config.physics_step_ns / SECOND
        self.profiles = tuple(profiles)
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
            own_frames=self.own_frames,
            floor_m=config.floor_m,
        )
        self.geodesy = Geodesy(config.home_lat_deg, config.home_lon_deg, config.home_alt_m)
        self.streams = Streams(tuple(streamed), n, config.start_ns)
        self.pilots: Sequence[Pilot] = ()
        self.clocks = Clocks(config, self.profiles)
        self.known = Known(config, pads)
        self.broken = Broken(pads)
        self.talking = np.zeros(n, dtype=bool)
        self.signing = [
            VehicleSigning(vehicle.signing_key, self.unix_us() if vehicle.gps else 0) for vehicle in config.vehicles
        ]

    def own_time_ns(self) -> NDArray[np.int64]:
        """Time since power-up as each vehicle counts it, shape (n,)."""
        return self.clocks.own_ns(self.now_ns)

    def unix_us(self) -> int:
        """The date, microseconds."""
        return self.clocks.unix_us(self.now_ns)

    def true_quat(self) -> Array:
        """True attitude, FRD to NED, shape (4, n)."""
        yaw = frames.yaw_ned_from_enu(self.dynamics.motion.yaw_enu_rad)
        return frames.quat_from_euler(*frames.euler_from_thrust(self.dynamics.motion.up_enu, yaw), yaw)

    def power_off(self, index: int) -> None:
        """Forgets what a vehicle loses with its power."""
        self.talking[index] = self.known.has_position[index] = self.known.has_origin[index] = False
        self.clocks.start(index, self.now_ns)
        for name in self.streams.names:
            self.streams.set_interval(index, name, 0, self.now_ns)

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
            np.array([profile.frame.mass_kg for profile in self.profiles]),
            np.array([profile.frame.rotor_span_m for profile in self.profiles]),
        )
