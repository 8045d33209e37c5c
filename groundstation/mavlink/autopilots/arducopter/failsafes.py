"""What ArduCopter is to do when nobody steers it any more."""

from __future__ import annotations

from groundstation.mavlink.failsafes import (
    BLIND_FLIGHT,
    GONE,
    HEIGHT_TOLERANCE_M,
    STACKED,
    STATION_SYSID,
    TIME_TOLERANCE_S,
    Failsafes,
    Rule,
    Wish,
    named,
    named_in,
    near_to,
    none_of,
    one_of,
    setpoint_loss_s,
    strict,
)


class ArduCopterFailsafes(Failsafes):
    """ArduCopter: without setpoints it brakes and hovers (GUID_TIMEOUT); FS_GCS_ENABLE acts when heartbeats end.

    The ground station's system id counts too: heartbeats of another one do not.
    """

    _LINK = {  # noqa: RUF012 - never written to
        0: "does nothing", 2: "continues a mission", 3: "returns the way it came", 4: "returns the way it came",
        5: "lands straight down", 7: "brakes, or lands straight down",
    }  # fmt: skip
    _BATTERY = {0: "does nothing", 1: "lands straight down", 5: "motors off: it falls"}  # noqa: RUF012
    _EKF = {0: "only reports", 2: "flies by sticks"}  # noqa: RUF012 - never written to
    _RADIO = {3: "lands straight down", 5: "lands straight down"}  # noqa: RUF012 - never written to
    _LINK_ACTION = {"return": 1, "land": 5, "hold": 0}  # noqa: RUF012 - never written to

    def rules(self, wish: Wish) -> tuple[Rule, ...]:
        """Setpoint loss, ground station loss, the way home, remote control, battery, estimator, speed limits."""
        rules = [
            Rule(
                named("GUID_TIMEOUT"), setpoint_loss_s(wish.setpoint_s), BLIND_FLIGHT,
                lambda value: max(0.2, 3.0 * wish.setpoint_s) <= value <= max(0.5, 5.0 * wish.setpoint_s),
                lambda value: not 2.0 * wish.setpoint_s <= value <= 3.0,
            ),
            *self._station_lost(wish),
            Rule(
                (("MAV_GCS_SYSID", 1.0), ("SYSID_MYGCS", 1.0)), float(STATION_SYSID),
                "the heartbeats of this ground station do not count for its failsafe",
                one_of(STATION_SYSID), none_of(STATION_SYSID),
            ),
            Rule(
                named("FS_THR_ENABLE"), None, f"that is what it does when a remote control is lost, and {STACKED}",
                lambda value: not (wish.stacked and round(value) in self._RADIO), meanings=self._RADIO,
            ),
            Rule(
                named("FS_EKF_ACTION"), 1.0, "that is what it does when its estimator fails", one_of(1, 3),
                one_of(0), self._EKF,
            ),
            Rule(
                named("BATT_FS_LOW_ACT"), 2.0, "that is what it does when the battery is low"
                + (f", and {STACKED}" if wish.stacked else ""),
                one_of(2, 3, 4, 6) if wish.stacked else one_of(1, 2, 3, 4, 6, 7), one_of(0, 5), self._BATTERY,
            ),
            Rule(
                named("DISARM_DELAY"), 10.0, "disarms by itself where takeoff does not follow; arming takes 8 s",
                lambda value: value >= 8.0,
            ),
            Rule(
                named("ARMING_CHECK"), 1.0, "not all of its checks before arming are on", one_of(1), optional=True
            ),
            Rule(
                named("ARMING_SKIPCHK"), 0.0, "some of its checks before arming are off", one_of(0), optional=True
            ),
            Rule(
                (("WPNAV_SPEED", 100.0), ("WP_SPD", 1.0)), max(wish.speed_m_s, 10.0),
                "slower than the mission's speed_limit_m_s", lambda value: value >= wish.speed_m_s,
            ),
        ]  # fmt: skip
        return tuple(rules)

    def settings(self, wish: Wish) -> dict[str, float]:
        """What the parameters should be; the newer name of the arming checks is left to those that have it."""
        return {name: value for name, value in super().settings(wish).items() if name != "ARMING_SKIPCHK"}

    def _station_lost(self, wish: Wish) -> list[Rule]:
        if wish.action == "own":
            fine = one_of(1, 3, 4, 6) if wish.stacked else one_of(1, 3, 4, 5, 6, 7)
            return [Rule(named("FS_GCS_ENABLE"), None, GONE, fine, one_of(0), self._LINK)]
        action = self._LINK_ACTION[wish.action]
        why = f"that is what it does when the ground station is gone, and {GONE}"
        allowed = {"return": (1,), "land": (1, 5, 7), "hold": (0,)}[wish.action]
        rules = [Rule(named("FS_GCS_ENABLE"), float(action), why, one_of(*allowed), none_of(*allowed), self._LINK)]
        if wish.action == "hold":
            return rules
        timeout = Rule(
            named("FS_GCS_TIMEOUT"), wish.after_s, "each vehicle has its own turn",
            near_to(wish.after_s, TIME_TOLERANCE_S),
        )  # fmt: skip
        if wish.action == "land":
            return [*rules, timeout]
        height = "each vehicle returns at a height of its own"
        return [
            *rules,
            strict(timeout),
            strict(
                Rule(
                    (("RTL_ALT", 100.0), ("RTL_ALT_M", 1.0)), wish.height_m, height,
                    near_to(wish.height_m, HEIGHT_TOLERANCE_M),
                )
            ),
            strict(
                Rule(
                    named_in("RTL_LOIT_TIME", 1000.0), wish.wait_s, "nobody lands before everybody is above its pad",
                    near_to(wish.wait_s, TIME_TOLERANCE_S),
                )
            ),
            strict(Rule(named("RTL_CONE_SLOPE"), 0.0, f"near its home it would not climb; {height}", one_of(0))),
            strict(
                Rule((("RTL_ALT_FINAL", 100.0), ("RTL_ALT_FINAL_M", 1.0)), 0.0, "it does not land", lambda v: v <= 0.0)
            ),
            strict(
                Rule((("RTL_CLIMB_MIN", 100.0), ("RTL_CLIMB_MIN_M", 1.0)), 0.0, f"it climbs on; {height}", one_of(0))
            ),
        ]  # fmt: skip
