"""What ArduCopter says by itself while it starts, and when it finds where it is."""

from __future__ import annotations

from sitl.autopilot import Autopilot
from sitl.personalities.arducopter.modes import INFO

_BOOT_TEXTS = (
    (1.86, "Barometer 1 calibration complete"), (1.86, "Barometer 2 calibration complete"), (2.39, "ArduPilot Ready"),
    (2.39, "AHRS: DCM active"), (4.39, "EKF3 IMU0 initialised"), (4.39, "EKF3 IMU1 initialised"),
    (4.39, "AHRS: EKF3 active"), (5.74, "EKF3 IMU0 tilt alignment complete"),
    (5.74, "EKF3 IMU1 tilt alignment complete"), (5.83, "EKF3 IMU0 MAG0 initial yaw alignment complete"),
    (5.83, "EKF3 IMU1 MAG0 initial yaw alignment complete"), (9.75, "GPS 1: probing for u-blox at 230400 baud"),
    (9.76, "GPS 1: detected u-blox"),
)  # fmt: skip
"""What it says while it starts, and after how many seconds; sooner where start-up takes less than the real one's."""
_REAL_ORIGIN_S = 20.0


class Words:
    """Those of one vehicle, each said once."""

    def __init__(self, pilot: Autopilot) -> None:
        self._pilot = pilot
        self._boot_texts = list(_BOOT_TEXTS)
        self._pace = pilot.boot.origin_ns / _REAL_ORIGIN_S  # nanoseconds of this start for a second of the real one's
        self._origin_told = False

    def begin(self) -> None:
        """What comes out of a freshly booted board: bytes that are no MAVLink, then its banner."""
        self._pilot.body.link.emit(b"\r\n\r\nInit ArduCopter V4.7.0-dev\r\n\r\nFree RAM: 131072\r\n")
        self._say("ArduCopter V4.7.0-dev (gs sitl)", "Frame: QUAD/X")

    def position_found(self) -> None:
        """Tells about the sensors in use."""
        self._say("EKF3 IMU0 is using GPS", "EKF3 IMU1 is using GPS")

    def step(self) -> None:
        """Says what is due."""
        pilot = self._pilot
        if not self._origin_told and pilot.body.senses.has_origin:
            self._origin_told = True
            self._say("EKF3 IMU0 origin set", "EKF3 IMU1 origin set")
        while self._boot_texts and pilot.age_ns >= self._boot_texts[0][0] * self._pace:
            self._say(self._boot_texts.pop(0)[1])

    def _say(self, *texts: str) -> None:
        for text in texts:
            self._pilot.voice.text(INFO, text)
