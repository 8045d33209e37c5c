"""What the rest of the emulator may ask of an autopilot, so that it knows none of them."""

from __future__ import annotations

from typing import Protocol

from groundstation.mavlink.codec import Encoder
from sitl.battery import Battery
from sitl.config import Boot
from sitl.wire import Fields


class Pilot(Protocol):
    """What goes into streamed messages beside the state of the body.

    Attributes:
        mav_autopilot: MAV_AUTOPILOT of the heartbeat.
        encoder: makes its frames and numbers them.
        boot: how it starts.
        landed: as its land detector says.
        battery: its battery.
        mission, mission_seq: stored items, and which is under way.
    """

    mav_autopilot: int
    encoder: Encoder
    boot: Boot
    landed: bool
    battery: Battery
    mission: list[Fields]
    mission_seq: int

    @property
    def age_ns(self) -> int:
        """Time since power-up."""

    def base_mode(self) -> int:
        """MAV_MODE_FLAG bits of the heartbeat."""

    def custom_mode(self) -> int:
        """Mode number of the heartbeat."""

    def system_status(self) -> int:
        """MAV_STATE of the heartbeat."""

    def landed_state(self) -> int:
        """MAV_LANDED_STATE."""

    def sensor_bits(self) -> tuple[int, int, int]:
        """SYS_STATUS sensors: present, enabled, healthy."""
