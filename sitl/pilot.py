"""What the rest of the emulator may ask of an autopilot, so that it knows none of them."""

from __future__ import annotations

from typing import Protocol

from sitl.battery import Battery
from sitl.config import Boot
from sitl.mission_store import MissionStore
from sitl.voice import Voice


class Pilot(Protocol):
    """What goes into streamed messages beside the state of the body.

    Attributes:
        mav_autopilot: MAV_AUTOPILOT of the heartbeat.
        voice: makes its frames and numbers them.
        boot: how it starts.
        landed: as its land detector says.
        battery: its battery.
        mission: stored items, and which is under way.
    """

    mav_autopilot: int
    voice: Voice
    boot: Boot
    landed: bool
    battery: Battery
    mission: MissionStore

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
