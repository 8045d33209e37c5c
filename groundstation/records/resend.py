"""What of a log may be sent to another program: what vehicles tell of themselves, and nothing else.

The program at the other end may be connected with vehicles that fly now, so that nothing is sent that one of them could
obey or take for a measurement: no command, setpoint, parameter, mission item, stick position, origin, key or file, and
no heartbeat of a ground station, which keeps a failsafe from acting. That is decided twice: by the kind of the message,
a list of those that only tell; and by its sender, only autopilots that never said that they are a ground station.
"""

from __future__ import annotations

from collections import Counter

from groundstation.mavlink.codec import Frame, message_name
from groundstation.records.survey import Survey, heartbeat_kind

_TELLING = """
    HEARTBEAT SYS_STATUS EXTENDED_SYS_STATE AUTOPILOT_VERSION STATUSTEXT PARAM_VALUE POWER_STATUS
    BATTERY_STATUS HOME_POSITION GPS_GLOBAL_ORIGIN
    ATTITUDE ATTITUDE_QUATERNION ATTITUDE_TARGET ALTITUDE VFR_HUD LOCAL_POSITION_NED LOCAL_POSITION_NED_COV
    GLOBAL_POSITION_INT GLOBAL_POSITION_INT_COV POSITION_TARGET_LOCAL_NED POSITION_TARGET_GLOBAL_INT
    NAV_CONTROLLER_OUTPUT MISSION_CURRENT MISSION_ITEM_REACHED
    GPS_RAW_INT GPS2_RAW GPS_STATUS RAW_IMU SCALED_IMU SCALED_IMU2 SCALED_IMU3 HIGHRES_IMU VIBRATION
    RAW_PRESSURE SCALED_PRESSURE SCALED_PRESSURE2 SCALED_PRESSURE3 WIND WIND_COV
    SERVO_OUTPUT_RAW ACTUATOR_OUTPUT_STATUS ESC_TELEMETRY_1_TO_4 ESC_TELEMETRY_5_TO_8
    ESTIMATOR_STATUS EKF_STATUS_REPORT AHRS AHRS2 AHRS3 MEMINFO HWSTATUS MCU_STATUS FENCE_STATUS RPM
"""
TELLING = frozenset(_TELLING.split())
"""Message types that tell and that no autopilot acts upon. Left out though vehicles send them, because autopilots take
them from others: ODOMETRY, DISTANCE_SENSOR, RC_CHANNELS, RADIO_STATUS, SYSTEM_TIME, TIMESYNC, acknowledgements."""


class Passing:
    """Decides frame by frame what is sent again, and counts what is not.

    Args:
        survey: of the whole log: who said anywhere in it what he is.

    Attributes:
        kept_back: frames that were not sent, by (words for the sender, message name).
    """

    def __init__(self, survey: Survey) -> None:
        self.kept_back: Counter[tuple[str, str]] = Counter()
        self._survey = survey
        self._vehicles = survey.vehicle_senders

    def __call__(self, frame: Frame) -> bool:
        """Whether a frame is sent."""
        name = message_name(frame.msgid) or f"id {frame.msgid}"
        kind = heartbeat_kind(frame)
        if (
            name in TELLING
            and (frame.sysid, frame.compid) in self._vehicles
            and not self._survey.sent_by_ground(frame)
            and (kind is None or kind.is_autopilot)
        ):
            return True
        sender = self._survey.senders.get((frame.sysid, frame.compid))
        words = sender.words if sender is not None else "unknown"
        self.kept_back[f"system {frame.sysid}, component {frame.compid} ({words})", name] += 1
        return False

    def words(self) -> list[str]:
        """What was not sent, a line for each sender."""
        by_sender: dict[str, Counter[str]] = {}
        for (sender, name), count in self.kept_back.items():
            by_sender.setdefault(sender, Counter())[name] += count
        return [
            f"not sent, of {sender}: {', '.join(f'{name} {count}' for name, count in counts.most_common(12))}"
            for sender, counts in sorted(by_sender.items())[:40]
        ]
