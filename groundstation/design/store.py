"""Formation files and gains files.

Reads what people write, strictly: an unknown key, an edge out of range or a gains file that does not belong to its
formation is a ``UserError`` that names file, key and remedy. Never unpickles. Stores only what carries a certificate,
and believes no certificate on reading: ``check_gains`` computes it again.
"""

from __future__ import annotations

import io
import math
import struct
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, FiniteFloat

from groundstation.core.errors import UserError
from groundstation.core.files import read_yaml, validate
from groundstation.core.findings import no_boolean
from groundstation.core.formation import Formation, Gains
from groundstation.core.own_files import write_whole
from groundstation.core.types import ComplexArray, FloatArray
from groundstation.design.certify import RESIDUAL_LIMIT, BlockCertificate, Certificate, certify, faults
from groundstation.design.problem import SPECTRAL_NORM, Matrix

FILE_VERSION, SPARSE_VERSION = 1, 2
"""Layouts of a gains file: whole matrices; or of large sparse graphs the entries on the edges alone, without duals."""
SPARSE_MIN = 128
"""Agents above which gains without a dual are stored by their edges."""
_MEMBERS_MAX = 32
_SPARSE_MAX = 2_000  # agents: as many as a formation file may have
_BYTES_MAX = 1 << 28  # unpacked; a thousand agents need 48 MB
CLAIM_TOLERANCE = 1e-6
"""Stored eigenvalues may differ from recomputed ones by this much of the spectral norm, and so may that itself."""

DAMAGE = (
    OSError,
    ValueError,
    EOFError,
    KeyError,
    AttributeError,
    RuntimeError,
    MemoryError,
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
)
"""What numpy and zipfile raise on files that are cut, altered or no archives at all."""


# Beyond a million kilometres nothing flies, and products of what is read stay numbers.
Number = Annotated[FiniteFloat, BeforeValidator(no_boolean), Field(ge=-1e9, le=1e9)]
Positive = Annotated[FiniteFloat, BeforeValidator(no_boolean), Field(gt=0, le=1e9)]
Agent = Annotated[int, Field(strict=True, ge=1)]


class FormationFile(BaseModel):
    """A formation as written: positions in ENU metres before scaling, agents counted from 1.

    Attributes:
        name: for messages.
        scale: multiplies points.
        points: one [x, y, z] per agent, agent 1 first.
        edges: pairs of agents, or ``complete``.
        avoidance_radius_m: safety radius with which the formation was flown; a mission sets its own.
        avoidance_activation_m: activation distance with which it was flown.
    """

    model_config = ConfigDict(extra="forbid")

    name: Annotated[str, Field(strict=True, min_length=1)]
    scale: Positive = 1.0
    points: Annotated[
        list[Annotated[list[Number], Field(min_length=3, max_length=3)]], Field(min_length=1, max_length=2_000)
    ]
    edges: Literal["complete"] | list[Annotated[list[Agent], Field(min_length=2, max_length=2)]]
    avoidance_radius_m: Positive | None = None
    avoidance_activation_m: Positive | None = None


def load_formation_file(path: Path) -> FormationFile:
    """Reads a formation file as it is written.

    Raises:
        UserError: unreadable, not YAML, an unknown key, a wrong type or an impossible edge; names file and key.
    """
    file = validate(FormationFile, read_yaml(path), str(path))
    check_edges(str(path), file)
    return file


def load_formation(path: Path) -> Formation:
    """Reads a formation: scale applied, agents counted from 0, edges sorted.

    Raises:
        UserError: as ``load_formation_file``.
    """
    return to_formation(load_formation_file(path))


def to_formation(file: FormationFile) -> Formation:
    """Applies the scale, counts agents from 0 and sorts the edges of a checked formation file."""
    points = np.array(file.points, dtype=np.float64) * file.scale
    n = len(points)
    if file.edges == "complete":
        pairs = [(i, j) for i in range(n) for j in range(i + 1, n)]
    else:
        pairs = sorted((min(i, j) - 1, max(i, j) - 1) for i, j in file.edges)
    return Formation(name=file.name, points_enu_m=points, edges=tuple(pairs))


def check_edges(path: str, file: FormationFile) -> None:
    """Makes sure that edges join agents that there are, each pair once.

    Args:
        path: for messages.
        file: the formation.

    Raises:
        UserError: which edge, and why not.
    """
    if file.edges == "complete":
        return
    seen: dict[tuple[int, int], int] = {}
    for index, (i, j) in enumerate(file.edges):
        if max(i, j) > len(file.points):
            raise UserError(f"{path}: edges[{index}]: there is no agent {max(i, j)}, points has {len(file.points)}")
        if i == j:
            raise UserError(f"{path}: edges[{index}]: joins agent {i} to itself; remove it")
        pair = (min(i, j), max(i, j))
        if pair in seen:
            raise UserError(f"{path}: edges[{index}]: {i} to {j} is already edges[{seen[pair]}]; remove one")
        seen[pair] = index


