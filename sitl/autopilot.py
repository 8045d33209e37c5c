"""What both personalities share: power-up, arming state, lift-off and touch-down, setpoints turned into commands.

One object per vehicle; ``tick`` is called every 20 ms of simulated time, message handlers in between. Refuses to
move anything itself: it writes commands into the dynamics and reads what the estimator believes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from groundstation.mavlink.codec import Frame
from sitl.battery import Battery
from sitl.frames import is_place
from sitl.mission import MissionFlight
from sitl.params import ParamSet
from sitl.protocol import ACCEPTED, DENIED, UNSUPPORTED, Protocol
from sitl.setpoints import NOTHING, Setpoint, Triple
from sitl.telemetry import RATES_HZ
from sitl.wire import whole

if TYPE_CHECKING:
    from sitl.vision import Vision
    from sitl.world import VehicleConfig, World

SECOND = 1_000_000_000
FORCE_MAGIC = 21196
LANDED, IN_AIR, TAKING_OFF, LANDING = 1, 2, 3, 4
_LIFTED_M = 0.03


@dataclass(frozen=True)
class Boot:
    """When, after power-up, a vehicle gets how far.

    Attributes:
        stream_ns: first message.
        heartbeat_ns: first heartbeat at the earliest.
        position_ns: position estimate.
        ready_ns: prearm checks pass (apart from the position).
        origin_ns: origin of the estimator.
        deaf_ns: mode requests are acknowledged but do nothing before this.
    """

    stream_ns: int
    heartbeat_ns: int
    position_ns: int
    ready_ns: int
    origin_ns: int
    deaf_ns: int


class Autopilot(Protocol):
    """One vehicle's flight state.

    Attributes:
        armed, armed_ns: whether, and since when.
        landed, landed_ns: as the land detector says, and since when.
        taken_off: has been in the air since arming.
        setpoint: the last valid one.
        battery: its battery.
    """

    def __init__(self, world: World, index: int, config: VehicleConfig, params: ParamSet, boot: Boot) -> None:
        super().__init__(world, index, config, params)
        self.boot = boot
        self.boot_ns = world.now_ns
        self.powered = True
        self.armed, self.armed_ns = False, 0
        self.landed, self.landed_ns = True, world.now_ns
        self.taken_off = False
        self.setpoint: Setpoint | None = None
        self.deny_arming = False
        self.vision: Vision | None = None
        self._beating = False
        self._contact_since_ns: int | None = None
        endurance = world.profile_of(index).hover_endurance_s
        self.flight = MissionFlight(self)
        self.battery = Battery(endurance) if endurance > 600 else Battery(endurance, 1, 250.0)
        self.commands.update(
            {
                400: self._arm_command,
                185: self._terminate,
                246: self._reboot_command,
                179: self._set_home,
                241: lambda _p, _f: ACCEPTED if not self.armed else DENIED,
            }
        )

    # -- what the personality tells -----------------------------------------------------------------------------

    def mode_name(self) -> str:
        """Name of the mode, for people."""
        raise NotImplementedError

    def base_mode(self) -> int:
        """MAV_MODE_FLAG bits of the heartbeat."""
        raise NotImplementedError

    def custom_mode(self) -> int:
        """Mode number of the heartbeat."""
        raise NotImplementedError

    def system_status(self) -> int:
        """MAV_STATE of the heartbeat."""
        raise NotImplementedError

    def landed_state(self) -> int:
        """MAV_LANDED_STATE."""
        return LANDED if self.landed else IN_AIR

    def sensor_bits(self) -> tuple[int, int, int]:
        """SYS_STATUS sensors: present, enabled, healthy."""
        raise NotImplementedError

    def update(self, now_ns: int) -> None:
        """Lets the modes act; called every tick once the vehicle is up."""
        raise NotImplementedError

    def arm_refusal(self) -> str | None:
        """Why arming is refused, None when it is not; an empty string is a refusal without words."""
        raise NotImplementedError

    def wants_up(self) -> bool:
        """Whether the present mode wants to leave the ground."""
        raise NotImplementedError

    def wants_down(self) -> bool:
        """Whether the present mode pushes towards the ground."""
        raise NotImplementedError

    first_item_is_home = False

    def vision_enabled(self) -> bool:
        """Whether the parameters let the estimator take positions from outside."""
        raise NotImplementedError

    def vision_has_origin(self) -> bool:
        """Whether positions from outside may be used before somebody has set an origin."""
        return True

    def mission_over(self) -> None:
        """Called every tick after the last item of a mission."""

    def mission_lands(self) -> None:
        """Called when a mission asks to land here."""
        raise NotImplementedError

    def mission_returns(self) -> None:
        """Called when a mission asks to return."""
        raise NotImplementedError

    def default_rates_hz(self) -> dict[str, float]:
        """Streams that run unasked."""
        return RATES_HZ[self.config.streams]

    # -- time ---------------------------------------------------------------------------------------------------

    @property
    def age_ns(self) -> int:
        """Time since power-up."""
        return self.world.now_ns - self.boot_ns

    @property
    def has_position(self) -> bool:
        """Whether the estimator has a position."""
        return bool(self.world.has_position[self.index])

    @property
    def ready(self) -> bool:
        """Whether the prearm checks pass."""
        return self.age_ns >= self.boot.ready_ns and self.position_good

    @property
    def position_good(self) -> bool:
        """Whether the estimator has a position that can be flown by."""
        return self.has_position and not self.world.invalid[self.index]

    def tick(self, now_ns: int, dt_s: float) -> None:
        """Runs everything that does not wait for a message, every 20 ms."""
        world, i = self.world, self.index
        if not self.powered:
            return
        if not world.talking[i] and self.age_ns >= self.boot.stream_ns:
            world.talking[i] = True
            world.streams.set_rates(i, {**self.default_rates_hz(), "HEARTBEAT": 0.0}, now_ns)
            self.started()
        if not self._beating and self.age_ns >= self.boot.heartbeat_ns:
            self._beating = True
            world.streams.set_interval(i, "HEARTBEAT", SECOND, now_ns)
            world.send_now(i, "HEARTBEAT")
        if not world.has_position[i]:
            self._look_for_position()
        if self.vision is not None:
            self.vision.tick(now_ns)
        self.battery.drain(float(world.dynamics.thrust_m_s2[i]) / 9.80665 * self.armed, dt_s)
        world.dynamics.thrust_share[i] = world.motor_share[i] if self.battery.left > 0.0 else 0.0
        if self._param_queue:
            self.send_queued_params()
        if self._upload is not None:
            self.ask_again()
        self._detect_landing(now_ns)
        self.update(now_ns)

    def started(self) -> None:
        """Called once, when the vehicle sends its first bytes."""

    def _look_for_position(self) -> None:
        world, i = self.world, self.index
        if not world.has_gps[i]:
            return
        if not world.has_origin[i] and self.age_ns >= self.boot.origin_ns:
            self.origin_found()
        if self.age_ns >= self.boot.position_ns:
            self.position_found()

    def origin_found(self) -> None:
        """Called when the estimator takes the place where it stands for its origin."""
        world, i = self.world, self.index
        world.has_origin[i] = True
        world.origin_enu_m[:, i] = world.dynamics.pos_enu_m[:, i] + world.estimator.origin_error_enu_m[:, i]

    def position_found(self) -> None:
        """Called when the estimator has found its position."""
        world, i = self.world, self.index
        if not world.has_origin[i]:
            self.origin_found()
        world.has_position[i] = True
        if self.landed:
            world.home_enu_m[:, i] = self.pos_est()

    # -- estimates ----------------------------------------------------------------------------------------------

    def pos_est(self) -> tuple[float, float, float]:
        """Believed position in the world's frame, ENU m."""
        world, i = self.world, self.index
        x, y, z = (world.dynamics.pos_enu_m[:, i] + world.estimator.pos_error[:, i]).tolist()
        return x, y, z

    def height_m(self) -> float:
        """Believed height above home."""
        return self.pos_est()[2] - float(self.world.home_enu_m[2, self.index])

    def yaw_enu(self) -> float:
        """Heading from east counter-clockwise, rad."""
        return float(self.world.dynamics.yaw_enu_rad[self.index])

    # -- commands to the dynamics -------------------------------------------------------------------------------

    def command(
        self,
        pos_enu_m: Triple,
        vel_enu_m_s: Triple,
        yaw_enu_rad: float | None = None,
        yaw_rate_rad_s: float | None = None,
    ) -> None:
        """Tells the dynamics what to fly; on each axis a position, a velocity, or both (then it is feed-forward)."""
        dynamics, i = self.world.dynamics, self.index
        for axis in range(3):
            pos, vel = pos_enu_m[axis], vel_enu_m_s[axis]
            dynamics.vel_sp_enu_m_s[axis, i] = 0.0 if vel is None else vel
            if pos is None:
                dynamics.pos_mask[axis, i] = 0.0
            else:
                dynamics.pos_mask[axis, i] = 1.0
                dynamics.pos_sp_enu_m[axis, i] = pos
                dynamics.positions_used = True
        if yaw_rate_rad_s is not None:
            dynamics.yaw_mask[i] = False
            dynamics.yaw_rate_sp_rad_s[i] = yaw_rate_rad_s
            dynamics.yaw_used = True
        elif yaw_enu_rad is not None:
            dynamics.yaw_mask[i] = True
            dynamics.yaw_sp_enu_rad[i] = yaw_enu_rad
            dynamics.yaw_used = True
        elif not dynamics.yaw_mask[i]:
            dynamics.yaw_mask[i] = True
            dynamics.yaw_sp_enu_rad[i] = dynamics.yaw_enu_rad[i]

    def set_flying(self, flying: bool) -> None:
        """Lets the motors lift, or idle."""
        self.world.dynamics.flying[self.index] = flying

    def limit_speed(self, xy_m_s: float | None = None, up: float | None = None, down: float | None = None) -> None:
        """Sets the limits of the position loop; None takes the profile's."""
        profile = self.world.profile_of(self.index)
        limits = self.world.dynamics.speed_limit_m_s
        limits[0, self.index] = min(xy_m_s or math.inf, profile.speed_xy_max_m_s)
        limits[1, self.index] = min(up or math.inf, profile.speed_up_max_m_s)
        limits[2, self.index] = min(down or math.inf, profile.speed_down_max_m_s)

    # -- arming -------------------------------------------------------------------------------------------------

    def arm(self) -> None:
        """Arms; whoever calls has checked."""
        now_ns = self.world.now_ns
        self.armed, self.armed_ns, self.taken_off = True, now_ns, False
        if self.landed:
            self.world.home_enu_m[:, self.index] = self.pos_est()
            self.command(NOTHING, NOTHING)

    def disarm(self) -> None:
        """Stops the motors at once, wherever the vehicle is."""
        self.armed = self.taken_off = False
        self.set_flying(False)
        self.world.dynamics.thrust_m_s2[self.index] *= 0.0

    def _arm_command(self, params: tuple[float, ...], _frame: Frame) -> int:
        if params[0] not in (0.0, 1.0):
            return UNSUPPORTED
        forced = whole(params[1]) == FORCE_MAGIC
        if params[0] == 1.0:
            return self.try_arm(forced)
        return self.try_disarm(forced)

    def try_arm(self, forced: bool) -> int:
        """Arms on request. Returns the MAV_RESULT."""
        raise NotImplementedError

    def try_disarm(self, forced: bool) -> int:
        """Disarms on request. Returns the MAV_RESULT."""
        raise NotImplementedError

    def _terminate(self, params: tuple[float, ...], _frame: Frame) -> int:
        if params[0] >= 0.5:
            self.disarm()
        return ACCEPTED

    def _reboot_command(self, params: tuple[float, ...], frame: Frame) -> int | None:
        if params[0] not in (1.0, 3.0) or self.armed:
            return DENIED
        self.ack(246, ACCEPTED, frame)
        self.world.reboot(self.index)
        return None

    def _set_home(self, params: tuple[float, ...], _frame: Frame) -> int:
        world, i = self.world, self.index
        if not self.has_position:
            return DENIED
        if params[0] == 1.0:
            world.home_enu_m[:, i] = self.pos_est()
        else:
            lat, lon, alt = params[4:7]
            if not is_place(lat, lon, alt):
                return DENIED
            world.home_enu_m[:, i] = world.geodesy.enu_from_geodetic(lat, lon, alt)
        world.send_now(i, "HOME_POSITION")
        return ACCEPTED

    # -- ground and air -----------------------------------------------------------------------------------------

    def _detect_landing(self, now_ns: int) -> None:
        dynamics, i = self.world.dynamics, self.index
        if self.landed:
            height = dynamics.pos_enu_m[2, i] - dynamics.ground_m[i]
            if self.armed and height > _LIFTED_M:
                self.landed = False
                self.taken_off = True
                self._contact_since_ns = None
            return
        if not dynamics.on_ground[i] or (self.armed and not self.wants_down()):
            self._contact_since_ns = None
            return
        if self._contact_since_ns is None:
            self._contact_since_ns = now_ns
        contact_ns = self.world.profile_of(self.index).land_contact_s * SECOND
        if now_ns - self._contact_since_ns >= contact_ns or not self.armed:
            self.landed, self.landed_ns = True, now_ns
            self.set_flying(False)
            self.touched_down()

    def touched_down(self) -> None:
        """Called when the land detector has decided."""
