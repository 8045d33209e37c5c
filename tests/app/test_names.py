"""Names that people type: logs without suffix, wrong names of every choice, schemas that editors find."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml

from groundstation.app.commands.command import _is_meant
from groundstation.app.commands.schema import schema_json
from groundstation.app.resources import find_log, log_to_write, packaged_configs
from groundstation.app.schema_files import SCHEMA_KINDS, schema_line, schema_name
from groundstation.core.errors import UserError
from tests.app.commands import gs
from tests.reference import unpack

Patch = pytest.MonkeyPatch
Captured = pytest.CaptureFixture[str]
_PACKAGED = [(kind, path) for kind in SCHEMA_KINDS for path in sorted((packaged_configs() / f"{kind}s").glob("*.yaml"))]


@pytest.mark.parametrize("kind", SCHEMA_KINDS)
def test_the_schema_that_comes_along_is_that_of_the_program(kind: str) -> None:
    kept = (packaged_configs() / "schemas" / schema_name(kind)).read_text(encoding="utf-8")
    assert kept == f"{schema_json(kind)}\n", "make docs draws it anew"


@pytest.mark.parametrize(("kind", "path"), _PACKAGED, ids=[f"{kind}-{path.stem}" for kind, path in _PACKAGED])
def test_every_packaged_file_leads_an_editor_to_its_schema(kind: str, path: Path) -> None:
    first = path.read_text(encoding="utf-8").splitlines()[0]
    assert first == schema_line(kind, "../schemas/")
    assert (path.parent / first.partition("$schema=")[2]).resolve().is_file()


def test_what_is_made_leads_an_editor_to_a_schema_beside_it(
    tmp_path: Path, monkeypatch: Patch, capsys: Captured
) -> None:
    monkeypatch.chdir(tmp_path)
    assert gs(["init", "mine"], monkeypatch, capsys)[0] == 0
    assert gs(["new", "formation", "ring", "-n", "4"], monkeypatch, capsys)[0] == 0
    made = [*Path("mine").glob("*.yaml"), Path("ring4.yaml")]
    assert len(made) == 3
    for path in made:
        named = path.read_text().splitlines()[0].partition("$schema=")[2]
        schema = json.loads((path.parent / named).read_text())
        assert set(yaml.safe_load(path.read_text())) <= set(schema["properties"])
    # One of another version is renewed, and what somebody else put there stays.
    schema = Path("formation.schema.json")
    for there, after in (('{"title": "FormationFile"}', schema_json("formation") + "\n"), ('{"mine": 1}',) * 2):
        schema.write_text(there)
        assert gs(["new", "formation", "line", "-n", "3", "-o", f"{len(there)}.yaml"], monkeypatch, capsys)[0] == 0
        assert schema.read_text() == after


def test_a_log_is_found_without_its_suffix_and_among_the_flights(tmp_path: Path, monkeypatch: Patch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("flights/old").mkdir(parents=True)
    for name in ("a.tlog", "flights/a.tlog", "flights/hello1-seed0.tlog", "flights/old/b.tlog", "flights/v1.5.tlog"):
        Path(name).write_bytes(b"")
    for typed, found in (
        ("a", "a.tlog"),  # one that is here comes first
        ("flights/hello1-seed0", "flights/hello1-seed0.tlog"),
        ("hello1-seed0", "flights/hello1-seed0.tlog"),
        ("hello1-seed0.tlog", "flights/hello1-seed0.tlog"),
        ("old/b", "flights/old/b.tlog"),
        ("v1.5", "flights/v1.5.tlog"),
        (str(tmp_path / "a"), str(tmp_path / "a.tlog")),
        ("flights", "flights"),  # a folder: whoever reads it says that it is none
    ):
        assert find_log(Path(typed)) == Path(found)
    with pytest.raises(UserError, match=r"helo1-seed0: no such log, the nearest name is flights/hello1-seed0\.tlog"):
        find_log(Path("helo1-seed0"))
    assert (log_to_write(Path("x/a")), log_to_write(Path("a.txt"))) == (Path("x/a.tlog"), Path("a.txt"))


def test_every_command_that_reads_a_log_finds_it_so(tmp_path: Path, monkeypatch: Patch, capsys: Captured) -> None:
    monkeypatch.chdir(tmp_path)
    Path("flights").mkdir()
    unpack("broken_off", Path("flights"))
    for line in ("replay broken_off --verify", "report flights/broken_off -o page", "identify broken_off"):
        code, out, err = gs(line.split(), monkeypatch, capsys)
        assert "no such" not in out + err
        assert code == 0 or "nothing can be identified" in err + out or "could be identified" in err, (line, err)
    for line in ("replay", "report -o page", "compare broken_off", "identify"):
        assert "nearest name is flights/broken_off.tlog" in gs([*line.split(), "broken_of"], monkeypatch, capsys)[2]


def test_a_flight_is_named_by_its_log_with_suffix_or_without(tmp_path: Path, monkeypatch: Patch) -> None:
    monkeypatch.chdir(tmp_path)
    about = {"mission": "cube8", "pid": 4711, "log": str(tmp_path / "flights" / "one.tlog")}
    for wanted in (
        "cube8",
        "4711",
        "one",
        "one.tlog",
        "flights/one",
        "flights/one.tlog",
        str(tmp_path / "flights/one"),
    ):
        assert _is_meant(about, wanted), wanted
    assert not any(_is_meant(about, wanted) for wanted in ("two", "one.tlo", "flights/two", "on"))


@pytest.mark.parametrize(
    ("typed", "answer"),
    [
        ("new formation rign -n 4", "rign: unknown, did you mean ring? known are ring, line"),
        ("new formaton ring -n 4", "formaton: unknown, did you mean formation?"),
        ("new formation ring -n 4 --graph blanced", "--graph blanced: unknown, did you mean balanced?"),
        ("schema mision", "gs schema mision: unknown, did you mean mission?"),
        ("init x --like cubee8", "the nearest name is cube8"),
        ("bench flght", "gs bench flght: unknown, did you mean flight?"),
        ("design cube8 --method closd-form", "--method closd-form: unknown, did you mean closed-form?"),
        ("design cube8 --suggest-graph robst", "--suggest-graph robst: unknown, did you mean robust?"),
        ("params sav --mission hello1", "gs params sav: unknown, did you mean save?"),
        ("signing nwe k", "gs signing nwe: unknown, did you mean new?"),
        ("completion fsh", "gs completion fsh: unknown, did you mean fish?"),
        ("report a -o b --also svgg", "--also svgg: unknown, did you mean svg?"),
        ("command hald", "gs command hald: unknown, did you mean hold?"),
        ("sitl --autopilot px5", "--autopilot: 'px5' is unknown, did you mean px4?"),
        ("sitl --profile crazyfly", "--profile: 'crazyfly' is unknown, did you mean crazyflie?"),
        ("sitl --noise moca", "--noise: 'moca' is unknown, did you mean mocap?"),
        ("sitl --streams quite", "--streams: 'quite' is unknown, did you mean quiet?"),
        ("import crazyswrm d -o x.tlog", "crazyswrm: unknown, did you mean crazyswarm?"),
        ("fyl", "did you mean fly?"),
        ("fly --mision cube8", "did you mean --mission?"),
        ("check --mission cube8 --set steps=[{fom: {}}]", "steps[0].fom: unknown key, did you mean form?"),
        (
            "check --mission cube8 --set steps.0.form.tolerance=1",
            "tolerance: unknown key, did you mean tolerance_m?",
        ),
        ("check --mission cube8 --set vehicles.0.autopilot=px5", "px5: unknown, did you mean px4?"),
        ("check --mission cube8 --set vehicles.0.profile=crazyfly", "crazyfly: unknown, did you mean crazyflie?"),
        ("check --mission cube8 --set avoidance.shape=shere", "avoidance.shape: shere: unknown, did you mean sphere?"),
    ],
)
def test_a_wrong_name_is_answered_with_the_nearest(
    typed: str, answer: str, tmp_path: Path, monkeypatch: Patch, capsys: Captured
) -> None:
    monkeypatch.chdir(tmp_path)
    words = typed.replace(" {}", "\0{}").split(" ")
    code, _, err = gs([word.replace("\0", " ") for word in words], monkeypatch, capsys)
    assert code in (2, 3)
    assert answer in " ".join(err.split())
