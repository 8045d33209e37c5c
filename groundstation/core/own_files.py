"""Files that this program writes: whole or not at all, through no link, and one writer at a time.

A name that is a symbolic link, or a file that has other names too, leads to somebody else's file: nothing is written
through it. Folders may be links; people move their flights to other disks. Locks are the system's own, which end with
the program that holds them, however it ends. Refuses to know what is in the files, and who may replace what.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import stat
from collections.abc import Callable, Iterator
from pathlib import Path

from groundstation.core.errors import UserError

_MADE = os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
_NAME_MAX = 255  # bytes of one name, of all usual disks
_PART = ".{}.part"  # what a file is called until it is whole
_NO_LOCKS = (errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS)


def require_name(path: Path, what: str, remedy: str) -> None:
    """Makes sure that a file can have this name, before anything is done for what it is to hold.

    Args:
        path: the file; it need not exist.
        what: it is, for the message: "the log".
        remedy: how another one is named, for the message: "another file with -o".

    Raises:
        UserError: the name of a folder alone, too long a name, or one that the system does not take.
    """
    if path.name in ("", ".."):
        raise UserError(f"{path}: is a folder, expected a file for {what}; name {remedy}")
    size, most = len(os.fsencode(path.name)), _NAME_MAX - len(_PART.format(""))
    if size > most:
        raise UserError(f"{path}: the name of {what} has {size} bytes, limit {most}; name {remedy}")
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError):
        pass
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise UserError(f"{path}: cannot be used for {what}: {why}; name {remedy}") from error


def refuse_links(path: Path, what: str) -> None:
    """Makes sure that a name leads to no other file.

    Args:
        path: the file that is to be written; it need not exist.
        what: it is, for the message: "the log".

    Raises:
        UserError: it is a symbolic link, no plain file, or a file with other names.
    """
    try:
        found = path.lstat()
    except (OSError, ValueError):
        return  # whoever opens it says why it cannot be
    if stat.S_ISLNK(found.st_mode):
        raise UserError(
            f"{path}: is a symbolic link to {os.readlink(path)}, and {what} is not written through links; remove the"
            " link, or name the file itself"
        )
    if stat.S_ISDIR(found.st_mode):
        raise UserError(f"{path}: is a folder, expected a file for {what}; name another file")
    if not stat.S_ISREG(found.st_mode):
        raise UserError(f"{path}: is no plain file, expected one for {what}; name a file on a disk")
    if found.st_nlink > 1:
        raise UserError(
            f"{path}: has {found.st_nlink} names (hard links), limit 1, and {what} would change them all; name another"
            " file"
        )


def claim(path: Path, what: str, remedy: str, *, ours: Callable[[], bool], force: bool | None) -> bool:
    """Makes sure that a command may write a file: none replaces what it did not make, unless it is told to.

    Args:
        path: the file.
        what: it is, for messages: "the page".
        remedy: how another place is named, for messages: "another folder with -o".
        ours: whether the file that is there was made by the same command and can be made again; asked where one is.
        force: replace it whatever it is; None where the command has no --force.

    Returns:
        Whether a file that is there will be replaced.

    Raises:
        UserError: no name for a file, a link, or a file that is to be kept.
    """
    require_name(path, what, remedy)
    refuse_links(path, what)
    if not path.exists():
        return False
    if not force and not ours():
        last = "move it away" if force is None else "move it away, or replace it with --force"
        raise UserError(f"{path}: exists, and is not what this command would make again; name {remedy}, {last}")
    return True


def open_alone(path: Path, what: str, *, new: bool) -> tuple[int, bool]:
    """Opens a file for writing that nobody else writes at the same time; nothing of what is in it is lost by that.

    Args:
        path: the file.
        what: it is, for messages: "the log".
        new: whether it must not exist yet.

    Returns:
        Its descriptor, for reading and writing, locked until it is closed, however the program ends; and whether the
        file was made just now.

    Raises:
        UserError: a link, another program that writes it, a file that is there, or one that cannot be made.
    """
    refuse_links(path, what)
    descriptor, made = -1, True
    try:
        try:
            descriptor = os.open(path, os.O_RDWR | _MADE, 0o666)
        except FileExistsError:
            if new:
                raise
            made = False
            flags = os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
            descriptor = os.open(path, flags)
        _lock(descriptor, needed=not made)
        if not os.path.samestat(os.fstat(descriptor), path.lstat()):
            raise BlockingIOError
        refuse_links(path, what)
    except (OSError, ValueError, UserError) as error:
        if descriptor >= 0:
            os.close(descriptor)
        if isinstance(error, UserError):
            raise
        raise UserError(_why_not(path, what, error)) from error
    return descriptor, made


def _lock(descriptor: int, *, needed: bool) -> None:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno not in _NO_LOCKS or needed:
            raise  # a disk without locks: a file that was made just now is this program's alone anyway


def _why_not(path: Path, what: str, error: OSError | ValueError) -> str:
    if isinstance(error, BlockingIOError):
        return f"{path}: another program is writing it; wait until it has ended, or name another file"
    if isinstance(error, FileExistsError):
        return f"{path}: exists and is not written over; name another file or move it away"
    if isinstance(error, OSError) and error.errno in _NO_LOCKS:
        return f"{path}: exists on a disk on which files cannot be locked; name a file that is not there yet"
    reason = error.strerror if isinstance(error, OSError) and error.strerror else error
    return f"{path}: cannot create {what}: {reason}; give a file that can be written"


@contextlib.contextmanager
def alone_in(folder: Path, what: str) -> Iterator[None]:
    """Keeps other programs of this kind out of a folder while the block runs; makes the folder.

    Args:
        folder: in which this program writes.
        what: it writes, for messages: "the campaign".

    Raises:
        UserError: another one is in it, or it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{folder}: cannot be made: {error.strerror or error}; give another folder") from error
    descriptor, _ = open_alone(folder / ".lock", what, new=False)
    try:
        yield
    finally:
        os.close(descriptor)


def write_whole(path: Path, content: bytes, *, mode: int = 0o666, durable: bool = True) -> None:
    """Writes a file so that there is always a whole one, also after a power cut: into a new file that takes the name.

    Args:
        path: the file; one that is there is replaced.
        content: all of it.
        mode: of the new file, before the process's mask.
        durable: whether to wait until it is on the disk.

    Raises:
        OSError: it cannot be written, or is a symbolic link; what was there before is left as it was.
    """
    if path.is_symlink():
        raise OSError(errno.ELOOP, "is a symbolic link, and nothing is written through links; remove it")
    part = path.with_name(_PART.format(path.name))
    with contextlib.suppress(FileNotFoundError):
        part.unlink()  # of a program that was killed; a link goes, and what it leads to stays
    descriptor = os.open(part, os.O_WRONLY | _MADE, mode)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(content)
            file.flush()
            if durable:
                os.fsync(descriptor)
        part.replace(path)
    except BaseException:  # Ctrl-C too
        with contextlib.suppress(OSError):
            part.unlink()
        raise
    if durable:
        sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Brings the names in a folder to the disk, where the system can."""
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
