"""Commands to vehicles and their acknowledgements, sans-IO.

One command per vehicle is under way at a time, since COMMAND_ACK names the command and not its parameters. Silence is
met with the same command and a higher confirmation count, as the MAVLink command protocol asks (0.5 s and three
repetitions, which is what PX4's own sender does). Whether an accepted command took effect is not known here: believe
the heartbeat.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from groundstation.mavlink.vehicle import Ack

RESULT_ACCEPTED, RESULT_IN_PROGRESS = 0, 5  # MAV_RESULT
RESULT_WORDS = {
    0: "accepted",
    1: "temporarily rejected",
    2: "denied",
    3: "unsupported",
    4: "failed",
    5: "in progress",
    6: "cancelled",
}
_REPEAT_NS = 500_000_000
_IN_PROGRESS_NS = 10_000_000_000
_REPETITIONS = 3


@dataclass(frozen=True)
class Command:
    """A COMMAND_LONG: ``command`` is a MAV_CMD, ``params`` its seven parameters, ``name`` what people call it.

    ``asks`` marks one that only asks for messages: a refusal is no reason why something does not fly.
    """

    name: str
    command: int
    params: tuple[float, ...] = ()
    asks: bool = False

    def padded(self) -> tuple[float, ...]:
        """All seven parameters."""
        return self.params + (0.0,) * (7 - len(self.params))


@dataclass(frozen=True)
class Outcome:
    """How a command ended; ``result`` is a MAV_RESULT, None when nobody answered."""

    vehicle: int
    command: Command
    result: int | None

    @property
    def accepted(self) -> bool:
        """Whether the vehicle said yes."""
        return self.result == RESULT_ACCEPTED

    def words(self) -> str:
        """The outcome for people."""
        if self.result is None:
            return f"{self.command.name}: no answer to {1 + _REPETITIONS} tries"
        return f"{self.command.name}: {RESULT_WORDS.get(self.result, 'unknown result')} (result {self.result})"


@dataclass(frozen=True)
class Transmission:
    """A COMMAND_LONG to be sent now."""

    vehicle: int
    command: Command
    confirmation: int


@dataclass
class _Lane:
    waiting: deque[Command] = field(default_factory=deque)
    tries: int = 0
    next_ns: int = 0


class CommandQueue:
    """Commands under way to n vehicles.

    Attributes:
        unanswered: commands to each vehicle that nobody answered since its last answer, whatever they asked for.
        answered: whether a vehicle has ever answered one.
    """

    def __init__(self, n: int) -> None:
        self.unanswered = [0] * n
        self.answered = [False] * n
        self._lanes = [_Lane() for _ in range(n)]
        self._outcomes: list[Outcome] = []

    def request(self, vehicle: int, command: Command) -> None:
        """Puts a command behind those that wait for this vehicle already; the same one is not put twice."""
        lane = self._lanes[vehicle]
        if command not in lane.waiting:
            lane.waiting.append(command)

    def pending(self, vehicle: int) -> bool:
        """Whether anything waits for this vehicle's answer or its turn."""
        return bool(self._lanes[vehicle].waiting)

    def clear(self, vehicle: int) -> None:
        """Forgets what waits, so that something urgent comes first."""
        self._lanes[vehicle] = _Lane()

    def acknowledge(self, ack: Ack) -> None:
        """Takes an acknowledgement; one that fits nothing under way is left alone."""
        lane = self._lanes[ack.vehicle]
        self.unanswered[ack.vehicle], self.answered[ack.vehicle] = 0, True
        if not lane.waiting or lane.tries == 0 or lane.waiting[0].command != ack.command:
            return
        if ack.result == RESULT_IN_PROGRESS:
            lane.next_ns = ack.t_rx_ns + _IN_PROGRESS_NS
            return
        self._end(ack.vehicle, ack.result)

    def due(self, now_ns: int) -> list[Transmission]:
        """Says what has to be sent now, first tries and repetitions."""
        transmissions = []
        for vehicle, lane in enumerate(self._lanes):
            if lane.waiting and lane.tries > _REPETITIONS and now_ns >= lane.next_ns:
                self._end(vehicle, None)
            if lane.waiting and (lane.tries == 0 or now_ns >= lane.next_ns):
                transmissions.append(Transmission(vehicle, lane.waiting[0], lane.tries))
                lane.tries += 1
                lane.next_ns = now_ns + _REPEAT_NS
        return transmissions

    def take_outcomes(self) -> list[Outcome]:
        """Hands out how commands ended since the last call."""
        outcomes, self._outcomes = self._outcomes, []
        return outcomes

    def _end(self, vehicle: int, result: int | None) -> None:
        lane = self._lanes[vehicle]
        self.unanswered[vehicle] += result is None
        self._outcomes.append(Outcome(vehicle, lane.waiting.popleft(), result))
        lane.tries = 0
