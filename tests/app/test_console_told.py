"""What a page tells of snapshots that a test makes up, in a real browser: alarms, preflight."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import expect

from groundstation.app.check_screen import COLUMNS
from groundstation.app.console.snapshot import AIRBORNE, LOST, Snapshot, encode
from groundstation.app.console.viewers import Viewers
from groundstation.core.phases import Phase
from tests.app.browser import SOFTWARE_GL, chromium, opened
from tests.app.test_order_socket import Desk

_ROOT = Path(__file__).parents[2]
_NO_SOUND = "alarm: this browser makes no sound before the page was clicked"
_COUNTS_SOUNDS = """
  window.sounds = 0;
  window.AudioContext = class {
    currentTime = 0; state = "running";
    createOscillator() { return { connect() {}, frequency: {}, stop() {}, start() { window.sounds++; } }; }
  };
"""


_SCENE = """(() => {
  const name = Object.keys(window).find((key) => key.startsWith("scene_c"));
  const scene = name && getElement(+name.slice(7));
  const meshes = scene ? [...scene.objects.values()].map((item) => item.mesh).filter((mesh) => mesh) : [];
  const bodies = meshes.filter((mesh) => mesh.isInstancedMesh);
  return {
    counts: bodies.map((mesh) => mesh.count).join(),
    places: bodies.map((mesh) => [...mesh.instanceMatrix.array.slice(0, 16 * mesh.count)]),
    colours: bodies.map((mesh) => (mesh.instanceColor ? [...mesh.instanceColor.array.slice(0, 3 * mesh.count)] : [])),
    lines: meshes.filter((mesh) => mesh.isLineSegments).map((mesh) => mesh.geometry.attributes.position.count / 2),
    calls: scene ? scene.renderer.info.render.calls : 0,
  };
})()"""
"""What three.js has of bodies and lines."""


@contextmanager
def console(folder: Path) -> Iterator[tuple[str, Callable[[Snapshot], None]]]:
    """Its address, and what sends it a snapshot."""
    command = [sys.executable, "-m", "tests.app.bare_console", str(folder), str(os.getpid())]
    with subprocess.Popen(command, cwd=_ROOT, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            url = process.stdout.readline().strip()
            (listens,) = folder.glob("*.view")
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as out:

                def send(snapshot: Snapshot) -> None:
                    out.sendto(encode(snapshot), str(listens))

                yield url, send
        finally:
            process.kill()


@pytest.fixture
def quiet() -> Snapshot:
    desk = Desk(Path("/nowhere"))
    return Viewers(Path("/nowhere"), desk.session.runner.plan).snapshot(desk.session, desk.now_ns)


def alarmed(snapshot: Snapshot, *times_s: float) -> Snapshot:
    """At the last of these times, with an alarm at each."""
    notes = tuple((t_s, "alarm", f"wind at {t_s:.0f}") for t_s in times_s)
    words = replace(snapshot.words, phase="hold", notes=notes)
    return replace(snapshot, t_s=times_s[-1] + 0.1, words=words)


def test_an_alarm_sounds_when_it_happens_and_not_when_a_page_is_opened_later(
    tmp_path_factory: pytest.TempPathFactory, quiet: Snapshot
) -> None:
    folder = tmp_path_factory.mktemp("c")
    with console(folder) as (url, send), chromium() as browser:
        send(replace(alarmed(quiet, 50.0), t_s=100.0))
        tab = opened(browser, url, script=_COUNTS_SOUNDS)
        notes = tab.page.get_by_test_id("notes")
        expect(notes).to_contain_text("wind at 50")
        send(alarmed(quiet, 50.0, 101.0))
        tab.page.wait_for_function("window.sounds > 0")
        tab.page.keyboard.press("m")
        expect(tab.page.get_by_role("switch", name="sound")).not_to_be_checked()
        send(alarmed(quiet, 50.0, 101.0, 102.0))
        expect(notes).to_contain_text("wind at 102")
        tab.page.keyboard.press("m")
        expect(tab.page.get_by_role("switch", name="sound")).to_be_checked()
        send(alarmed(quiet, 50.0, 101.0, 102.0, 103.0))
        tab.page.wait_for_function("window.sounds > 1")
        send(alarmed(quiet, 50.0, 101.0, 102.0, 103.0, 104.0))
        tab.page.wait_for_function("window.sounds > 2")
        assert tab.page.evaluate("window.sounds") == 3  # of five: one was long past, and one was muted
        # As browsers do with a page that nobody has touched; here they take the test's own questions for a touch.
        silent = opened(browser, url, script=_COUNTS_SOUNDS.replace("running", "suspended"))
        expect(silent.page.get_by_test_id("notes")).to_contain_text("wind at 104")
        silent.shows("answer", _NO_SOUND)  # of this moment, it is told though the page was opened after it
        assert tab.wrong == silent.wrong == []


def test_who_is_not_ready_stands_beside_what_to_do(tmp_path_factory: pytest.TempPathFactory, quiet: Snapshot) -> None:
    folder = tmp_path_factory.mktemp("c")
    state = COLUMNS.index("state")

    def found(state_of_two: str, remedy: str) -> Snapshot:
        rows = [[str(vehicle)] + ["-"] * (len(COLUMNS) - 1) + [""] for vehicle in (1, 2)]
        rows[0][state], rows[1][state], rows[1][-1] = "ready", state_of_two, remedy
        words = replace(quiet.words, phase=Phase.CONNECT.value, checks=tuple(map(tuple, rows)))
        return replace(quiet, words=words)

    with console(folder) as (url, send), chromium() as browser:
        send(found("not ready", "battery 12 %, charge it"))
        tab = opened(browser, url, width=820, height=1180)
        heads = tab.page.get_by_test_id("preflight-table").get_by_role("columnheader")
        expect(heads).to_have_count(len(COLUMNS) + 1)
        for at, head in enumerate(("vehicle", "state", "what is wrong, and what to do")):
            expect(heads.nth(at)).to_have_accessible_name(head)
        remedy = tab.page.get_by_role("cell", name="battery 12 %, charge it")
        expect(remedy).to_be_in_viewport(ratio=1.0)  # on a tablet, without scrolling
        tab.shows("preflight-team", "1 of 2 ready")
        send(found("ready", ""))
        tab.shows("preflight-team", "2 of 2 ready")
        expect(heads).to_have_count(len(COLUMNS))
        assert tab.wrong == []


def test_the_scene_has_everybody_where_they_are_and_in_their_colours(
    tmp_path_factory: pytest.TempPathFactory, quiet: Snapshot
) -> None:
    folder = tmp_path_factory.mktemp("c")
    nowhere = replace(quiet, pos_team_enu_m=np.full((2, 3), np.nan))
    here_m = np.array([[1.0, 2.0, 3.0], [-4.0, 5.0, 6.0]])
    with console(folder) as (url, send), chromium(*SOFTWARE_GL) as browser:
        send(nowhere)
        tab = opened(browser, url.replace("/flat?", "/?"))
        pads, bodies, calm, told, ghosts = range(5)
        drawn = f"({_SCENE}).counts === '2,0,0,0,0' && ({_SCENE}).calls > 0"
        tab.page.wait_for_function(drawn)
        send(replace(quiet, t_s=quiet.t_s + 1.0, pos_team_enu_m=here_m, state=np.array([AIRBORNE, AIRBORNE | LOST])))
        tab.page.wait_for_function(f"({_SCENE}).counts === '2,2,1,1,2'")
        tab.page.wait_for_function(f"({_SCENE}).lines.includes(12)")  # the fence
        seen = tab.page.evaluate(_SCENE)
        for which, places_m in ((pads, quiet.pads_enu_m), (bodies, here_m), (calm, here_m[:1]), (told, here_m[1:])):
            matrices = np.array(seen["places"][which]).reshape(-1, 4, 4)  # three.js keeps columns
            np.testing.assert_allclose(matrices[:, 3, :3], places_m, atol=1e-4)
        colours = np.array(seen["colours"][bodies]).reshape(-1, 3)
        assert colours[0].argmax() == 2  # blue
        assert colours[1].argmax() == 0  # vermilion
        assert len(seen["places"][ghosts]) == 2 * 16
        assert tab.wrong == []
