"""``gs missions`` and ``gs init``: what comes along, and a folder of one's own to begin with."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table
from rich.text import Text

from groundstation.app.completing import packaged
from groundstation.app.options import ForceOption, JsonOption
from groundstation.app.output import Output
from groundstation.core.errors import UserError

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")  # what a mission may be called, and any file system takes
_FORMATION = re.compile(r"\.\./formations/([\w-]+\.yaml)")
_GAINS_LINE = re.compile(r"^(?:#[^\n]*\n)?gains: \.\./gains/[^\n]*\n", re.MULTILINE)
_GAINS_KEY = re.compile(r", gains: \.\./gains/[\w-]+\.npz")
_README = """# {name}

| file | what it is |
| --- | --- |
| `mission.yaml` | the mission: vehicles, pads, links, speeds, safety radius, steps |
{formations}| `*.schema.json` | what editors check and complete these files by |

```
gs fly --mission mission.yaml --dry-run      # on the emulator: no vehicle moves
gs report flights/{name}-seed0.tlog -o report
gs check --mission mission.yaml              # preflight of the real vehicles; arms nothing
```
"""
_README_GAINS = """
`gs design {first}` tells what the sensing graph is worth. Gains are designed when the mission is loaded. To keep them:
`gs design {first} -o gains.npz`, and write `gains: gains.npz` into the mission.
"""


def missions(*, as_json: JsonOption = False) -> None:
    """Lists the missions that come along. Fly one with gs fly, or copy one with gs init."""
    from groundstation.app.resources import packaged_configs, packaged_names
    from groundstation.core.files import read_yaml

    out = Output(as_json=as_json)
    table = Table("mission", "vehicles", "what it is")
    rows = []
    for name in packaged_names("missions"):
        path = packaged_configs() / "missions" / f"{name}.yaml"
        about = _first_words(path)
        vehicles = len(read_yaml(path).get("vehicles") or ())
        table.add_row(name, str(vehicles), Text(about))
        rows.append({"name": name, "vehicles": vehicles, "about": about, "file": str(path)})
    out.console.print(table)
    out.console.print(
        "fly one:  gs fly --mission cube8 --dry-run      copy one:  gs init mine --like cube8", markup=False
    )
    out.result({"missions": rows})


def init(
    name: Annotated[str, typer.Argument(help="Name of the mission and of the folder that is made for it.")],
    *,
    like: Annotated[
        str, typer.Option("--like", help="Mission to begin with, see gs missions.", autocompletion=packaged("missions"))
    ] = "cube8",
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Makes a folder with a mission, its formation and a page that says what to type next."""
    from groundstation.app.resources import find_config
    from groundstation.app.schema_files import schema_name, schema_text

    out = Output(as_json=as_json)
    folder = Path(name)
    if not _NAME.fullmatch(folder.name):
        raise UserError(f"{name}: a mission's name has 1 to 64 letters, digits, - and _, and begins with no sign")
    source = find_config(Path(like), "missions")
    text = source.read_text(encoding="utf-8")
    formations = sorted({*_FORMATION.findall(text)})
    if not formations and re.search(r"^formation:", text, flags=re.MULTILINE):
        raise UserError(f"--like {like}: names no formation in ../formations; take one that gs missions lists")
    text = text.replace("$schema=../schemas/", "$schema=")
    text = re.sub(r"^name: .*$", f"name: {folder.name}", text, count=1, flags=re.MULTILINE)
    text = _FORMATION.sub(r"\1", _GAINS_KEY.sub("", _GAINS_LINE.sub("", text)))
    files = {"mission.yaml": text}
    for formation in formations:
        shape = (source.parent.parent / "formations" / formation).read_text(encoding="utf-8")
        files[formation] = shape.replace("$schema=../schemas/", "$schema=")
    for kind in ("mission", "formation") if formations else ("mission",):
        files[schema_name(kind)] = schema_text(kind)
    listed = "".join(f"| `{item}` | a formation: points and sensing graph |\n" for item in formations)
    files["README.md"] = _README.format(name=folder.name, formations=listed)
    if formations:
        files["README.md"] += _README_GAINS.format(first=formations[0])
    replaced = _write(folder, files, force=force)
    mission = folder / "mission.yaml"
    out.console.print(Text(f"{'replaced in' if replaced else 'made'} {folder}: {', '.join(files)}"))
    out.console.print(Text(f"next:  gs fly --mission {mission} --dry-run"))
    out.result({"folder": str(folder), "mission": str(mission), "files": list(files)})


def _write(folder: Path, files: dict[str, str], *, force: bool) -> bool:
    """Writes into a new folder; into one that is there only with ``force``. Returns whether files were replaced.

    Raises:
        UserError: there is such a folder already, or it cannot be made.
    """
    from groundstation.core.own_files import claim, write_whole

    try:
        folder.mkdir(parents=True, exist_ok=force)
        paths = [folder / file for file in files]
        replaced = [claim(path, "the new one", "another name", ours=lambda: False, force=force) for path in paths]
        for file, text in files.items():
            write_whole(folder / file, text.encode(), durable=False)
        return any(replaced)
    except FileExistsError:
        raise UserError(
            f"{folder}: is there already; choose another name, move it away, or write into it with --force"
        ) from None
    except OSError as error:
        raise UserError(f"{folder}: cannot be written: {error.strerror or error}") from None


def _first_words(path: Path) -> str:
    """The comment that a file begins with, as one line."""
    lines = []
    for line in path.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            break
        if not line.startswith("# yaml-language-server"):
            lines.append(line.lstrip("# "))
    return " ".join(lines)