@dataclass(frozen=True)
class StoredGains:
    """A gains file as read, unchecked beyond its layout.

    Attributes:
        path: where it was read, for messages.
        gains: the matrices.
        points_enu_m: formation they were designed for, shape (n, 3), ENU metres.
        edges: its graph, counted from 0.
        dual_xy: dual matrix of the horizontal block, shape (n, n), see ``design.certify``.
        dual_z: dual matrix of the vertical block, shape (n, n).
        claims: the stored figures: rows xy and z, columns slowest, fastest, bound, zeros, residual, shape (2, 5).
        method: what found the gains.
    """

    path: Path
    gains: Gains
    points_enu_m: FloatArray
    edges: tuple[tuple[int, int], ...]
    dual_xy: ComplexArray
    dual_z: FloatArray
    claims: FloatArray
    method: str


def save_gains(
    path: Path,
    formation: Formation,
    gains: Gains,
    certificate: Certificate,
    method: str,
    *,
    spectral_norm: float = SPECTRAL_NORM,
) -> None:
    """Writes a gains file; the same values give the same bytes, and a crash leaves the old file whole.

    Args:
        path: ``.npz`` to write.
        formation: what the gains are for.
        gains: the matrices.
        certificate: their proof.
        method: what found them.
        spectral_norm: fastest mode that they were designed for, 1/s.

    Raises:
        UserError: the gains are no design for this formation (nothing is written), or the file cannot be written.
    """
    found = faults(formation, gains, certificate) + _wrong_scale(certificate, spectral_norm)
    if found:
        raise UserError(f"{path}: not stored, the gains are no design for {formation.name}: {'; '.join(found)}")
    members: dict[str, NDArray[np.generic]] = {
        "xy": gains.xy,
        "z": gains.z,
        "points": formation.points_enu_m,
        "edges": np.array(formation.edges, dtype=np.int64).reshape(-1, 2) + 1,
        "certificate": claims(certificate),
        "dual_xy": np.asarray(certificate.xy.dual, dtype=np.complex128),
        "dual_z": np.asarray(certificate.z.dual, dtype=np.float64),
        "method": np.array(method),
        "version": np.array(FILE_VERSION),
    }
    if formation.size > SPARSE_MIN and not members["dual_xy"].any() and not members["dual_z"].any():
        first, second = members["edges"].T - 1
        members["edges"] = members["edges"].astype(np.uint16)
        members |= {"xy": gains.xy[first, second], "z": gains.z[first, second], "version": np.array(SPARSE_VERSION)}
        del members["dual_xy"], members["dual_z"]
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive:
        for name, values in members.items():
            info = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            info.create_system, info.external_attr = 3, 0o644 << 16
            info.compress_type = zipfile.ZIP_DEFLATED
            buffer = io.BytesIO()
            np.lib.format.write_array(buffer, np.asarray(values, order="C"), version=(1, 0), allow_pickle=False)
            archive.writestr(info, buffer.getvalue())
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, content.getvalue(), durable=False)
    except OSError as error:
        raise UserError(f"{path}: cannot be written ({error.strerror}); choose another place with -o") from error


def claims(certificate: Certificate) -> FloatArray:
    """The figures of a certificate as stored, shape (2, 5); see ``StoredGains.claims``."""
    return np.array(
        [[b.slowest, b.fastest, b.bound, b.zeros, b.residual] for b in (certificate.xy, certificate.z)],
        dtype=np.float64,
    )


