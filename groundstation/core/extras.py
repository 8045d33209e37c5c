"""Packages that only some commands need: which extra of ``pip install`` brings them, and words when one is missing."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec

from groundstation.core.errors import UserError

EXTRAS: dict[str, tuple[str, ...]] = {
    "campaign": ("pyarrow", "dask", "distributed"),
    "export": ("pyarrow", "mcap"),
    "mavlink": ("pymavlink",),
    "mavsdk": ("mavsdk",),
    "solvers": ("cvxpy",),
    "console": ("nicegui", "fastapi", "uvicorn"),
    "crazyflie": ("cflib",),
    "mocap": ("motioncapture",),
    "rerun": ("rerun",),
    "foxglove": ("foxglove",),
}
"""Extra of this project: the packages that it brings, by the names that they are imported by."""


def need(extra: str, what: str, *, load: bool = True) -> None:
    """Makes sure, before anything is done, that the packages of an extra are there.

    Args:
        extra: a key of ``EXTRAS``.
        what: who needs them, as the user wrote it.
        load: loads them; else they are only looked for, as by whoever begins a process that needs them.

    Raises:
        UserError: one is missing; names it and the command that installs it.
    """
    for package in EXTRAS[extra]:
        try:
            if load:
                import_module(package)
            elif find_spec(package) is None:
                raise ImportError(package)
        except ImportError:
            raise UserError(
                f"{what}: needs the package {package}, which is not installed;"
                f" install it with: pip install 'gs-groundstation[{extra}]'"
            ) from None
