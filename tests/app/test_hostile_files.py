"""Files that mean harm: they are refused in a sentence, run nothing and take neither memory nor time without bound."""

from __future__ import annotations

import io
import json
import os
import pickle
import resource
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from groundstation.app.resources import find_config, packaged_configs
from groundstation.app.signing import read_keys
from groundstation.core import files
from groundstation.core.errors import UserError
from groundstation.core.files import parse_yaml, read_yaml
from groundstation.design import store
from groundstation.design.store import load_formation, load_gains
from groundstation.links.opening import open_link
from groundstation.mavlink.codec import Encoder
from groundstation.mission.plan.reading import load_mission
from groundstation.records.imports import read_crazyswarm
from groundstation.records.manifest import Manifest, manifest_path, read_manifest
from groundstation.records.notes import Kind, Noise
from groundstation.records.replay import load_flight
from groundstation.records.responses import load_motions
from groundstation.records.tlog import TlogReader, TlogWriter, read_tlog
from sitl import faults
from sitl.faults import FaultError, parse_faults

CUBE8 = packaged_configs() / "missions" / "cube8.yaml"
GAINS = packaged_configs() / "gains" / "cube8.npz"
EPOCH_US = 1_577_836_800_000_000


class _Trap:
    """Unpickling it makes a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return Path.touch, (self.path,)


def _gains_with(path: Path, name: str, content: bytes) -> Path:
    """The good gains with one array replaced."""
    with zipfile.ZipFile(GAINS) as good, zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as bad:
        for info in good.infolist():
            bad.writestr(info.filename, content if info.filename == f"{name}.npy" else good.read(info))
    return path


def _header(shape: tuple[int, ...], descr: str) -> bytes:
    buffer = io.BytesIO()
    np.lib.format.write_array_header_1_0(buffer, {"shape": shape, "fortran_order": False, "descr": descr})
    return buffer.getvalue()


def test_gains_are_never_unpickled(tmp_path: Path) -> None:
    trap = tmp_path / "sprung"
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, np.array([_Trap(trap)], dtype=object), allow_pickle=True)
    assert b"touch" in buffer.getvalue()  # the trap is set
    for path in (
        _gains_with(tmp_path / "object.npz", "xy", buffer.getvalue()),
        _gains_with(tmp_path / "more.npz", "unknown", pickle.dumps(_Trap(trap))),
    ):
        if path.stem == "object":
            with pytest.raises(UserError, match="no gains file, or a damaged one"):
                load_gains(path)
        else:
            load_gains(path)
    bare = tmp_path / "bare.npz"
    bare.write_bytes(pickle.dumps(_Trap(trap)))
    with pytest.raises(UserError, match="no gains file, or a damaged one"):
        load_gains(bare)
    assert not trap.exists()


@pytest.mark.parametrize(
    ("shape", "descr"),
    [((10**6, 10**6), "<c16"), ((1 << 62, 4), "<f8"), ((2, 2), "V2000000000"), ((-1,), "<f8"), ((), "<c16")],
)
def test_an_array_that_claims_more_than_it_holds_takes_no_memory(
    tmp_path: Path, shape: tuple[int, ...], descr: str
) -> None:
    path = _gains_with(tmp_path / "bomb.npz", "xy", _header(shape, descr) + bytes(64))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(UserError, match="no gains file, or a damaged one"):
        load_gains(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # kB


def test_an_archive_that_unpacks_to_more_than_gains_can_be_is_not_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = _gains_with(tmp_path / "bomb.npz", "xy", _header((1000, 1000), "<c16") + bytes(16_000_000))
    assert path.stat().st_size < 100_000
    monkeypatch.setattr(store, "_BYTES_MAX", 10_000_000)
    monkeypatch.setattr(store, "_read_array", lambda *_: pytest.fail("unpacked"))
    with pytest.raises(UserError, match="bytes unpacked, limits"):
        load_gains(path)


LAUGHS = "".join(f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]\n" for a, b in zip("abcdefghij", "bcdefghijk", strict=True))
MERGES = "".join(
    f"{b}: &{b} {{<<: [{', '.join([f'*{a}'] * 9)}]}}\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: &a lol\n" + LAUGHS, "values when aliases are written out"),
        ("a: &a {k: v}\n" + MERGES, "values when aliases are written out"),
        ("a: &a [*a]", "an alias that holds itself"),
        ("a: &a {b: {c: *a}}", "an alias that holds itself"),
        ("a: " + "9" * 5000, "a number of 5000 characters, limit 400"),
        ("a: 0x" + "f" * 100_000, "a number of 100002 characters"),
        ("a: 1" + ":59" * 5000, "a number of 15001 characters"),
        ("a: !!python/object/apply:os.system ['true']", "could not determine a constructor"),
        ("a: !!python/name:os.system", "could not determine a constructor"),
        ("a: " + "[" * 50_000, "nested more than 100 deep"),
        ("- " * 5_000, "nested too deeply"),
        ("a: 2001-99-99", "is not valid YAML"),
        ("a: 1\na: 2", "key 'a' is given twice"),
    ],
)
def test_yaml_that_grows_or_runs_is_refused(text: str, words: str) -> None:
    with pytest.raises(UserError, match=words):
        parse_yaml(text, "f.yaml")
    with pytest.raises((FaultError, UserError)):
        parse_faults(text)


def test_honest_aliases_and_merges_are_taken() -> None:
    values = parse_yaml("a: &a {x: 1, y: 2}\nb: {<<: *a, y: 3}\nc: [*a, *a]", "f.yaml")
    assert values["b"] == {"x": 1, "y": 3}
    assert values["c"] == [{"x": 1, "y": 2}] * 2


def test_a_value_of_any_length_makes_a_short_message(tmp_path: Path) -> None:
    path = tmp_path / "long.yaml"
    path.write_text("name: " + "x" * 200_000 + "\n" + CUBE8.read_text().split("\n", 1)[1])
    with pytest.raises(UserError) as error:
        load_mission(path)
    assert len(str(error.value)) < 1000
    with pytest.raises(UserError, match="rate_hz"):
        load_mission(CUBE8, ["rate_hz=0x" + "f" * 380])
    for value in ("9999-99-99", "&a [*a]", "9" * 5000, "[" * 5000):
        with pytest.raises(UserError, match="the value is not valid YAML"):
            load_mission(CUBE8, [f"rate_hz={value}"])


def test_a_file_without_end_is_not_read_to_its_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "_BYTES_MAX", 1000)
    monkeypatch.setattr(faults, "_BYTES_MAX", 1000)
    with pytest.raises(UserError, match="is longer than"):
        read_yaml(Path("/dev/zero"))
    with pytest.raises(FaultError, match="is longer than"):
        faults.load_faults(Path("/dev/zero"))


@pytest.mark.parametrize(
    "text",
    [
        "[" * 100_000,
        '{"format": ' + "9" * 5000 + "}",
        "\udcff",
        '{"format": 1, "mission": {}, "epoch_unix_us": -1, "versions": {}, "seed": null, "dry_run": true,'
        ' "gains_npz_base64": null, "gains_sha256": null, "result": null}',
        '{"format": 1, "mission": {}, "epoch_unix_us": 1, "versions": {}, "seed": null, "dry_run": true,'
        ' "gains_npz_base64": "\\ud7ff", "gains_sha256": null, "result": null}',
        '{"format": 1, "mission": {}, "epoch_unix_us": '
        + "9" * 100
        + ', "versions": {}, "seed": null, "dry_run": true,'
        ' "gains_npz_base64": null, "gains_sha256": null, "result": null}',
    ],
    ids=["deep", "long number", "no text", "before time", "gains", "after time"],
)
def test_hostile_manifests_are_a_short_message(tmp_path: Path, text: str) -> None:
    path = tmp_path / "f.manifest.json"
    path.write_bytes(text.encode(errors="surrogateescape"))
    with pytest.raises(UserError, match=r"f\.manifest\.json: ") as error:
        read_manifest(path)
    assert len(str(error.value)) < 1000


@pytest.mark.parametrize(
    ("mission", "result"),
    [
        ({"vehicles": 3}, {}),
        ({"vehicles": [3]}, {}),
        ({"vehicles": [{"id": True}]}, {}),
        ({"vehicles": [{"id": 10**30}]}, {}),
        ({"vehicles": [{"id": 1, "pad_m": {"x": 1}}]}, {}),
        ({"formation": {"points": 1}}, {}),
        ({"formation": {"points": [[0, 0, 1]], "scale": "big"}}, {}),
        ({"formation": 7}, {}),
        ({"formation": {"points": [[0, 0, 1e308]], "scale": 1e308}}, {}),
        ({"formation": {"points": [[0, 0, 1]] * 3000, "edges": "complete"}}, {}),
        ({"formation": {"points": [[0, 0, 1]], "edges": [[1, [2]]]}}, {}),
        ({"avoidance": {"radius_m": [1, 2]}}, {}),
        ({"avoidance": [1]}, {}),
        ({"vehicles": [{"id": 1, "pad_m": [0, 0, 0]}]}, {"local_origins_enu_m": {"a": 1}}),
        ({"vehicles": [{"id": 1, "pad_m": [0, 0, 0]}]}, {"local_origins_enu_m": [7]}),
    ],
)
def test_manifests_that_hold_other_things_are_a_message(
    tmp_path: Path, mission: dict[str, Any], result: dict[str, Any]
) -> None:
    log = tmp_path / "f.tlog"
    with TlogWriter(log, EPOCH_US) as writer:
        writer.received(0, "p", Encoder(1).encode("LOCAL_POSITION_NED", x=1.0), 1000)
    manifest = Manifest(mission=mission, epoch_unix_us=EPOCH_US).finished(result)
    manifest_path(log).write_text(json.dumps(json.loads(manifest.to_json())))
    with pytest.raises(UserError, match="manifest"):
        load_flight(log)


def test_a_note_that_never_ends_takes_no_memory() -> None:
    """Pieces that all say that more follows; read in time that grows with the file and no faster."""
    encoder = Encoder(255, 190)
    head = Kind.NOISE
    piece = bytes((1,)) + b"x" * 127
    more = encoder.encode("TUNNEL", payload_type=int(head), payload_length=128, payload=piece)
    stamp = EPOCH_US.to_bytes(8, "big")
    header = encoder.encode(
        "TUNNEL", payload_type=int(Kind.HEADER), payload_length=10, payload=b"\x01\x00" + EPOCH_US.to_bytes(8, "little")
    )
    end = encoder.encode("TUNNEL", payload_type=int(head), payload_length=4, payload=b"\x00end")
    reader = TlogReader(stamp + header + (stamp + more) * 20_000 + stamp + end)
    assert all(len(record.data) <= 1 << 20 for record in reader if isinstance(record, Noise))


def test_a_time_that_is_too_large_to_be_written_out_is_a_message(tmp_path: Path) -> None:
    (tmp_path / "time_stamp.csv").write_text("h\n1e999999\n")
    with pytest.raises(UserError, match="is not one time in unix seconds"):
        read_crazyswarm(tmp_path)


def test_faults_with_null_for_a_number_are_a_message() -> None:
    with pytest.raises(FaultError, match=r"probability.*null is no number"):
        parse_faults("[{kind: loss, probability: null}]")


@pytest.mark.parametrize("name", ["x" * 5000, "a\\0b", "a.**"])
def test_names_that_no_file_can_have_are_a_message(name: str) -> None:
    for key in ("formation", "gains"):
        with pytest.raises(UserError, match="no such file"):
            load_mission(CUBE8, [f'{key}="{name}"'])
    plan = load_mission(CUBE8, [f'signing.key_file="{name}"'])
    with pytest.raises(UserError, match=r"cannot be opened|no name of a file|no such key file"):
        read_keys(plan)
    with pytest.raises(UserError, match="no such file"):
        find_config(Path(name), "missions")


def test_a_formation_beyond_all_bounds_is_a_message(tmp_path: Path) -> None:
    path = tmp_path / "huge.yaml"
    for scale, coordinate in ((1e308, 1), (1, 1e308)):
        path.write_text(f"name: a\nscale: {scale:.1e}\npoints: [[0, 0, 1], [0, 1, {coordinate:.1e}]]\nedges: complete")
        with pytest.raises(UserError, match="expected a number of at most 1000000000"):
            load_formation(path)


@pytest.mark.parametrize("kind", ["udpin", "udpout", "tcpin", "tcpout"])
def test_names_that_no_host_can_have_are_a_message(kind: str) -> None:
    with pytest.raises(UserError, match=f"link {kind}://aaa"):
        open_link(f"{kind}://{'a' * 70}.invalid:14540")


@pytest.mark.parametrize("key", ["vehicles.²", "vehicles." + "9" * 5000, "vehicles.-1", "vehicles.0.id.x"])
def test_odd_numbers_of_list_items_are_a_message(key: str) -> None:
    with pytest.raises(UserError, match="--set vehicles"):
        load_mission(CUBE8, [f"{key}=1"])


@pytest.mark.parametrize("read", [load_flight, read_tlog, lambda path: load_motions(path, 0.02), read_crazyswarm])
def test_what_has_no_end_is_not_read(read: Any, tmp_path: Path) -> None:
    """A device, a pipe, a folder and a file with a hole as large as a disk."""
    path = tmp_path / ("time_stamp.csv" if read is read_crazyswarm else "a.tlog")
    argument = tmp_path if read is read_crazyswarm else path
    path.symlink_to("/dev/zero")
    with pytest.raises(UserError, match="is no regular file"):
        read(argument)
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(UserError, match="is no regular file"):
        read(argument)
    path.unlink()
    path.touch()
    os.truncate(path, 1 << 40)
    with pytest.raises(UserError, match="1099511627776 bytes are too many for"):
        read(argument)


def test_a_folder_or_the_root_is_no_log() -> None:
    for path in (Path(), Path("/"), Path("/dev/zero")):
        with pytest.raises(UserError, match="is no regular file, expected a log"):
            load_flight(path)
