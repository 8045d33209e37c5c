"""Writes the commit that a wheel or sdist is built from into it, for ``gs --version``."""

from __future__ import annotations

import os
import subprocess
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class CommitHook(BuildHookInterface):  # type: ignore[type-arg, misc, unused-ignore]
    """Adds groundstation/commit.txt; an sdist has it already when a wheel is made of it."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Called before files are collected; an editable installation asks git itself."""
        if version == "editable" or (Path(self.root) / "groundstation" / "commit.txt").exists():
            return
        commit = os.environ.get("GS_COMMIT") or self._commit()
        if commit:
            with tempfile.NamedTemporaryFile("w", suffix=".txt", delete=False, encoding="utf-8") as file:
                file.write(f"{commit}\n")
            build_data["force_include"][file.name] = "groundstation/commit.txt"

    def _commit(self) -> str:
        """What git says; "" where there is no git or no history."""
        if not (Path(self.root) / ".git").exists():
            return ""
        try:
            command = ["/usr/bin/env", "git", "-C", self.root, "rev-parse", "--short=12", "HEAD"]
            return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()  # noqa: S603
        except (OSError, subprocess.SubprocessError):
            return ""
