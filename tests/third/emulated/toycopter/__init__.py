"""The emulated toycopter: it stands, follows velocities, or lands; it has one message of its own."""

from __future__ import annotations

import math

from groundstation.mavlink.codec import Frame, StructuredArray
from sitl.autopilot import Autopilot
from sitl.body import Body
from sitl.config import VehicleConfig
from sitl.mavlink_ids import ACCEPTED, DENIED, MSG_SET_POSITION_TARGET_LOCAL_NED, UNSUPPORTED
from sitl.messages import IntArray, Message, message, rows_of, times_ms
from sitl.mission import MissionEnd
from sitl.outfit import Outfit
from sitl.params import REAL32, ParamSet
from sitl.personality import Personality, StartUp
from sitl.setpoints import NOTHING, Setpoint, heading
from sitl.state import State
from sitl.telemetry import View
from sitl.wire import Fields, whole

STAND, FOLLOW, LAND = range(3)
OWN_MESSAGES: dict[str, Message] = {}


@message(OWN_MESSAGES)
def _debug_vect(state: State, _view: View, vehicles: IntArray) -> StructuredArray:
    out = rows_of("DEBUG_VECT", vehicles)
    out["name"] = b"toy"
    out["x"] = times_ms(state, vehicles)
    return out


class Toycopter(Autopilot):
    """One vehicle."""

    mav_autopilot = 18

    def __init__(self, body: Body, config: VehicleConfig, outfit: Outfit) -> None:
        super().__init__(body, config, outfit)
        self.mode = STAND
        self.messages[MSG_SET_POSITION_TARGET_LOCAL_NED] = self._on_setpoint
        self.commands[176] = self._mode_command

    def mode_name(self) -> str:
        return ("STAND", "FOLLOW", "LAND")[self.mode]

    def base_mode(self) -> int:
        return 0x1 | (0x80 if self.armed else 0)

    def custom_mode(self) -> int:
        return self.mode

    def system_status(self) -> int:
        return 4 if self.armed else 3

    def sensor_bits(self) -> tuple[int, int, int]:
        return 0x10000020, 0x20, 0x10000020

    def arm_refusal(self) -> str | None:
        return None if self.ready and self.mode != LAND else "not yet"

    def try_arm(self, forced: bool) -> int:
        if self.arm_refusal() is not None and not forced:
            return DENIED
        self.arm()
        return ACCEPTED

    def try_disarm(self, forced: bool) -> int:
        if not forced and not self.landed:
            return DENIED
        self.disarm()
        return ACCEPTED

    def _mode_command(self, params: tuple[float, ...], _frame: Frame) -> int:
        if whole(params[1]) not in (STAND, FOLLOW, LAND):
            return UNSUPPORTED
        self.mode = whole(params[1])
        return ACCEPTED

    def _on_setpoint(self, fields: Fields, _frame: Frame) -> None:
        north, east, down = (fields[name] for name in ("vx", "vy", "vz"))
        if all(map(math.isfinite, (north, east, down))):
            self.setpoint = Setpoint(self.body.now_ns, NOTHING, (east, north, -down), *heading(fields))

    def _climb_m_s(self) -> float:
        if self.mode == LAND:
            return -0.5
        up = self.setpoint.vel_enu_m_s[2] if self.mode == FOLLOW and self.setpoint is not None else None
        return up or 0.0

    def wants_up(self) -> bool:
        return self._climb_m_s() > 0.05

    def wants_down(self) -> bool:
        return self._climb_m_s() < -0.05

    def update(self, now_ns: int) -> None:
        if not self.armed:
            return
        if self.landed and self.mode == LAND and now_ns - self.landed_ns > 1_000_000_000:
            self.disarm()
            return
        if self.landed and self.wants_up():
            self.body.motors.flying = True
        point = self.setpoint
        if self.mode == FOLLOW and point is not None:
            self.body.motors.command(NOTHING, point.vel_enu_m_s, point.yaw_enu_rad, point.yaw_rate_rad_s)
        else:
            self.body.motors.command(NOTHING, (0.0, 0.0, self._climb_m_s()))

    def acts_alone(self) -> bool:
        return self.mode == LAND

    def mission_ends(self, end: MissionEnd) -> None:
        self.mode = LAND

    def vision_enabled(self) -> bool:
        return False


def parameters(_sysid: int) -> ParamSet:
    return ParamSet({"TOY_SPEED": (1.0, REAL32)})


_START = StartUp(*((0.1 * k, 0.1 * k) for k in range(1, 7)))
PERSONALITY = Personality(
    name="toycopter",
    autopilot=Toycopter,
    parameters=parameters,
    quick_start=_START,
    real_start=_START,
    profile="crazyflie",
    streams="toy",
    rates_hz={"toy": {"HEARTBEAT": 1.0, "SYS_STATUS": 2.0, "EXTENDED_SYS_STATE": 5.0, "DEBUG_VECT": 10.0}},
    messages=OWN_MESSAGES,
)
