"""A Crazyflie with its own firmware (CRTP, protocol version 12), as cflib knows it and as it was seen to behave."""

from __future__ import annotations

from sitl.personalities.crazyflie.autopilot import Crazyflie
from sitl.personalities.crazyflie.params import crazyflie_params
from sitl.personalities.crazyflie.profiles import CRAZYFLIE
from sitl.personality import Personality, StartUp

__all__ = ["PERSONALITY"]

PERSONALITY = Personality(
    name="crazyflie",
    autopilot=Crazyflie,
    parameters=crazyflie_params,
    quick_start=StartUp(
        stream_s=(0.0, 0.0),
        heartbeat_s=(0.0, 0.0),
        position_s=(0.2, 0.2),
        ready_s=(0.3, 0.3),
        origin_s=(0.1, 0.1),
        deaf_s=(0.0, 0.0),
    ),
    real_start=StartUp(
        stream_s=(1.0, 1.5),
        heartbeat_s=(1.0, 1.5),
        position_s=(2.0, 3.0),
        ready_s=(2.5, 3.5),
        origin_s=(1.5, 2.0),
        deaf_s=(0.0, 0.0),
    ),
    profile="crazyflie",
    profiles=(CRAZYFLIE,),
    streams="silent",
    rates_hz={"silent": {}},
    first_port=19850,
)
