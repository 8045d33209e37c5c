"""The other end of ``order_socket``: finds the flights of this user and asks them things.

Imports little, so that an order does not wait for the rest of the program to be loaded.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from groundstation.app.output import to_json

ANSWERS_MAX = 1 << 16
"""Longest answer, bytes."""
_CREDENTIALS = struct.Struct("3i")  # pid, uid, gid


def runtime_folder(environment: Mapping[str, str], home: Path) -> Path:
    """Where the sockets of a user's flights lie.

    Args:
        environment: the process's; XDG_RUNTIME_DIR is the user's own folder for such things where there is one.
        home: the user's own folder.
    """
    given = environment.get("XDG_RUNTIME_DIR", "")
    return Path(given) / "gs" if given.startswith("/") and Path(given).is_dir() else home / ".gs" / "run"


def is_ours(item: socket.socket) -> bool:
    """Whether the other end is a process of the same user, as the kernel says; by the folder alone elsewhere."""
    option = getattr(socket, "SO_PEERCRED", None)
    if option is None:
        return True
    try:
        _, uid, _ = _CREDENTIALS.unpack(item.getsockopt(socket.SOL_SOCKET, option, _CREDENTIALS.size))
    except OSError:
        return False
    return bool(uid == os.geteuid())


def remove_stale(folder: Path) -> None:
    """Removes the sockets of flights that ended without cleaning up."""
    for path in folder.glob("*.sock"):
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
            probe.setblocking(False)
            try:
                probe.connect(str(path))
            except (ConnectionRefusedError, FileNotFoundError):
                path.unlink(missing_ok=True)
            except BlockingIOError:
                pass  # its backlog is full: somebody is there


def one_line(values: Mapping[str, Any]) -> bytes:
    """Encodes one line of JSON; what is no Unicode (a file's name, half a surrogate) is escaped."""
    return to_json(values).encode("utf-8", "backslashreplace") + b"\n"


def ask(path: Path, request: Mapping[str, Any], timeout_s: float) -> dict[str, Any]:
    """Sends one line to a flight and waits for its answer: the client's side.

    Raises:
        OSError: nobody is there, or it is somebody else's, or it does not answer in time.
        ValueError: what it answers is no answer.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as item:
        item.settimeout(timeout_s)
        item.connect(str(path))
        if not is_ours(item):
            raise PermissionError(f"{path} belongs to another user's program")
        item.sendall(one_line(request))
        data = b""
        while not data.endswith(b"\n"):
            piece = item.recv(4096)
            if not piece or len(data) > ANSWERS_MAX:
                raise ConnectionAbortedError("the flight ended before it answered")
            data += piece
    values = json.loads(data)
    if not isinstance(values, dict):
        raise ValueError(f"{path}: no answer of a flight")
    return values


def flights(folder: Path, timeout_s: float = 2.0) -> tuple[list[tuple[Path, dict[str, Any]]], Sequence[Path]]:
    """Flights that are under way, and sockets whose flight does not answer."""
    found, silent = [], []
    if folder.is_dir():
        remove_stale(folder)
        for path in sorted(folder.glob("*.sock")):
            try:
                found.append((path, ask(path, {"about": True}, timeout_s)))
            except (OSError, ValueError):
                silent.append(path)
    return found, silent
