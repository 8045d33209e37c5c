"""How each mode flies: takeoff, hold, landing, the way home, setpoints.

Refuses to choose the mode: the commander does. Only a takeoff that is over goes on by itself, to holding.
"""

from __future__ import annotations

import math

from sitl.autopilot import Autopilot
from sitl.config import SECOND
from sitl.frames import is_place
from sitl.personalities.px4.commander import Commander
from sitl.personalities.px4.modes import CRITICAL, INFO, LAND, LOITER, MISSION, OFFBOARD, POSCTL, RTL, TAKEOFF
from sitl.setpoints import NOTHING

_SINK_M_S = 0.6  # 0.55 to 0.65 were seen
Place = tuple[float, float, float]
_UP, _ACROSS, _DOWN, _WAITING = range(4)


class Navigator:
    """One vehicle's."""

    def __init__(self, pilot: Autopilot, commander: Commander) -> None:
        self._pilot, self._commander = pilot, commander
        self._hold: Place = (0.0, 0.0, 0.0)
        self._takeoff_to: Place | None = None
        self._stage = _UP
        self._above_home_ns = 0

    @property
    def comes_down(self) -> bool:
        """Whether the mode that acts pushes to the ground at its end."""
        mode = self._commander.mode
        return mode == LAND or (mode == RTL and self._stage == _DOWN)

    def aim(self, lat_deg: float = math.nan, lon_deg: float = math.nan, alt_amsl_m: float = math.nan) -> None:
        """Works out where a takeoff ends; heights below MIS_TAKEOFF_ALT are raised to it, as PX4 does."""
        pilot, body = self._pilot, self._pilot.body
        usual_m = pilot.params["MIS_TAKEOFF_ALT"]
        x, y, z = body.senses.pos_enu_m
        lowest = (z if pilot.landed else body.senses.home_enu_m[2]) + usual_m
        if not abs(alt_amsl_m) <= 100_000.0:  # NaN, most of all: "as usual"
            pilot.voice.text(INFO, f"Using default takeoff altitude: {usual_m:.2f} m\t")
            top = lowest
        else:
            top = alt_amsl_m - body.home_alt_m
            if top < lowest - 0.1:
                pilot.voice.text(CRITICAL, f"Using minimum takeoff altitude: {usual_m:.2f} m\t")
            top = max(top, lowest)
        if is_place(lat_deg, lon_deg, 0.0):
            x, y, _ = body.geodesy.enu_from_geodetic(lat_deg, lon_deg, body.home_alt_m).tolist()
        self._takeoff_to = x, y, max(top, z)

    def aim_as_usual(self) -> None:
        """The same for a takeoff that was asked for by its mode alone."""
        if self._takeoff_to is None:
            self.aim()

    def go_to(self, place: Place) -> None:
        """Holds at a place from now on."""
        self._commander.entered, self._hold = LOITER, place
        self._pilot.body.motors.command(place, NOTHING)

    def fly_setpoint(self) -> None:
        """Follows the last setpoint."""
        point = self._pilot.setpoint
        if point is not None:
            self._pilot.body.motors.command(point.pos_enu_m, point.vel_enu_m_s, point.yaw_enu_rad, point.yaw_rate_rad_s)

    def act(self) -> None:
        """Lets the mode act; called every tick in the air."""
        commander = self._commander
        mode = commander.mode
        entering = commander.entered != mode
        commander.entered = mode
        if mode == OFFBOARD:
            if entering:
                self.fly_setpoint()
        elif mode == TAKEOFF:
            self._take_off(entering)
        elif mode == LAND:
            self._land(entering)
        elif mode == RTL:
            self._return(entering)
        elif mode == MISSION:
            self._pilot.mission_flight.act(entering)
        elif entering:
            self._stay()

    def _stay(self) -> None:
        motors = self._pilot.body.motors
        x, y, z = self._hold = self._pilot.body.senses.pos_enu_m
        motors.limit_speed()
        if self._commander.failsafe == POSCTL:  # the throttle stick that is not there counts as pulled down
            motors.command((x, y, None), (None, None, -_SINK_M_S))
        else:
            motors.command((x, y, z), NOTHING)

    def _take_off(self, entering: bool) -> None:
        senses, motors = self._pilot.body.senses, self._pilot.body.motors
        target = self._takeoff_to or senses.pos_enu_m
        if entering:
            motors.limit_speed(up=self._pilot.params["MPC_TKO_SPEED"])
            motors.command(target, NOTHING)
        x, y, z = senses.pos_enu_m
        start = senses.ground_m
        if not self._pilot.landed and z > target[2] - min(0.8, 0.2 * (target[2] - start)):
            # the altitude counts as reached within NAV_MC_ALT_RAD; Hold keeps the takeoff's altitude
            self._takeoff_to = None
            self._commander.intend(LOITER)
            self.go_to((x, y, target[2]))

    def _land(self, entering: bool) -> None:
        body, params = self._pilot.body, self._pilot.params
        x, y, z = body.senses.pos_enu_m
        if entering:
            self._hold = (x, y, z)
            body.motors.limit_speed()
        height = z - body.senses.home_enu_m[2]
        slow, fast = params["MPC_LAND_SPEED"], params["MPC_Z_V_AUTO_DN"]
        share = min(max((height - 5.0) / 5.0, 0.0), 1.0)  # MPC_LAND_ALT2 and MPC_LAND_ALT1
        speed = min(slow + share * (fast - slow), body.profile.manners.speed_down_max_m_s)
        if height < body.profile.manners.crawl_below_m:
            speed = min(speed, body.profile.manners.crawl_m_s)
        body.motors.command((self._hold[0], self._hold[1], None), (None, None, -speed))

    def _return_height(self, z: float, home_z: float, far: float) -> float:
        """Height of the way back: a cone around home where RTL_CONE_ANG says so, never below the present height."""
        params = self._pilot.params
        highest = home_z + params["RTL_RETURN_ALT"]
        cone_deg = params["RTL_CONE_ANG"]
        if cone_deg <= 0:
            return max(z, highest)
        near = params["NAV_ACC_RAD"]
        if far <= near:
            wanted = home_z + 2.0 * far
        else:
            wanted = highest
            if far <= params["RTL_MIN_DIST"]:
                wanted = min(home_z + far / math.tan(math.radians(min(max(cone_deg, 1.0), 89.0))), highest)
            wanted = max(wanted, home_z + 2.0 * near)
        return z if wanted < z else min(wanted, highest)

    def _return(self, entering: bool) -> None:
        body, params = self._pilot.body, self._pilot.params
        x, y, z = body.senses.pos_enu_m
        home = body.senses.home_enu_m
        far = math.hypot(x - home[0], y - home[1])
        if entering:
            self._stage = _UP
            self._hold = (x, y, self._return_height(z, home[2], far))
            body.motors.limit_speed()
        if self._stage == _UP and abs(z - self._hold[2]) < 0.5:
            self._stage = _ACROSS
            self._hold = (home[0], home[1], self._hold[2])
        if self._stage == _ACROSS and far < 0.5:
            waits = params["RTL_LAND_DELAY"] != 0.0
            self._stage = _WAITING if waits else _DOWN
            self._above_home_ns = body.now_ns
            self._hold = (home[0], home[1], min(z, home[2] + params["RTL_DESCEND_ALT"]) if waits else z)
        if self._stage == _WAITING:
            delay_s = params["RTL_LAND_DELAY"]
            if abs(z - self._hold[2]) > 0.8:  # NAV_MC_ALT_RAD; the wait begins at RTL_DESCEND_ALT
                self._above_home_ns = body.now_ns
            elif 0.0 <= delay_s <= (body.now_ns - self._above_home_ns) / SECOND:
                self._stage, self._hold = _DOWN, (home[0], home[1], z)
        if self._stage == _DOWN:
            self._land(False)
        else:
            body.motors.command(self._hold, NOTHING)
