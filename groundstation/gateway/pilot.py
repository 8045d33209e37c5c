"""Who flies a Crazyflie at this moment: nobody, the ground station's velocities, or the high-level commander.

The rules that keep it in the air: velocities outrank the high-level commander, so they are ended by name before it is
asked for anything; one that is not renewed is repeated while it is news, and before the firmware would level out
(0.5 s) and fall (2 s) the vehicle is told to stay where it believes to be. Sends nothing: orders lie in ``orders``.
"""

from __future__ import annotations

import math
from enum import IntEnum
from functools import lru_cache

from groundstation.gateway.measured import Pose, Supervisor
from groundstation.gateway.orders import (
    Arm,
    EmergencyStop,
    GoTo,
    HighLevelStop,
    LandAt,
    Order,
    Place,
    SetpointsStop,
    TakeOff,
    Velocity,
)
from groundstation.gateway.settings import HOLD, LAND, RETURN, Settings

SECOND_NS = 1_000_000_000
_CLIMB_M_S, _CRUISE_M_S, _SINK_M_S = 0.8, 1.0, 0.4
_TAKE_OFF_M_S, _EASE_S = 0.5, 1.5
_DARK_SINK_M_S, _DARK_EASE_S = 0.6, 0.4
_DARK_S, _ALONE_NS = 1.0, 3 * SECOND_NS
_FRESH_NS = SECOND_NS // 2
_AGAIN_NS, _PATIENCE_NS = 8 * SECOND_NS, 4 * SECOND_NS  # left alone twice in so long: it follows no sooner than this
_REPEAT_NS = SECOND_NS // 10  # a velocity that nobody renews, as long as it is news: one packet may have been lost
_DOWN_NS = SECOND_NS
_YAW_GAIN_1_S, _YAW_RATE_MAX = 1.5, math.radians(60.0)
_LEAST_DURATION_S = 1.0
_supervisor = lru_cache(256)(Supervisor)  # asked for many times a tick


class Mode(IntEnum):
    """What it does, as its heartbeat says."""

    STAND = 0
    VELOCITY = 1
    HOLD = 2
    LAND = 3
    RETURN = 4
    OUT = 5


