"""What is wanted, what may be, and what has to happen instead: modes, arming checks, failsafes.

Refuses to fly: the navigator does.
"""

from __future__ import annotations

from sitl.autopilot import Autopilot
from sitl.config import SECOND
from sitl.mavlink_ids import ACCEPTED, TEMPORARILY_REJECTED
from sitl.personalities.px4.modes import (
    CRITICAL,
    INFO,
    LAND,
    LOITER,
    MISSION,
    NEED_POSITION,
    OFFBOARD,
    POSCTL,
    PREVENT_ARMING,
    RTL,
    WARNING,
    Mode,
)
from sitl.wire import whole

_NAMES = {OFFBOARD: "Offboard", MISSION: "Mission"}
_OFFBOARD_LOST = {3: RTL, 4: LAND, 5: LOITER}  # COM_OBL_RC_ACT; others fly by sticks that are not there
_MOTORS_OFF = (6, 7)
_HEARTBEAT_MISSED_NS = round(2.5 * SECOND)  # after the last one: only from there on the link counts as lost
_SLOW_CHECKS = 5  # what need not be looked at every 20 ms
_BATTERY_LEVELS = (
    ("BAT_LOW_THR", WARNING, "Low battery level, return advised\t"),
    ("BAT_CRIT_THR", CRITICAL, "Critical battery level, return now\t"),
    ("BAT_EMERGEN_THR", CRITICAL, "Dangerous battery level, land now\t"),
)


