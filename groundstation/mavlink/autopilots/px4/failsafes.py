"""What PX4 is to do when nobody steers it any more."""

from __future__ import annotations

from groundstation.mavlink.failsafes import (
    BLIND_FLIGHT,
    GONE,
    HEIGHT_TOLERANCE_M,
    STACKED,
    TIME_TOLERANCE_S,
    Failsafes,
    Rule,
    Wish,
    always,
    named,
    near_to,
    none_of,
    one_of,
    setpoint_loss_s,
    strict,
    warning,
)


class Px4Failsafes(Failsafes):
    """PX4: a lost stream of setpoints (COM_OBL_RC_ACT) holds, a lost ground station (NAV_DLL_ACT) acts later.

    Of two failsafes the stronger one acts, so a return takes over from a hold. COM_FAIL_ACT_T delays it once more, and
    what PX4 is late by is taken off, so that in a mixed team turns are as far apart as planned.
    """

    _LOST = {  # noqa: RUF012 - never written to
        0: "Position mode, which sinks without sticks", 1: "Altitude mode, which drifts", 2: "Stabilized, by sticks",
        3: "returns at once", 4: "lands at once, straight down", 6: "flight termination: it falls",
        7: "motors off: it falls",
    }  # fmt: skip
    _LINK = {  # noqa: RUF012 - never written to
        0: "does nothing", 1: "holds until the battery is empty", 2: "returns", 3: "lands straight down",
        5: "flight termination: it falls", 6: "motors off: it falls",
    }  # fmt: skip
    _BATTERY = {0: "only warns", 1: "returns", 2: "lands straight down"}  # noqa: RUF012 - never written to
    _ACTION_DELAY_S = 5.0
    _LATE_S = 3.0  # a heartbeat is missed 2.5 s after the last one, and COM_DL_LOSS_T counts from there: 3 s were seen
    _LOSS_MIN_S = 5.0  # of COM_DL_LOSS_T
    _LINK_ACTION = {"return": 2, "land": 3, "hold": 1}  # noqa: RUF012 - never written to

    def rules(self, wish: Wish) -> tuple[Rule, ...]:
        """Setpoint loss, ground station loss, the way home, remote control, battery, speed limits."""
        period_s = wish.setpoint_s
        by_itself = (3, 4, 5) if not wish.stacked else (3, 5)
        falls = (6, 7)
        lost_fine = {"return": (5,), "hold": (5,), "land": (3, 4, 5), "own": by_itself}[wish.action]
        lost_insane = {"return": none_of(5), "hold": none_of(5), "land": one_of(*falls), "own": one_of(*falls)}[
            wish.action
        ]
        if wish.stacked and wish.action == "own":
            lost_insane = one_of(0, 1, 2, 4, *falls)
        rules = [
            Rule(
                named("COM_OF_LOSS_T"), setpoint_loss_s(period_s), BLIND_FLIGHT,
                lambda value: max(0.2, 3.0 * period_s) <= value <= max(0.5, 5.0 * period_s),
                lambda value: not 2.0 * period_s <= value <= 5.0,
            ),
            Rule(
                named("COM_OBL_RC_ACT"), 5.0, f"that is what it does when setpoints stop, and {STACKED}"
                if wish.stacked else "that is what it does when setpoints stop",
                one_of(*lost_fine), lost_insane, self._LOST,
            ),
            *self._station_lost(wish),
            Rule(
                named("COM_RCL_EXCEPT"), 4.0, "without a remote control OFFBOARD (4) is a failsafe of its own",
                lambda value: bool(round(value) & 4),
            ),
            Rule(
                named("COM_RC_IN_MODE"), None, "no such way of manual control is known", lambda value: 0 <= value <= 8
            ),
            Rule(
                named("COM_LOW_BAT_ACT"), 3.0, "nothing happens when the battery is critical"
                if not wish.stacked else f"that is what it does when the battery is critical, and {STACKED}",
                one_of(1, 3) if wish.stacked else one_of(1, 2, 3), one_of(0), self._BATTERY,
            ),
            Rule(
                named("BAT_CRIT_THR"), None,
                f"it acts by itself before the ground station does, at {wish.battery_min:g} (limits.battery_min)",
                lambda value: value < max(wish.battery_min, 1e-9) or wish.battery_min == 0.0,
            ),
            Rule(
                named("COM_DISARM_PRFLT"), 10.0, "disarms by itself where takeoff does not follow; arming takes 8 s",
                lambda value: value >= 8.0,
            ),
            Rule(
                named("MPC_XY_VEL_MAX"), max(wish.speed_m_s, 12.0), "slower than the mission's speed_limit_m_s",
                lambda value: value >= wish.speed_m_s,
            ),
            Rule(
                named("MPC_Z_VEL_MAX_UP"), max(wish.speed_m_s, 3.0), "slower than the mission's speed_limit_m_s",
                lambda value: value >= min(wish.speed_m_s, 3.0),
            ),
        ]  # fmt: skip
        return tuple(rules)

    def _station_lost(self, wish: Wish) -> list[Rule]:
        if wish.action == "own":
            return [
                Rule(named("NAV_DLL_ACT"), None, GONE, one_of(2, 3), one_of(5, 6), self._LINK),
                Rule(named("COM_DL_LOSS_T"), None, "time without a ground station", lambda value: value <= 120.0),
            ]
        action = self._LINK_ACTION[wish.action]
        counted_s = wish.after_s - self._LATE_S
        after_s = float(max(self._LOSS_MIN_S, round(counted_s - self._ACTION_DELAY_S)))
        delay_s = float(min(self._ACTION_DELAY_S, max(0, round(counted_s - after_s))))
        why = f"that is what it does when the ground station is gone, and {GONE}"
        fine = {"return": (2,), "land": (2, 3), "hold": (0, 1)}[wish.action]
        rules = [Rule(named("NAV_DLL_ACT"), float(action), why, one_of(*fine), none_of(*fine), self._LINK)]
        if wish.action == "hold":
            return rules
        turn = "each vehicle has its own turn"
        rules += [
            Rule(named("COM_DL_LOSS_T"), after_s, turn, near_to(after_s, TIME_TOLERANCE_S), always),
            Rule(
                named("COM_FAIL_ACT_T"), delay_s, f"it delays the return, and {turn}",
                near_to(delay_s, TIME_TOLERANCE_S), always,
            ),
        ]  # fmt: skip
        if wish.action == "land":
            return [*rules[:1], *(warning(rule) for rule in rules[1:])]
        height = "each vehicle returns at a height of its own"
        near = near_to(wish.height_m, HEIGHT_TOLERANCE_M)
        return [
            *(strict(rule) for rule in rules),
            strict(Rule(named("RTL_RETURN_ALT"), wish.height_m, height, near)),
            strict(Rule(named("RTL_DESCEND_ALT"), wish.height_m, f"{height}, and waits there", near)),
            strict(
                Rule(
                    named("RTL_LAND_DELAY"), wish.wait_s, "nobody lands before everybody is above its pad",
                    near_to(wish.wait_s, TIME_TOLERANCE_S),
                )
            ),
            strict(Rule(named("RTL_CONE_ANG"), 0.0, f"near its home it would not climb; {height}", one_of(0))),
            strict(Rule(named("RTL_TYPE"), 0.0, "it has to return to its own pad", one_of(0))),
            Rule(
                named("COM_DLL_EXCEPT"), None, "a ground station lost in OFFBOARD or in Hold does not count",
                lambda value: not round(value) & 6, always, optional=True,
            ),
        ]  # fmt: skip
