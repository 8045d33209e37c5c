"""Which version of the program this is, and from which commit it was made."""

from __future__ import annotations

import shutil
import subprocess
from importlib import metadata
from pathlib import Path

import groundstation

_PACKAGE = Path(groundstation.__file__).parent
_DIGITS = 12
_LONG_S = 5.0


def commit() -> str:
    """The commit: as the wheel was built from, or of the checkout, with a + where files differ; "" where not known."""
    written = _PACKAGE / "commit.txt"
    if written.is_file():
        return written.read_text(encoding="utf-8").strip()
    git = shutil.which("git")
    if git is None or not (_PACKAGE.parent / ".git").exists():
        return ""
    try:
        head, changed = (
            subprocess.run(  # noqa: S603 - git, with arguments of our own
                [git, "-C", str(_PACKAGE.parent), *words], capture_output=True, text=True, check=True, timeout=_LONG_S
            ).stdout.strip()
            for words in (("rev-parse", f"--short={_DIGITS}", "HEAD"), ("status", "--porcelain", "-uno"))
        )
    except (OSError, subprocess.SubprocessError):
        return ""
    return head + ("+" if changed else "")


def version_words() -> str:
    """One line: the version, and the commit where it is known."""
    try:
        version = metadata.version("gs-groundstation")
    except metadata.PackageNotFoundError:
        version = "unknown"
    made_from = commit()
    return f"gs {version} (commit {made_from})" if made_from else f"gs {version}"
