"""What makes one kind of autopilot: the record that each folder of ``sitl/personalities`` has.

Values alone. Refuses to name any kind: ``sitl/personalities`` finds them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from sitl.autopilot import Autopilot
from sitl.body import Body
from sitl.config import SECOND, Boot, VehicleConfig
from sitl.estimator import Noise
from sitl.messages import Message
from sitl.outfit import Outfit
from sitl.params import ParamSet
from sitl.profiles import Profile
from sitl.simulator import Simulator

Span = tuple[float, float]


@dataclass(frozen=True)
class StartUp:
    """Earliest and latest time after power-up, in seconds, of what ``Boot`` tells of."""

    stream_s: Span
    heartbeat_s: Span
    position_s: Span
    ready_s: Span
    origin_s: Span
    deaf_s: Span

    def boot(self, share: float) -> Boot:
        """One start between the earliest (0) and the latest (1)."""

        def ns(span: Span) -> int:
            return round((span[0] + (span[1] - span[0]) * share) * SECOND)

        return Boot(
            stream_ns=ns(self.stream_s),
            heartbeat_ns=ns(self.heartbeat_s),
            position_ns=ns(self.position_s),
            ready_ns=ns(self.ready_s),
            origin_ns=ns(self.origin_s),
            deaf_ns=ns(self.deaf_s),
        )


@dataclass(frozen=True)
class Personality:
    """One kind of autopilot, as the emulator and the program around it have to know it.

    Attributes:
        name: as missions and ``--autopilot`` say it.
        autopilot: its class; modes, setpoints and commands are its own affair.
        parameters: a firmware's own parameters for a system id.
        quick_start, real_start: how long it takes to start, in a hurry and as the real one does.
        profile: how it flies where nobody says (``sitl.personalities.PROFILES``).
        streams: what it sends unasked where nobody says (``sitl.personalities.RATES_HZ``).
        rates_hz: sets of streams that it brings along, by name; 0 Hz and what is missing is off.
        profiles: ways of flying that it brings along.
        noises: errors of estimates that it brings along, by name.
        messages: streamed types that only vehicles of this kind send, beside those of ``sitl.messages``.
        simulator: how the firmware's own simulator is started; None without one.
        usual: whether it is meant where nobody says; it comes first in lists then.
        first_port: of a kind that speaks something else than MAVLink: vehicle i (from 0) listens on this UDP port + i,
            gets datagrams as they come (``Traits.datagram``), and sends one packet a datagram to whoever has spoken to
            it. None: MAVLink, sent to the ground station's port.
    """

    name: str
    autopilot: Callable[[Body, VehicleConfig, Outfit], Autopilot]
    parameters: Callable[[int], ParamSet]
    quick_start: StartUp
    real_start: StartUp
    profile: str
    streams: str
    rates_hz: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    profiles: tuple[Profile, ...] = ()
    noises: Mapping[str, Noise] = field(default_factory=dict)
    messages: Mapping[str, Message] = field(default_factory=dict)
    simulator: Simulator | None = None
    usual: bool = False
    first_port: int | None = None
