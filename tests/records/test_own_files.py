"""Logs and what lies beside them: no link is followed, no two programs write one, a power cut costs a second."""

from __future__ import annotations

import errno
import io
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from groundstation.app.steady_file import SteadyFile
from groundstation.core.errors import UserError
from groundstation.core.own_files import alone_in, open_alone, write_whole
from groundstation.mavlink.keys import write_times
from groundstation.mavlink.signing import Times
from groundstation.records.log_file import LogFile
from groundstation.records.manifest import Manifest, manifest_path, write_manifest
from groundstation.records.notes import Tick
from groundstation.records.recording import recording
from groundstation.records.tlog import TlogReader, TlogWriter, read_tlog
from tests.app.commands import gs

EPOCH_US = 1_577_836_800_000_000
MANIFEST = Manifest(mission={"name": "a"}, epoch_unix_us=EPOCH_US, dry_run=True)
PRECIOUS = b"somebody else's bytes"
FLY = ["fly", "--mission", "first_flight2.yaml", "--dry-run", "--set", "limits.preflight_s=0.2", "--log"]
"""Refused with code 3 before the vehicles are ready: a dry run of a moment, with its log."""


@pytest.fixture
def precious(tmp_path: Path) -> Path:
    path = tmp_path / "elsewhere" / "precious"
    path.parent.mkdir()
    path.write_bytes(PRECIOUS)
    return path


NAMES = {
    "log": "a.tlog",
    "manifest": "a.manifest.json",
    "part of the manifest": ".a.manifest.json.part",
}


