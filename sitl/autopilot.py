"""What all personalities share: power-up, arming state, lift-off and touch-down, setpoints turned into commands.

One object per vehicle; ``tick`` is called every 20 ms of simulated time, message handlers in between. Refuses to
move anything itself, and to know the world: it has its ``Body``.
"""

from __future__ import annotations

from groundstation.mavlink.codec import Frame
from sitl.battery import Battery
from sitl.body import Body
from sitl.config import SECOND, VehicleConfig
from sitl.frames import is_place
from sitl.mavlink_ids import ACCEPTED, DENIED, UNSUPPORTED
from sitl.mission import MissionFlight
from sitl.outfit import Outfit
from sitl.protocol import Conversation
from sitl.setpoints import NOTHING, Setpoint
from sitl.traits import Traits
from sitl.vision import Vision
from sitl.wire import whole

FORCE_MAGIC = 21196
LANDED, IN_AIR, TAKING_OFF, LANDING = 1, 2, 3, 4
_LIFTED_M = 0.03


class Autopilot(Conversation, Traits):
    """One vehicle's flight state.

    Attributes:
        armed, armed_ns: whether, and since when.
        landed, landed_ns: as the land detector says, and since when.
        taken_off: has been in the air since arming.
        setpoint: the last valid one.
        battery: its battery.
    """

    def __init__(self, body: Body, config: VehicleConfig, outfit: Outfit) -> None:
        super().__init__(body, config, outfit)
        self.boot, self._rates_hz = outfit.boot, outfit.rates_hz
        self.boot_ns = body.now_ns
        self.armed, self.armed_ns = False, 0
        self.landed, self.landed_ns = True, body.now_ns
        self.taken_off = False
        self.setpoint: Setpoint | None = None
        self.deny_arming = False
        self.vision: Vision | None = None
        self._beating = False
        self._contact_since_ns: int | None = None
        endurance = body.profile.frame.hover_endurance_s
        self.mission_flight = MissionFlight(self)
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

    def landed_state(self) -> int:
        """MAV_LANDED_STATE."""
        return LANDED if self.landed else IN_AIR

    def vision_has_origin(self) -> bool:
        """Whether positions from outside may be used already."""
        return self.body.senses.has_origin or not self.vision_needs_origin

    # -- time ---------------------------------------------------------------------------------------------------

    @property
    def age_ns(self) -> int:
        """Time since power-up."""
        return self.body.now_ns - self.boot_ns

    @property
    def has_position(self) -> bool:
        """Whether the estimator has a position."""
        return self.body.senses.has_position

    @property
    def ready(self) -> bool:
        """Whether the prearm checks pass."""
        return self.age_ns >= self.boot.ready_ns and self.position_good

    @property
    def position_good(self) -> bool:
        """Whether the estimator has a position that can be flown by."""
        return self.body.senses.position_good

    def tick(self, now_ns: int, dt_s: float) -> None:
        """Runs everything that does not wait for a message, every 20 ms."""
        body = self.body
        if not body.link.talking and self.age_ns >= self.boot.stream_ns:
            body.link.talking = True
            body.link.set_rates({**self._rates_hz, "HEARTBEAT": 0.0})
            self.started()
        if not self._beating and self.age_ns >= self.boot.heartbeat_ns:
            self._beating = True
            body.link.set_interval("HEARTBEAT", SECOND)
            body.link.send_now("HEARTBEAT")
        if not body.senses.has_position:
            self._look_for_position()
        if self.vision is not None:
            self.vision.tick(now_ns)
        self.battery.drain(body.motors.thrust_m_s2 / 9.80665 * self.armed, dt_s)
        body.motors.power(self.battery.left > 0.0)
        if self.param_server.waiting:
            self.param_server.send_queued()
        if self.mission.uploading:
            self.mission.ask_again()
        self._detect_landing(now_ns)
        self.update(now_ns)

    def _look_for_position(self) -> None:
        if not self.body.senses.has_gps:
            return
        if not self.body.senses.has_origin and self.age_ns >= self.boot.origin_ns:
            self.origin_found()
        if self.age_ns >= self.boot.position_ns:
            self.position_found()

    def origin_found(self) -> None:
        """Called when the estimator takes the place where it stands for its origin."""
        self.body.senses.set_origin()

    def position_found(self) -> None:
        """Called when the estimator has found its position."""
        if not self.body.senses.has_origin:
            self.origin_found()
        self.body.senses.has_position = True
        if self.landed:
            self.body.senses.set_home(self.body.senses.pos_enu_m)

    # -- arming -------------------------------------------------------------------------------------------------

    def arm(self) -> None:
        """Arms; whoever calls has checked."""
        now_ns = self.body.now_ns
        self.armed, self.armed_ns, self.taken_off = True, now_ns, False
        if self.landed:
            self.body.senses.set_home(self.body.senses.pos_enu_m)
            self.body.motors.command(NOTHING, NOTHING)

    def disarm(self) -> None:
        """Stops the motors at once, wherever the vehicle is."""
        self.armed = self.taken_off = False
        self.body.motors.stop()

    def _arm_command(self, params: tuple[float, ...], _frame: Frame) -> int:
        if params[0] not in (0.0, 1.0):
            return UNSUPPORTED
        forced = whole(params[1]) == FORCE_MAGIC
        if params[0] == 1.0:
            return self.try_arm(forced)
        return self.try_disarm(forced)

    def _terminate(self, params: tuple[float, ...], _frame: Frame) -> int:
        if params[0] >= 0.5:
            self.disarm()
        return ACCEPTED

    def _reboot_command(self, params: tuple[float, ...], frame: Frame) -> int | None:
        if params[0] not in (1.0, 3.0) or self.armed:
            return DENIED
        self.voice.ack(246, ACCEPTED, frame)
        self.body.reboot()
        return None

    def _set_home(self, params: tuple[float, ...], _frame: Frame) -> int:
        body = self.body
        if not self.has_position:
            return DENIED
        if params[0] == 1.0:
            body.senses.set_home(body.senses.pos_enu_m)
        else:
            lat, lon, alt = params[4:7]
            if not is_place(lat, lon, alt):
                return DENIED
            body.senses.set_home(body.geodesy.enu_from_geodetic(lat, lon, alt))
        body.link.send_now("HOME_POSITION")
        return ACCEPTED

    # -- ground and air -----------------------------------------------------------------------------------------

    def _detect_landing(self, now_ns: int) -> None:
        if self.landed:
            if self.armed and self.body.senses.above_ground_m > _LIFTED_M:
                self.landed = False
                self.taken_off = True
                self._contact_since_ns = None
            return
        if not self.body.senses.on_ground or (self.armed and not self.wants_down()):
            self._contact_since_ns = None
            return
        if self._contact_since_ns is None:
            self._contact_since_ns = now_ns
        contact_ns = self.body.profile.manners.land_contact_s * SECOND
        if now_ns - self._contact_since_ns >= contact_ns or not self.armed:
            self.landed, self.landed_ns = True, now_ns
            self.body.motors.flying = False
            self.touched_down()
