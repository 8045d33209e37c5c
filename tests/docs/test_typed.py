"""The tutorial's commands, typed as printed, give what the page shows; every page names commands that there are."""

from __future__ import annotations

import os
import re
import shlex
import sys
from pathlib import Path

import pytest

from groundstation.core.extras import EXTRAS
from groundstation.mavlink.dialect import from_pymavlink, to_json
from tests.docs.pages import click_commands
from tests.docs.typed import PAGES, ROOT, fresh, missing, passages, type_page

_ALL = sorted(path.relative_to(ROOT).as_posix() for path in [*ROOT.glob("*.md"), *ROOT.glob("docs/*.md")])
_WAITS = ("make ", "source ", "pip ", "gs fly --mission first_flight2")
"""Installing, which is done, and a minute on the wall clock."""


@pytest.mark.parametrize("page", [page for page in PAGES if page != "README.md"])
def test_what_a_page_promises_comes_out_when_its_commands_are_typed(page: str, tmp_path: Path) -> None:
    home = tmp_path / "home"
    home.mkdir()
    environment = fresh(home)
    environment["PATH"] = f"{Path(sys.executable).parent}:{environment['PATH']}"
    environment |= {key: os.environ[key] for key in ("OPENBLAS_NUM_THREADS",) if key in os.environ}
    # Nothing that comes as an extra is there: what the tutorial flies, replays, reports and designs needs none of it.
    blocked = sorted(name for names in EXTRAS.values() for name in names)
    tables = home / "tables.json"  # as a wheel has them in place of pymavlink
    tables.write_text(to_json(from_pymavlink()))
    (home / "sitecustomize.py").write_text(
        "import sys, pathlib, groundstation.mavlink.dialect as dialect\n"
        f"dialect.TABLES = pathlib.Path({str(tables)!r})\n"
        f"sys.modules.update(dict.fromkeys({blocked!r}))\n"
    )
    environment["PYTHONPATH"] = str(home)
    found = passages((ROOT / page).read_text(encoding="utf-8"))
    assert {"fly", "replay", "report", "design"} <= {line.split()[1] for item in found for line in item.commands}
    assert sum(len(item.commands) for item in found) > 10
    assert sum(len(item.promised) for item in found) > 10
    assert type_page(found, tmp_path, environment, _WAITS) == []


def test_a_promise_that_is_not_kept_is_seen(tmp_path: Path) -> None:
    page = "```\necho one 2\n```\n\n```text\none 7\n```\n\n```\necho three\nfalse\n```\n\n```text\nfour\n```\n"
    wrong = type_page(passages(page), tmp_path, fresh(tmp_path))
    assert [re.sub(r"\n.*", "", words, flags=re.DOTALL) for words in wrong] == [
        "['echo three', 'false']: 'four' did not come out of",
        "['echo three', 'false']: ended with ['0', '1']:",
    ]
    assert missing(["a  1.5 s"], "x\n  a 20.25 s here\n") == []


def _typed(page: str) -> list[str]:
    """Lines of a page's blocks and tables that begin with the program's name."""
    text = (ROOT / page).read_text(encoding="utf-8")
    blocks = "\n".join(re.findall(r"^```\w*\n(.*?)^```$", text, re.DOTALL | re.MULTILINE))
    inline = re.findall(r"`(gs [a-z][^`]*)`", re.sub(r"^```.*?^```$", "", text, flags=re.DOTALL | re.MULTILINE))
    return [line.strip() for line in blocks.splitlines() if re.match(r"\s*gs [a-z-]", line)] + inline


@pytest.mark.parametrize("page", _ALL)
def test_every_command_and_option_that_a_page_names_exists(page: str) -> None:
    known = click_commands()
    for line in _typed(page):
        words = shlex.split(re.split(r"\s+#|\s[|>;&]", line)[0])
        if words[0] != "gs" or len(words) < 2:
            continue
        assert words[1] in known, f"{page}: {line}: there is no gs {words[1]}"
        options = {option for item in known[words[1]].params for option in (*item.opts, *item.secondary_opts)}
        for word in words[2:]:
            if re.match(r"--?[a-z]", word):
                assert word.split("=")[0] in options | {"--help"}, f"{page}: {line}: gs {words[1]} has no {word}"


def test_commands_are_found_on_every_page_that_has_some() -> None:
    assert sum(len(_typed(page)) for page in _ALL) > 150
