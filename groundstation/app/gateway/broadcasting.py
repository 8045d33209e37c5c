"""Packets for all vehicles of one radio, channel and rate, by cflib's sharing of the radio; nobody acknowledges them.

The radio chip of every Crazyflie listens at FFE7E7E7E7 besides its own address, whatever that is, answers nothing there
(esb.c of crazyflie2-nrf-firmware), and each vehicle finds its own pose by the last byte of its address
(crtp_localization_service.c). Only what may be lost goes this way: poses from outside, of which the next comes at once.

The radio itself waits for answers, and sends again what got none, three times: cflib's sharing (0.1.34) has no way to
end the waiting, but the sending again can be ended, for as long as it takes. It has been tried on no real radio.
"""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress

from cflib.crtp.radiodriver import RadioDriver, RadioManager

from groundstation.core.errors import UserError
from groundstation.gateway.orders import ExternalPose
from groundstation.gateway.packets import packed_poses
from groundstation.mavlink.addresses import radio_of

_ADDRESS = (0xFF, 0xE7, 0xE7, 0xE7, 0xE7)
_AGAIN = 3  # as cflib sets it for whoever connects


class Broadcast:
    """Those that hear one broadcast.

    Args:
        number, channel, rate: of the radio, as cflib has them.
        numbers: last byte of each vehicle's address, by system id.
    """

    def __init__(self, number: int, channel: int, rate: int, numbers: Mapping[int, int]) -> None:
        self.sysids = list(numbers)
        self._numbers = dict(numbers)
        self._radio = RadioManager.open(number)
        self._radio.set_channel(channel)
        self._radio.set_data_rate(rate)
        self._radio.set_address(_ADDRESS)
        self._waiting: dict[int, ExternalPose] = {}
        self._news = threading.Condition()
        self._ends = False
        threading.Thread(target=self._send_all, name=f"broadcasts on {channel}", daemon=True).start()

    def send(self, poses: Mapping[int, ExternalPose]) -> None:
        """Takes poses by system id; of those that wait only the newest of each goes out."""
        if poses:
            with self._news:
                self._waiting |= {self._numbers[sysid]: pose for sysid, pose in poses.items()}
                self._news.notify()

    def close(self) -> None:
        """Gives its share of the radio back."""
        with self._news:
            self._ends = True
            self._news.notify()

    def _send_all(self) -> None:
        while True:
            with self._news:
                self._news.wait_for(lambda: self._ends or self._waiting)
                if self._ends:
                    break
                poses, self._waiting = self._waiting, {}
            with suppress(Exception):  # cflib raises whatever its drivers raise; the vehicles' own links tell of it
                self._radio.set_arc(0)
                for data in packed_poses(poses):
                    self._radio.send_packet(list(data))
            with suppress(Exception):
                self._radio.set_arc(_AGAIN)
        with suppress(Exception):
            self._radio.close()


def broadcasts(uris: Mapping[int, str]) -> list[Broadcast]:
    """One for all vehicles that share radio, channel and rate; none over UDP.

    Two whose addresses end in the same byte would take each other's poses: they get theirs by themselves.

    Raises:
        UserError: a radio cannot be opened.
    """
    groups: dict[tuple[int, int, int], dict[int, int]] = {}
    for sysid, uri in uris.items():
        if radio_of(uri) is None:
            continue
        number, channel, rate, address, _ = RadioDriver.parse_uri(uri)
        groups.setdefault((number, channel, rate), {})[sysid] = int(address[-1])
    for key, numbers in groups.items():
        count = Counter(numbers.values())
        groups[key] = {sysid: last for sysid, last in numbers.items() if count[last] == 1}
    try:
        return [Broadcast(*key, numbers) for key, numbers in groups.items() if numbers]
    except Exception as error:  # cflib raises whatever its drivers raise
        raise UserError(f"broadcasts: {type(error).__name__}: {error}; see that the radio is plugged in") from error
