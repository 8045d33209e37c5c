"""One flight with its record: every byte is split into frames once, written down, then given to the runner.

Nothing is armed that cannot be recorded: when the log fails before takeoff, the flight ends there, by an order as the
operator would give it. Who is in the air flies on without a log.

Loops call it with times; it reads no clock. Replay does the same calls from the log and must get the same setpoints.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from groundstation.mavlink.blocks import Arrivals
from groundstation.mavlink.codec import Frame, Piece, Splitters
from groundstation.mavlink.gate import Gate, Refused
from groundstation.mavlink.station import Outgoing
from groundstation.mission.operator import parse_command
from groundstation.mission.runner import Note, Phase, Runner
from groundstation.records.tlog import TlogWriter

_FEW = 6  # datagrams
_BLOCK_BYTES = 16_384  # split at once, so that the work is done while there is time for it


class Session:
    """A runner and its log.

    Args:
        runner: the mission.
        log: where to record, None for nowhere.
        gate: checks and makes signatures; None where no link is signed.

    Attributes:
        notes: what happened since the loop last took it, for the screen.
        said: what the last tick had to say, for whoever waits for the answer to an order.
        unlogged: "" unless the flight was ended before takeoff because it could not be recorded: why.
        armed_unlogged: whether vehicles may have been armed by then.
        onward: takes what was let in of what vehicles told, as it came; whoever watches along. Never waits or raises.
    """

    def __init__(self, runner: Runner, log: TlogWriter | None, gate: Gate | None = None) -> None:
        self.runner = runner
        self.gate = gate
        self.notes: list[Note] = []
        self.said: list[Note] = []
        self.unlogged = ""
        self.armed_unlogged = False
        self.onward: Callable[[bytes], None] | None = None
        self._log = log
        self._arrivals = Arrivals()
        self._splitters = Splitters()
        self._streams = frozenset(runner.plan.stream_links)
        self._log_problem_told = False

    def deliver(self, link: int, peer: str, data: bytes, t_rx_ns: int) -> None:
        """Takes a datagram from a link, or the next bytes of a stream; they are in the log with the next tick.

        Datagrams are split together, as a block; streams and what is signed are split piece by piece.
        """
        if self.gate is None and link not in self._streams:
            if self.onward is not None:
                self.onward(data)
            self._arrivals.add(link, peer, data, t_rx_ns)
            if self._arrivals.size >= _BLOCK_BYTES:
                self.settle()
            return
        self.settle()
        if self.gate is None:
            pieces = self._splitters.feed((link, peer), data, stream=True)
            self._show(pieces)
            self._admit(link, peer, pieces, t_rx_ns)
            return
        for piece in self.gate.receive(link, peer, data, t_rx_ns):
            if not isinstance(piece, Refused):
                self._show((piece,))
                self._admit(link, peer, (piece,), t_rx_ns)
            elif self._log is not None:
                self._log.refused(link, peer, piece.frame, int(piece.verdict), t_rx_ns)

    def deliver_all(self, datagrams: Sequence[tuple[int, str, bytes, int]]) -> None:
        """The same for many: link, peer, bytes, time of each, in the order of their arrival."""
        if self.gate is not None or self._streams or self.onward is not None:
            for link, peer, data, t_rx_ns in datagrams:
                self.deliver(link, peer, data, t_rx_ns)
            return
        self._arrivals.extend(datagrams)

    def _show(self, pieces: Sequence[Piece]) -> None:
        """Whole frames for whoever watches along."""
        if self.onward is not None:
            for piece in pieces:
                if isinstance(piece, Frame):
                    self.onward(piece.raw)

    def settle(self) -> None:
        """Splits, records and hands on the datagrams that have arrived; a few one by one, which is quicker then."""
        arrivals = self._arrivals
        if len(arrivals) < _FEW:
            for link, peer, data, t_rx_ns in arrivals.datagrams():
                self._admit(link, peer, self._splitters.feed((link, peer), data, stream=False), t_rx_ns)
            return
        block = arrivals.block()
        if self._log is not None:
            self._log.took_block(block)
        self.runner.take_block(block)

    def _admit(self, link: int, peer: str, pieces: Sequence[Piece], t_rx_ns: int) -> None:
        if self._log is not None:
            self._log.took(link, peer, pieces, t_rx_ns)
        self.runner.take(link, peer, pieces, t_rx_ns)

    def operator(self, command: str, now_ns: int) -> str:
        """Takes an order, see ``mission.operator``; it is in the log before it is acted upon.

        Returns:
            The order in its plain form.

        Raises:
            ValueError: it is none, in words for people; nothing happens and nothing is recorded.
        """
        text = parse_command(command, self.runner.fleet.ids.tolist()).text
        self.settle()
        if self._log is not None:
            self._log.operator(text, now_ns)
        self.runner.operator(text)
        return text

    def remark(self, kind: str, text: str, now_ns: int) -> None:
        """Tells people something that the runner need not know; in the log it is an event."""
        self.settle()
        if self._log is not None:
            self._log.event(f"{kind}: {text}", now_ns)
        self.notes.append(Note(kind, text))

    def tick(self, now_ns: int) -> list[Outgoing]:
        """Steps the runner and records what it sends and says."""
        self.settle()
        before = self.runner.phase
        if self._log is not None:
            self._log.tick(now_ns, self.runner.figures.ticks)
        outgoing = self.runner.step(now_ns)
        greetings: list[Outgoing] = []
        if self.gate is not None:
            outgoing = self.gate.sign(outgoing, now_ns)
            greetings = self.gate.greetings(now_ns)  # not the runner's, and not in the log: they steer nothing
        notes = self.runner.take_notes()
        if self._log is not None:
            self._log.sent_datagrams(outgoing, now_ns)
            for note in notes:
                if note.kind == "roles":
                    self._log.roles(note.roles, now_ns)
                else:
                    self._log.event(f"{note.kind}: {note.text}", now_ns)
            if before is Phase.CONNECT and self.runner.phase is Phase.ARM:
                self._log.flush()  # a disk that is full shows before anybody is asked to arm, not a second later
            if self._log.problem is not None and not self._log_problem_told:
                self._log_problem_told = True
                notes.append(Note("alarm", self._without_log(self._log.problem, before, now_ns)))
        self.said = notes
        self.notes += notes
        return outgoing + greetings

    def _without_log(self, problem: str, before: Phase, now_ns: int) -> str:
        """Goes on in the air, and ends what has not taken off; returns words for people.

        Args:
            problem: of the log.
            before: phase in which this tick began.
            now_ns: its time.
        """
        if self.runner.phase not in (Phase.CONNECT, Phase.ARM):
            return f"{problem}; the flight goes on without a log"
        self.unlogged, self.armed_unlogged = problem, before is Phase.ARM
        self.operator("return", now_ns)
        return f"{problem}; nobody takes off without a log"

    def take_notes(self) -> list[Note]:
        """Hands out what happened since the last call."""
        notes, self.notes = self.notes, []
        return notes
