"""How one vehicle talks: numbered frames of its own, texts, acknowledgements. Refuses to know when."""

from __future__ import annotations

from collections.abc import Callable

from groundstation.mavlink.codec import Encoder, Frame, message_id
from sitl.config import VehicleConfig
from sitl.mavlink_ids import IN_PROGRESS
from sitl.wire import V1_LAST_ID

_TEXT_BYTES = 50


class Voice:
    """One vehicle's.

    Args:
        emit: sends a frame.
        config: of the vehicle.

    Attributes:
        sysid, compid: its MAVLink address.
        encoder: makes its frames and numbers them.
    """

    def __init__(self, emit: Callable[[bytes], None], config: VehicleConfig) -> None:
        self._emit = emit
        self.sysid, self.compid = config.sysid, 1
        self.encoder = Encoder(config.sysid, self.compid, version=2 if config.mavlink_version == 2 else 1)
        self._text_id = 0

    def send(self, name: str, **fields: object) -> None:
        """Sends one message; what MAVLink 1 cannot carry is left out there, as the firmwares do."""
        if self.encoder.version == 2 or message_id(name) <= V1_LAST_ID:
            self._emit(self.encoder.encode(name, **fields))

    def text(self, severity: int, message: str) -> None:
        """Sends a STATUSTEXT, in chunks of 50 bytes when it is longer."""
        data = message.encode()
        if len(data) <= _TEXT_BYTES:
            self.send("STATUSTEXT", severity=severity, text=data)
            return
        self._text_id = self._text_id % 0xFFFF + 1
        for chunk, start in enumerate(range(0, len(data), _TEXT_BYTES)):
            piece = data[start : start + _TEXT_BYTES]
            self.send("STATUSTEXT", severity=severity, text=piece, id=self._text_id, chunk_seq=chunk)

    def ack(self, command: int, result: int, to: Frame) -> None:
        """Acknowledges a command to whoever sent it."""
        self.send(
            "COMMAND_ACK",
            command=command,
            result=result,
            progress=255 if result != IN_PROGRESS else 0,
            target_system=to.sysid,
            target_component=to.compid,
        )
