"""PX4 main of mid 2025, as it was seen to behave."""

from __future__ import annotations

from sitl.personalities.px4.autopilot import Px4
from sitl.personalities.px4.params import px4_params
from sitl.personalities.px4.profiles import PX4_QUAD, PX4_SIH, SIH_NOISE
from sitl.personalities.px4.simulator import Px4Simulator
from sitl.personalities.px4.streams import GCS_RATES_HZ, ONBOARD_RATES_HZ, RADIO_RATES_HZ
from sitl.personality import Personality, StartUp

__all__ = ["PERSONALITY"]

PERSONALITY = Personality(
    name="px4",
    autopilot=Px4,
    parameters=px4_params,
    quick_start=StartUp(
        stream_s=(0.1, 0.1),
        heartbeat_s=(0.1, 0.1),
        position_s=(1.0, 1.4),
        ready_s=(1.8, 2.0),
        origin_s=(1.0, 1.4),
        deaf_s=(0.2, 0.2),
    ),
    real_start=StartUp(
        stream_s=(1.0, 1.1),
        heartbeat_s=(2.1, 2.8),
        position_s=(1.2, 1.8),
        ready_s=(5.0, 7.5),
        origin_s=(1.2, 1.8),
        deaf_s=(0.0, 0.0),
    ),
    profile="crazyflie",
    streams="onboard",
    rates_hz={"onboard": ONBOARD_RATES_HZ, "gcs": GCS_RATES_HZ, "radio": RADIO_RATES_HZ},
    profiles=(PX4_QUAD, PX4_SIH),
    noises={"px4_sih": SIH_NOISE},
    simulator=Px4Simulator(),
    usual=True,
)
