"""What holds for every test of a run."""

from __future__ import annotations

import gc
import os
import signal
import sys

from hypothesis import settings

settings.register_profile("untimed", deadline=None)  # how long something takes depends on what else the machine does
settings.load_profile("untimed")

# Machines may be told to keep no compiled code, containers are: each worker, and each gs that a test starts, would then
# compile every module again.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False


def pytest_configure() -> None:
    """A run that a script has put into the background ignores Ctrl-C, and all that it starts would as well."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_finish() -> None:
    """What was imported stays: looking through it for garbage again and again is a tenth of what a flight costs."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 50)
