"""Starts the command line: ``gs``, ``groundstation`` and ``python -m groundstation`` are the same program.

Loads nothing before Ctrl-C is looked after, so that an early one ends in a word instead of a traceback.
"""

import sys

from groundstation.app.stopped import STOPPED, STOPPED_JSON, STOPPED_WORDS, CtrlC

_WRONG_SYSTEM = 2
_CTRL_C = CtrlC()
if sys.platform != "win32":
    _CTRL_C.listen()  # now: the script that pip makes of an entry point works for some ms before it calls main


def main() -> None:
    """Runs the command line; Ctrl-C where no command looks after it ends the program with a word."""
    if sys.platform == "win32":
        sys.stderr.write("gs: runs on Linux and macOS; on Windows it runs inside WSL 2, see README.md\n")
        sys.exit(_WRONG_SYSTEM)
    try:
        from groundstation.app.cli import main as run  # noqa: PLC0415 - loading takes a while

        _CTRL_C.begin()
        run()
    except BaseException as error:
        _CTRL_C.over = True
        of_it = isinstance(error, KeyboardInterrupt) or (_CTRL_C.raised and not isinstance(error, SystemExit))
        if not of_it:
            raise
        if "--json" in sys.argv:
            sys.stdout.write(STOPPED_JSON)
        sys.stderr.write(STOPPED_WORDS)
        sys.exit(STOPPED)
    finally:
        _CTRL_C.over = True
        _CTRL_C.end()


if __name__ == "__main__":
    main()