class Commander:
    """One vehicle's.

    Attributes:
        intention: the mode that the user asked for; it outlives failsafes.
        failsafe: the mode that acts instead of it, None while there is none.
        entered: the mode that has begun to act; None when whatever acts next begins anew.
    """

    def __init__(self, pilot: Autopilot) -> None:
        self._pilot = pilot
        self.intention: Mode = LOITER
        self.failsafe: Mode | None = None
        self.entered: Mode | None = None
        self._after_flight: Mode = LOITER
        self._until_setpoints = False
        self._battery_told = 0
        self._ticks = 0

    @property
    def mode(self) -> Mode:
        """The mode that acts, and is shown."""
        return self.failsafe or self.intention

    def intend(self, mode: Mode) -> None:
        """Keeps what the user wants; the last of it in which arming is possible is wanted again after the flight."""
        self.intention = mode
        if mode not in PREVENT_ARMING:
            self._after_flight = mode

    def change(self, mode: Mode) -> int:
        """Changes the mode as a user asks. Returns the MAV_RESULT."""
        pilot = self._pilot
        flying = pilot.armed and not pilot.landed
        if flying and ((mode == OFFBOARD and not self.setpoint_alive()) or (mode == MISSION and not pilot.mission)):
            pilot.voice.text(CRITICAL, f"Switching to mode '{_NAMES[mode]}' is currently not possible\t")
            return TEMPORARILY_REJECTED
        if flying and mode in NEED_POSITION and not pilot.has_position:
            return TEMPORARILY_REJECTED
        self.intend(mode)
        self.failsafe = self.entered = None
        return ACCEPTED

    def setpoint_alive(self) -> bool:
        """Whether the last setpoint is younger than COM_OF_LOSS_T."""
        pilot = self._pilot
        point = pilot.setpoint
        return point is not None and pilot.body.now_ns - point.t_ns <= pilot.params["COM_OF_LOSS_T"] * SECOND

    def arm_refusal(self) -> str | None:
        """Why arming would be refused; without words as often as not."""
        pilot = self._pilot
        if pilot.deny_arming:
            return "Preflight Fail: Sensor 0 missing"
        if pilot.battery.left < pilot.params["BAT_CRIT_THR"]:
            return "Preflight Fail: Critical battery level"
        if not pilot.ready:
            return "Preflight Fail: ekf2 missing data" if not pilot.has_position else ""
        if self.mode == OFFBOARD and not self.setpoint_alive():
            return ""
        if self.mode in PREVENT_ARMING:
            return ""
        return None

    def begin(self) -> None:
        """A flight begins: what was wrong before counts no more."""
        self.failsafe = self.entered = None

    def end(self, *, armed: bool) -> None:
        """A failsafe ends with the flight, and so does a mode in which nobody can arm."""
        if armed:
            self.intention = self._after_flight
        self.failsafe = None

    def check(self, now_ns: int) -> None:
        """Looks at everything that may end a mode, or the flight."""
        self._check_offboard()
        self._check_estimate()
        self._ticks += 1
        if self._ticks % _SLOW_CHECKS == 0:
            self._check_battery()
            self._check_data_link(now_ns)
            self._check_sticks()
        self._disarm_by_itself(now_ns)

    def _fail_to(self, mode: Mode, *, until_setpoints: bool = False) -> None:
        """Lets a failsafe take over; the one for lost setpoints ends when they come back."""
        self.failsafe = mode
        self._until_setpoints = until_setpoints
        self.entered = None
        self._pilot.voice.text(CRITICAL, "Failsafe activated\t")

    def _check_offboard(self) -> None:
        if self.intention != OFFBOARD:
            return
        alive = self.setpoint_alive()
        if self.failsafe is None and not alive:
            action = whole(self._pilot.params["COM_OBL_RC_ACT"])
            self._fail_to(_OFFBOARD_LOST.get(action, POSCTL), until_setpoints=True)
            if action in _MOTORS_OFF:
                self._pilot.disarm()
        elif self.failsafe is not None and self._until_setpoints and alive:
            self.failsafe = self.entered = None

    def _check_estimate(self) -> None:
        """Without a position it descends where it is."""
        pilot = self._pilot
        if not pilot.position_good and not pilot.landed and self.mode in NEED_POSITION and self.mode != LAND:
            self._fail_to(LAND)

    def _check_battery(self) -> None:
        """Tells about each threshold once, and acts on it as COM_LOW_BAT_ACT says (0: it does not)."""
        pilot = self._pilot
        left, action = pilot.battery.left, whole(pilot.params["COM_LOW_BAT_ACT"])
        for level, (name, severity, words) in enumerate(_BATTERY_LEVELS):
            if left >= pilot.params[name] or level < self._battery_told:
                continue
            self._battery_told = level + 1
            pilot.voice.text(severity, words)
            wanted = {2: LAND, 3: LAND if level == 2 else RTL}.get(action) if level else None
            if wanted is not None and not pilot.landed and self.mode not in (LAND, wanted):
                self._fail_to(wanted)

    def _check_data_link(self, now_ns: int) -> None:
        """Any ground station's heartbeat counts; NAV_DLL_ACT is off by default."""
        pilot = self._pilot
        action, heard = whole(pilot.params["NAV_DLL_ACT"]), pilot.gcs_heard_ns
        mode = {1: LOITER, 2: RTL, 3: LAND}.get(action)
        if mode is None or heard is None or pilot.landed or self.mode in (mode, *PREVENT_ARMING):
            return
        late_ns = now_ns - heard - _HEARTBEAT_MISSED_NS - pilot.params["COM_DL_LOSS_T"] * SECOND
        if late_ns <= 0:
            return
        if late_ns > pilot.params["COM_FAIL_ACT_T"] * SECOND or mode == LOITER:
            self._fail_to(mode)
        elif self.failsafe is None:
            self._fail_to(LOITER)  # so that a pilot may still take over

    def _check_sticks(self) -> None:
        """There are none: OFFBOARD goes on only while COM_RCL_EXCEPT excepts it."""
        params = self._pilot.params
        mode = {1: LOITER, 2: RTL, 3: LAND}.get(whole(params["NAV_RCL_ACT"]))
        excepted = whole(params["COM_RCL_EXCEPT"]) & 4
        if mode is not None and not excepted and self.mode == OFFBOARD and not self._pilot.landed:
            self._fail_to(mode)

    def _disarm_by_itself(self, now_ns: int) -> None:
        pilot = self._pilot
        if not pilot.landed:
            return
        if pilot.taken_off:
            wait, words = pilot.params["COM_DISARM_LAND"], "Disarmed by landing\t"
            since = pilot.landed_ns
        else:
            # 10 s by parameter, counted once the motors have spun up: 10.8 s were seen
            wait, words = pilot.params["COM_DISARM_PRFLT"] + 0.8, "Disarmed by auto preflight disarming\t"
            since = pilot.armed_ns
        if wait > 0 and now_ns - since >= wait * SECOND:
            pilot.disarm()
            pilot.voice.text(INFO, words)
