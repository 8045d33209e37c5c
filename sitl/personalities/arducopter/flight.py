"""Which mode ArduCopter is in, and how each flies: takeoff, GUIDED and its time-out, landing, the way home.

Modes that need sticks hold the position in the air: nobody is there to move them.
"""

from __future__ import annotations

import math

from sitl.autopilot import Autopilot
from sitl.config import SECOND
from sitl.mavlink_ids import ACCEPTED, FAILED
from sitl.personalities.arducopter.modes import (
    AUTO,
    GUIDED,
    LAND,
    NAMES,
    NEED_POSITION,
    RTL,
    SMART_RTL,
    STABILIZE,
    WARNING,
)
from sitl.setpoints import NOTHING, Setpoint

_ARMING_NS, _SPOOL_NS = 2 * SECOND, round(1.4 * SECOND)  # after arming; after that, or after the takeoff command
_UP, _ACROSS, _DOWN, _WAITING = range(4)


class Flight:
    """One vehicle's.

    Attributes:
        mode: flight mode number.
        taking_off_to: height above home of a takeoff under way, None while there is none.
    """

    def __init__(self, pilot: Autopilot) -> None:
        self._pilot = pilot
        self.mode = STABILIZE
        self.taking_off_to: float | None = None
        self._asked_up_ns = 0
        self._entered: int | None = None
        self._hold: tuple[float, float, float] = (0.0, 0.0, 0.0)
        self._stage = _UP
        self._above_home_ns = 0
        self._braked = False

    @property
    def landing(self) -> bool:
        """Whether it comes down to stay there."""
        return self.mode == LAND or (self.mode in (RTL, SMART_RTL) and self._stage == _DOWN)

    @property
    def wants_up(self) -> bool:
        """Only a takeoff lifts off: an upward velocity alone does not."""
        return self.taking_off_to is not None or (self.mode == AUTO and bool(self._pilot.mission))

    def may_lift(self, now_ns: int) -> bool:
        """Whether it wants to, and the motors have spun up."""
        return self.wants_up and now_ns - max(self._pilot.armed_ns + _ARMING_NS, self._asked_up_ns) >= _SPOOL_NS

    def change(self, mode: int) -> int:
        """Changes the mode. Returns the MAV_RESULT."""
        pilot = self._pilot
        if mode not in NAMES:
            pilot.voice.text(WARNING, f"No such mode {mode}")
            return FAILED
        if pilot.age_ns < pilot.boot.deaf_ns:
            return ACCEPTED  # seen: acknowledged in the first seconds, and never in effect
        # Disarmed it takes any mode, as was seen 4 s after start; arming then asks for the position.
        if mode in NEED_POSITION and pilot.armed and not pilot.position_good:
            pilot.voice.text(WARNING, f"Mode change to {NAMES[mode]} failed: requires position")
            return FAILED
        if mode == AUTO and not pilot.mission:
            pilot.voice.text(WARNING, "Mode change to AUTO failed: init failed")
            return FAILED
        if mode != self.mode:
            self.begin()
            pilot.setpoint = None
        self.mode = mode
        return ACCEPTED

    def begin(self) -> None:
        """Whatever acts next begins anew; no takeoff is under way."""
        self._entered = self.taking_off_to = None

    def enter(self) -> None:
        """Whatever acts next begins anew."""
        self._entered = None

    def take_off(self, height_m: float) -> None:
        """Climbs to a height above home."""
        self.taking_off_to = height_m
        self._asked_up_ns = self._pilot.body.now_ns
        self._entered = None

    def go_to(self, x: float, y: float, z: float) -> None:
        """Flies to a place, in GUIDED."""
        pilot = self._pilot
        self._entered, self.taking_off_to = GUIDED, None
        pilot.body.motors.limit_speed()
        pilot.setpoint = Setpoint(pilot.body.now_ns, (x, y, z), NOTHING, None, None)
        self._fly_setpoint(pilot.setpoint)

    def follow(self, point: Setpoint | None) -> None:
        """Follows a setpoint; None brakes and holds, staying in GUIDED."""
        pilot = self._pilot
        pilot.setpoint = point
        if not pilot.armed or pilot.landed:
            return
        if point is None:
            pilot.body.motors.command(NOTHING, NOTHING)
        else:
            self._entered = GUIDED
            self._fly_setpoint(point)

    def _fly_setpoint(self, point: Setpoint) -> None:
        self._braked = False
        self._pilot.body.motors.command(point.pos_enu_m, point.vel_enu_m_s, point.yaw_enu_rad, point.yaw_rate_rad_s)

    def act(self, now_ns: int) -> None:
        """Lets the mode act; called every tick in the air."""
        entering = self._entered != self.mode
        self._entered = self.mode
        if self.mode == GUIDED:
            self._guided(entering, now_ns)
        elif self.mode == LAND:
            self._land(entering)
        elif self.mode in (RTL, SMART_RTL):
            self._return(entering)
        elif self.mode == AUTO:
            self._pilot.mission_flight.act(entering)
        elif entering:
            body = self._pilot.body
            self._hold = body.senses.pos_enu_m
            body.motors.limit_speed()
            body.motors.command(self._hold, NOTHING)

    def _guided(self, entering: bool, now_ns: int) -> None:
        pilot, body = self._pilot, self._pilot.body
        x, y, z = body.senses.pos_enu_m
        if self.taking_off_to is not None:
            top = body.senses.home_enu_m[2] + self.taking_off_to
            if entering:
                self._hold = (x, y, top)
                body.motors.limit_speed(up=pilot.params["WPNAV_SPEED_UP"] / 100.0)
                body.motors.command(self._hold, NOTHING)
            if not pilot.landed and z > top - 0.1:
                self.taking_off_to = None
            return
        if entering:
            self._hold = (x, y, z)
            body.motors.limit_speed()
            if pilot.setpoint is None:
                body.motors.command(self._hold, NOTHING)
        point = pilot.setpoint
        if point is None or point.pos_enu_m[0] is not None or self._braked:
            return
        if now_ns - point.t_ns > pilot.params["GUID_TIMEOUT"] * SECOND:
            self._braked = True  # the last velocity has been kept until now; brakes and hovers, no word of it
            body.motors.command(NOTHING, NOTHING)

    def _land(self, entering: bool) -> None:
        body, params = self._pilot.body, self._pilot.params
        x, y, z = body.senses.pos_enu_m
        if entering:
            self._hold = (x, y, z)
            body.motors.limit_speed()
        height = z - body.senses.home_enu_m[2]
        fast = params["LAND_SPEED_HIGH"] or params["WPNAV_SPEED_DN"]
        speed = (fast if height > params["LAND_ALT_LOW"] / 100.0 else params["LAND_SPEED"]) / 100.0
        speed = min(speed, body.profile.manners.speed_down_max_m_s)
        body.motors.command((self._hold[0], self._hold[1], None), (None, None, -speed))

    def _return(self, entering: bool) -> None:
        body, params = self._pilot.body, self._pilot.params
        x, y, z = body.senses.pos_enu_m
        home = body.senses.home_enu_m
        far = math.hypot(x - home[0], y - home[1])
        if entering:
            self._stage = _UP
            climbs = far > 1.0 or params["RTL_CONE_SLOPE"] == 0.0
            top = max(z, home[2] + params["RTL_ALT"] / 100.0) if climbs else z
            self._hold = (x, y, top)
            body.motors.limit_speed()
        if self._stage == _UP and abs(z - self._hold[2]) < 0.5:
            self._stage, self._hold = _ACROSS, (home[0], home[1], self._hold[2])
        if self._stage == _ACROSS and far < 0.5:
            self._stage, self._above_home_ns = _WAITING, body.now_ns
        if self._stage == _WAITING and body.now_ns - self._above_home_ns >= params["RTL_LOIT_TIME"] * 1e6:
            self._stage, self._hold = _DOWN, (home[0], home[1], z)
        if self._stage == _DOWN:
            self._land(False)
        else:
            body.motors.command(self._hold, NOTHING)
