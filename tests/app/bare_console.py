"""A console without a flight, for ``test_console_told``: shows whatever snapshots are sent to it.

``python -m tests.app.bare_console FOLDER PID``: where it listens, and whose console it is. Prints the operator's
address.
"""

from __future__ import annotations

import socket
import sys
from pathlib import Path

from nicegui import app

from groundstation.app.console.serving import Place, serve_flight


def main() -> None:
    """Serves until it is killed."""
    folder, pid = Path(sys.argv[1]), int(sys.argv[2])
    item = socket.socket()
    item.bind(("127.0.0.1", 0))
    item.listen()
    place = Place(item, item.getsockname()[1], ("127.0.0.1",))
    keys = place.keys()

    def say() -> None:
        sys.stdout.write(f"http://127.0.0.1:{place.port}/flat?token={keys.operator}\n")
        sys.stdout.flush()

    app.on_startup(say)
    serve_flight(place, keys, folder / f"{pid}.sock", pid, None)


if __name__ == "__main__":
    main()
