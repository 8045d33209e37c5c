"""Finds files that people name: as given, then among the configurations that come with the package."""

from __future__ import annotations

from pathlib import Path

import groundstation
from groundstation.core.errors import UserError
from groundstation.core.files import is_file


def packaged_configs() -> Path:
    """Folder of the configurations that come along: inside the wheel, or at the top of a checkout."""
    package = Path(groundstation.__file__).parent
    inside = package / "configs"
    return inside if inside.is_dir() else package.parent / "configs"


def find_config(path: Path, folder: str) -> Path:
    """Looks a file up as given, then in ``configs/<folder>``.

    Args:
        path: what the user wrote.
        folder: ``missions``, ``formations`` or ``gains``.

    Raises:
        UserError: it is in neither place.
    """
    if is_file(path):
        return path
    packaged = packaged_configs() / folder / path
    if not path.is_absolute() and is_file(packaged):
        return packaged
    known = (item for item in (packaged_configs() / folder).iterdir() if item.suffix == (path.suffix or ".yaml"))
    have = ", ".join(sorted(item.name for item in known))
    raise UserError(f"{path}: no such file; name one that exists, or one of those that come along: {have}")
