"""Key files: what is taken, what is refused, and that a message never holds what it must not."""

from __future__ import annotations

import base64
import json
import os
from hashlib import sha256
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.core.errors import UserError
from groundstation.mavlink.keys import new_key, read_key, read_times, times_path, write_times
from groundstation.mavlink.signing import SecretKey, Times

SECRET = bytes(range(100, 132))


def _file(folder: Path, content: bytes, mode: int = 0o600) -> Path:
    path = folder / "team.key"
    path.write_bytes(content)
    path.chmod(mode)
    return path


@pytest.mark.parametrize(
    ("content", "secret"),
    [
        (SECRET, SECRET),
        (SECRET.hex().encode() + b"\n", SECRET),
        (SECRET.hex().upper().encode(), SECRET),
        (base64.b64encode(SECRET) + b"\n", SECRET),
        (b"passphrase: correct horse\n", sha256(b"correct horse").digest()),
        ("passphrase: zwölf Boxkämpfer".encode(), sha256("zwölf Boxkämpfer".encode()).digest()),
    ],
)
def test_forms_of_a_key(tmp_path: Path, content: bytes, secret: bytes) -> None:
    assert read_key(_file(tmp_path, content)) == SecretKey(secret)


@pytest.mark.parametrize(
    "content",
    [b"", SECRET[:31], SECRET + b"x", SECRET.hex()[:-1].encode(), SECRET.hex().encode() + b"0", b"correct horse"],
)
def test_a_key_that_lost_or_won_a_byte_is_refused_and_not_shown(tmp_path: Path, content: bytes) -> None:
    with pytest.raises(UserError, match=f"{len(content)} bytes are no key; expected 32 raw bytes") as error:
        read_key(_file(tmp_path, content))
    assert content == b"" or repr(content)[2:10] not in str(error.value)


@pytest.mark.parametrize("content", [bytes(32), b"0" * 64, base64.b64encode(bytes(32))])
def test_the_key_that_stands_for_no_signing_is_refused(tmp_path: Path, content: bytes) -> None:
    with pytest.raises(UserError, match="32 bytes of zero are what MAVLink takes for no key at all"):
        read_key(_file(tmp_path, content))
    assert read_key(_file(tmp_path, bytes(31) + b"\1")) == SecretKey(bytes(31) + b"\1")


def test_an_empty_passphrase_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="passphrase is empty"):
        read_key(_file(tmp_path, b"passphrase:  \n"))


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o602, 0o610, 0o601, 0o777])
def test_whoever_else_may_read_or_change_it_the_file_is_refused(tmp_path: Path, mode: int) -> None:
    path = _file(tmp_path, SECRET, mode)
    with pytest.raises(UserError, match=f"has mode {mode:04o}, .* chmod 600 {path}"):
        read_key(path)


def test_what_is_no_plain_file_is_refused(tmp_path: Path) -> None:
    key = _file(tmp_path, SECRET)
    link = tmp_path / "link.key"
    link.symlink_to(key)
    with pytest.raises(UserError, match=f"symbolic link; name the key file itself, {key}"):
        read_key(link)
    os.link(key, tmp_path / "second.key")
    with pytest.raises(UserError, match="has 2 names"):
        read_key(key)
    os.mkfifo(tmp_path / "pipe.key", 0o600)
    with pytest.raises(UserError, match="no plain file"):  # and nobody waits for a writer
        read_key(tmp_path / "pipe.key")
    with pytest.raises(UserError, match="plain file"):
        read_key(tmp_path)
    with pytest.raises(UserError, match=r"no such key file; make one with: gs signing new"):
        read_key(tmp_path / "none.key")


def test_a_file_of_somebody_else_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = _file(tmp_path, SECRET)
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    with pytest.raises(UserError, match="belongs to user"):
        read_key(path)


def test_a_large_file_is_not_read(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="2000 bytes are no key, limit 1024"):
        read_key(_file(tmp_path, bytes(2000)))


def test_new_keys_are_for_the_owner_alone_differ_and_replace_nothing(tmp_path: Path) -> None:
    old_mask = os.umask(0)
    try:
        new_key(tmp_path / "a.key")
    finally:
        os.umask(old_mask)
    new_key(tmp_path / "b.key")
    assert (tmp_path / "a.key").stat().st_mode & 0o777 == 0o600
    assert read_key(tmp_path / "a.key") != read_key(tmp_path / "b.key")
    with pytest.raises(UserError, match="not written over"):
        new_key(tmp_path / "a.key")
    (tmp_path / "c.key").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(UserError, match="not written over"):
        new_key(tmp_path / "c.key")


def test_times_come_back_as_they_were_with_what_may_be_used_until_the_next_writing(tmp_path: Path) -> None:
    path = times_path(tmp_path / "team.key")
    assert path.name == "team.key.times"
    assert read_times(path) == Times()
    write_times(path, Times(100, 90, {(1, 1, 0): 80, (2, 1, 5): 85}), 1000, durable=True)
    assert read_times(path) == Times(1100, 90, {(1, 1, 0): 80, (2, 1, 5): 85})
    assert path.stat().st_mode & 0o777 == 0o600


@given(content=st.binary(max_size=200) | st.recursive(
    st.none() | st.integers() | st.text(max_size=5) | st.floats(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from(["sent", "newest", "streams"]), inner),
).map(lambda value: json.dumps(value).encode()))  # fmt: skip
def test_damaged_times_are_an_error_with_a_remedy_and_never_believed(
    tmp_path_factory: pytest.TempPathFactory, content: bytes
) -> None:
    path = tmp_path_factory.mktemp("times") / "t"
    path.write_bytes(content)
    try:
        times = read_times(path)
    except UserError as error:
        told = str(error)
        assert "remove the file" in told
    else:
        assert 0 <= times.sent < 1 << 48
        assert all(0 <= stamp < 1 << 48 for stamp in times.streams.values())
