"""The Crazyflie's own firmware: packets in, packets out, motors by the commander as far as the supervisor lets it.

Refuses to speak MAVLink: of what it inherits it uses the body, the battery, the arming state and the land detector.
"""

from __future__ import annotations

from sitl.autopilot import Autopilot
from sitl.body import Body
from sitl.config import VehicleConfig
from sitl.mavlink_ids import ACCEPTED, DENIED
from sitl.mission import MissionEnd
from sitl.outfit import Outfit
from sitl.personalities.crazyflie.commander import Commander
from sitl.personalities.crazyflie.crtp import LOG, NULL, read, write
from sitl.personalities.crazyflie.desk import Desk
from sitl.personalities.crazyflie.poses import Poses
from sitl.personalities.crazyflie.supervisor import Situation, Stage, Supervisor
from sitl.setpoints import Setpoint

_MS = 1_000_000


class Crazyflie(Autopilot):
    """One vehicle.

    Attributes:
        commander, supervisor, poses: its parts.
        packets_in: how many packets it has been sent.
    """

    mav_autopilot = 0

    def __init__(self, body: Body, config: VehicleConfig, outfit: Outfit) -> None:
        super().__init__(body, config, outfit)
        self.commander, self.supervisor = Commander(), Supervisor()
        self.poses = Poses(body, config.sysid & 0xFF)
        self.packets_in = 0
        self._desk = Desk(self)
        body.link.talking = outfit.boot.stream_ns == 0  # a client over UDP asks once: nothing may be lost at the start

    # -- packets ------------------------------------------------------------------------------------------------

    def datagram(self, data: bytes) -> None:
        """Takes one CRTP packet and answers it."""
        packet = read(data)
        if packet is None:
            return
        self.packets_in += 1
        if data[0] & 0xF3 == 0xF3:  # the null packet, whatever its middle bits
            self.body.link.emit(NULL)
            return
        answer = self._desk.answer(packet)
        if answer is not None:
            self.body.link.emit(write(packet.port, packet.channel, answer))

    # -- time ---------------------------------------------------------------------------------------------------

    def tick(self, now_ns: int, dt_s: float) -> None:
        """Runs everything that does not wait for a packet, every 20 ms."""
        body = self.body
        body.link.talking = self.age_ns >= self.boot.stream_ns
        if not body.senses.has_position and body.senses.has_gps and self.age_ns >= self.boot.position_ns:
            body.senses.set_origin((0.0, 0.0, 0.0))
            body.senses.has_position = True
        self.poses.tick(now_ns, dt_s)
        self.battery.drain(body.motors.thrust_m_s2 / 9.80665 * self.armed, dt_s)
        body.motors.power(self.battery.left > 0.0)
        self._detect_landing(now_ns)
        self.update(now_ns)
        for data in self._desk.logs.due(now_ns, body.own_time_ns):
            body.link.emit(write(LOG, 2, data))

    def update(self, now_ns: int) -> None:
        """Lets the commander and the supervisor act."""
        supervisor, commander = self.supervisor, self.commander
        commander.update(now_ns)
        supervisor.high_level = commander.high.bits(now_ns)
        supervisor.step(_situation(self, now_ns), now_ns)
        if supervisor.armed != self.armed:
            if supervisor.armed:
                self.arm()
            else:
                self.disarm()
        ready = supervisor.stage in (Stage.READY, Stage.LANDED)
        self.stands_ready = supervisor.auto_armed and ready and not self.body.motors.flying
        point = commander.setpoint
        if not supervisor.may_fly or point is None:
            if self.body.motors.flying:
                self.body.motors.stop()
            return
        if self.landed and self.wants_up():
            self.body.motors.flying = True
        if supervisor.stage is Stage.LEVEL_OUT:
            _level_out(self, point)
        else:
            self.body.motors.command(point.pos_enu_m, point.vel_enu_m_s, point.yaw_enu_rad, point.yaw_rate_rad_s)

    # -- as the rest of the emulator asks -----------------------------------------------------------------------

    def mode_name(self) -> str:
        """Name of the stage, for people."""
        return self.supervisor.stage.name

    def base_mode(self) -> int:
        """Whether it is armed, as MAVLink would say it."""
        return 0x80 if self.armed else 0

    def custom_mode(self) -> int:
        """Number of the supervisor's stage."""
        return list(Stage).index(self.supervisor.stage)

    def system_status(self) -> int:
        """MAV_STATE, as MAVLink would say it."""
        return 4 if self.armed else 3

    def sensor_bits(self) -> tuple[int, int, int]:
        """None: it speaks no MAVLink."""
        return 0, 0, 0

    def acts_alone(self) -> bool:
        """Whether it is flown by the watchdog of its setpoints."""
        return self.supervisor.stage in (Stage.LEVEL_OUT, Stage.FREE_FALL)

    def arm_refusal(self) -> str | None:
        """Why arming is refused, None when it is not; it gives no words."""
        return None if self.supervisor.stage is Stage.CHECKS_PASS and not self.deny_arming else ""

    def try_arm(self, forced: bool) -> int:
        """Arms on request."""
        return ACCEPTED if self._desk.ask_arm(True) else DENIED

    def try_disarm(self, forced: bool) -> int:
        """Disarms on request."""
        return ACCEPTED if self._desk.ask_arm(False) else DENIED

    def wants_up(self) -> bool:
        """Whether what is flown leads off the ground."""
        point = self.commander.setpoint
        if point is None or self.commander.lands():
            return False
        climb, height = point.vel_enu_m_s[2] or 0.0, point.pos_enu_m[2]
        return climb > 0.05 or (height is not None and height > self.body.senses.pos_enu_m[2] + 0.05)

    def wants_down(self) -> bool:
        """Whether what is flown leads to the ground, or the motors are to stand."""
        return self.commander.lands()

    def vision_enabled(self) -> bool:
        """MAVLink brings it no positions."""
        return False

    def mission_ends(self, end: MissionEnd) -> None:
        """It flies no missions of its own."""


def _situation(vehicle: Crazyflie, now_ns: int) -> Situation:
    senses, params = vehicle.body.senses, vehicle.params
    return Situation(
        ready=vehicle.age_ns >= vehicle.boot.ready_ns,
        auto_arm=params["system.autoArm"] > 0.0 and not vehicle.deny_arming,
        thrust=vehicle.body.motors.flying and vehicle.commander.setpoint is not None,
        setpoint_age_ns=now_ns - vehicle.commander.heard_ns,
        on_ground=senses.on_ground,
        up=senses.up_enu[2],
        wrecked=senses.wrecked,
        checks_tumbling=params["supervisor.tmblChckEn"] > 0.0,
        landed_timeout_ns=int(params["supervisor.landedTimeout"]) * _MS,
        preflight_timeout_ns=int(params["supervisor.prefltTimeout"]) * _MS,
    )


def _level_out(vehicle: Crazyflie, point: Setpoint) -> None:
    """No tilt, heading kept: it goes on as it went, slowed by the air; the height as it was asked for last."""
    frame, loops = vehicle.body.profile.frame, vehicle.body.profile.loops
    share = 1.0 - 2.0 * frame.drag_per_s / loops.kp_xy_per_s
    x, y, _ = vehicle.body.senses.vel_enu_m_s
    height, climb = point.pos_enu_m[2], point.vel_enu_m_s[2]
    vehicle.body.motors.command((None, None, height), (share * x, share * y, climb), None, 0.0)
