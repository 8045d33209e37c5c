"""One direction of one link: delay, jitter, loss, bursts, duplicates, reordering, corrupted bytes; all from a seed.

Refuses to know what it carries, and to read a clock: datagrams go in with their time and come out with another.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class LinkConfig:
    """How one direction of a link treats datagrams; the default carries everything at once.

    Attributes:
        delay_ns: delay of every datagram.
        jitter_ns: standard deviation of what is added to it (one-sided, half-normal).
        loss: probability that a datagram is lost.
        duplicate: probability that it arrives twice.
        reorder: probability that it is held back by ``reorder_ns``, so that later ones overtake it.
        reorder_ns: how long such a datagram is held back.
        corrupt: probability that one to four of its bytes are overwritten.
        burst_start: probability per datagram that a burst begins, in which everything is lost.
        burst_ns: mean length of a burst (exponential).
        blackout: nothing passes.
    """

    delay_ns: int = 0
    jitter_ns: int = 0
    loss: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0
    reorder_ns: int = 30_000_000
    corrupt: float = 0.0
    burst_start: float = 0.0
    burst_ns: int = 300_000_000
    blackout: bool = False


PERFECT = LinkConfig()


class Channel:
    """One direction of one vehicle's link.

    Attributes:
        config: may be replaced at any time; datagrams that are under way are not touched.
        lost, duplicated, corrupted: counters.
    """

    def __init__(self, config: LinkConfig, rng: np.random.Generator) -> None:
        self.config = config
        self._rng = rng
        self._burst_end_ns = -1
        self.lost = self.duplicated = self.corrupted = 0

    def carry(self, t_ns: int, data: bytes) -> list[tuple[int, bytes]]:
        """Sends one datagram at ``t_ns``.

        Returns:
            (time of arrival, bytes) of whatever arrives: none, one or two.
        """
        config = self.config
        if config is PERFECT:
            return [(t_ns, data)]
        rng = self._rng
        if config.burst_start and t_ns >= self._burst_end_ns and rng.random() < config.burst_start:
            self._burst_end_ns = t_ns + int(rng.exponential(config.burst_ns))
        if config.blackout or t_ns < self._burst_end_ns or (config.loss and rng.random() < config.loss):
            self.lost += 1
            return []
        if config.corrupt and rng.random() < config.corrupt:
            data = self._corrupted(data)
        arrivals = [(self._arrival(t_ns), data)]
        if config.duplicate and rng.random() < config.duplicate:
            self.duplicated += 1
            arrivals.append((self._arrival(t_ns), data))
        return arrivals

    def _arrival(self, t_ns: int) -> int:
        config = self.config
        t_ns += config.delay_ns
        if config.jitter_ns:
            t_ns += int(abs(self._rng.standard_normal()) * config.jitter_ns)
        if config.reorder and self._rng.random() < config.reorder:
            t_ns += config.reorder_ns
        return t_ns

    def _corrupted(self, data: bytes) -> bytes:
        self.corrupted += 1
        broken = bytearray(data)
        for _ in range(int(self._rng.integers(1, 5))):
            if broken:
                position = int(self._rng.integers(len(broken)))
                broken[position] ^= int(self._rng.integers(1, 256))
        return bytes(broken)
