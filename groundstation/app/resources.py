"""Finds files that people name: as given, then among the configurations that come with the package."""

from __future__ import annotations

from pathlib import Path

from groundstation.app.packaged import packaged_configs, packaged_names
from groundstation.core.choices import nearest
from groundstation.core.errors import UserError
from groundstation.core.files import exists, is_file

__all__ = ["find_config", "find_log", "log_to_write", "packaged_configs", "packaged_names"]
_FLIGHTS = Path("flights")


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
    near = nearest(path.stem, known)
    hint = f", the nearest name is {near}" if near else ""
    raise UserError(
        f"{path}: no such file{hint}; name one that exists, or one of those that come along: {', '.join(known)}"
    )


def find_log(path: Path) -> Path:
    """Looks a log up as given, then in ``flights``, where flights are recorded; ``.tlog`` may be left out.

    Args:
        path: what the user wrote.

    Returns:
        The log; what is there and no plain file as it is, for whoever reads it to judge.

    Raises:
        UserError: there is none; names the nearest of those that are there.
    """
    folders = [path.parent] if path.is_absolute() or _FLIGHTS in path.parents else [path.parent, _FLIGHTS / path.parent]
    if path.name:
        for folder in folders:
            for name in (path.name, f"{path.name}.tlog"):
                if is_file(folder / name):
                    return folder / name
    if not path.name or exists(path):
        return path
    beside = {item.stem: item for folder in reversed(folders) for item in _logs_in(folder)}
    near = nearest(path.name.removesuffix(".tlog"), beside)
    hint = f", the nearest name is {beside[near]}" if near else ""
    raise UserError(f"{path}: no such log{hint}; name a .tlog file that exists, the suffix may be left out")


def log_to_write(path: Path) -> Path:
    """The log that a name stands for: ``.tlog`` may be left out here too, but of devices and pipes."""
    bare = path.name not in ("", "..") and not path.suffix and not _is_special(path)
    return path.with_name(f"{path.name}.tlog") if bare else path


def _is_special(path: Path) -> bool:
    """Whether there is something of this name that is neither a file nor a folder: /dev/null, a pipe."""
    return exists(path) and not (is_file(path) or path.is_dir() or path.is_symlink())


def _logs_in(folder: Path) -> list[Path]:
    try:
        return sorted(item for item in folder.iterdir() if item.suffix == ".tlog")
    except (OSError, ValueError):
        return []
