"""What is installed with pip alone is enough for flying; who needs more says what, in one line."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from groundstation.core.extras import EXTRAS
from tests.app.commands import gs

_ROOT = Path(__file__).parents[2]
_PROJECT = tomllib.loads((_ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
_IMPORTED_AS = {"pyyaml": "yaml", "pyserial": "serial", "rerun-sdk": "rerun", "foxglove-sdk": "foxglove"}
_ALONE = {"rerun"}  # too large for whoever wants all
_PART_OF = {"dask": "distributed", "fastapi": "nicegui", "uvicorn": "nicegui"}  # come with it


def _packages(requirements: list[str]) -> set[str]:
    names = {re.split(r"[<>=\[ ]", item)[0] for item in requirements}
    return {_IMPORTED_AS.get(name, name) for name in names}


_MAVSDK_LINK = "mavsdk://udpin://127.0.0.1:14999"
_ALWAYS = _packages(_PROJECT["dependencies"])
_SOMETIMES = {
    name: extra for extra in EXTRAS for name in (*_packages(_PROJECT["optional-dependencies"][extra]), *EXTRAS[extra])
}


def _imports(path: Path, *, top: bool) -> set[str]:
    """Packages of other people that a module imports: at its top level, or anywhere."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    found: set[str] = set()
    for node in tree.body if top else ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found.add(node.module.split(".")[0])
    return (
        found - set(sys.stdlib_module_names) - {"groundstation", "sitl", "__future__"} - {"pydantic_core"}
    )  # comes with pydantic


_MODULES = sorted(path for folder in ("groundstation", "sitl") for path in (_ROOT / folder).rglob("*.py"))


def test_every_package_that_is_imported_is_asked_for() -> None:
    used = {name for path in _MODULES for name in _imports(path, top=False)}
    assert used - _ALWAYS - set(_SOMETIMES) == set()
    assert _ALWAYS - used == set(), "asked for, and used by nobody"


def test_what_an_extra_brings_is_what_the_program_says_of_it() -> None:
    optional = _PROJECT["optional-dependencies"]
    assert sorted(optional["all"]) == sorted(
        {item for extra in EXTRAS if extra not in _ALONE for item in optional[extra]}
    )
    for extra, names in EXTRAS.items():
        assert {_PART_OF.get(name, name) for name in names} == _packages(_PROJECT["optional-dependencies"][extra])


@pytest.mark.parametrize(
    ("words", "package", "extra"),
    [
        (["campaign", "--mission", "first_flight2", "--runs", "1", "-o", "out"], "pyarrow", "campaign"),
        (["campaign", "--mission", "first_flight2", "--runs", "1", "-o", "out"], "distributed", "campaign"),
        (["design", "cube8", "--method", "cvxpy"], "cvxpy", "solvers"),
        (["bench", "gains"], "cvxpy", "solvers"),
        (["export", "flight", "--to", "parquet", "-o", "out"], "pyarrow", "export"),
        (["export", "flight", "--to", "mcap", "-o", "out"], "mcap", "export"),
        (["export", "flight", "--to", "rrd", "-o", "out"], "rerun", "rerun"),
        (
            ["fly", "--mission", "first_flight2", "--dry-run", "--realtime", "--stream", "foxglove"],
            "foxglove",
            "foxglove",
        ),
        (["console", "--stream", "foxglove"], "foxglove", "foxglove"),
        (["bench", "codec"], "pymavlink", "mavlink"),
        (["sitl", "--signing", "some.key"], "pymavlink", "mavlink"),
        (["console"], "nicegui", "console"),
        (["vehicles", _MAVSDK_LINK], "mavsdk", "mavsdk"),
        (
            ["fly", "--mission", "first_flight2", "--set", "vehicles.0.link=mavsdk://udpin://0.0.0.0:14999"],
            "mavsdk",
            "mavsdk",
        ),
    ],
)
def test_who_needs_an_extra_says_so_in_one_line_and_does_nothing(
    *,
    words: list[str],
    package: str,
    extra: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, package, None)  # importing it fails now
    code, _, err = gs(words, monkeypatch, capsys)
    assert code == 2
    assert err.startswith("gs: ")
    assert len(err.splitlines()) == 1
    assert f"needs the package {package}" in err
    assert err.endswith(f"pip install 'gs-groundstation[{extra}]'\n")
    assert not list(tmp_path.rglob("*.tlog"))
    assert not (tmp_path / "out").exists()


def test_what_flies_looks_back_and_designs_loads_no_extra() -> None:
    """At any depth; the tutorial is typed without extras too (tests/docs)."""
    code = (
        "import groundstation.mavlink.dialect as tables, pathlib, tempfile;"
        "path = pathlib.Path(tempfile.mkdtemp(), 'tables.json');"  # as a wheel has them
        "path.write_text(tables.to_json(tables.from_pymavlink())); tables.TABLES = path;"
        f"import sys; sys.modules.update(dict.fromkeys({sorted(_SOMETIMES)!r}));"
        "import groundstation.app.flying, groundstation.app.replaying, groundstation.app.report,"
        "groundstation.app.verify, groundstation.app.designing, groundstation.app.identifying"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
