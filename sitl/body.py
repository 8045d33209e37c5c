"""What an autopilot sees of its vehicle, and what it can do to it: the only door from the one to the other.

Estimates, motors, clock, GPS receiver, the link to the ground. Refuses to show other vehicles, and truths that no
sensor tells (contact with the ground, the ground's height beneath and the thrust are taken for sensed).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Mapping, Sequence
from typing import NamedTuple

from sitl.frames import Array, Geodesy
from sitl.profiles import Profile
from sitl.setpoints import Triple
from sitl.signing import VehicleSigning
from sitl.state import State

Place = tuple[float, float, float]

_GUESSES_NS = 5_700_000_000  # PX4 1.16 in its own simulator flew on without a fix for as long, and told nothing


class Radio(NamedTuple):
    """What a vehicle can do beside flying, each for the vehicle of that index.

    Attributes:
        emit: sends a frame.
        send_now: sends one message of a streamed type out of turn; returns whether it could be made.
        reboot: powers it off and on again.
    """

    emit: Callable[[int, bytes], None]
    send_now: Callable[[int, str], bool]
    reboot: Callable[[int], None]


class Senses:
    """What a vehicle's sensors tell, and what its estimator makes of them."""

    def __init__(self, state: State, index: int) -> None:
        self._index = index
        self._state = state
        self._known, self._broken, self._estimator = state.known, state.broken, state.estimator
        self._motion, self._ground = state.dynamics.motion, state.dynamics.ground
        self._frames = state.own_frames

    @property
    def pos_enu_m(self) -> Place:
        """Believed position in the world's frame."""
        i = self._index
        x, y, z = (self._motion.pos_enu_m[:, i] + self._estimator.pos_error[:, i]).tolist()
        return x, y, z

    @property
    def yaw_enu_rad(self) -> float:
        """Believed heading from east counter-clockwise."""
        off_rad = 0.0 if self._frames is None else float(self._frames.heading_rad[self._index])
        return float(self._motion.yaw_enu_rad[self._index]) - off_rad

    @property
    def has_gps(self) -> bool:
        """Whether there is a GPS receiver."""
        return bool(self._known.has_gps[self._index])

    @property
    def has_position(self) -> bool:
        """Whether the estimator has a position."""
        return bool(self._known.has_position[self._index])

    @has_position.setter
    def has_position(self, found: bool) -> None:
        self._known.has_position[self._index] = found

    @property
    def position_good(self) -> bool:
        """Whether it has one that can be flown by."""
        broken, i = self._broken, self._index
        guessed = self._state.now_ns - int(broken.no_fix_ns[i]) > _GUESSES_NS
        return self.has_position and not broken.invalid[i] and not guessed

    @property
    def has_origin(self) -> bool:
        """Whether the estimator has an origin."""
        return bool(self._known.has_origin[self._index])

    @property
    def origin_enu_m(self) -> Place:
        """Where LOCAL_POSITION_NED begins."""
        x, y, z = self._known.origin_enu_m[:, self._index].tolist()
        return x, y, z

    @property
    def home_enu_m(self) -> Place:
        """Home."""
        x, y, z = self._known.home_enu_m[:, self._index].tolist()
        return x, y, z

    def set_origin(self, place_enu_m: Sequence[float] | Array | None = None) -> None:
        """Gives the estimator its origin; None takes the place where it stands, as well as GPS knows it."""
        i = self._index
        self._known.has_origin[i] = True
        if place_enu_m is None:
            place_enu_m = self._motion.pos_enu_m[:, i] + self._estimator.origin_error_enu_m[:, i]
        self._known.origin_enu_m[:, i] = place_enu_m

    def set_home(self, place_enu_m: Sequence[float] | Array) -> None:
        """Sets home."""
        self._known.home_enu_m[:, self._index] = place_enu_m

    def correct(self, by_enu_m: Sequence[float]) -> None:
        """Moves the believed position."""
        estimator = self._estimator
        for axis in range(3):
            estimator.offset_enu_m[axis, self._index] += by_enu_m[axis]
        estimator.refresh()

    def mislead(self, by_enu_m_s: Sequence[float]) -> None:
        """Sets by how much the believed velocity is off beside its usual errors."""
        self._estimator.mislead(self._index, by_enu_m_s)

    @property
    def on_ground(self) -> bool:
        """Whether it touches the ground."""
        return bool(self._motion.on_ground[self._index])

    @property
    def ground_m(self) -> float:
        """Height of the ground beneath it, in the world's frame."""
        return float(self._ground.height_m[self._index])

    @property
    def above_ground_m(self) -> float:
        """Height above it."""
        return float(self._motion.pos_enu_m[2, self._index]) - self.ground_m

    @property
    def vel_enu_m_s(self) -> Place:
        """Believed velocity in the world's frame."""
        i = self._index
        x, y, z = (self._motion.vel_enu_m_s[:, i] + self._estimator.vel_error[:, i]).tolist()
        return x, y, z

    @property
    def up_enu(self) -> Place:
        """Upward body axis, a unit vector in the world's frame as the vehicle believes it."""
        up = self._motion.up_enu
        x, y, z = (up if self._frames is None else self._frames.believed(up))[:, self._index].tolist()
        return x, y, z

    @property
    def wrecked(self) -> bool:
        """Whether it has hit the ground tumbling and lies there."""
        return bool(self._motion.crashed[self._index])


