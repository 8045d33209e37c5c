"""The process that streams a flight to Foxglove: begun with it, ended with it. Loads nothing of Foxglove's here."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from groundstation.core.errors import UserError
from groundstation.core.extras import need

HOST, PORT = "127.0.0.1", 8765
"""Where Foxglove looks by itself."""
_END_S = 3.0


@contextmanager
def streamed(to: str | None) -> Iterator[str]:
    """Streams this process's flight beside the block, from a process of its own, where that is wished.

    Yields:
        What that process said when it was ready: where it listens; "" where none is wished.

    Raises:
        UserError: the extra is missing, or somebody listens there already.
    """
    if to is None:
        yield ""
        return
    need(to, f"--stream {to}", load=False)
    package = Path(__file__).parents[2]
    path = os.pathsep.join([str(package.parent), *filter(None, [os.environ.get("PYTHONPATH")])])
    words = ["console", "--stream", to, "--flight", str(os.getpid()), "--port", str(PORT)]
    with subprocess.Popen(  # noqa: S603 - our own program
        [sys.executable, "-m", package.name, *words],
        env=os.environ | {"PYTHONPATH": path, "NO_COLOR": "1", "COLUMNS": "300"},
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        start_new_session=True,
    ) as child:  # fmt: skip
        try:
            said = "" if child.stdout is None else child.stdout.readline().strip()
            if f"ws://{HOST}" not in said:
                raise UserError(
                    f"{said.removeprefix('gs: ')}; or leave --stream out here, and run in another terminal:"
                    f" gs console --stream {to} --port PORT"
                )
            yield said
            with suppress(subprocess.TimeoutExpired):
                child.wait(_END_S)  # it ends with the flight's last snapshot
        finally:
            child.terminate()
