"""What the gateway of a Crazyflie is to do when nobody steers any more.

The vehicle itself knows none of it: while the gateway lives it holds, returns or lands it by the high-level commander.
When the gateway itself is gone the firmware levels out after 0.5 s and lets it fall after 2 s.
"""

from __future__ import annotations

from groundstation.mavlink.failsafes import (
    BLIND_FLIGHT,
    GONE,
    HEIGHT_TOLERANCE_M,
    TIME_TOLERANCE_S,
    Failsafes,
    Rule,
    Wish,
    named,
    near_to,
    none_of,
    one_of,
    strict,
)


class CrazyflieFailsafes(Failsafes):
    """GW_ parameters are the gateway's (``groundstation.gateway.settings``)."""

    _LOST = {0: "holds until the battery is empty", 1: "returns", 2: "lands straight down"}  # noqa: RUF012
    _LINK_ACTION = {"return": 1, "land": 2, "hold": 0}  # noqa: RUF012 - never written to

    def rules(self, wish: Wish) -> tuple[Rule, ...]:
        """Setpoint loss, ground station loss, the way home, the speed limit, the check for tumbling."""
        return (
            Rule(named("GW_SETP_LOSS_S"), 0.3, BLIND_FLIGHT, lambda value: 0.1 <= value <= 0.4, strict_range),
            *self._station_lost(wish),
            Rule(
                named("GW_SPEED_M_S"), max(2.0, wish.speed_m_s), "slower than the mission's speed_limit_m_s",
                lambda value: value >= wish.speed_m_s,
            ),
            Rule(
                named("GW_SETP_HZ"), 50.0, "so rarely setpoints go out", lambda value: value >= 10.0,
                lambda value: value < 5.0,
            ),
            Rule(
                named("super.tmblChckEn"), 1.0, "one that has tumbled would let its motors run", one_of(1),
                optional=True,
            ),
        )  # fmt: skip

    def _station_lost(self, wish: Wish) -> list[Rule]:
        if wish.action == "own":
            fine = (1,) if wish.stacked else (1, 2)
            return [Rule(named("GW_LOSS_ACT"), None, GONE, one_of(*fine), meanings=self._LOST)]
        action = self._LINK_ACTION[wish.action]
        why = f"that is what it does when the ground station is gone, and {GONE}"
        rules = [Rule(named("GW_LOSS_ACT"), float(action), why, one_of(action), none_of(action), self._LOST)]
        if wish.action == "hold":
            return rules
        turn = Rule(
            named("GW_LOSS_S"), wish.after_s, "each vehicle has its own turn", near_to(wish.after_s, TIME_TOLERANCE_S)
        )
        if wish.action == "land":
            return [*rules, turn]
        return [
            *rules,
            strict(turn),
            strict(
                Rule(
                    named("GW_RTL_ALT_M"), wish.height_m, "each vehicle returns at a height of its own",
                    near_to(wish.height_m, HEIGHT_TOLERANCE_M),
                )
            ),
            strict(
                Rule(
                    named("GW_RTL_WAIT_S"), wish.wait_s, "nobody lands before everybody is above its pad",
                    near_to(wish.wait_s, TIME_TOLERANCE_S),
                )
            ),
        ]  # fmt: skip


def strict_range(value: float) -> bool:
    """Beyond what keeps the firmware's own watchdog (0.5 s) from acting first."""
    return not 0.05 <= value <= 0.45
