"""A console for ``test_console_stalled``: gives up pages soon, and answers how much waits to be sent to them.

``python -m tests.app.stalled_console FOLDER PID``: the flight's folder and process. Prints the viewer's address.
Each line on stdin is answered by one, 20 in a second at most: pages, and messages that are kept for them.
"""

from __future__ import annotations

import asyncio
import socket
import sys
from pathlib import Path

from nicegui import Client, app, core, run

from groundstation.app.console import serving
from groundstation.app.console.serving import Place, serve_flight


def _kept() -> int:
    """Messages in NiceGUI's outboxes, waiting or kept to be sent again, and packets in the queues of its sockets."""
    boxes = [client.outbox for client in Client.instances.values()]
    waiting = sum(len(box.messages) + len(box.message_history) for box in boxes)
    return waiting + sum(int(item.queue.qsize()) for item in core.sio.eio.sockets.values())


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def main() -> None:
    """Serves until it is killed."""
    folder, pid = Path(sys.argv[1]), int(sys.argv[2])
    serving._OUT_OF_TOUCH_S = 1.0  # of NiceGUI's follow 4 s between two questions to a page, and 2 s for its answer
    item = socket.socket()
    item.bind(("127.0.0.1", 0))
    item.listen()
    place = Place(item, item.getsockname()[1], ("127.0.0.1",))
    keys = place.keys()

    async def answer() -> None:
        while await run.io_bound(sys.stdin.readline):
            await asyncio.sleep(0.05)
            _say(f"{len(Client.instances)} {_kept()}")

    app.on_startup(answer)
    app.on_startup(lambda: _say(f"http://127.0.0.1:{place.port}/flat?token={keys.viewer}"))
    serve_flight(place, keys, folder / f"{pid}.sock", pid, None)


if __name__ == "__main__":
    main()
