"""JSON schemas as files, and the line by which an editor finds them.

The line names a file by its place beside the YAML file (``../schemas/`` among the configurations that come along): it
is found without a network, in a checkout, in an installed package and on a web page of the repository alike, and it is
the schema of the version that wrote the file. An address on the web would do neither in a hall without a network.
"""

from __future__ import annotations

import json
from pathlib import Path

from groundstation.app.resources import packaged_configs
from groundstation.core.errors import UserError
from groundstation.core.files import read_text
from groundstation.core.own_files import refuse_links, write_whole

SCHEMA_KINDS = ("mission", "formation", "campaign")
_BYTES_MAX = 1 << 20


def schema_name(kind: str) -> str:
    """Name of the file with the schema of a kind of file."""
    return f"{kind}.schema.json"


def schema_line(kind: str, folder: str = "") -> str:
    """The comment that tells an editor where the schema of a YAML file lies, seen from that file."""
    return f"# yaml-language-server: $schema={folder}{schema_name(kind)}"


def schema_text(kind: str) -> str:
    """The schema of a kind of file, as it comes along."""
    return (packaged_configs() / "schemas" / schema_name(kind)).read_text(encoding="utf-8")


def write_schema(folder: Path, kind: str) -> Path | None:
    """Puts a schema beside a file that names it; one of another version of this program is replaced.

    Args:
        folder: where the file lies.
        kind: mission, formation or campaign.

    Returns:
        What was written; None where the schema is there, or somebody else's file of that name is, which stays.

    Raises:
        UserError: it cannot be written.
    """
    path, text = folder / schema_name(kind), schema_text(kind)
    refuse_links(path, "the schema")
    if path.exists():
        there = _title(path)
        if there is None or there[0] != json.loads(text).get("title") or there[1] == text:
            return None
    try:
        write_whole(path, text.encode(), durable=False)
    except OSError as error:
        raise UserError(f"{path}: cannot be written: {error.strerror or error}") from None
    return path


def _title(path: Path) -> tuple[object, str] | None:
    """Title and text of the schema that is there; None for what is no schema."""
    try:
        text = read_text(path, _BYTES_MAX)
        values = json.loads(text)
    except (UserError, ValueError, RecursionError):
        return None
    return (values.get("title"), text) if isinstance(values, dict) else None
