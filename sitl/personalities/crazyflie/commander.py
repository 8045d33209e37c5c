"""Who is flown by: setpoints of a client, the high-level commander, or nobody.

A setpoint of a client outranks the high-level commander and makes it forget its plan; only after
notify_setpoint_stop is that heard again. Refuses to judge how old a setpoint is: the supervisor does.
"""

from __future__ import annotations

from sitl.body import Place
from sitl.personalities.crazyflie.plans import HighLevel
from sitl.personalities.crazyflie.setpoints import STOP, read_setpoint
from sitl.setpoints import Setpoint

_COMMAND_CHANNEL, _NOTIFY_STOP = 1, 0


class Commander:
    """One vehicle's.

    Attributes:
        high: the high-level commander.
        low_level: setpoints of a client rule.
        setpoint: what is to be flown; None: the motors stand.
        heard_ns: when it came.
        refused: setpoints that are not flown.
    """

    def __init__(self) -> None:
        self.high = HighLevel()
        self.low_level = False
        self.setpoint: Setpoint | None = None
        self.heard_ns = 0
        self.refused = 0

    def generic(self, channel: int, data: bytes, now_ns: int, yaw_enu_rad: float) -> None:
        """Takes a packet of the generic commander's port."""
        if channel == _COMMAND_CHANNEL:
            if data[:1] == bytes((_NOTIFY_STOP,)):
                self.low_level = False
            return
        if data[:1] == bytes((STOP,)):
            self.stop(now_ns)
            return
        point = read_setpoint(data, now_ns, yaw_enu_rad)
        if point is None:
            self.refused += 1
            return
        self._rule(point, now_ns)

    def stop(self, now_ns: int) -> None:
        """Takes a setpoint that lets the motors stand."""
        self._rule(None, now_ns)

    def thrust(self, data: bytes, now_ns: int) -> None:
        """Takes a packet of the old commander's port: roll, pitch, yaw rate, thrust; only thrust 0 is obeyed."""
        if data[12:14] == b"\0\0":
            self.stop(now_ns)
        else:
            self.refused += 1

    def high_level(self, data: bytes, now_ns: int, place_enu_m: Place, yaw_enu_rad: float) -> int:
        """Takes a packet of the high-level commander's port; returns the error number, 0 for none."""
        return self.high.obey(data, now_ns, place_enu_m, yaw_enu_rad)

    def _rule(self, point: Setpoint | None, now_ns: int) -> None:
        self.low_level, self.setpoint, self.heard_ns = True, point, now_ns
        self.high.forget()

    def update(self, now_ns: int) -> None:
        """Lets the high-level commander say what it wants, where it is heard."""
        if self.low_level or not self.high.enabled:
            return
        plan = self.high.plan
        stands = plan is None or (plan.lands and plan.finished(now_ns))
        self.setpoint = None if plan is None or stands else plan.at(now_ns)
        self.heard_ns = now_ns

    def lands(self) -> bool:
        """Whether it is coming down to stand, or is told to stand."""
        if self.setpoint is None:
            return True
        plan = self.high.plan
        if not self.low_level and plan is not None and plan.lands:
            return True
        climb = self.setpoint.vel_enu_m_s[2]
        return climb is not None and climb < -0.05
