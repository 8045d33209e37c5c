"""What holds for every test of a run."""

from __future__ import annotations

import gc


def pytest_collection_finish() -> None:
    """What was imported stays: looking through it for garbage again and again is a tenth of what a flight costs."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 50)
