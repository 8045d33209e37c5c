"""Where the configurations that come along lie, and what they are called; loads nothing, for shells that ask."""

from __future__ import annotations

from pathlib import Path


def packaged_configs() -> Path:
    """Folder of the configurations that come along: inside the wheel, or at the top of a checkout."""
    package = Path(__file__).parents[1]
    inside = package / "configs"
    return inside if inside.is_dir() else package.parent / "configs"


def packaged_names(folder: str) -> list[str]:
    """Names, without suffix, of the YAML files in ``configs/<folder>``."""
    return sorted(item.stem for item in (packaged_configs() / folder).iterdir() if item.suffix == ".yaml")
