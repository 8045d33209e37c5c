"""Signing keys and time stamps in files: only the owner's own, and nothing of a key in any message.

A key file holds one of: 32 raw bytes; 64 hexadecimal digits; base64 of 32 bytes; or ``passphrase: WORDS``, of which the
SHA-256 (UTF-8) is the key, as Mission Planner, QGroundControl and MAVProxy make it from what is typed there. A
passphrase has to say that it is one, so that a key that lost a digit is an error and not another key.

Refuses files that anybody else could read or might have put there, and the key of zeros that everybody knows.
"""

from __future__ import annotations

import base64
import binascii
import contextlib
import errno
import json
import os
import secrets
import stat
import string
from hashlib import sha256
from pathlib import Path

from groundstation.core.errors import UserError
from groundstation.core.own_files import write_whole
from groundstation.mavlink.signing import ADOPTED_MAX, KEY_BYTES, LATEST, SecretKey, Times

_FILE_MAX = 1_024
_TIMES_MAX = 1 << 20
_PASSPHRASE = b"passphrase:"
_FORMS = f"{KEY_BYTES} raw bytes, {2 * KEY_BYTES} hexadecimal digits, base64 of {KEY_BYTES} bytes, or passphrase: WORDS"


def read_key(path: Path) -> SecretKey:
    """Reads a key file.

    Raises:
        UserError: no such file, a link instead of a file, another owner, readable by others, or no key in it; with the
            file, what is wrong and what to do.
    """
    try:
        # Opened first and judged by its descriptor, so that what is judged is what is read.
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except FileNotFoundError:
        raise UserError(f"{path}: no such key file; make one with: gs signing new {path}") from None
    except ValueError:
        raise UserError(f"{str(path)!r}: is no name of a file; correct key_file") from None
    except OSError as error:
        if error.errno == errno.ELOOP:
            raise UserError(f"{path}: is a symbolic link; name the key file itself, {path.resolve()}") from None
        raise UserError(f"{path}: the key file cannot be opened: {error.strerror or error}") from None
    try:
        _judge(path, os.fstat(descriptor))
        content = os.read(descriptor, _FILE_MAX + 1)
    finally:
        os.close(descriptor)
    secret = _secret_in(path, content)
    if not any(secret):
        raise UserError(
            f"{path}: {KEY_BYTES} bytes of zero are what MAVLink takes for no key at all, anybody could sign with it;"
            " make a key: gs signing new"
        )
    return SecretKey(secret)


def _judge(path: Path, found: os.stat_result) -> None:
    if not stat.S_ISREG(found.st_mode):
        raise UserError(f"{path}: is no plain file; keep the key in a file of its own")
    if found.st_uid != os.geteuid():
        raise UserError(
            f"{path}: belongs to user {found.st_uid}, not to you ({os.geteuid()}), who could change it; make a copy of"
            " your own"
        )
    mode = stat.S_IMODE(found.st_mode)
    if mode & 0o077:
        raise UserError(
            f"{path}: has mode {mode:04o}, others may read or change it, limit 0600; make the key safe with:"
            f" chmod 600 {path}, and a new one if somebody may have seen it"
        )
    if found.st_nlink > 1:
        raise UserError(f"{path}: has {found.st_nlink} names (hard links), limit 1; make a copy of its own")
    if found.st_size > _FILE_MAX:
        raise UserError(f"{path}: {found.st_size} bytes are no key, limit {_FILE_MAX}; expected {_FORMS}")


def _secret_in(path: Path, content: bytes) -> bytes:
    """The key in a file's content; errors tell lengths, never content."""
    if content.startswith(_PASSPHRASE):
        words = content.removeprefix(_PASSPHRASE).strip()
        if not words:
            raise UserError(f"{path}: the passphrase is empty; write words behind it, or make a key: gs signing new")
        return sha256(words).digest()
    text = content.strip()
    if len(text) == 2 * KEY_BYTES and all(digit in string.hexdigits.encode() for digit in text):
        return bytes.fromhex(text.decode())
    if len(content) == KEY_BYTES:
        return content
    with contextlib.suppress(binascii.Error, ValueError):
        secret = base64.b64decode(text, validate=True)
        if len(secret) == KEY_BYTES:
            return secret
    raise UserError(f"{path}: {len(content)} bytes are no key; expected {_FORMS}")


def new_key(path: Path) -> None:
    """Makes a key of random bits and writes it as hexadecimal digits, for the owner alone.

    Raises:
        UserError: there is such a file already, or it cannot be made.
    """
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    except FileExistsError:
        raise UserError(f"{path}: exists and is not written over; name another file") from None
    except OSError as error:
        raise UserError(f"{path}: cannot be made: {error.strerror or error}; name another place") from None
    with os.fdopen(descriptor, "w", encoding="ascii") as file:
        os.fchmod(descriptor, 0o600)
        file.write(secrets.token_hex(KEY_BYTES) + "\n")
        file.flush()
        os.fsync(descriptor)


def times_path(key_file: Path) -> Path:
    """Where the time stamps of a key are kept: ``team.key`` -> ``team.key.times``, in the same folder."""
    return key_file.with_name(key_file.name + ".times")


def read_times(path: Path) -> Times:
    """Reads what earlier flights with a key left; nothing where there were none.

    Raises:
        UserError: it cannot be read, or is damaged.
    """
    try:
        with path.open("rb") as file:
            content = file.read(_TIMES_MAX + 1)
    except FileNotFoundError:
        return Times()
    except OSError as error:
        raise UserError(
            f"{path}: the time stamps of earlier flights cannot be read: {error.strerror or error}"
        ) from None
    try:
        values = json.loads(content)
        times = Times(
            sent=_stamp(values["sent"], ADOPTED_MAX),
            newest=_stamp(values["newest"], ADOPTED_MAX),
            streams={(_byte(s), _byte(c), _byte(k)): _stamp(t) for s, c, k, t in values["streams"]},
        )
    except (ValueError, KeyError, TypeError, RecursionError):
        raise UserError(
            f"{path}: is damaged, the time stamps of earlier flights are not known; if this computer's clock is right,"
            " remove the file"
        ) from None
    return times


def write_times(path: Path, times: Times, ahead: int, *, durable: bool) -> None:
    """Writes what the next flight with a key has to know, whole or not at all.

    Args:
        path: see ``times_path``.
        times: as of now.
        ahead: time stamps that may be used before the next writing: the next flight begins behind them.
        durable: whether to wait until it is on the disk.

    Raises:
        OSError: it cannot be written; what was there before is left as it was.
    """
    values = {
        "sent": min(times.sent + ahead, LATEST),
        "newest": times.newest,
        "streams": [[*stream, stamp] for stream, stamp in sorted(times.streams.items())],
    }
    write_whole(path, json.dumps(values).encode("ascii"), mode=0o600, durable=durable)


def _stamp(value: object, limit: int = LATEST) -> int:
    if type(value) is not int or not 0 <= value <= limit:
        raise ValueError("no time stamp")
    return value


def _byte(value: object) -> int:
    if type(value) is not int or not 0 <= value <= 0xFF:
        raise ValueError("no byte")
    return value
