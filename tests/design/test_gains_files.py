"""Formation and gains files: strict on reading, deterministic on writing, believed by nobody."""

from __future__ import annotations

import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from groundstation.app.resources import packaged_configs
from groundstation.core.errors import UserError
from groundstation.core.formation import Formation, Gains
from groundstation.design.certify import certify
from groundstation.design.common_shapes import points_of
from groundstation.design.designer import design
from groundstation.design.mesh import mesh
from groundstation.design.store import StoredGains, check_gains, load_formation, load_gains, save_gains

CUBE = packaged_configs() / "formations" / "cube8.yaml"
CUBE_GAINS = packaged_configs() / "gains" / "cube8.npz"

GOOD = """
name: triangle
scale: 2
points: [[0, 0, 0], [1, 0, 0], [0, 1, 1]]
edges: [[3, 1], [1, 2], [2, 3]]
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "triangle.yaml"
    path.write_text(text)
    return path


def test_formation_is_scaled_sorted_and_counted_from_zero(tmp_path: Path) -> None:
    formation = load_formation(written(tmp_path, GOOD))
    assert formation.name == "triangle"
    assert formation.edges == ((0, 1), (0, 2), (1, 2))
    assert formation.points_enu_m.tolist() == [[0, 0, 0], [2, 0, 0], [0, 2, 2]]


def test_complete_graph_is_one_word(tmp_path: Path) -> None:
    text = GOOD.replace("[[3, 1], [1, 2], [2, 3]]", "complete")
    assert load_formation(written(tmp_path, text)).edges == ((0, 1), (0, 2), (1, 2))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("scale: 2", "size: 2", r"size: unknown key, remove it or correct"),
        ("scale: 2", "scale: -1", r"scale: expected a number above 0, got -1"),
        ("scale: 2", "scale: true", r"scale: expected a number, got True"),
        ("scale: 2", "scale: .nan", r"scale: .*finite"),
        ("name: triangle", "", r"name: is missing"),
        ("[1, 0, 0]", "[1, 0]", r"points\[1\]: .*at least 3"),
        ("[1, 0, 0]", "[1, 0, far]", r"points\[1\]\[2\]: .*got 'far'"),
        ("[3, 1]", "[4, 1]", r"edges\[0\]: there is no agent 4, points has 3"),
        ("[3, 1]", "[0, 1]", r"edges\[0\]\[0\]: .*at least 1"),
        ("[3, 1]", "[1, 1]", r"edges\[0\]: joins agent 1 to itself"),
        ("[3, 1]", "[2, 1]", r"edges\[1\]: 1 to 2 is already edges\[0\]"),
        ("[[3, 1], [1, 2], [2, 3]]", "all", r"edges: expected complete or a list, got 'all'"),
        ("scale: 2", "scale: [", r"not valid YAML"),
    ],
)
def test_wrong_formation_names_file_key_and_value(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = written(tmp_path, GOOD.replace(old, new))
    with pytest.raises(UserError, match=message) as caught:
        load_formation(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert caught.value.exit_code == 2


@pytest.mark.parametrize("content", [b"", b"3", b"[1, 2]", b"\xff\xfe\x00"])
def test_file_that_is_no_formation_is_a_message(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "f.yaml"
    path.write_bytes(content)
    with pytest.raises(UserError, match=r"f\.yaml: "):
        load_formation(path)


def saved(folder: Path, name: str = "cube.npz") -> tuple[Path, Formation]:
    formation = load_formation(CUBE)
    result = design(formation)
    assert result.gains is not None
    assert result.certificate is not None
    save_gains(folder / name, formation, result.gains, result.certificate, result.method)
    return folder / name, formation


def test_gains_survive_the_file_to_the_bit_and_files_are_reproducible(tmp_path: Path) -> None:
    first, formation = saved(tmp_path)
    second, _ = saved(tmp_path, "again.npz")
    assert first.read_bytes() == second.read_bytes()
    stored = load_gains(first)
    result = design(formation)
    assert result.gains is not None
    assert np.array_equal(stored.gains.xy, result.gains.xy)
    assert np.array_equal(stored.gains.z, result.gains.z)
    assert stored.edges == formation.edges
    certificate = check_gains(stored, formation)
    assert certificate.interval == pytest.approx((5.0, 5.0), abs=1e-6)


def test_arrays_of_the_contract_are_in_the_file() -> None:
    with np.load(CUBE_GAINS, allow_pickle=False) as archive:
        assert archive["xy"].shape == archive["z"].shape == (8, 8)
        assert archive["xy"].dtype == np.complex128
        assert archive["points"].shape == (8, 3)
        assert archive["edges"].min() == 1
        assert archive["edges"].shape == (12, 2)


@pytest.mark.parametrize("keep", [0, 1, 100, 1000, -1])
def test_truncated_gains_are_a_message(tmp_path: Path, keep: int) -> None:
    path = tmp_path / "cut.npz"
    path.write_bytes(CUBE_GAINS.read_bytes()[:keep])
    with pytest.raises(UserError, match=r"cut\.npz: no(t a)? gains file"):
        load_gains(path)


def test_flipped_bytes_never_pass(tmp_path: Path) -> None:
    whole = CUBE_GAINS.read_bytes()
    formation = load_formation(CUBE)
    sound = load_gains(CUBE_GAINS).gains
    path = tmp_path / "flipped.npz"
    for position in range(0, len(whole), 5):
        path.write_bytes(whole[:position] + bytes([whole[position] ^ 0x55]) + whole[position + 1 :])
        try:
            stored = load_gains(path)
            check_gains(stored, formation)
        except UserError:
            continue
        # bytes that the archive does not use: then nothing may have changed
        assert np.array_equal(stored.gains.xy, sound.xy)
        assert np.array_equal(stored.gains.z, sound.z)


def test_missing_file_says_how_to_make_it(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"none\.npz: no such file; make it with: gs design"):
        load_gains(tmp_path / "none.npz")


def test_pickles_are_not_loaded(tmp_path: Path) -> None:
    path = tmp_path / "pickle.npz"
    np.savez(path, xy=np.array([object()], dtype=object))
    with pytest.raises(UserError, match="gains file"):
        load_gains(path)


def test_archive_without_the_arrays_is_a_message(tmp_path: Path) -> None:
    path = tmp_path / "other.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("readme.txt", "hello")
    with pytest.raises(UserError, match=r"other\.npz: not a gains file: array xy is missing"):
        load_gains(path)


def altered(stored: StoredGains, xy: np.ndarray | None = None, z: np.ndarray | None = None) -> StoredGains:
    gains = Gains(xy=stored.gains.xy if xy is None else xy, z=stored.gains.z if z is None else z)
    return replace(stored, gains=gains)


def test_every_broken_property_is_found_and_named() -> None:
    stored, formation = load_gains(CUBE_GAINS), load_formation(CUBE)
    xy, z = stored.gains.xy, stored.gains.z
    unsymmetric = xy.copy()
    unsymmetric[0, 1] += 1e-3
    stray = z.copy()
    stray[0, 2] = stray[2, 0] = 1e-3
    rows = z + 1e-3 * np.eye(8)
    other_kernel = np.zeros((8, 8))
    for i, j in formation.edges:
        other_kernel[i, j] = other_kernel[j, i] = 1.0
    other_kernel -= np.diag(other_kernel.sum(axis=1))
    for broken, word in (
        (altered(stored, xy=unsymmetric), "not symmetric"),
        (altered(stored, z=stray), "agents 1 and 3 have a gain but no edge"),
        (altered(stored, z=rows), "row sums"),
        (altered(stored, z=other_kernel), "kernel residual"),
        (altered(stored, xy=-xy), "positive eigenvalue"),
        (altered(stored, z=np.zeros((8, 8))), "8 zero eigenvalues, the formation has 2"),
        (altered(stored, xy=0.5 * xy), "stored certificate does not fit"),
        (altered(stored, z=z * np.nan), "not finite"),
    ):
        with pytest.raises(UserError, match=word):
            check_gains(broken, formation)


def test_packaged_gains_are_sound() -> None:
    for path in sorted((packaged_configs() / "gains").glob("*.npz")):
        check_gains(load_gains(path), load_formation(packaged_configs() / "formations" / f"{path.stem}.yaml"))


@pytest.mark.parametrize("factor", [1e-12, 0.5, 1.001, 1e4])
def test_scale_of_a_matrix_is_checked_even_when_all_its_figures_fit(factor: float) -> None:
    stored, formation = load_gains(CUBE_GAINS), load_formation(CUBE)
    gains = Gains(xy=factor * stored.gains.xy, z=factor * stored.gains.z)
    figures = stored.claims * np.array([factor, factor, factor, 1.0, factor])
    with pytest.raises(UserError, match=r"fastest mode is .* designs have 10 1/s"):
        check_gains(replace(stored, gains=gains, claims=figures), formation)


@pytest.mark.parametrize("column", range(5))
@pytest.mark.parametrize("value", [0.5, -1.0, np.nan, np.inf])
def test_every_stored_figure_is_compared(column: int, value: float) -> None:
    stored, formation = load_gains(CUBE_GAINS), load_formation(CUBE)
    figures = stored.claims.copy()
    figures[1, column] = value
    with pytest.raises(UserError, match="stored certificate does not fit"):
        check_gains(replace(stored, claims=figures), formation)


def test_gains_of_another_scale_are_not_written(tmp_path: Path) -> None:
    formation = load_formation(CUBE)
    result = design(formation, spectral_norm=20.0)
    assert result.gains is not None
    assert result.certificate is not None
    with pytest.raises(UserError, match="designs have 10 1/s"):
        save_gains(tmp_path / "fast.npz", formation, result.gains, result.certificate, result.method)
    assert list(tmp_path.iterdir()) == []


def test_gains_of_another_formation_are_refused() -> None:
    stored, formation = load_gains(CUBE_GAINS), load_formation(CUBE)
    moved = formation.points_enu_m.copy()
    moved[2, 0] += 0.01
    graph = tuple(sorted({*formation.edges, (0, 6)}))
    for other, word in (
        (Formation("moved", moved, formation.edges), "agent 3 stands 0.01 m from where moved has it"),
        (Formation("joined", formation.points_enu_m, graph), "edge 1 to 7 is missing from the gains of joined"),
        (Formation("cut", formation.points_enu_m, formation.edges[1:]), "edge 1 to 2 is not in cut"),
        (Formation("pair", formation.points_enu_m[:2], ((0, 1),)), "they are for 8 agents, pair has 2"),
    ):
        with pytest.raises(UserError, match=f"gains of another formation: {word}") as caught:
            check_gains(stored, other)
        assert str(CUBE_GAINS) in str(caught.value)


def test_unsound_gains_are_never_written(tmp_path: Path) -> None:
    formation = load_formation(CUBE)
    zero = Gains(xy=np.zeros((8, 8), dtype=np.complex128), z=np.zeros((8, 8)))
    certificate = certify(formation, zero, np.zeros((8, 8)), np.zeros((8, 8)))
    with pytest.raises(UserError, match="not stored, the gains are no design for cube8"):
        save_gains(tmp_path / "bad.npz", formation, zero, certificate, "none")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name: a\nname: b\npoints: [[0, 0, 0]]\nedges: complete\n", "key 'name' is given twice"),
        ("[" * 5000, "is not valid YAML"),
    ],
    ids=["key given twice", "nested too deep"],
)
def test_formation_files_are_read_as_strictly_as_missions(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "formation.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(UserError, match=r"formation\.yaml") as caught:
        load_formation(path)
    assert message in str(caught.value)


def test_gains_of_a_large_sparse_graph_are_stored_by_their_edges_and_checked_as_all_others(tmp_path: Path) -> None:
    formation = mesh(Formation("cube", points_of("cube", 150), ((0, 1),)))
    result = design(formation, method="triangles")
    assert result.gains is not None
    assert result.certificate is not None
    path = tmp_path / "gains.npz"
    save_gains(path, formation, result.gains, result.certificate, result.method)
    assert path.stat().st_size < 80_000  # whole matrices and duals take 160,000
    stored = load_gains(path)
    np.testing.assert_allclose(stored.gains.xy, result.gains.xy, atol=1e-13)
    np.testing.assert_allclose(stored.gains.z, result.gains.z, atol=1e-13)
    certificate = check_gains(stored, formation)
    assert certificate.xy.slowest == pytest.approx(result.certificate.xy.slowest, rel=1e-6)
    arrays = dict(np.load(path))
    for name, wrong in (
        ("xy", arrays["xy"][:-1]),
        ("z", arrays["z"].astype(np.complex128)),
        ("edges", arrays["edges"] + 150),
    ):
        np.savez(tmp_path / "wrong.npz", **{**arrays, name: wrong})
        with pytest.raises(UserError, match=f"not a gains file: array {name}"):
            load_gains(tmp_path / "wrong.npz")
    np.savez(tmp_path / "wrong.npz", **{**arrays, "xy": 1.1 * arrays["xy"]})
    with pytest.raises(UserError, match="the file was altered"):
        check_gains(load_gains(tmp_path / "wrong.npz"), formation)