def load_gains(path: Path) -> StoredGains:
    """Reads a gains file; call ``check_gains`` before using it.

    Raises:
        UserError: missing, truncated, not a gains file, or with arrays of wrong shapes.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            arrays = {info.filename.removesuffix(".npy"): _read_array(archive, info) for info in _members(archive)}
    except FileNotFoundError as error:
        raise UserError(f"{path}: no such file; make it with: gs design FORMATION.yaml -o {path}") from error
    except DAMAGE as error:
        raise UserError(f"{path}: no gains file, or a damaged one ({error}); make it again with gs design") from error
    try:
        return _unpack(path, arrays)
    except (KeyError, ValueError, TypeError) as error:
        raise UserError(f"{path}: not a gains file: {error}; make it again with gs design") from error


def _members(archive: zipfile.ZipFile) -> list[zipfile.ZipInfo]:
    members = [info for info in archive.infolist() if info.filename.endswith(".npy")]
    size = sum(info.file_size for info in members)
    if len(members) > _MEMBERS_MAX or size > _BYTES_MAX:
        raise ValueError(
            f"{len(members)} arrays of {size} bytes unpacked, limits {_MEMBERS_MAX} and {_BYTES_MAX}: no gains file"
        )
    return members


def _read_array(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> NDArray[np.generic]:
    """Reads one array whose header claims no more than its bytes hold; never unpickles."""
    with archive.open(info) as member:
        content = member.read(info.file_size)  # a member that holds more than it says fails its checksum here
    buffer = io.BytesIO(content)
    version = np.lib.format.read_magic(buffer)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"array {info.filename} has format {version}, expected 1.0 or 2.0")
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read_header(buffer)
    if dtype.hasobject or math.prod(shape) * dtype.itemsize != len(content) - buffer.tell():
        raise ValueError(f"array {info.filename} claims {shape} of {dtype}, which is not what it holds")
    buffer.seek(0)
    values: NDArray[np.generic] = np.lib.format.read_array(buffer, allow_pickle=False)
    return values


def _spread(arrays: dict[str, NDArray[np.generic]]) -> dict[str, NDArray[np.generic]]:
    """Whole matrices of entries on the edges: Hermitian, the diagonal minus the row sums, and no dual."""
    n, edges = len(np.atleast_1d(arrays["points"])), _numbers(arrays, "edges", (-1, 2)).astype(np.int64) - 1
    if edges.size and not (edges.min() >= 0 and edges.max() < n and bool((edges[:, 0] != edges[:, 1]).all())):
        raise ValueError("array edges names an agent that does not exist")
    if n > _SPARSE_MAX:
        raise ValueError(f"array points has {n} agents, limit {_SPARSE_MAX}")
    whole: dict[str, NDArray[np.generic]] = {}
    for name in ("xy", "z"):
        entries = arrays[name]
        if entries.shape != (len(edges),) or entries.dtype.kind not in ("fiuc" if name == "xy" else "fiu"):
            raise ValueError(f"array {name} is {entries.shape} of {entries.dtype}, expected a number for each edge")
        matrix = np.zeros((n, n), dtype=np.complex128 if name == "xy" else np.float64)
        matrix[edges[:, 0], edges[:, 1]] = entries
        matrix[edges[:, 1], edges[:, 0]] = np.conj(entries)
        matrix[np.diag_indices(n)] = -matrix.sum(axis=1).real
        whole[name] = matrix
        whole[f"dual_{name}"] = np.zeros((n, n), dtype=matrix.dtype)
    return {**arrays, **whole, "version": np.array(FILE_VERSION)}


def _unpack(path: Path, arrays: dict[str, NDArray[np.generic]]) -> StoredGains:
    if {"points", "edges", "xy", "z", "version"} <= set(arrays) and arrays["version"] == SPARSE_VERSION:
        arrays = _spread(arrays)
    for name in ("xy", "z", "points", "edges", "certificate", "dual_xy", "dual_z", "method", "version"):
        if name not in arrays:
            raise ValueError(f"array {name} is missing")
    if int(_numbers(arrays, "version", ())) != FILE_VERSION:
        raise ValueError(
            f"version {arrays['version']} is unknown, this program reads {FILE_VERSION} and {SPARSE_VERSION}"
        )
    n = len(np.atleast_1d(arrays["points"]))
    edges = _numbers(arrays, "edges", (-1, 2))
    if edges.size and (np.any(edges != np.round(edges)) or edges.min() < 1 or edges.max() > n):
        raise ValueError("array edges names an agent that does not exist")
    pairs = tuple((int(i) - 1, int(j) - 1) for i, j in edges)
    return StoredGains(
        path=path,
        gains=Gains(xy=_entries(arrays, "xy", n), z=_numbers(arrays, "z", (n, n))),
        points_enu_m=_numbers(arrays, "points", (n, 3)),
        edges=pairs,
        dual_xy=_entries(arrays, "dual_xy", n),
        dual_z=_numbers(arrays, "dual_z", (n, n)),
        claims=_numbers(arrays, "certificate", (2, 5)),
        method=str(arrays["method"]),
    )


def _entries(arrays: dict[str, NDArray[np.generic]], name: str, n: int) -> ComplexArray:
    values = arrays[name]
    if values.shape != (n, n) or values.dtype.kind not in "fiuc":
        raise ValueError(f"array {name} is {values.shape} of {values.dtype}, expected ({n}, {n}) of complex numbers")
    return values.astype(np.complex128)


def _numbers(arrays: dict[str, NDArray[np.generic]], name: str, shape: tuple[int, ...]) -> FloatArray:
    values = arrays[name]
    fits = values.ndim == len(shape) and all(want in (-1, have) for want, have in zip(shape, values.shape, strict=True))
    if not fits or values.dtype.kind not in "fiu":
        raise ValueError(f"array {name} has shape {values.shape} of {values.dtype}, expected {shape} of real numbers")
    return values.astype(np.float64)


def _wrong_scale(certificate: Certificate, spectral_norm: float) -> list[str]:
    """Blocks whose fastest mode is not the one that all designs have: nothing else fixes the scale of a matrix."""
    return [
        f"{name}: the fastest mode is {block.fastest:.6g} 1/s, designs have {spectral_norm:g} 1/s"
        for name, block in (("xy", certificate.xy), ("z", certificate.z))
        if np.isfinite(block.slowest) and not abs(block.fastest - spectral_norm) <= CLAIM_TOLERANCE * spectral_norm
    ]


def check_gains(stored: StoredGains, formation: Formation, spectral_norm: float = SPECTRAL_NORM) -> Certificate:
    """Checks a gains file against the formation that is to be flown, and against itself.

    Belonging: same coordinates, same edges. Soundness: kernel, symmetry, structure (3), pattern, spectrum, scale; the
    stored figures are compared with recomputed ones.

    Args:
        stored: what ``load_gains`` read.
        formation: what is to be flown.
        spectral_norm: fastest mode that the gains were designed for, 1/s.

    Returns:
        The recomputed certificate.

    Raises:
        UserError: file and reason.
    """
    where = stored.path
    mend = f"make new ones with: gs design {formation.name}.yaml -o NEW.npz, and name that file"
    if len(stored.points_enu_m) != formation.size:
        raise UserError(
            f"{where}: gains of another formation: they are for {len(stored.points_enu_m)} agents, "
            f"{formation.name} has {formation.size}; {mend}"
        )
    size_m = max(float(np.max(np.abs(formation.points_enu_m))), 1e-300)
    apart = np.max(np.abs(stored.points_enu_m - formation.points_enu_m), axis=1)
    # a coordinate may have gone through a decimal file, no more
    if not np.all(apart <= 1e-9 * size_m):
        worst = int(np.argmax(apart)) + 1
        raise UserError(
            f"{where}: gains of another formation: agent {worst} stands {np.max(apart):.3g} m from where "
            f"{formation.name} has it; {mend}"
        )
    extra, missing = set(stored.edges) - set(formation.edges), set(formation.edges) - set(stored.edges)
    if extra or missing:
        i, j = sorted(extra or missing)[0]
        kind = "not in" if extra else "missing from the gains of"
        edge = f"edge {i + 1} to {j + 1} is {kind} {formation.name}"
        raise UserError(f"{where}: gains of another formation: {edge}; {mend}")
    arrays: list[Matrix] = [stored.gains.xy, stored.gains.z, stored.dual_xy, stored.dual_z]
    if not all(np.all(np.isfinite(values)) for values in arrays):
        raise UserError(f"{where}: the gains contain a number that is not finite; {mend}")
    certificate = certify(formation, stored.gains, stored.dual_xy, stored.dual_z)
    found = faults(formation, stored.gains, certificate)
    if found:
        raise UserError(f"{where}: no sound design: {'; '.join(found)}; {mend}")
    parts = (certificate.xy, certificate.z)
    if any(_differ(part, claim) for part, claim in zip(parts, stored.claims, strict=True)):
        raise UserError(f"{where}: the stored certificate does not fit the gains, the file was altered; {mend}")
    found = _wrong_scale(certificate, spectral_norm)
    if found:
        raise UserError(f"{where}: no sound design: {'; '.join(found)}; {mend}")
    return certificate


def _differ(figures: BlockCertificate, claim: FloatArray) -> bool:
    """Whether stored figures are not those of the matrix; rounding differs from one machine to the next."""
    now = np.array([figures.slowest, figures.fastest, figures.bound, figures.zeros, figures.residual])
    norm = max(figures.fastest, 1.0)
    allowed = norm * np.array([CLAIM_TOLERANCE] * 3 + [0.0, RESIDUAL_LIMIT])
    with np.errstate(invalid="ignore"):
        return not bool(np.all((now == claim) | (np.abs(now - claim) <= allowed)))
