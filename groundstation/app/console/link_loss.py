"""What is lost on the way from each vehicle, by the numbers that MAVLink counts its frames with. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from groundstation.core.types import FloatArray
from groundstation.mavlink.vehicle import AUTOPILOT_COMPID

_V2, _V1, _SIGNED = 0xFD, 0xFE, 0x01
_LATE = 128  # a number so far on is one from before that took a longer way


class LinkLoss:
    """Counts gaps between frames of each vehicle's autopilot.

    A router that leaves out messages on purpose makes gaps as a poor link does; MAVLink does not tell them apart.
    """

    def __init__(self) -> None:
        self._last: dict[int, int] = {}
        self._got: dict[int, int] = {}
        self._lost: dict[int, int] = {}

    def take(self, data: bytes) -> None:
        """Takes whole frames, one after the other; what is none ends it. Never raises."""
        at, end = 0, len(data)
        while at + 8 <= end:
            if data[at] == _V2 and at + 12 <= end:
                seq, sysid, compid = data[at + 4], data[at + 5], data[at + 6]
                at += data[at + 1] + (25 if data[at + 2] & _SIGNED else 12)
            elif data[at] == _V1:
                seq, sysid, compid = data[at + 2], data[at + 3], data[at + 4]
                at += data[at + 1] + 8
            else:
                return
            if compid == AUTOPILOT_COMPID:
                self._count(sysid, seq)

    def _count(self, sysid: int, seq: int) -> None:
        gap = (seq - self._last.get(sysid, seq - 1) - 1) & 0xFF
        if gap < _LATE:
            self._last[sysid] = seq
            self._lost[sysid] = self._lost.get(sysid, 0) + gap
        self._got[sysid] = self._got.get(sysid, 0) + 1

    def take_shares(self, sysids: Sequence[int]) -> FloatArray:
        """Share of frames that were lost since this was last asked, shape (n,); NaN of whom nothing was heard.

        NaN too of those who share a system id, on different links: frames of one are not told from those of another.
        """
        shared = {sysid for sysid, count in Counter(sysids).items() if count > 1}
        shares = [
            self._lost.get(sysid, 0) / (self._lost.get(sysid, 0) + got)
            if (got := self._got.get(sysid, 0)) and sysid not in shared
            else np.nan
            for sysid in sysids
        ]
        self._got.clear()
        self._lost.clear()
        return np.array(shares, dtype=np.float64)
