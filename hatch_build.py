"""Writes into a wheel or sdist what is known where it is built: the commit, and MAVLink's wire tables."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class CommitHook(BuildHookInterface):  # type: ignore[type-arg, misc, unused-ignore]
    """Adds groundstation/commit.txt; an sdist has it already when a wheel is made of it."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Called before files are collected; an editable installation asks git itself."""
        if version == "editable":
            return
        for path, content in (
            ("groundstation/commit.txt", self._commit_line),
            ("groundstation/mavlink/tables.json", self._tables),
        ):
            text = "" if (Path(self.root) / path).exists() else content()
            if text:
                with tempfile.NamedTemporaryFile("w", suffix=".txt", delete=False, encoding="utf-8") as file:
                    file.write(text)
                build_data["force_include"][file.name] = path

    def _commit_line(self) -> str:
        commit = os.environ.get("GS_COMMIT") or self._commit()
        return f"{commit}\n" if commit else ""

    def _tables(self) -> str:
        """What the wheel has in place of pymavlink; made by the module that reads it, which loads nothing else."""
        path = Path(self.root) / "groundstation" / "mavlink" / "dialect.py"
        spec = importlib.util.spec_from_file_location("_dialect", path)
        if spec is None or spec.loader is None:
            raise RuntimeError(f"{path}: cannot be loaded")
        module = importlib.util.module_from_spec(spec)
        sys.modules["_dialect"] = module
        spec.loader.exec_module(module)
        text: str = module.to_json(module.from_pymavlink())
        return text

    def _commit(self) -> str:
        """What git says; "" where there is no git or no history."""
        if not (Path(self.root) / ".git").exists():
            return ""
        try:
            command = ["/usr/bin/env", "git", "-C", self.root, "rev-parse", "--short=12", "HEAD"]
            return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()  # noqa: S603
        except (OSError, subprocess.SubprocessError):
            return ""
