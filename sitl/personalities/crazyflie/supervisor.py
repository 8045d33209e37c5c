"""The supervisor: whether it may be armed, may fly, flies; and what it does when setpoints stop or it turns over.

As seen of real firmware: 0.5 s after the last setpoint it levels out, after 2.0 s the motors stop, it falls, and is
locked until it is restarted. Refuses to fly: it says what is allowed.
"""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

from sitl.config import SECOND

LEVEL_OUT_NS, SHUT_DOWN_NS = SECOND // 2, 2 * SECOND
_TUMBLED_UP, _TUMBLED_NS = 0.5, SECOND // 2
_WATCHDOG_NS = SECOND


class Stage(Enum):
    """How far it has got; the names are the firmware's."""

    CHECKS_FAIL = "pre-flight checks not passed"
    CHECKS_PASS = "pre-flight checks passed"  # noqa: S105 - a stage, no password
    READY = "ready to fly"
    FLYING = "flying"
    LANDED = "landed"
    LEVEL_OUT = "warning, level out"
    FREE_FALL = "exception, free fall"
    LOCKED = "locked"
    CRASHED = "crashed"


_MOTORS_RUN = (Stage.READY, Stage.FLYING, Stage.LANDED, Stage.LEVEL_OUT)
_AIRBORNE = (Stage.FLYING, Stage.LEVEL_OUT)


class Situation(NamedTuple):
    """What the supervisor looks at.

    Attributes:
        ready: self-test and start-up are over.
        auto_arm: it arms itself.
        thrust: the motors are asked to lift.
        setpoint_age_ns: of what the commander goes by.
        on_ground, up: contact with the ground, and the upward part of the upward axis.
        wrecked: it has hit the ground tumbling.
        checks_tumbling: the parameter says so.
        landed_timeout_ns, preflight_timeout_ns: after which it disarms.
    """

    ready: bool
    auto_arm: bool
    thrust: bool
    setpoint_age_ns: int
    on_ground: bool
    up: float
    wrecked: bool
    checks_tumbling: bool
    landed_timeout_ns: int
    preflight_timeout_ns: int


class Supervisor:
    """One vehicle's.

    Attributes:
        stage: how far it has got.
        armed, auto_armed: whether it is, and whether it arms itself.
        tumbled: lies or flies on its side or back.
        high_level: what the high-level commander does: bits 8 (flies), 9 (has finished), 10 (is disabled).
    """

    def __init__(self) -> None:
        self.stage, self.since_ns = Stage.CHECKS_FAIL, 0
        self.armed = self.auto_armed = self.tumbled = False
        self.high_level = 0
        self._tilted_ns: int | None = None
        self._watchdog_ns: int | None = None

    @property
    def may_fly(self) -> bool:
        """Whether motors may run."""
        return self.armed and self.stage in _MOTORS_RUN

    def bits(self) -> int:
        """State as clients read it: bits 0 to 7, and the high-level commander's."""
        stage = self.stage
        flags = (
            stage is Stage.CHECKS_PASS and not self.armed,
            self.armed,
            self.auto_armed,
            self.may_fly,
            stage in _AIRBORNE,
            self.tumbled,
            stage is Stage.LOCKED,
            stage is Stage.CRASHED,
        )
        return sum(flag << k for k, flag in enumerate(flags)) | self.high_level

    def ask_arm(self, arm: bool, now_ns: int) -> bool:
        """Arms or disarms on request; returns whether that is so now. In the air, disarming lets it fall."""
        if arm:
            if self.stage is Stage.CHECKS_PASS:
                self._arm(now_ns)
            return self.armed
        if self.stage in _AIRBORNE:
            self._go(Stage.FREE_FALL, now_ns)
        elif self.stage in (Stage.READY, Stage.LANDED):
            self._go(Stage.CHECKS_FAIL, now_ns)
        self.armed = False
        return True

    def ask_recovery(self, now_ns: int) -> bool:
        """After a crash: to the beginning again, once it stands upright; returns whether it did."""
        if self.stage is not Stage.CRASHED or self.tumbled:
            return False
        self._go(Stage.CHECKS_FAIL, now_ns)
        return True

    def emergency_stop(self, now_ns: int) -> None:
        """Stops the motors for good: locked until it is restarted."""
        self.armed = False
        self._go(Stage.LOCKED, now_ns)

    def feed_watchdog(self, now_ns: int) -> None:
        """Once fed, it has to be fed every second, else it is an emergency stop."""
        self._watchdog_ns = now_ns

    def step(self, at: Situation, now_ns: int) -> None:
        """Looks at the situation, and moves on by at most one stage."""
        self._look_for_tumble(at, now_ns)
        self.auto_armed = at.auto_arm
        if self._watchdog_ns is not None and now_ns - self._watchdog_ns > _WATCHDOG_NS and self.armed:
            self.emergency_stop(now_ns)
        following = self._following(at, now_ns - self.since_ns)
        if following is not None:
            if following in (Stage.CRASHED, Stage.FREE_FALL, Stage.CHECKS_FAIL):
                self.armed = False
            self._go(following, now_ns)
        if self.stage is Stage.CHECKS_PASS and at.auto_arm:
            self._arm(now_ns)

    def _following(self, at: Situation, since_ns: int) -> Stage | None:
        stage = self.stage
        if stage in _AIRBORNE:
            return self._in_the_air(at)
        if stage is Stage.CHECKS_FAIL:
            return Stage.CHECKS_PASS if at.ready and not self.tumbled else None
        if stage in (Stage.CHECKS_PASS, Stage.READY, Stage.LANDED) and self.tumbled:
            return Stage.CHECKS_FAIL
        if stage in (Stage.READY, Stage.LANDED) and at.thrust:
            return Stage.FLYING
        if stage is Stage.READY and not at.auto_arm and since_ns > at.preflight_timeout_ns:
            return Stage.CHECKS_FAIL
        if stage is Stage.LANDED and since_ns > at.landed_timeout_ns:
            return Stage.CHECKS_FAIL
        return Stage.LOCKED if stage is Stage.FREE_FALL and at.on_ground else None

    def _in_the_air(self, at: Situation) -> Stage | None:
        if self.tumbled:
            return Stage.CRASHED
        if not at.thrust:
            return Stage.LANDED if at.on_ground else None
        if at.setpoint_age_ns >= SHUT_DOWN_NS:
            return Stage.FREE_FALL
        late = at.setpoint_age_ns >= LEVEL_OUT_NS
        if late == (self.stage is Stage.LEVEL_OUT):
            return None
        return Stage.LEVEL_OUT if late else Stage.FLYING

    def _look_for_tumble(self, at: Situation, now_ns: int) -> None:
        if at.wrecked:
            self.tumbled = True
        elif not at.checks_tumbling or at.up > _TUMBLED_UP:
            self._tilted_ns, self.tumbled = None, False
        elif self._tilted_ns is None:
            self._tilted_ns = now_ns
        elif now_ns - self._tilted_ns >= _TUMBLED_NS:
            self.tumbled = True

    def _arm(self, now_ns: int) -> None:
        self.armed = True
        self._go(Stage.READY, now_ns)

    def _go(self, stage: Stage, now_ns: int) -> None:
        self.stage, self.since_ns = stage, now_ns
