"""A flight streamed to Foxglove from a process of its own: listens as every console does, and tells whoever looks.

It only tells: the server takes no orders, parameters or messages, and listens on this machine alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import foxglove

from groundstation.app.console.beside import HOST
from groundstation.app.console.feed import Feed
from groundstation.app.console.live import live_messages
from groundstation.app.foxglove_messages import Message, schema_of, stamped
from groundstation.core.errors import UserError
from groundstation.mission.timing import SECOND_NS

_WAIT_S, _LAST_S = 1.0, 0.5


class Streamer:
    """The server that Foxglove connects to.

    Args:
        port: where it listens; 0 for one that is free.

    Attributes:
        port: where it listens.
    """

    def __init__(self, port: int) -> None:
        self._context = foxglove.Context()
        try:
            self._server = foxglove.start_server(name="gs", host=HOST, port=port, context=self._context)
        except RuntimeError as error:
            said = str(error).removeprefix("FoxgloveError: ")
            raise UserError(f"--stream foxglove: {HOST}:{port}: {said}; choose another with --port") from error
        self.port = self._server.port
        self._channels: dict[str, foxglove.Channel] = {}

    def tell(self, items: Iterable[Message], epoch_ns: int) -> None:
        """Sends messages to whoever has asked for their topics; ``epoch_ns``: Unix time of the flight's second 0."""
        for item in items:
            channel = self._channels.get(item.topic)
            if channel is None:
                channel = self._channels[item.topic] = foxglove.Channel(
                    item.topic, schema=schema_of(item.schema), context=self._context
                )
            if channel.has_sinks():
                channel.log(stamped(item, epoch_ns), log_time=epoch_ns + item.t_ns)

    def close(self) -> None:
        """Stops listening."""
        self._server.stop()


def stream(feed: Feed, streamer: Streamer, alive: Callable[[], bool], unix_ns: Callable[[], int]) -> str:
    """Streams until the flight is over.

    Args:
        feed: of the flight.
        streamer: where to.
        alive: whether the flight's process is there.
        unix_ns: the time of day.

    Returns:
        How it ended.
    """
    epoch_ns: int | None = None
    told, shown = 0, None
    while True:
        feed.wait(_WAIT_S)
        feed.read()
        snapshot = feed.last
        if snapshot is not None and snapshot is not shown:
            shown = snapshot
            if epoch_ns is None:
                epoch_ns = unix_ns() - round(snapshot.t_s * SECOND_NS)
            streamer.tell(live_messages(snapshot, feed.notes[told:]), epoch_ns)
            told = len(feed.notes)
            if snapshot.words.outcome:
                feed.wait(_LAST_S)  # the server sends by threads of its own: what was told last is on its way
                return f"the flight is over: {snapshot.words.outcome}"
        elif not alive():
            return feed.problem or "the flight's process has gone"
