"""A log with its manifest, opened and begun together: whoever flies leaves both or neither."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from groundstation.core.own_files import open_alone, sync_folder
from groundstation.records.log_file import LogFile, Sink
from groundstation.records.manifest import Manifest, manifest_path, shares_system_ids, write_manifest
from groundstation.records.tlog import TlogWriter


@contextmanager
def recording(
    log: Path, manifest: Manifest, *, replace: bool, through: Callable[[LogFile], Sink] = lambda file: file
) -> Iterator[TlogWriter]:
    """Opens a log for this program alone, with its manifest beside it, so that a flight that ends badly leaves both.

    Args:
        log: the .tlog file; judged by ``manifest.claim_log`` before.
        manifest: as it is at the start.
        replace: whether a log that is there is replaced.
        through: what the log is written through, for example by a thread of its own; by default at once.

    Raises:
        UserError: links, another program that writes it, or files that cannot be written; a log that was there before
            is left as it was.
    """
    descriptor, made = open_alone(log, "the log", new=not replace)
    try:
        write_manifest(manifest_path(log), manifest)
    except BaseException:
        if made:
            with suppress(OSError):
                log.unlink()
        os.close(descriptor)
        raise
    sync_folder(log.parent)
    by_link = shares_system_ids(manifest.mission)
    with TlogWriter(through(LogFile(log, descriptor)), manifest.epoch_unix_us, by_link=by_link) as writer:
        yield writer
