"""Starts the command line: ``gs``, ``groundstation`` and ``python -m groundstation`` are the same program.

Loads nothing before Ctrl-C is looked after, so that an early one ends in a word instead of a traceback.
"""

import signal
import sys

from groundstation.app.stopped import STOPPED, STOPPED_WORDS

_WRONG_SYSTEM = 2


def main() -> None:
    """Runs the command line; Ctrl-C before a command looks after it itself ends the program at once."""
    if sys.platform == "win32":
        sys.stderr.write("gs: runs on Linux and macOS; on Windows it runs inside WSL 2, see README.md\n")
        sys.exit(_WRONG_SYSTEM)
    try:
        from groundstation.app.cli import main as run  # noqa: PLC0415 - loading takes a while

        run()
    except KeyboardInterrupt:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever presses twice wants the same
        sys.stderr.write(STOPPED_WORDS)
        sys.exit(STOPPED)


if __name__ == "__main__":
    main()
