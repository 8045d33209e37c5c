"""ArduCopter 4.7.0-dev of mid 2025, as it was seen to behave."""

from __future__ import annotations

from sitl.personalities.arducopter.autopilot import ArduCopter
from sitl.personalities.arducopter.messages import ARDUPILOT_MESSAGES
from sitl.personalities.arducopter.params import ardupilot_params
from sitl.personalities.arducopter.profiles import ARDUCOPTER
from sitl.personalities.arducopter.simulator import ArduPilotSimulator
from sitl.personalities.arducopter.streams import ARDUPILOT_RATES_HZ
from sitl.personality import Personality, StartUp

__all__ = ["PERSONALITY"]

PERSONALITY = Personality(
    name="arducopter",
    autopilot=ArduCopter,
    parameters=ardupilot_params,
    quick_start=StartUp(
        stream_s=(0.1, 0.1),
        heartbeat_s=(0.1, 0.1),
        position_s=(1.8, 2.0),
        ready_s=(0.9, 1.0),
        origin_s=(1.0, 1.4),
        deaf_s=(0.2, 0.2),
    ),
    real_start=StartUp(
        stream_s=(0.5, 0.6),
        heartbeat_s=(1.9, 2.1),
        position_s=(41.5, 42.5),
        ready_s=(23.5, 24.5),
        origin_s=(20.5, 21.5),
        deaf_s=(3.0, 3.0),
    ),
    profile="arducopter",
    streams="ardupilot",
    rates_hz={"ardupilot": ARDUPILOT_RATES_HZ},
    profiles=(ARDUCOPTER,),
    messages=ARDUPILOT_MESSAGES,
    simulator=ArduPilotSimulator(),
)
