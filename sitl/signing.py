"""MAVLink 2 signing as the emulated vehicles do it: pymavlink's own code, so that it is a witness of ours.

Refuses to make a checksum or a signature of its own invention; only the flag and the order of the bytes are put here.
pymavlink is loaded with the first key; a vehicle takes none where it is not installed.
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING

from groundstation.mavlink.codec import Frame, message_id

_EPOCH_UNIX_US = 1_420_070_400_000_000
_RADIO_STATUS = message_id("RADIO_STATUS")
_SIGNED = 0x01

if TYPE_CHECKING:
    from pymavlink.dialects.v20.ardupilotmega import MAVLink


class VehicleSigning:
    """Signing of one vehicle's telemetry links.

    Args:
        key: 32 bytes; None while it has none.
        unix_us: date that it knows; 0 without GPS, as after the first start: then it takes the date from who signs.

    Attributes:
        refused: frames that were not obeyed.
    """

    def __init__(self, key: bytes | None, unix_us: int) -> None:
        self.refused = 0
        self._timestamp = max((unix_us - _EPOCH_UNIX_US) // 10, 0)  # until there is somebody who keeps it
        self._made: MAVLink | None = None
        self.set_key(key)

    @property
    def _mav(self) -> MAVLink:
        if self._made is None:
            from pymavlink.dialects.v20 import ardupilotmega  # noqa: PLC0415 - few vehicles sign

            self._made = ardupilotmega.MAVLink(None)
            self._made.signing.link_id = 0
            self._made.signing.timestamp = self._timestamp
        return self._made

    def set_key(self, key: bytes | None) -> None:
        """Takes another key, or none."""
        if self._made is None and (key is None or find_spec("pymavlink") is None):
            return
        self._mav.signing.secret_key = key
        self._mav.signing.sign_outgoing = key is not None

    @property
    def on(self) -> bool:
        """Whether it has a key."""
        return self._made is not None and self._made.signing.secret_key is not None

    def date(self, unix_us: int) -> None:
        """What GPS says of the date; time stamps never go back."""
        now = (unix_us - _EPOCH_UNIX_US) // 10
        if self._made is None:
            self._timestamp = max(self._timestamp, now)
        else:
            self._made.signing.timestamp = max(self._made.signing.timestamp, now)

    def sign(self, frame: bytes) -> bytes:
        """Signs a frame; MAVLink 1 cannot be signed and is sent as it is, as ArduPilot does."""
        if not self.on or frame[0] != 0xFD:
            return frame
        raw = bytearray(frame)
        raw[2] |= _SIGNED
        from pymavlink.dialects.v20.ardupilotmega import mavlink_map  # noqa: PLC0415
        from pymavlink.generator.mavcrc import x25crc  # noqa: PLC0415

        kind = mavlink_map[int.from_bytes(frame[7:10], "little")]
        crc = x25crc(raw[1 : 10 + raw[1]])
        crc.accumulate(bytes((kind.crc_extra,)))
        raw[10 + raw[1] :] = crc.crc.to_bytes(2, "little")
        message = kind.__new__(kind)
        message._msgbuf = raw
        message.sign_packet(self._mav)
        return bytes(message._msgbuf)

    def accepts(self, frame: Frame) -> bool:
        """Whether a frame is obeyed: signed as it should be, or a radio's word about itself."""
        if not self.on or frame.msgid == _RADIO_STATUS:
            return True
        if frame.signed and self._mav.check_signature(bytearray(frame.raw), frame.sysid, frame.compid):
            return True
        self.refused += 1
        return False
