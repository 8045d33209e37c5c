"""Finds files that people name: as given, then among the configurations that come with the package."""

from __future__ import annotations

import difflib
from pathlib import Path

from groundstation.core.errors import UserError
from groundstation.core.files import is_file


def packaged_configs() -> Path:
    """Folder of the configurations that come along: inside the wheel, or at the top of a checkout."""
    package = Path(__file__).parents[1]
    inside = package / "configs"
    return inside if inside.is_dir() else package.parent / "configs"


def find_config(path: Path, folder: str) -> Path:
    """Looks a file up as given, then in ``configs/<folder>``; the suffix ``.yaml`` may be left out.

    Args:
        path: what the user wrote.
        folder: ``missions``, ``formations`` or ``campaigns``.

    Raises:
        UserError: it is in neither place; names the nearest of those that come along.
    """
    for name in (path, path.with_name(f"{path.name}.yaml")) if path.name else (path,):
        if is_file(name):
            return name
        packaged = packaged_configs() / folder / name
        if not name.is_absolute() and is_file(packaged):
            return packaged
    known = packaged_names(folder)
    near = difflib.get_close_matches(path.stem, known, n=1)
    hint = f", the nearest name is {near[0]}" if near else ""
    raise UserError(
        f"{path}: no such file{hint}; name one that exists, or one of those that come along: {', '.join(known)}"
    )


def packaged_names(folder: str) -> list[str]:
    """Names, without suffix, of the YAML files in ``configs/<folder>``."""
    return sorted(item.stem for item in (packaged_configs() / folder).iterdir() if item.suffix == ".yaml")
