"""Keys of a mission file about vehicles behind a gateway of the flight's own: those whose link is a cflib address."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from groundstation.mavlink.addresses import GATEWAY_LINK


class GatewaySpec(BaseModel):
    """The gateway that a flight starts."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    link: str = GATEWAY_LINK
    log_hz: float = Field(default=25.0, ge=5, le=100)
    broadcast: bool = False
    radio_packets: float | None = Field(default=None, ge=10, le=5000)