class Motors:
    """What a vehicle flies with, and what it is told to fly."""

    def __init__(self, state: State, index: int) -> None:
        self._index = index
        self._motion, self._commands = state.dynamics.motion, state.dynamics.commands
        self._health, self._broken = state.dynamics.health, state.broken
        self._profile = state.profiles[index]
        self._heading_off_rad = 0.0 if state.own_frames is None else float(state.own_frames.heading_rad[index])

    @property
    def thrust_m_s2(self) -> float:
        """Thrust over mass."""
        return float(self._motion.thrust_m_s2[self._index])

    @property
    def flying(self) -> bool:
        """Whether the motors lift."""
        return bool(self._commands.flying[self._index])

    @flying.setter
    def flying(self, lift: bool) -> None:
        self._commands.flying[self._index] = lift

    def stop(self) -> None:
        """Ends their thrust at once."""
        self.flying = False
        self._motion.thrust_m_s2[self._index] *= 0.0

    def power(self, powered: bool) -> None:
        """Gives the motors what they can take, or nothing."""
        self._health.power(self._index, self._broken.motor_share[self._index] if powered else 0.0)

    def command(
        self,
        pos_enu_m: Triple,
        vel_enu_m_s: Triple,
        yaw_enu_rad: float | None = None,
        yaw_rate_rad_s: float | None = None,
    ) -> None:
        """Tells it what to fly; on each axis a position, a velocity, or both (then it is feed-forward)."""
        commands, i = self._commands, self._index
        for axis in range(3):
            pos, vel = pos_enu_m[axis], vel_enu_m_s[axis]
            commands.vel_sp_enu_m_s[axis, i] = 0.0 if vel is None else vel
            if pos is None:
                if commands.positions_used:  # else it is zero still
                    commands.pos_mask[axis, i] = 0.0
            else:
                commands.pos_mask[axis, i] = 1.0
                commands.pos_sp_enu_m[axis, i] = pos
                commands.positions_used = True
        if yaw_rate_rad_s is not None:
            commands.yaw_mask[i] = False
            commands.yaw_rate_sp_rad_s[i] = yaw_rate_rad_s
            commands.yaw_used = True
        elif yaw_enu_rad is not None:
            commands.yaw_mask[i] = True
            commands.yaw_sp_enu_rad[i] = yaw_enu_rad + self._heading_off_rad
            commands.yaw_used = True
        elif not commands.yaw_mask[i]:
            commands.yaw_mask[i] = True
            commands.yaw_sp_enu_rad[i] = self._motion.yaw_enu_rad[i]

    def limit_speed(self, xy_m_s: float | None = None, up: float | None = None, down: float | None = None) -> None:
        """Sets the limits of the position loop; None takes the profile's."""
        profile, limits = self._profile, self._commands.speed_limit_m_s
        limits[0, self._index] = min(xy_m_s or math.inf, profile.manners.speed_xy_max_m_s)
        limits[1, self._index] = min(up or math.inf, profile.manners.speed_up_max_m_s)
        limits[2, self._index] = min(down or math.inf, profile.manners.speed_down_max_m_s)


class Link:
    """What a vehicle has to the ground: single frames, and streams that the radio makes for all of them at once."""

    def __init__(self, state: State, index: int, radio: Radio, streamed: Container[str]) -> None:
        self._state, self._index, self._radio, self._streamed = state, index, radio, streamed

    @property
    def talking(self) -> bool:
        """Whether it has sent its first bytes."""
        return bool(self._state.talking[self._index])

    @talking.setter
    def talking(self, begun: bool) -> None:
        self._state.talking[self._index] = begun

    def emit(self, frame: bytes) -> None:
        """Sends a frame, once it talks."""
        self._radio.emit(self._index, frame)

    def send_now(self, name: str) -> bool:
        """Sends one message of a streamed type out of turn. Returns whether it could be made."""
        return self._radio.send_now(self._index, name)

    def can_stream(self, name: str) -> bool:
        """Whether a vehicle of its kind knows how to stream a type."""
        return name in self._streamed

    def set_rates(self, rates_hz: Mapping[str, float]) -> None:
        """Sets all streams: those that are not named are off."""
        self._state.streams.set_rates(self._index, rates_hz, self._state.now_ns)

    def set_interval(self, name: str, interval_ns: int) -> bool:
        """Sets one stream, 0 for off. Returns False for a type that is never streamed."""
        return self.can_stream(name) and self._state.streams.set_interval(
            self._index, name, interval_ns, self._state.now_ns
        )

    def interval(self, name: str) -> int | None:
        """Interval of a stream in ns, 0 for off, None for a type that is never streamed."""
        return self._state.streams.interval(self._index, name) if self.can_stream(name) else None


class Body:
    """One vehicle as its autopilot has it.

    Args:
        state: of all vehicles.
        index: which of them.
        radio: what it sends with.
        streamed: types that a vehicle of its kind can stream.

    Attributes:
        index: row of the vehicle in the world.
        senses, motors, link: what it has.
        profile: how it flies.
        signing: its signatures.
        geodesy: between the world's frame and the globe.
        home_alt_m: height of the world's origin above the sea.
    """

    def __init__(self, state: State, index: int, radio: Radio, streamed: Container[str]) -> None:
        self._state, self.index, self._radio = state, index, radio
        self.senses, self.motors = Senses(state, index), Motors(state, index)
        self.link = Link(state, index, radio, streamed)
        self.profile: Profile = state.profiles[index]
        self.signing: VehicleSigning = state.signing[index]
        self.geodesy: Geodesy = state.geodesy
        self.home_alt_m = state.config.home_alt_m

    @property
    def now_ns(self) -> int:
        """The world's clock."""
        return self._state.now_ns

    @property
    def own_time_ns(self) -> int:
        """Time since power-up as the vehicle counts it."""
        return int(self._state.own_time_ns()[self.index])

    def reboot(self) -> None:
        """Powers itself off and on again."""
        self._radio.reboot(self.index)