class Pilot:
    """One vehicle's.

    Args:
        settings: the gateway's.

    Attributes:
        mode: what it does.
        failsafe: it does so since it was left alone.
        dark_s: for so long nobody has told it where it is, where somebody did before; 0 while it is told. It comes down
            quickly then, for it drifts the longer the farther.
        most_hz: setpoints a second, where its link carries no more than that.
        orders: what is to be sent, in order; whoever sends it empties it.
    """

    def __init__(self, settings: Settings) -> None:
        self.mode, self.failsafe = Mode.STAND, False
        self.most_hz, self.dark_s = math.inf, 0.0
        self.orders: list[Order] = []
        self._settings = settings
        self._armed = False  # by the ground station: one that arms itself is not, as long as it stands
        self._climbs_until_ns = self._heard_ns = self._sent_ns = 0
        self._velocity: tuple[Place, float | None] | None = None
        self._pose: Pose | None = None
        self._pose_ns = self._down_since_ns = 0
        self._left_alone_ns, self._follows_from_ns = -_AGAIN_NS, 0
        self._home_enu_m: Place | None = None
        self._station_ns: int | None = None
        self._legs: list[tuple[float, Order | None]] = []
        self._leg_until_ns = 0

    # -- what is known ------------------------------------------------------------------------------------------

    @property
    def supervisor(self) -> Supervisor:
        """As it was told last."""
        return _supervisor(0 if self._pose is None else self._pose.bits)

    @property
    def armed(self) -> bool:
        """Whether its motors turn, or may at any moment by our doing."""
        told = self.supervisor
        return told.flies or (told.armed and self._armed)

    def climbs(self, now_ns: int) -> bool:
        """Whether a takeoff is under way."""
        return now_ns < self._climbs_until_ns

    def fresh(self, now_ns: int) -> bool:
        """Whether it is known where it is."""
        return self._pose is not None and now_ns - self._pose_ns <= _FRESH_NS

    def saw(self, pose: Pose, now_ns: int) -> None:
        """Takes a pose, as soon as it was measured."""
        self._pose, self._pose_ns = pose, now_ns
        if not pose.bits & 0x10 and not self._armed:
            self._home_enu_m = pose.pos_enu_m
        if self.supervisor.flies:
            self._down_since_ns = now_ns

    def station(self, now_ns: int) -> None:
        """Takes note that the ground station lives."""
        self._station_ns = now_ns

    def resume(self, home_enu_m: Place | None, now_ns: int) -> None:
        """Takes over one that flies, from a gateway that has ended: it stays where it is, until a velocity comes."""
        self.mode, self.failsafe, self._home_enu_m = Mode.HOLD, True, home_enu_m
        self._velocity, self._heard_ns = ((0.0, 0.0, 0.0), None), now_ns
        self.orders += [SetpointsStop(), GoTo((0.0, 0.0, 0.0), True, 0.0, _LEAST_DURATION_S)]

    # -- what is asked of it ------------------------------------------------------------------------------------

    def arm(self, trouble: str | None) -> str | None:
        """Arms; returns why not, None where it did or has asked for it."""
        if trouble is not None:
            return trouble
        self._armed = True
        if not self.supervisor.armed:
            self.orders.append(Arm(True))
        return None

    def disarm(self) -> bool:
        """Disarms on the ground; returns False in the air, where nothing happens."""
        if self.supervisor.flies:
            return False
        self._stand()
        return True

    def kill(self) -> None:
        """Motors off at once, wherever it is."""
        self._armed, self.mode, self._velocity, self._legs = False, Mode.OUT, None, []
        self._climbs_until_ns = 0
        self.orders += [EmergencyStop(), EmergencyStop(old=True)] * 3  # each may be lost, and only one is understood

    def follow(self, now_ns: int) -> None:
        """Follows velocities from now on; one that was on its way down stays where it is until one comes."""
        if self.supervisor.flies and self.mode in (Mode.LAND, Mode.RETURN):
            self._stay(now_ns, failsafe=False)
        self.mode, self.failsafe, self._legs, self._velocity = Mode.VELOCITY, False, [], None

    def stand(self) -> bool:
        """Stands; refused in the air."""
        return self.disarm()

    def hold(self, now_ns: int) -> None:
        """Stays where it is; on the ground nothing happens."""
        self._legs = []
        if self.supervisor.flies:
            self._stay(now_ns, failsafe=False)

    def take_off(self, height_m: float, now_ns: int) -> str | None:
        """Climbs to a height above where it stands; returns why not."""
        if self.mode is not Mode.VELOCITY or not self.armed:
            return "takes off only armed and in VELOCITY mode"
        if self.climbs(now_ns):
            return None  # asked again: a second one would begin the path anew
        if self.supervisor.flies:
            return "is in the air already"
        if self._pose is None or not self.fresh(now_ns):
            return "does not know where it is"
        if not (math.isfinite(height_m) and 0.1 <= height_m <= 20.0):
            return f"takeoff height {height_m:g} m, limits 0.1 and 20"
        duration_s = height_m / _TAKE_OFF_M_S + _EASE_S
        # Firmware takes off only out of rest, which a client that has closed its link has ended by a setpoint.
        self.orders += [
            SetpointsStop(), HighLevelStop(), TakeOff(self._pose.pos_enu_m[2] + height_m, duration_s),
        ]  # fmt: skip
        self._climbs_until_ns = now_ns + round(duration_s * SECOND_NS)
        self._velocity = None
        return None

    def land(self, now_ns: int, *, failsafe: bool = False) -> str | None:
        """Sinks where it is to the height at which it took off; returns why not."""
        if self._pose is None:
            return "does not know where it is"
        if not self.supervisor.flies:  # a landing asked for on the ground would start the motors
            self._stand()
            return None
        if self.mode is Mode.LAND and self.supervisor.flies:
            return None  # a second one would begin the path again
        self.mode, self.failsafe, self._velocity, self._climbs_until_ns = Mode.LAND, failsafe, None, 0
        self._legs = []
        self.orders += [SetpointsStop(), self._down(self._pose.pos_enu_m[2])]
        self._down_since_ns = now_ns
        return None

    def velocity(self, vel_enu_m_s: Place, yaw_enu_rad: float | None, now_ns: int) -> bool:
        """Takes a setpoint; returns whether it steers."""
        if not all(map(math.isfinite, vel_enu_m_s)) or not self.supervisor.flies or self.climbs(now_ns):
            return False
        waits = self.mode is Mode.HOLD and self.failsafe and self._velocity is not None
        if waits and now_ns >= self._follows_from_ns:
            self.mode, self.failsafe = Mode.VELOCITY, False  # it was left alone for a moment
        if self.mode is not Mode.VELOCITY:
            return False
        speed = math.hypot(*vel_enu_m_s)
        share = min(1.0, self._settings["GW_SPEED_M_S"] / speed) if speed > 0.0 else 1.0
        x, y, z = vel_enu_m_s
        self._velocity, self._heard_ns = ((share * x, share * y, share * z), yaw_enu_rad), now_ns
        if now_ns - self._sent_ns >= 0.9 * SECOND_NS / min(self._settings["GW_SETP_HZ"], self.most_hz):
            self._send(now_ns)
        return True

    def asks(self, order: Order, now_ns: int) -> bool:
        """Whether what was not answered is still wanted, and is to be asked for again."""
        match order:
            case TakeOff(_, duration_s):
                wanted = self.climbs(now_ns) and not self.supervisor.flies
                if wanted:
                    self._climbs_until_ns = now_ns + round(duration_s * SECOND_NS)
                return wanted
            case HighLevelStop():
                return self.mode is Mode.STAND
            case _:  # a landing, a place, and the end of the stream of velocities
                return self.supervisor.flies and self.mode in (Mode.HOLD, Mode.LAND, Mode.RETURN)

    # -- time ---------------------------------------------------------------------------------------------------

    def tick(self, now_ns: int) -> str | None:
        """Does what is due; returns what people are to be told."""
        if self.supervisor.locked or self.supervisor.crashed:
            self.mode, self._armed, self._velocity, self._legs = Mode.OUT, False, None, []
            return None
        if not self.supervisor.flies:
            return self._on_the_ground(now_ns)
        lost = self._lost(now_ns)
        if lost is not None:
            return lost
        if self._legs and now_ns >= self._leg_until_ns:
            self._next_leg(now_ns)
        if self.mode is Mode.VELOCITY and self._velocity is not None:
            if now_ns - self._heard_ns >= self._settings["GW_SETP_LOSS_S"] * SECOND_NS:
                age_s = (now_ns - self._heard_ns) / SECOND_NS
                # To and fro between modes would look like two vehicles under one id.
                again = now_ns - self._left_alone_ns < _AGAIN_NS
                self._left_alone_ns, self._follows_from_ns = now_ns, now_ns + (_PATIENCE_NS if again else 0)
                self._stay(now_ns, failsafe=True)
                return f"no setpoint for {age_s:.2f} s; it stays where it is"
            if now_ns - self._sent_ns >= _REPEAT_NS:
                self._send(now_ns)
        return None

    def _on_the_ground(self, now_ns: int) -> str | None:
        if self.mode is Mode.OUT:
            self._stand()  # it has come round
        came_down = self.mode in (Mode.LAND, Mode.RETURN) and now_ns - self._down_since_ns >= _DOWN_NS
        if came_down and not self._legs:
            self._stand()
            return "has landed"
        return None

    def _lost(self, now_ns: int) -> str | None:
        """Acts where the ground station has gone."""
        since_ns, action = self._station_ns, round(self._settings["GW_LOSS_ACT"])
        if self._alone_in_the_dark(now_ns):
            dark_s = self.dark_s
            self.land(now_ns, failsafe=True)
            return f"nobody has told it where it is for {dark_s:.1f} s, nor what to do; it lands where it is"
        busy = self.mode in (Mode.LAND, Mode.RETURN)
        if since_ns is None or busy or now_ns - since_ns < self._settings["GW_LOSS_S"] * SECOND_NS:
            return None
        if self.climbs(now_ns) or not self.fresh(now_ns):
            return None
        gone = f"no ground station for {(now_ns - since_ns) / SECOND_NS:.0f} s"
        if action == LAND:
            self.land(now_ns, failsafe=True)
            return f"{gone}; it lands where it is"
        if action == RETURN:
            self._return(now_ns)
            return f"{gone}; it returns"
        if action == HOLD and self.mode is not Mode.HOLD:
            self._stay(now_ns, failsafe=True)
            return f"{gone}; it stays where it is"
        return None

    def _alone_in_the_dark(self, now_ns: int) -> bool:
        """Whether to stay, or to fly home, would be done by an estimate that nobody corrects, at nobody's order."""
        if self.dark_s < _DARK_S or self.mode in (Mode.LAND, Mode.OUT) or self.climbs(now_ns):
            return False
        heard_ns = max(self._heard_ns, self._station_ns or 0)
        return now_ns - heard_ns >= _ALONE_NS or (self.failsafe and now_ns - self._heard_ns >= _DARK_S * SECOND_NS)

    def _return(self, now_ns: int) -> None:
        """Climbs, flies home, waits, lands."""
        if self._pose is None or self._home_enu_m is None:
            self.land(now_ns, failsafe=True)
            return
        (x, y, z), home = self._pose.pos_enu_m, self._home_enu_m
        height, yaw = home[2] + self._settings["GW_RTL_ALT_M"], self._pose.yaw_enu_rad
        up_s = abs(height - z) / _CLIMB_M_S + _EASE_S
        over_s = math.hypot(home[0] - x, home[1] - y) / _CRUISE_M_S + _EASE_S
        self._legs = [
            (up_s, GoTo((x, y, height), False, yaw, up_s)),
            (over_s, GoTo((home[0], home[1], height), False, yaw, over_s)),
            (self._settings["GW_RTL_WAIT_S"], None),
            (0.0, self._down(height)),
        ]
        self.mode, self.failsafe, self._velocity = Mode.RETURN, True, None
        self.orders.append(SetpointsStop())
        self._next_leg(now_ns)

    def _next_leg(self, now_ns: int) -> None:
        duration_s, order = self._legs.pop(0)
        self._leg_until_ns = now_ns + round((duration_s + 0.2) * SECOND_NS)
        if order is not None:
            self.orders.append(order)
        self._down_since_ns = now_ns

    def _down(self, from_m: float) -> LandAt:
        ground_m = 0.0 if self._home_enu_m is None else self._home_enu_m[2]
        height_m = abs(from_m - ground_m)
        if self.dark_s:
            return LandAt(ground_m, height_m / _DARK_SINK_M_S + _DARK_EASE_S)
        return LandAt(ground_m, max(_LEAST_DURATION_S, height_m / _SINK_M_S + _EASE_S))

    def _stay(self, now_ns: int, *, failsafe: bool) -> None:
        """Stays where the vehicle itself believes to be: what was told of that may be old."""
        self.mode, self.failsafe = Mode.HOLD, failsafe
        if not failsafe:
            self._velocity = None
        self._climbs_until_ns = 0
        self.orders += [SetpointsStop(), GoTo((0.0, 0.0, 0.0), True, 0.0, _LEAST_DURATION_S)]

    def _send(self, now_ns: int) -> None:
        if self._velocity is None:
            return
        velocity, yaw_enu_rad = self._velocity
        rate = 0.0
        if yaw_enu_rad is not None and math.isfinite(yaw_enu_rad) and self._pose is not None and self.fresh(now_ns):
            off = math.remainder(yaw_enu_rad - self._pose.yaw_enu_rad, math.tau)
            rate = min(max(_YAW_GAIN_1_S * off, -_YAW_RATE_MAX), _YAW_RATE_MAX)
        self.orders.append(Velocity(velocity, rate))
        self._sent_ns = now_ns

    def _stand(self) -> None:
        told = self.supervisor
        if self.mode is not Mode.STAND:  # a takeoff that has not lifted it yet would go on
            self.orders.append(HighLevelStop())
        if self._armed and told.armed and not told.auto_armed:
            self.orders.append(Arm(False))
        self._armed, self.mode, self.failsafe, self._velocity = False, Mode.STAND, False, None
        self._legs, self._climbs_until_ns = [], 0
