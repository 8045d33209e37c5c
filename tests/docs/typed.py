"""Types the commands of a page exactly as they are printed, and holds what comes out against what the page shows.

``python -m tests.docs.typed`` does it in a fresh clone with an empty home: README.md and docs/tutorial.md, with what
they install. The tests do the same without installing anew and without what waits for the wall clock.

A fenced block without a language holds commands. One of ``yaml`` after the words "Write this into `FILE`" is that file.
One of ``text`` shows lines that come out of the commands since the last one; figures may differ.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = ("README.md", "docs/tutorial.md")
_BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_FILE = re.compile(r"[Ww]rite this into `([\w./-]+)`[^`]*(?:`[^`]*`[^`]*)?:\s*$")
_FIGURE = re.compile(r"\d+")
_LONG_S = 1_500
NOT_HERE = ("make test", "make fuzz")
"""Commands that take so long that a page's reader is not expected to wait for them here."""


@dataclass
class Passage:
    """What is typed between two promises.

    Attributes:
        commands: lines for a shell.
        files: written before, name and text.
        promised: lines that have to come out, figures aside.
    """

    commands: list[str] = field(default_factory=list)
    files: dict[str, str] = field(default_factory=dict)
    promised: list[str] = field(default_factory=list)


def passages(page: str) -> list[Passage]:
    """Reads what a page has people type.

    Args:
        page: its text, Markdown.
    """
    found = [Passage()]
    for block in _BLOCK.finditer(page):
        kind, text = block[1], block[2]
        if kind == "text":
            found[-1].promised += text.splitlines()
            found.append(Passage())
        elif kind == "yaml":
            named = _FILE.search(page[: block.start()].rstrip() + "\n")
            if named is not None:
                found[-1].files[named[1]] = text
        elif not kind:
            found[-1].commands += [line for line in text.splitlines() if line and not line.startswith("#")]
    return [item for item in found if item.commands or item.files]


def missing(promised: Sequence[str], output: str) -> list[str]:
    """Promised lines that did not come out, wherever they stand and whatever their figures."""
    plain = [_FIGURE.sub("0", " ".join(line.split())) for line in output.splitlines()]
    return [line for line in promised if not any(_FIGURE.sub("0", " ".join(line.split())) in out for out in plain)]


def script(page: Sequence[Passage], skip: Sequence[str] = ()) -> str:
    """One shell that types everything, with a mark after each command that tells its exit code.

    Args:
        page: what to type.
        skip: beginnings of commands that are left out.
    """
    lines = ["exec 2>&1"]
    for number, passage in enumerate(page):
        lines.append(f"echo '@passage {number}'")
        for name, text in passage.files.items():
            lines += [f"cat > {name} <<'END OF FILE'", text.rstrip("\n"), "END OF FILE"]
        for command in passage.commands:
            if not command.startswith(tuple(skip)):
                lines += [command, f'echo "@exit $? {number}"'] if not command.rstrip().endswith("&") else [command]
    return "\n".join(lines) + "\n"


def type_page(
    page: Sequence[Passage], folder: Path, environment: Mapping[str, str], skip: Sequence[str] = ()
) -> list[str]:
    """Types a page.

    Args:
        page: what to type.
        folder: in which.
        environment: of the shell.
        skip: beginnings of commands that are left out; what is promised of a passage that lacks one is not asked for.

    Returns:
        What was not as promised, in words; empty when all was.
    """
    done = subprocess.run(
        ["/bin/bash", "-c", script(page, skip)],
        cwd=folder,
        env=dict(environment),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
        timeout=_LONG_S,
        check=False,
    )
    parts = re.split(r"^@passage \d+\n", done.stdout, flags=re.MULTILINE)[1:]
    wrong: list[str] = []
    for passage, output in zip(page, parts, strict=True):
        left_out = [line for line in passage.commands if line.startswith(tuple(skip))] if skip else []
        said = re.sub(r"^@exit .*\n", "", output, flags=re.MULTILINE)
        if not left_out:
            wrong += [
                f"{passage.commands}: {line!r} did not come out of\n{said}" for line in missing(passage.promised, said)
            ]
        refused = any(line.startswith("gs: ") for line in passage.promised)
        codes = re.findall(r"^@exit (\d+)", output, re.MULTILINE)
        if not refused and any(code != "0" for code in codes):
            wrong.append(f"{passage.commands}: ended with {codes}:\n{said}")
        if "Traceback" in said:
            wrong.append(f"{passage.commands}: a traceback:\n{said}")
    return wrong


def fresh(home: Path) -> dict[str, str]:
    """Environment of somebody who has just logged in: an empty home, nothing of this process's Python."""
    kept = {key: value for key, value in os.environ.items() if key in ("LANG", "LC_ALL", "TERM", "PIP_CONFIG_FILE")}
    return kept | {"HOME": str(home), "PATH": os.environ["PATH"], "COLUMNS": "200"}


def main() -> int:
    """Types every page in one fresh clone, in order."""
    with tempfile.TemporaryDirectory() as place:
        clone, home = Path(place) / "gs", Path(place) / "home"
        home.mkdir()
        subprocess.run(["/usr/bin/env", "git", "clone", "--quiet", str(ROOT), str(clone)], check=True)
        wrong = []
        for page in PAGES:
            found = passages((clone / page).read_text(encoding="utf-8"))
            wrong += [f"{page}: {words}" for words in type_page(found, clone, fresh(home), NOT_HERE)]
    sys.stdout.write("\n".join([*wrong, f"{len(wrong)} promises were not kept"]) + "\n")
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
