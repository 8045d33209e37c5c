"""Writes pictures, and knows those that this program wrote. matplotlib is loaded by whoever draws."""

from __future__ import annotations

import io
from base64 import b64encode
from pathlib import Path
from typing import TYPE_CHECKING

from groundstation.core.errors import UserError
from groundstation.core.own_files import claim, write_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MAKER = "gs, the ground station"  # what a picture's own metadata name as its program
_LOOKED_AT = 4096  # bytes of a picture among which that stands


def drawn_by_gs(path: Path) -> bool:
    """Whether a picture says of itself that this program drew it."""
    try:
        with path.open("rb") as file:
            return _MAKER.encode() in file.read(_LOOKED_AT)
    except OSError:
        return False


def source(content: bytes) -> str:
    """A PNG picture as what an image of a page is read from, so that the page needs no other file."""
    return f"data:image/png;base64,{b64encode(content).decode()}"


def save_picture(figure: Figure, path: Path, dpi: int) -> None:
    """Writes a picture of the kind that its name ends in, with its maker's name where the kind has room for one.

    Raises:
        OSError: it cannot be written.
        ValueError: there is no such kind.
    """
    drawn, kind = io.BytesIO(), path.suffix.lower().removeprefix(".") or "png"
    where = {"png": "Software", "svg": "Creator", "pdf": "Creator"}.get(kind)
    figure.savefig(drawn, dpi=dpi, format=kind, metadata={where: _MAKER} if where else None)
    write_whole(path, drawn.getvalue(), durable=False)


def claim_picture(path: Path, *, force: bool) -> bool:
    """Makes sure that what --picture names may be written; returns whether a picture of ours will be replaced.

    Raises:
        UserError: see ``own_files.claim``.
    """
    other = "another file with --picture"
    return claim(path, "the picture", other, ours=lambda: drawn_by_gs(path), force=force)


def save_asked_picture(figure: Figure, path: Path) -> None:
    """Writes what --picture names.

    Raises:
        UserError: it cannot be written, or there is no such kind.
    """
    try:
        save_picture(figure, path, 140)
    except (OSError, ValueError) as error:
        raise UserError(f"{path}: cannot be written ({error}); choose another --picture, .png or .svg") from error