@pytest.mark.parametrize("what", NAMES)
@pytest.mark.parametrize("dangling", [False, True])
def test_nothing_is_written_through_a_link(
    what: str, *, dangling: bool, precious: Path, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    if dangling:
        precious.unlink()
    link = tmp_path / NAMES[what]
    link.symlink_to(precious)
    code, _, err = gs([*FLY, str(tmp_path / "a.tlog")], monkeypatch, capsys)
    words = " ".join(err.split())
    if "part" in what:  # the rest of a killed program, or somebody's trap: it goes, and where it leads stays
        assert code == 3
    else:
        assert code == 2
        assert f"is a symbolic link to {precious}" in words
        assert link.is_symlink()
    assert (not precious.exists()) if dangling else precious.read_bytes() == PRECIOUS


def test_no_file_is_written_through_a_link_in_any_other_way(precious: Path, tmp_path: Path) -> None:
    link, hard = tmp_path / "a.tlog", tmp_path / "b.tlog"
    link.symlink_to(precious)
    os.link(precious, hard)
    writers: list[Callable[[Path], object]] = [
        lambda path: TlogWriter(path, EPOCH_US),
        lambda path: open_alone(path, "the log", new=False),
        lambda path: write_whole(path, b"new"),
        lambda path: write_manifest(path, MANIFEST),
        lambda path: write_times(path, Times(), 0, durable=False),
    ]
    for write in writers:
        with pytest.raises((UserError, OSError), match="symbolic link"):
            write(link)
    with pytest.raises(UserError, match=r"has 2 names \(hard links\), limit 1"):
        TlogWriter(hard, EPOCH_US)
    assert precious.read_bytes() == PRECIOUS
    os.mkfifo(tmp_path / "c.tlog")
    with pytest.raises(UserError, match="is no plain file"):
        TlogWriter(tmp_path / "c.tlog", EPOCH_US)


def test_a_folder_may_be_a_link(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "flights").symlink_to(tmp_path / "disk")
    with recording(tmp_path / "flights" / "a.tlog", MANIFEST, replace=False) as log:
        log.tick(0, 1)
    assert list(read_tlog(tmp_path / "disk" / "a.tlog")) == [Tick(0, 1)]


HOLDER = """
import sys
from pathlib import Path
from groundstation.core.own_files import alone_in
from groundstation.records.manifest import Manifest
from groundstation.records.recording import recording
path = Path(sys.argv[1])
with recording(path, Manifest(mission={"name": "first"}, epoch_unix_us=1, dry_run=True), replace=True) as log, \
        alone_in(path.parent / "campaign", "the campaign"):
    log.tick(0, 1)
    log.flush()
    print("there", flush=True)
    sys.stdin.read()
"""


def test_two_programs_write_no_one_log_and_a_killed_one_leaves_no_lock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.tlog"
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as first:
        assert first.stdout is not None
        assert first.stdout.readline() == b"there\n"
        before = path.read_bytes(), manifest_path(path).read_bytes()
        code, _, err = gs([*FLY, str(path), "--force"], monkeypatch, capsys)
        assert code == 2
        assert f"{path}: another program is writing it; wait until it has ended, or name another file" in " ".join(
            err.split()
        )
        assert (path.read_bytes(), manifest_path(path).read_bytes()) == before
        with pytest.raises(UserError, match="another program is writing it"), alone_in(tmp_path / "campaign", "it"):
            pass
        assert len(list(read_tlog(path))) == 1  # reading is free
        first.send_signal(signal.SIGKILL)
        first.wait()
    assert gs([*FLY, str(path), "--force"], monkeypatch, capsys)[0] == 3
    with alone_in(tmp_path / "campaign", "it"):
        pass


def test_a_manifest_that_cannot_be_written_costs_no_log_that_was_there(tmp_path: Path) -> None:
    path = tmp_path / "a.tlog"
    with recording(path, MANIFEST, replace=False) as log:
        log.tick(0, 1)
    before = path.read_bytes()
    (tmp_path / ".a.manifest.json.part").mkdir()
    with pytest.raises(UserError, match="cannot write the manifest"), recording(path, MANIFEST, replace=True):
        pass
    assert path.read_bytes() == before
    (tmp_path / ".b.manifest.json.part").mkdir()
    with pytest.raises(UserError, match="cannot write"), recording(tmp_path / "b.tlog", MANIFEST, replace=False):
        pass
    assert not (tmp_path / "b.tlog").exists()


class SlowDisk:
    """An fsync that lasts until it is let go, and what the file held when each began."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.held: list[bytes] = []
        self.began, self.go = threading.Semaphore(0), threading.Semaphore(0)

    def sync(self, _descriptor: int) -> None:
        assert threading.current_thread() is not threading.main_thread()
        self.held.append(self.path.read_bytes())
        self.began.release()
        assert self.go.acquire(timeout=30)


def log_file(path: Path) -> LogFile:
    return LogFile(path, open_alone(path, "the log", new=False)[0])


def test_every_second_reaches_the_disk_and_no_tick_waits_for_it(tmp_path: Path) -> None:
    path = tmp_path / "a.tlog"
    disk = SlowDisk(path)
    writer = TlogWriter(SteadyFile(log_file(path), disk.sync), EPOCH_US)
    assert disk.began.acquire(timeout=30)  # the first sync hangs; everything below has to go on
    for number in range(1, 251):  # five seconds of ticks
        writer.tick(number * 20_000_000, number)
    assert writer.problem is None
    assert len(disk.held) == 1
    disk.go.release()
    assert disk.began.acquire(timeout=30)  # one sync for all that came in the meantime
    ticks = [record.number for record in TlogReader(disk.held[1]) if isinstance(record, Tick)]
    assert ticks == list(range(1, 251))[: len(ticks)]
    assert len(ticks) >= 200  # all but the last second
    disk.go.release(100)
    writer.close()
    assert [record.number for record in read_tlog(path) if isinstance(record, Tick)] == list(range(1, 251))
    assert disk.held[-1] == path.read_bytes()


def test_before_arming_a_disk_that_takes_nothing_is_noticed_and_a_full_one_too(tmp_path: Path) -> None:
    class Full(LogFile):
        def write(self, data: bytes | memoryview, /) -> int:
            raise OSError(errno.ENOSPC, "No space left on device")

    path = tmp_path / "a.tlog"
    writer = TlogWriter(SteadyFile(Full(path, open_alone(path, "the log", new=False)[0])), EPOCH_US)
    writer.tick(0, 1)
    writer.flush()
    assert writer.problem == f"{path}: recording stopped: No space left on device"
    disk = SlowDisk(tmp_path / "b.tlog")
    slow = TlogWriter(SteadyFile(log_file(disk.path), disk.sync), EPOCH_US)
    assert disk.began.acquire(timeout=30)
    slow.tick(0, 1)
    slow.flush()
    assert slow.problem == f"{disk.path}: recording stopped: the disk has taken nothing for 0.2 s"
    disk.go.release(100)
    slow.close()


def test_how_late_the_disk_is(tmp_path: Path) -> None:
    now = [0.0]
    disk = SlowDisk(tmp_path / "a.tlog")
    file = SteadyFile(log_file(disk.path), disk.sync, lambda: now[0])
    file.write(b"abc")
    assert disk.began.acquire(timeout=30)
    now[0] = 7.5
    assert file.late_s() == 7.5
    disk.go.release(100)
    file.close()
    assert file.late_s() == 0.0


def test_a_flight_on_vehicles_syncs_its_log_every_second_by_a_thread_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nobody answers on these links: three seconds of preflight, recorded as a flight is."""
    threads: list[str] = []
    fsync = os.fsync

    def count(descriptor: int) -> None:
        threads.append(threading.current_thread().name)
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", count)
    sets = [f"vehicles.{k}.link=udpin://127.0.0.1:{45_871 + k}" for k in range(2)] + ["limits.preflight_s=3"]
    options = [part for item in sets for part in ("--set", item)]
    code, _, _ = gs(
        ["fly", "--mission", "first_flight2.yaml", *options, "--log", str(tmp_path / "a.tlog")], monkeypatch, capsys
    )
    assert code == 3
    assert threads.count("log") >= 3
    assert io.BytesIO((tmp_path / "a.tlog").read_bytes()).getbuffer().nbytes > 1000


def test_ctrl_c_in_the_middle_of_a_file_leaves_the_old_one_and_nothing_beside_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(_descriptor: int) -> None:
        raise KeyboardInterrupt

    write_whole(tmp_path / "file", b"old")
    monkeypatch.setattr(os, "fsync", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_whole(tmp_path / "file", b"new")
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [("file", b"old")]
