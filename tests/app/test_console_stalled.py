"""A console whose browser stalls: it costs the flight nothing, and the console gives the page up."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from groundstation.app.console.viewers import Viewers
from groundstation.app.flying import fly_dry
from groundstation.app.order_socket import prepare_folder
from groundstation.app.output import Output
from groundstation.app.resources import find_config
from groundstation.app.session import Session
from groundstation.core.phases import Phase
from groundstation.mission.plan.reading import load_mission
from sitl.world import World
from tests.app.browser import chromium, opened
from tests.app.test_order_socket import Desk

_ROOT = Path(__file__).parents[2]
_SECOND_NS = 1_000_000_000
_PER_S, _GIVEN_UP_S = 20, 4.0 + 2.0 + 1.0  # updates of a page at most; see ``stalled_console``


def _below(pid: int) -> list[int]:
    """Processes that a process has begun, and those that they have."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            parent = int(path.read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()[1])
        except OSError:  # it has gone meanwhile
            continue
        if parent == pid:
            child = int(path.parent.name)
            found += [child, *_below(child)]
    return found


@contextmanager
def _stopped_browser() -> Iterator[None]:
    """Every process of the browser stands still, as on a tablet that was put away: it neither reads nor answers."""
    browser = [pid for pid in _below(os.getpid()) if b"chromium" in Path(f"/proc/{pid}/cmdline").read_bytes()]
    assert browser
    for pid in browser:
        os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        for pid in browser:
            os.kill(pid, signal.SIGCONT)


@pytest.mark.skipif(not Path("/proc/self/stat").is_file(), reason="finds the browser's processes in /proc")
def test_a_browser_that_stalls_costs_the_flight_not_a_byte_and_the_console_no_memory(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path_factory.mktemp("c")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    prepare_folder(folder / "gs")
    plan, out = load_mission(find_config(Path("hello1"), "missions")), Output(as_json=True)
    alone = fly_dry(out, plan, folder / "alone.tlog", (), seed=3, realtime=False)
    command = [sys.executable, "-m", "tests.app.stalled_console", str(folder / "gs"), str(os.getpid())]
    with (
        chromium() as browser,
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=_ROOT) as console,
        ExitStack() as after,
    ):
        after.callback(console.kill)
        assert console.stdin is not None
        assert console.stdout is not None
        url = console.stdout.readline()

        def kept() -> tuple[int, int]:
            print("?", file=console.stdin, flush=True)
            pages, messages = console.stdout.readline().split()  # type: ignore[union-attr]
            return int(pages), int(messages)

        desk = Desk(Path("/nowhere"))
        with Viewers(folder / "gs", desk.session.runner.plan) as viewers:
            viewers(desk.session, _SECOND_NS)
            tab = opened(browser, url)
            tab.shows("title", "first_flight2")  # what its first look was of

            waiting: list[int] = []

            def watch(session: Session, now_ns: int, _world: World) -> None:
                if session.runner.phase is Phase.TAKEOFF and not waiting:
                    assert tab.wrong == []
                    after.enter_context(_stopped_browser())
                    waiting.append(0)
                if waiting and now_ns % _SECOND_NS == 0:
                    waiting.append(kept()[1])

            shown = fly_dry(out, plan, folder / "shown.tlog", (), seed=3, realtime=False, console=True, watch=watch)
            assert waiting
            assert (folder / "shown.tlog").read_bytes() == (folder / "alone.tlog").read_bytes()
            np.testing.assert_equal({**shown, "log": ""}, {**alone, "log": ""})
            first, looks = viewers.snapshot(desk.session, _SECOND_NS), 0
            while (now := kept())[0]:  # a flight that goes on and on
                waiting.append(now[1])
                looks += 1
                goes_on = replace(first, t_s=looks / 20.0, pos_team_enu_m=first.pos_team_enu_m + looks * 1e-3)
                monkeypatch.setattr(viewers, "snapshot", lambda *_, at=goes_on: at)
                viewers(desk.session, (looks + 2) * _SECOND_NS)
            assert 0 < max(waiting) < _PER_S * _GIVEN_UP_S * 3
            assert now == (0, 0)
            assert viewers.lost == 0  # the console itself read on
